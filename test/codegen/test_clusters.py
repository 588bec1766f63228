# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Loops eliminated cluster by cluster give the motion of dense matrices, or step aside."""

from dataclasses import replace
from functools import partial

from closedloop_dynamics.codegen import clusters, function_table as calls, routines, space
from closedloop_dynamics.engine import types as t
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.mechanism.mechanism import CutJoint, Joint
from closedloop_dynamics.simulation.system import build_system, number_of_states
from families import geared_arm, tower
import numpy as np
import pytest

from .spatial_engine import _array, _inputs, inputs_with_forces, interpret
from .test_arms import drawn
from ..reference.compare import assert_agree
from ..reference.numbers import Numbers

ANGLES = 0.4, 1.1, 2.3, -0.9


def without_loops(mechanism, q):
    """Return a mechanism with its loops open."""
    return replace(mechanism, cut_joints=()), q


def welded(mechanism, q):
    """Return a mechanism with a plate on its last body that two joints hold, and nothing moves."""
    last, up = mechanism.bodies[-1], (0.0, 0.0, 1.0)
    return replace(
        mechanism, bodies=(*mechanism.bodies, replace(last, name='plate')),
        joints=(*mechanism.joints, Joint('weld', 'fixed', last.name, 'plate', 3 * (0.0,))),
        cut_joints=(*mechanism.cut_joints, CutJoint(
            'hinge', 'revolute', 'plate', last.name, up, up, axis_a=up, axis_b=up))), q


MACHINES = {
    'tower': partial(tower, 3, 1, ANGLES), 'tree': partial(tower, 2, 2, ANGLES),
    'welded': lambda: welded(*tower(1, 1, ANGLES)),
    'gears': partial(geared_arm, 3), 'open': lambda: without_loops(*tower(1, 2, ANGLES))}


def state_of(made, seed=0):
    """Return the model of a mechanism, closed coordinates with its free body anywhere, rates."""
    mechanism, position = made
    model, q = build_model(mechanism), np.array(position)
    rng, nv = np.random.default_rng(seed), len(model.tree) - 1
    q[:7] = rng.normal(size=7)
    q[3:7] /= np.linalg.norm(q[3:7])
    qd = rng.normal(size=nv)
    numbers = Numbers(model)
    numbers.move(q, qd)
    jac = numbers.jacobian()
    return model, q, qd - np.linalg.pinv(jac) @ (jac @ qd), rng.normal(size=nv)


def results(model, by, which, inputs, kind=float):
    """Return outputs of a routine by a module, interpreted, and whether they are good."""
    trace = routines.MechanismTrace(model, with_arms=by is clusters, by=by)
    if by is not None:
        assert trace.method() is by
    outputs, good = interpret(trace.traced(which), {
        source: np.asarray(array, dtype=kind) for source, array in inputs.items()})
    nv, nc = len(model.tree) - 1, len(model.column) - 1
    return {source: _array(outputs, source, size) for source, size in (
        (calls.QDD, nv), (calls.LAM, nc), (calls.CLOSURE, nc), (calls.CLOSURE_RATE, nc),
        (calls.CORRECTIONS, 2 * nv))}, good


@pytest.mark.parametrize('name', MACHINES)
@pytest.mark.parametrize('armature', [0.0, 0.02])
def test_clusters_give_the_motion_of_the_other_methods_and_of_dense_matrices(name, armature):
    for seed in range(2):
        model, q, qd, tau = state_of(MACHINES[name](), seed)
        plain = model.tree[1:, t.TYPE] != t.BALL
        model.body[1:, space.ARMATURE] = armature * plain
        inputs = _inputs(model, q, qd, tau)
        inputs[calls.BAUMGARTE] = np.full(len(inputs[calls.BAUMGARTE]), 3.0)
        found, good = results(model, clusters, calls.EVALUATION, inputs)
        assert good
        expected, _ = results(model, None, calls.EVALUATION, inputs, np.longdouble)
        for source in (calls.QDD, calls.LAM):
            assert_agree(found[source], expected[source], 1e-12)
        for source in (calls.CLOSURE, calls.CLOSURE_RATE):
            np.testing.assert_allclose(found[source], expected[source], atol=1e-14)
        numbers = Numbers(model)
        numbers.move(q, qd)
        qdd, lam, _ = numbers.accelerations(tau, 0.0)
        assert_agree(found[calls.QDD], qdd, 1e-11)
        assert_agree(found[calls.LAM], lam, 1e-11)


@pytest.mark.parametrize('name', MACHINES)
def test_forces_of_effects_are_added(name):
    model, q, qd, tau = state_of(MACHINES[name]())
    inputs = inputs_with_forces(model, q, qd, tau)
    found, good = results(model, clusters, calls.ACCELERATION, inputs)
    expected, _ = results(model, None, calls.ACCELERATION, inputs, np.longdouble)
    assert good
    for source in (calls.QDD, calls.LAM):
        assert_agree(found[source], expected[source], 1e-11)


