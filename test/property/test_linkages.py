# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What holds for every linkage, on random ones: symmetries of mechanics."""

from dataclasses import replace
from functools import partial

from closedloop_dynamics.mechanism.mechanism import PRISMATIC
from hypothesis import given, settings, strategies
import numpy as np
import pytest

from ..codegen.engine import Engine
from ..reference.compare import assert_agree
from ..reference.linkages import random_linkage
from ..reference.scenes import simulated

# Some compile for minutes on a busy machine.
pytestmark = pytest.mark.timeout(1200)
GRAVITY = (1.3, -9.0)
# Drawn again from the same numbers in every run; compiled code has no deadline.
FIXED = settings(max_examples=20, derandomize=True, deadline=None, database=None)
SHORT = settings(FIXED, max_examples=8)
# Each is unrolled once, for all properties: that takes longer than looking at it.
LINKAGES = strategies.integers(0, 11)
# Solves of well-conditioned linkages, some digits lost.
SOLVE = 1e-8


def drawn(number):
    """Return (rng, mechanism, q, qd, tau) of a number."""
    rng = np.random.default_rng([17, number])
    mechanism, q, qd = random_linkage(
        rng, n_subsystems=1 + number % 3, max_cuts=1 + number % 4, shuffle=number % 2 == 1)
    return rng, mechanism, q, qd, rng.normal(size=len(q))


simulation = partial(simulated, gravity=GRAVITY, step_size=2e-4)


@FIXED
@given(LINKAGES)
def test_power_of_the_torques_is_the_rate_of_the_energy(number):
    _, mechanism, q, qd, tau = drawn(number)
    engine = Engine(mechanism, GRAVITY)
    qdd, _ = engine.forward_dynamics(q, qd, tau)
    # qd . (I qdd + c) is the rate of kinetic and potential energy; the loops do no work.
    needed = engine.tree_torque(q, qd, qdd)
    assert_agree(qd @ needed, tau @ qd, SOLVE, smallest=np.abs(qd * needed).max())


@SHORT
@given(LINKAGES)
def test_time_reversed_returns_to_the_start(number):
    _, mechanism, q, qd, _ = drawn(number)
    run = simulation(mechanism, q, qd)
    tau = np.zeros(len(q))
    run.advance(tau, 50)
    run.set_state(run.position, -run.velocity)
    run.advance(tau, 50)
    assert_agree(run.position, q, 1e-8, smallest=1.0)
    assert_agree(-run.velocity, qd, 1e-7, smallest=1.0)


def mirrored(mechanism):
    """Return the mechanism reflected at the x axis, and the sign of each coordinate."""
    def flip(point):
        return (point[0], -point[1])
    signs = np.array([1.0 if joint.type == PRISMATIC else -1.0 for joint in mechanism.joints])
    return replace(
        mechanism,
        bodies=tuple(replace(b, center_of_mass=flip(b.center_of_mass)) for b in mechanism.bodies),
        joints=tuple(replace(j, position=flip(j.position), angle=-j.angle)
                     for j in mechanism.joints),
        cut_joints=tuple(replace(c, point_a=flip(c.point_a), point_b=flip(c.point_b),
                                 angle=-c.angle) for c in mechanism.cut_joints)), signs


@FIXED
@given(LINKAGES)
def test_mirrored_mechanism_mirrors_its_motion(number):
    _, mechanism, q, qd, tau = drawn(number)
    expected, _ = Engine(mechanism, GRAVITY).forward_dynamics(q, qd, tau)
    other, signs = mirrored(mechanism)
    qdd, _ = Engine(other, (GRAVITY[0], -GRAVITY[1])).forward_dynamics(
        signs * q, signs * qd, signs * tau)
    assert_agree(signs * qdd, expected, SOLVE)


def rescaled(mechanism, length, mass):
    """Return the mechanism in other units, and the unit of each coordinate."""
    def scaled(point):
        return tuple(length * value for value in point)
    units = np.array([length if joint.type == PRISMATIC else 1.0 for joint in mechanism.joints])
    return replace(
        mechanism,
        bodies=tuple(replace(b, mass=mass * b.mass, inertia=mass * length ** 2 * b.inertia,
                             center_of_mass=scaled(b.center_of_mass)) for b in mechanism.bodies),
        joints=tuple(replace(j, position=scaled(j.position)) for j in mechanism.joints),
        cut_joints=tuple(replace(c, point_a=scaled(c.point_a), point_b=scaled(c.point_b))
                         for c in mechanism.cut_joints)), units


@FIXED
@given(LINKAGES, strategies.floats(-3.0, 3.0), strategies.floats(-6.0, 6.0),
       strategies.floats(-3.0, 3.0))
def test_other_units_give_the_same_motion(number, length, mass, time):
    length, mass, time = 10.0 ** length, 10.0 ** mass, 10.0 ** time
    _, mechanism, q, qd, tau = drawn(number)
    expected, _ = Engine(mechanism, GRAVITY).forward_dynamics(q, qd, tau)
    other, units = rescaled(mechanism, length, mass)
    force = mass * length ** 2 / (time ** 2 * units)
    qdd, _ = Engine(other, np.multiply(GRAVITY, length / time ** 2)).forward_dynamics(
        units * q, units * qd / time, force * tau)
    assert_agree(qdd * time ** 2 / units, expected, SOLVE)


@FIXED
@given(LINKAGES)
def test_names_and_order_change_nothing(number):
    rng, mechanism, q, qd, tau = drawn(number)
    expected, forces = Engine(mechanism, GRAVITY).forward_dynamics(q, qd, tau)
    names = [body.name for body in mechanism.bodies]
    other_names = {'ground': 'ground', **dict(zip(names, rng.permutation(
        [f'part_{k}' for k in range(len(names))]).tolist()))}
    order = rng.permutation(len(q))
    cuts = rng.permutation(len(mechanism.cut_joints))
    joints = tuple(replace(
        mechanism.joints[k], name=f'axis_{k}', parent=other_names[mechanism.joints[k].parent],
        child=other_names[mechanism.joints[k].child]) for k in order)
    other = replace(
        mechanism, joints=joints,
        bodies=tuple(replace(mechanism.bodies[k], name=other_names[names[k]])
                     for k in rng.permutation(len(names))),
        cut_joints=tuple(replace(
            mechanism.cut_joints[k], name=f'loop_{k}',
            body_a=other_names[mechanism.cut_joints[k].body_a],
            body_b=other_names[mechanism.cut_joints[k].body_b]) for k in cuts))
    qdd, lam = Engine(other, GRAVITY, unrolled=False).forward_dynamics(
        q[order], qd[order], tau[order])
    assert_agree(qdd, expected[order], SOLVE)
    assert_agree(np.sort(np.abs(lam)), np.sort(np.abs(forces)), SOLVE)


@SHORT
@given(LINKAGES)
def test_loops_stay_closed_and_energy_stays(number):
    _, mechanism, q, qd, _ = drawn(number)
    run = simulation(mechanism, q, qd)
    energy = run.energy
    run.advance(np.zeros(len(q)), 100)
    assert run.closure < 1e-10
    assert abs(run.energy - energy) < 1e-7 * max(1.0, abs(energy))
