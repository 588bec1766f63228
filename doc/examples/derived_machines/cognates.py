# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Cognates of a four-bar linkage: the two others that trace the same coupler curve.

The theorem of Roberts and Chebyshev, in complex numbers. Input link A0 A, coupler A B, output link
B0 B, and P = A + k (B - A) on the coupler; the third pivot is C0 = A0 + k (B0 - A0). One cognate
has the links k (B - A) from A0, k (A - A0), and k (B - B0) from C0; the other one (1 - k) (A - A0)
from C0, (1 - k) (B0 - B), and P - B from B0.
"""

import cmath

from closedloop_dynamics.effects.gravity import Gravity
from closedloop_dynamics.effects.registry import effect_type
from closedloop_dynamics.formats.pose import poses_at
from closedloop_dynamics.kinematics.assembly import Assembler
from closedloop_dynamics.kinematics.geometry import Geometry
from closedloop_dynamics.mechanism.four_bar import bars
from closedloop_dynamics.mechanism.mechanism import (
    Body, CutJoint, GROUND, Joint, Mechanism, Point, REVOLUTE)
from closedloop_dynamics.scene.records import Initial, Scene
from variant import Variant

# Share of a length that is rounding.
NOTHING = 1e-9
JOINTS = 'input_joint', 'coupler_joint', 'output_joint'


def cognates(scene, point=None):
    """
    Return the cognates of a four-bar linkage.

    Their links are uniform rods with as much mass to a length as those of the linkage have
    together; they begin at rest in the same position of the point, under the same gravity.

    Parameters
    ----------
    scene : scene_records.Scene
        Of four revolute joints in one loop, in the plane.
    point : str, optional
        A point of its coupler; the first one when not given.

    Returns
    -------
    tuple of 2 variant.Variant
        The first one is driven at its shortest link, which turns round where that of the linkage
        does; the second one at its input link, which turns as that of the linkage does.

    Raises
    ------
    ValueError
        For other machines, no point of the coupler, and a point on one of its pins.
    AssemblyError
        Where the loop cannot be closed.

    """
    mechanism = scene.mechanism
    links = _links(mechanism)
    if links is None:
        raise ValueError('expected a four-bar linkage, four revolute joints in one loop in the '
                         f'plane, got {mechanism.name}')
    _, (crank, *_), (coupler, start, end, _), (rocker, *_) = links
    names = [one.name for one in mechanism.points if one.body == coupler]
    if not names or point not in (None, *names):
        raise ValueError(f'point: expected a point of the coupler, {coupler} '
                         f'({", ".join(names) or "it has none"}), got {point!r}')
    point = point or names[0]
    position = Assembler(mechanism, Geometry(mechanism).equations).positions(
        scene.initial.position, scene.initial.hold)

    def place(body, own):
        return complex(*poses_at(mechanism, position)[body].place((*own, 0.0))[:2])

    fixed_in, pin_in, pin_out, fixed_out = (
        place(links[1][0], links[1][1]), place(coupler, start), place(coupler, end),
        place(rocker, links[3][2]))
    traced = place(coupler, mechanism.point(point).position)
    share = (traced - pin_in) / (pin_out - pin_in)
    if min(abs(share), abs(1.0 - share)) < NOTHING:
        raise ValueError(f'point: expected one beside the pins of the coupler, got {point}, which '
                         'traces a circle')
    third = fixed_in + share * (fixed_out - fixed_in)
    line = sum(body.mass for body in mechanism.bodies) / (
        abs(pin_in - fixed_in) + abs(pin_out - pin_in) + abs(pin_out - fixed_out))
    first = fixed_in + traced - pin_in, third + share * (pin_out - fixed_out)
    second = third + (1.0 - share) * (pin_in - fixed_in), fixed_out + traced - pin_out
    pins = fixed_in, *first, third
    shortest = min(range(4), key=lambda k: abs(pins[k] - pins[k - 1]))
    return (_linkage(scene, 1, pins, traced, point, line, JOINTS[max(shortest - 1, 0)]),
            _linkage(scene, 2, (third, *second, fixed_out), traced, point, line, JOINTS[0]))


def _links(mechanism):
    """Return ``bars`` from the driven pivot on, or from the first one."""
    pivots = [joint.name for joint in mechanism.joints if joint.parent == GROUND]
    pivots += [cut.name for cut in mechanism.cut_joints if GROUND in (cut.body_a, cut.body_b)]
    driven = [name for name in pivots if name in mechanism.actuated_joints]
    return bars(mechanism, (driven or pivots or [None])[0])


def _linkage(scene, number, pins, traced, point, line, actuated):
    """Return the cognate of four pins, from pivot to pivot, as complex numbers."""
    steps = [end - start for start, end in zip(pins, pins[1:])]
    lengths = [abs(step) for step in steps]
    angles = [cmath.phase(steps[0]), cmath.phase(steps[1] / steps[0]), cmath.phase(-steps[2])]
    own = (traced - pins[1]) * abs(steps[1]) / steps[1]
    bodies = [Body(name, line * length, (0.5 * length, 0.0), line * length ** 3 / 12.0)
              if line > 0.0 else Body(name, 0.0, (0.0, 0.0), 0.0, massless=True)
              for name, length in zip(('input', 'coupler', 'output'), lengths)]
    joints = [Joint(name, REVOLUTE, parent, child, place, actuated=name == actuated)
              for name, (parent, child, place) in zip(JOINTS, (
                  (GROUND, 'input', (pins[0].real, pins[0].imag)),
                  ('input', 'coupler', (lengths[0], 0.0)),
                  (GROUND, 'output', (pins[3].real, pins[3].imag))))]
    mechanism = Mechanism(
        f'{scene.mechanism.name}_cognate_{number}', tuple(bodies), tuple(joints),
        (CutJoint('pin', REVOLUTE, 'coupler', 'output', (lengths[1], 0.0), (lengths[2], 0.0)),),
        (Point(point, 'coupler', (own.real, own.imag)),),
        f'Cognate {number} of {scene.name}: the same curve of {point}.')
    effects = {name: effect for name, effect in scene.effects.items() if type(effect) is Gravity}
    left_out = [f'effects.{name} ({effect_type(effect)})'
                for name, effect in scene.effects.items() if name not in effects]
    initial = Initial(tuple(angles), (0.0, 0.0, 0.0), (actuated,))
    return Variant(Scene(
        mechanism.name, None, mechanism.description, mechanism, initial, effects, scene.method,
        switched_off=tuple(name for name in scene.switched_off if name in effects)),
        ('the shapes and masses of the links, in whose place are uniform rods', *left_out))