@pytest.mark.parametrize('name', MACHINES)
def test_corrections_are_those_of_the_other_methods(name):
    model, q, qd, tau = state_of(MACHINES[name]())
    # Of open loops the equations differ by the gap times the turning of the closing body.
    inputs = _inputs(model, q + 1e-8, qd + 1e-2, tau)
    (found, good), (expected, _) = (results(model, by, calls.CORRECTION, inputs, kind)
                                    for by, kind in ((clusters, float), (None, np.longdouble)))
    assert good
    for ours, theirs in zip(*(one[calls.CORRECTIONS].reshape(2, -1) for one in (found, expected))):
        assert name == 'open' or np.abs(theirs).max() > 1e-10
        assert_agree(ours, theirs, 1e-6)


def test_loops_on_a_carried_body_of_a_machine_with_slides():
    model, q, qd, tau = drawn('excavator_arm', spread=0.0)
    numbers = Numbers(model)
    numbers.move(q, qd)
    jac = numbers.jacobian()
    qd -= np.linalg.pinv(jac) @ (jac @ qd)
    inputs = _inputs(model, q, qd, tau)
    (found, good), (expected, _) = (results(model, by, calls.EVALUATION, inputs, kind)
                                    for by, kind in ((clusters, float), (None, np.longdouble)))
    assert good
    for source in (calls.QDD, calls.LAM):
        assert_agree(found[source], expected[source], 1e-12)


def test_next_to_singular_loops_results_are_right_or_not_used():
    used = []
    for distance in (0.5, *10.0 ** -np.arange(1.0, 9.0), 0.0):
        made = tower(2, 1, (0.8, distance))
        # Independent equations are chosen away from there.
        model, _, _, tau = state_of(tower(2, 1, ANGLES))
        q = np.array(made[1])
        qd = np.zeros(len(tau))
        qd[:6], qd[6:] = 0.3, np.tile((0.7, 0.7, -0.7), 2)
        inputs = _inputs(model, q, qd, tau)
        found, good = results(model, clusters, calls.EVALUATION, inputs)
        used.append(good)
        if good:
            expected, _ = results(model, None, calls.EVALUATION, inputs, np.longdouble)
            for source in (calls.QDD, calls.LAM):
                assert_agree(found[source], expected[source], 1e-11)
    assert all(used[:2]) and not any(used[3:])


@pytest.mark.parametrize('angle', [0.8, 0.02, 1e-3, 0.0])
def test_compiled_code_gives_the_motion_of_loops_over_bodies(angle):
    model, _, _, tau = state_of(tower(1, 2, ANGLES))
    q, qd = np.array(tower(1, 2, (0.7, angle))[1]), np.zeros(len(tau))
    qd[:6], qd[6:] = 0.3, np.tile((0.7, 0.7, -0.7), 2)
    found = []
    for unrolled in (True, False):
        system = build_system(model, unrolled=unrolled)
        system.tau[:] = tau
        state = np.zeros(number_of_states(system))
        state[:len(q) + len(qd)] = np.concatenate([q, qd])
        system.native.evaluate_state(state)
        found.append((np.array(system.qdd), system.work.health[t.RANK_REVEALING_COUNT]))
    (ours, revealing), (expected, also) = found
    assert revealing == also and not (revealing and angle == 0.8)
    assert_agree(ours, expected, 1e-10)


def test_clusters_are_found_by_structure():
    def found(mechanism):
        trace = routines.MechanismTrace(build_model(mechanism))
        return trace.method(), trace.clusters

    by, some = found(tower(2, 2)[0])
    loops = [one for one in some if one.plan is not None]
    assert by is clusters and not any(one.plan.steps_aside for one in loops)
    # The free body has six rows of the tree, each four-bar three; the second is on a crank.
    assert sorted((one.closing, one.rows) for one in loops) == [
        (6, [7, 11, 12]), (6, [13, 17, 18]), (7, [8, 9, 10]), (13, [14, 15, 16])]
    assert [one.rows for one in some if one.plan is None] == [[1, 2, 3, 4, 5, 6]]
    by, some = found(geared_arm(3)[0])
    assert by is clusters and [one.closing for one in some if one.plan] == [8, 7, 6]
    # Loops that are held along the world's axes, or spherical joints within them.
    assert drawn_clusters('double_wishbone') is None
    assert drawn_clusters('stewart_platform') is None
    # In the plane the world's axes keep all zeros.
    assert drawn_clusters('four_bar') is None


def drawn_clusters(name):
    """Return the clusters of a shipped scene."""
    return routines.MechanismTrace(drawn(name)[0]).clusters


def test_a_tower_takes_operations_in_proportion_to_its_loops():
    counts = [routines.operations(build_model(tower(loops)[0])) for loops in (1, 2, 3)]
    per_loop = np.diff(counts)
    assert abs(per_loop[1] - per_loop[0]) < 0.05 * per_loop[0]
    # Articulated inertias and multipliers take more than twice as many.
    model = build_model(tower(3)[0])
    by_multipliers = routines.count_operations(routines.MechanismTrace(
        model, with_arms=False).traced(calls.EVALUATION))
    assert counts[2] < 0.5 * by_multipliers
