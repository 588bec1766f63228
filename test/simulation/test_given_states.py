# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Dynamics of given states: at once from arrays, and the same from anything else."""

from dataclasses import replace
import gc

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.codegen.function_table import LEFT_OUT
from closedloop_dynamics.effects.registry import JointFriction
from closedloop_dynamics.mechanism.config import shipped_names
import numpy as np
import pytest

from ..reference import cases


def moving(name):
    """Return a simulation of a scene on its way, and torques of its drives."""
    simulation = Simulation.from_scene(name)
    torque = np.linspace(0.1, 0.3, len(simulation.actuated_joints))
    simulation.step(torque, 0.02)
    return simulation, torque


def close(found, expected, share=1e-10):
    """Assert that numbers agree to a share of the largest."""
    assert len(found) == len(expected)
    for one, other in zip(found, expected):
        assert one.shape == other.shape
        assert np.abs(one - other).max(initial=0.0) <= share * np.abs(other).max(initial=1.0)


@pytest.mark.parametrize('name', cases.only(cases.CLASSES, shipped_names('scenes')))
def test_arrays_lists_and_evaluators_give_the_same(name):
    simulation, torque = moving(name)
    q, qd = simulation.position, simulation.velocity
    given = simulation.forward_dynamics(q, qd, torque)
    # Lists take the path that checks everything in Python.
    close(given, simulation.forward_dynamics(q.tolist(), qd.tolist(), torque.tolist()))
    evaluate = simulation.evaluator()
    close((evaluate.q, evaluate.qd), (q, qd), 0.0)
    evaluate.tau[:] = torque
    evaluate()
    close((evaluate.acceleration, evaluate.multipliers), given)
    qdd = given[0]
    needed = simulation.inverse_dynamics(q.tolist(), qd.tolist(), qdd.tolist())
    assert simulation.data.inverse.find(q, qd, qdd)
    close((simulation.data.inverse.torque, simulation.data.inverse.lam), needed, 1e-9)


@pytest.mark.parametrize('name', ['three_rrr', 'bricard'])
def test_what_lies_in_memory_otherwise_gives_the_same(name):
    simulation, torque = moving(name)
    q, qd = simulation.position, simulation.velocity
    expected = simulation.forward_dynamics(q, qd, torque)
    read_only = q.copy()
    read_only.flags.writeable = False
    for other in (np.repeat(q, 2)[::2], q.astype(q.dtype.newbyteorder()), q.tolist(), tuple(q),
                  q.astype(object), read_only, memoryview(q.copy())):
        close(simulation.forward_dynamics(other, qd, torque), expected, 0.0)
    close(simulation.forward_dynamics(q, np.zeros(len(qd), dtype=int), torque),
          simulation.forward_dynamics(q, np.zeros(len(qd)), torque), 0.0)


def test_wrong_arrays_are_refused_as_lists_are():
    simulation = Simulation.from_scene('three_rrr')
    q, qd = simulation.position, simulation.velocity
    bad = q.copy()
    bad[2] = np.nan
    tau = np.zeros(3)
    for arguments, words in (
            ((bad, qd, tau), 'position: expected 7 finite numbers'),
            ((q[:-1], qd, tau), 'position: expected 7 finite numbers'),
            ((q, q[np.newaxis], tau), 'velocity: expected 7 finite numbers'),
            ((q, qd, np.zeros(2)), 'torque: expected 3 values'),
            ((q, qd, np.full(3, np.inf)), 'torque: expected finite numbers')):
        with pytest.raises(ValueError, match=words):
            simulation.forward_dynamics(*arguments)
    # What was refused leaves nothing behind.
    close((simulation.acceleration,), (Simulation.from_scene('three_rrr').acceleration,), 0.0)


def test_present_state_is_read_anew_after_another_was_evaluated():
    for name in ('three_rrr', 'bricard', 'stewart_platform'):
        simulation, torque = moving(name)
        q, qd = simulation.position, simulation.velocity
        before = [simulation.acceleration, simulation.multipliers, simulation.constraint_forces,
                  simulation.joint_forces, simulation.points]
        other = Simulation.from_scene(name)
        simulation.forward_dynamics(other.position, other.velocity, torque + 1.0)
        simulation.inverse_dynamics(q, qd, simulation.forward_dynamics(q, qd, torque)[0])
        close([simulation.acceleration, simulation.multipliers, simulation.constraint_forces,
               simulation.joint_forces, simulation.points], before, 0.0)


def test_evaluator_is_independent_of_its_simulation():
    simulation, _ = moving('three_rrr_payload_friction')
    evaluate = simulation.evaluator('acceleration')
    evaluate()
    before, present = evaluate.acceleration.copy(), simulation.acceleration
    simulation.set_effect('gravity' if 'gravity' in simulation.effects else next(
        iter(simulation.effects)), enabled=False)
    evaluate()
    close((evaluate.acceleration,), (before,), 0.0)
    evaluate.tau[:] = 1.0
    evaluate()
    assert np.abs(evaluate.acceleration - before).max() > 1e-3
    del simulation
    gc.collect()
    evaluate()
    assert np.isfinite(present).all() and not hasattr(evaluate, 'multipliers')
    with pytest.raises(ValueError):
        evaluate.acceleration[0] = 1.0


@pytest.mark.parametrize('name', ['bennett', 'bricard'])
def test_accelerations_alone_fulfil_the_equations_left_out(name):
    routines, loops = Simulation.from_scene(name), Simulation.from_scene(name)
    assert routines.data.has_redundant_constraints and routines.data.system.table[LEFT_OUT]
    loops.data.system.table[LEFT_OUT] = 0
    start = routines.position
    for step in (0.0, 0.02):
        q, _ = routines.closed(start + step * np.cos(np.arange(len(start))), routines.velocity)
        expected, _ = routines.forward_dynamics(q, routines.velocity)
        for one in (routines, loops):
            evaluate = one.evaluator('acceleration')
            evaluate.q[:] = q
            evaluate()
            close((evaluate.acceleration,), (expected,))


def test_evaluator_refuses_what_is_no_state():
    simulation = Simulation.from_scene('stewart_platform')
    with pytest.raises(ValueError, match="evaluator: expected quantities .* got 'energy'"):
        simulation.evaluator('energy')
    evaluate = simulation.evaluator()
    assert 'acceleration, multipliers' in repr(evaluate)
    good = evaluate.q.copy()
    for place, number in ((0, np.nan), (simulation.coordinates.balls[0, 0], 2.0)):
        evaluate.q[:] = good
        evaluate.q[place] = number
        with pytest.raises(ValueError):
            evaluate()
    evaluate.q[:] = good
    evaluate()
    evaluate.tau[0] = np.inf
    with pytest.raises(ValueError, match='torque: expected finite numbers'):
        evaluate()


def test_friction_begins_by_the_rates_that_are_given():
    scene = load_scene('three_rrr')
    scene = replace(scene, effects={
        **scene.effects, 'dry': JointFriction(joint=scene.mechanism.joints[0].name, coulomb=0.5)})
    simulation = Simulation(scene)
    q, qd = simulation.position, simulation.forward_dynamics(
        simulation.position, simulation.velocity)[0]
    # Any rates that keep the loops closed: null vectors of the constraint Jacobian.
    _, _, right = np.linalg.svd(simulation.constraint_jacobian)
    for sign in (1.0, -1.0, 0.0):
        qd = sign * right[-1]
        # At rest one routine and the parts find the friction, by other operations.
        close(simulation.forward_dynamics(q, qd),
              simulation.forward_dynamics(q.tolist(), qd.tolist()), 0.0 if sign else 1e-14)
