# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Planar machines of textbooks and papers, as scenes, with lengths of one's own."""

import math

from closedloop_dynamics import load_scene
import numpy as np

BAR = '{{mass: {mass}, center_of_mass: {center}, inertia: {inertia}}}'


def four_bar(folder, crank, coupler, rocker, base, *, angle=1.0, elbow=1.0, masses=(1.0, 1.0, 1.0),
             centers=None, point=None, gravity=0.0):
    """
    Return the scene of a four-bar linkage at a crank angle; ``elbow``: the side of its coupler.

    ``centers``: of masses, in the bars' frames; in their middle when not given. ``point``: of
    the coupler.
    """
    centers = centers or [(0.5 * length, 0.0) for length in (crank, coupler, rocker)]
    bars = [BAR.format(mass=mass, center=list(center), inertia=0.1 * mass)
            for mass, center in zip(masses, centers)]
    beta, psi = closed(crank, coupler, rocker, base, angle, elbow)
    x, y = point or (0.5 * coupler, 0.0)
    (folder / 'machine.yaml').write_text(f"""
name: four_bar_of_lengths
parameters: {{crank: {crank}, coupler: {coupler}, rocker: {rocker}, base: {base}}}
bodies: {{crank: {bars[0]}, coupler: {bars[1]}, rocker: {bars[2]}}}
joints:
  crank_joint: {{type: revolute, parent: ground, child: crank, position: [0, 0], actuated: true}}
  coupler_joint: {{type: revolute, parent: crank, child: coupler, position: [crank, 0]}}
  rocker_joint: {{type: revolute, parent: ground, child: rocker, position: [base, 0]}}
cut_joints:
  pin: {{type: revolute, body_a: coupler, point_a: [coupler, 0], body_b: rocker,
         point_b: [rocker, 0]}}
points:
  tool: {{body: coupler, position: [{x}, {y}]}}
""")
    (folder / 'scene.yaml').write_text(f"""
mechanism: machine.yaml
initial:
  position: {{crank_joint: {angle!r}, coupler_joint: {beta - angle!r}, rocker_joint: {psi!r}}}
  hold: [crank_joint]
effects: {{gravity: {{type: gravity, acceleration: [0.0, {-gravity}]}}}}
""")
    return load_scene(folder / 'scene.yaml')


def closed(crank, coupler, rocker, base, angle, elbow=1.0):
    """Return the angles of coupler and rocker in the world, by two circles."""
    pin = crank * np.exp(1j * angle)
    way = base - pin
    reach = (coupler ** 2 + abs(way) ** 2 - rocker ** 2) / (2.0 * coupler * abs(way))
    beta = np.angle(way) + elbow * math.acos(reach)
    psi = np.angle(pin + coupler * np.exp(1j * beta) - base)
    return float(beta), float(psi)


def three_rpr(folder, base, sides, legs):
    """
    Return the scene of a platform on three legs of given lengths, its start open.

    ``sides``: of the platform, P1 P2, P2 P3 and P3 P1; the driven joints are ``leg_1`` to
    ``leg_3``.
    """
    one, two, three = sides
    x = (one ** 2 + three ** 2 - two ** 2) / (2.0 * one)
    corners = [(0.0, 0.0), (one, 0.0), (x, math.sqrt(three ** 2 - x ** 2))]
    body = '{mass: 1.0, center_of_mass: [0.1, 0.0], inertia: 0.1}'
    bodies = ''.join(f'  {name}_{k}: {body}\n' for k in (1, 2, 3) for name in ('swing', 'rod'))
    joints = ''.join(f"""
  turn_{k}: {{type: revolute, parent: ground, child: swing_{k}, position: [{x}, {y}]}}
  leg_{k}: {{type: prismatic, parent: swing_{k}, child: rod_{k}, position: [0, 0],
            actuated: true}}""" for k, (x, y) in enumerate(base, 1))
    cuts = ''.join(f"""
  pin_{k}: {{type: revolute, body_a: platform, point_a: {list(corners[k - 1])}, body_b: rod_{k},
            point_b: [0, 0]}}""" for k in (2, 3))
    (folder / 'machine.yaml').write_text(f"""
name: three_rpr
bodies:
{bodies}  platform: {body}
joints: {joints}
  wrist: {{type: revolute, parent: rod_1, child: platform, position: [0, 0]}}
cut_joints: {cuts}
""")
    start = ', '.join(
        f'turn_{k}: {1.0 + 0.3 * k}, leg_{k}: {leg}' for k, leg in enumerate(legs, 1))
    (folder / 'scene.yaml').write_text(f"""
mechanism: machine.yaml
initial:
  position: {{{start}, wrist: 0.2}}
""")
    return load_scene(folder / 'scene.yaml')
