# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Sign and frame of the multipliers: Newton-Euler of single links, written out here.

The multiplier of a cut joint is the force that body B exerts on body A, in
world axes; its opposite acts on body B. Only accelerations are taken from the
kernels, and nothing from the twins but the closing of states.
"""

from dataclasses import replace

from closedloop_dynamics.mechanism.mechanism import Body, Mechanism
import numpy as np
import pytest

from .engine import Engine
from ..reference import cases, linkages, machines, special, states
from ..reference.compare import assert_agree, SOLVE
from ..reference.trees import body_frames

G = 9.81


def moment(arm, force):
    """Return the moment of a force at the end of an arm."""
    return arm[0] * force[1] - arm[1] * force[0]


def test_upright_four_bar_carries_half_its_coupler_on_each_leg():
    # Body A of the cut is the coupler: its right leg pushes it up.
    mechanism, q, qd = special.ladder(1, tilt=0.0, rate=0.0)
    _, lam = Engine(mechanism).forward_dynamics(q, qd, np.zeros(3))
    assert_agree(lam, [0.0, 0.5 * G], SOLVE)


def test_three_rrr_proximal_link_obeys_eulers_equation_as_body_b():
    rng, mechanism, q, qd = cases.drawn('three_rrr')
    tau = rng.normal(size=7)
    qdd, lam = Engine(mechanism).forward_dynamics(q, qd, tau)
    # 3 kg, 0.4 m, turning about its fixed end by theta_6.
    axis = np.array([np.cos(q[5]), np.sin(q[5])])
    torque = tau[5] + moment(0.2 * axis, (0.0, -3.0 * G)) + moment(0.4 * axis, -lam[:2])
    assert 3.0 * 0.4 ** 2 / 3.0 * qdd[5] == pytest.approx(torque, rel=SOLVE)


def test_scraper_crank_obeys_eulers_equation_as_body_a():
    rng, mechanism, q, qd = cases.drawn('carpet_scraper')
    tau = 5.0 * rng.normal(size=7)
    qdd, lam = Engine(mechanism).forward_dynamics(q, qd, tau)
    # 1.5 kg, 0.038 m, turning about O1 by theta_1.
    axis = np.array([np.cos(q[0]), np.sin(q[0])])
    terms = (tau[0], moment(0.019 * axis, (0.0, -1.5 * G)), moment(0.038 * axis, lam[:2]))
    assert 1.5 * 0.038 ** 2 / 3.0 * qdd[0] == pytest.approx(
        sum(terms), abs=SOLVE * np.abs(terms).max())


def test_scraper_link_7_obeys_eulers_equation_on_its_moving_pivot():
    rng, mechanism, q, qd = cases.drawn('carpet_scraper')
    tau = 5.0 * rng.normal(size=7)
    qdd, lam = Engine(mechanism).forward_dynamics(q, qd, tau)
    # Joints 4, 6, 7 in a row: lengths 0.39, 0.13, then the link of 2 kg and 0.26 m.
    angles, rates, turns = (np.cumsum(values[[3, 5, 6]]) for values in (q, qd, qdd))

    def acceleration(length, k):
        axis, normal = (np.array([np.cos(angles[k]), np.sin(angles[k])]),
                        np.array([-np.sin(angles[k]), np.cos(angles[k])]))
        return length * (turns[k] * normal - rates[k] ** 2 * axis)

    center = acceleration(0.39, 0) + acceleration(0.13, 1) + acceleration(0.13, 2)
    axis = np.array([np.cos(angles[2]), np.sin(angles[2])])
    inertia = 2.0 * 0.26 ** 2 / 12.0
    terms = (tau[6], moment(0.13 * axis, (0.0, -2.0 * G)), moment(0.26 * axis, lam[4:]))
    # About the pivot: spin about the centre of mass, and the moment of its acceleration.
    assert inertia * turns[2] + moment(0.13 * axis, 2.0 * center) == pytest.approx(
        sum(terms), abs=SOLVE * np.abs(terms).max())


def test_slider_obeys_newtons_equation_as_body_b():
    rng, mechanism, q, qd = cases.drawn('slider_crank')
    tau = rng.normal(size=3)
    qdd, lam = Engine(mechanism).forward_dynamics(q, qd, tau)
    assert 2.0 * qdd[2] == pytest.approx(tau[2] - lam[0], rel=SOLVE)


ROCKER = Body('rocker', 2.0, (0.2, 0.1), 0.3)
PIVOT = np.array([1.2, 0.3])


def rocker_held_by_an_arm(kind, rocker_is_a):
    """Return (rng, mechanism, q, qd): a three-link arm from the ground holds a rocker."""
    rng = np.random.default_rng([5, rocker_is_a])
    arm = ('upper', 'lower', 'hand')
    joints = [machines.revolute(f'joint_{child}', parent, child, (0.7 * (parent != 'ground'), 0.0))
              for parent, child in zip(('ground', *arm), arm)]
    joints.append(machines.revolute('joint_rocker', 'ground', 'rocker', tuple(PIVOT), 0.4))
    mechanism = Mechanism(
        'rocker', (*(machines.bar(name, 1.0, 0.7, 0.35) for name in arm), ROCKER), tuple(joints))
    q = np.array([0.3, 0.9, -0.7, 0.2])
    pair = ('rocker', 'hand') if rocker_is_a else ('hand', 'rocker')
    cut = linkages.closing_cut(rng, 'cut', kind, body_frames(mechanism, q), *pair)
    mechanism = replace(mechanism, cut_joints=(cut,))
    return rng, mechanism, q, states.project(mechanism, q, rng.normal(size=4))


@pytest.mark.parametrize('rocker_is_a', [True, False])
@pytest.mark.parametrize('kind', ['revolute', 'prismatic', 'fixed'])
def test_rocker_obeys_eulers_equation_under_each_type_of_cut(kind, rocker_is_a):
    rng, mechanism, q, qd = rocker_held_by_an_arm(kind, rocker_is_a)
    tau = rng.normal(size=4)
    qdd, lam = Engine(mechanism).forward_dynamics(q, qd, tau)
    cut = mechanism.cut_joints[0]
    rocker = np.array([[np.cos(0.4 + q[3]), -np.sin(0.4 + q[3])],
                       [np.sin(0.4 + q[3]), np.cos(0.4 + q[3])]])
    hand = q[:3].sum()
    # What body B exerts on A: a force at A's cut point, and a torque.
    if kind == 'prismatic':
        # Both frames differ by the angle of the slot, whose axis is at body B's plus that.
        axis = (hand if cut.body_b == 'hand' else 0.4 + q[3]) + cut.angle
        force, torque = lam[0] * np.array([-np.sin(axis), np.cos(axis)]), lam[1]
    else:
        force, torque = lam[:2], lam[2] if kind == 'fixed' else 0.0
    if rocker_is_a:
        place = rocker @ cut.point_a
    else:
        force, torque = -force, -torque
        wrist = sum(0.7 * np.array([np.cos(a), np.sin(a)]) for a in np.cumsum(q[:2]))
        cos, sin = np.cos(hand), np.sin(hand)
        place = wrist + np.array([[cos, -sin], [sin, cos]]) @ cut.point_a - PIVOT
    center = rocker @ ROCKER.center_of_mass
    terms = (tau[3], moment(center, (0.0, -2.0 * G)), moment(place, force), torque)
    inertia = ROCKER.inertia + ROCKER.mass * center @ center
    assert inertia * qdd[3] == pytest.approx(sum(terms), abs=SOLVE * np.abs(terms).max())
