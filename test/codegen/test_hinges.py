# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Three hinges through one place cost what a spherical joint costs, and move as hinges."""

from closedloop_dynamics.codegen import function_table as calls, routines, space
from closedloop_dynamics.engine import types as t
from closedloop_dynamics.kinematics.global_assembly import ClosureProblem, find_closed
from closedloop_dynamics.mechanism.mechanism import Body, Coupling, CutJoint, Joint, Mechanism
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.scene.tree_choice import count_operations
import numpy as np
import pytest

from .spatial_engine import _array, _inputs, interpret, SpatialEngine
from ..reference.compare import assert_agree
from ..reference.numbers import Numbers

TURNED = (0.18257418583505536, 0.3651483716701107, 0.5477225575051661, 0.7302967433402214)
AXES = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))


def chain(name, parent, child, place, balls=False, axes=AXES):
    """Return three hinges through a place, or one spherical joint, and the bodies in between."""
    if balls:
        return [Joint(name, 'spherical', parent, child, place, orientation=TURNED)], []
    between = [f'{name}_1', f'{name}_2']
    joints = [Joint(f'{name}_{n}', 'revolute', one, other, place if n == 0 else (0.0, 0.0, 0.0),
                    orientation=TURNED if n == 0 else (0.0, 0.0, 0.0, 1.0), axis=axis)
              for n, (one, other, axis) in enumerate(zip(
                  [parent, *between], [*between, child], axes))]
    return joints, [Body(one, 0.0, (0.0, 0.0, 0.0), 0.0, massless=True) for one in between]


def leg(balls=False, cut='fixed', couplings=(), axes=AXES):
    """Return two bars on hinges, and a rod on three hinges whose end is closed with a bar."""
    def body(name, mass):
        return Body(name, mass, (0.2, 0.01, -0.03), (0.02, 0.03, 0.04, 0.001, 0.002, -0.003))

    first, between = chain('hip', 'ground', 'thigh', (0.0, 0.1, 0.0), balls, axes)
    second, more = chain('ball', 'thigh', 'rod', (0.1, 0.1, 0.0), balls)
    joints = [*first, Joint('knee', 'revolute', 'thigh', 'shin', (0.5, 0.0, 0.0),
                            axis=(0.0, 0.6, 0.8), actuated=True), *second]
    closing = CutJoint('end', cut, 'rod', 'shin', (0.45, 0.0, 0.05), (0.1, 0.12, 0.02))
    return validate_mechanism(Mechanism(
        'leg', (body('thigh', 2.0), body('shin', 1.0), body('rod', 0.3), *between, *more),
        tuple(joints), (closing,), couplings=tuple(couplings)))


def state(mechanism, cut='spherical'):
    """Return a closed position with rates that keep it closed, and torques."""
    loops, rng = ClosureProblem(mechanism, 1.0), np.random.default_rng(2)
    found = find_closed(mechanism, 1.0, loops.moved(
        loops.start(), 0.4 * rng.uniform(-1.0, 1.0, loops.nv)))
    assert found.closed
    jac = loops.residual(found.q)[1]
    qd = rng.normal(size=loops.nv)
    return found.q, qd - np.linalg.pinv(jac, rcond=1e-9) @ jac @ qd, rng.normal(size=loops.nv)


def triples(mechanism):
    """Return the rows that are eliminated as one joint."""
    return routines.MechanismTrace(SpatialEngine(mechanism).model).recursion.hinges


@pytest.mark.parametrize('axes', [AXES, AXES[::-1], ((0.6, 0.0, 0.8), (0.0, 1.0, 0.0),
                                                     (0.6, 0.0, 0.8))])
def test_accelerations_and_corrections_are_those_of_dense_matrices(axes):
    mechanism = leg(cut='spherical', axes=axes)
    assert len(triples(mechanism)) == 2
    engine = SpatialEngine(mechanism)
    q, qd, tau = state(mechanism)
    numbers = Numbers(engine.model)
    numbers.move(q, qd)
    expected, forces, _ = numbers.accelerations(tau, 0.0)
    qdd, lam, good = engine.forward_dynamics(q, qd, tau)
    assert good
    assert_agree(qdd, expected, 1e-11)
    assert_agree(lam, forces, 1e-11)
    for which in (calls.ACCELERATION, calls.REFINED_ACCELERATION):
        assert_agree(engine.in_parts(which, q, qd, tau)[0], expected, 1e-11)
    rates = qd + 0.1 * tau
    numbers.move(q, rates)
    change = numbers.correction(numbers.closures()[1])
    for which in (calls.CORRECTION, calls.REFINED_CORRECTION):
        assert_agree(engine.corrections(which, q, rates)[1], change, 1e-10)


def test_forces_on_the_bodies_in_between_act_in_the_hinges(monkeypatch):
    mechanism = leg(cut='spherical')
    q, qd, tau = state(mechanism)
    engine, rng = SpatialEngine(mechanism), np.random.default_rng(5)
    model = engine.model
    inputs = _inputs(model, q, qd, tau)
    outputs, _ = interpret(routines.MechanismTrace(model).routine(calls.OUTWARD), inputs)
    body = _array(outputs, calls.WORK_BODY, len(model.tree) * space.WORK_COLUMNS)
    body = body.reshape(-1, space.WORK_COLUMNS)
    body[1:, list(space.FORCES)] += rng.normal(size=body[1:, list(space.FORCES)].shape)
    inputs[calls.WORK_BODY] = body
    found = interpret(routines.MechanismTrace(model).routine(calls.ACCELERATION), inputs)[0]
    monkeypatch.setattr(space, 'hinges', lambda *_: ())
    one_by_one = interpret(routines.MechanismTrace(model).routine(calls.ACCELERATION), inputs)[0]
    for which, count in ((calls.QDD, engine.nv), (calls.LAM, engine.nc)):
        assert_agree(_array(found, which, count), _array(one_by_one, which, count), 1e-11)


def test_what_needs_each_hinge_keeps_them_apart():
    assert triples(leg(cut='spherical', couplings=[
        Coupling('gear', {'hip_2': 1.0, 'knee': 0.5})])) == triples(leg(cut='spherical'))[:1]
    mechanism = leg(cut='spherical')
    # A body in between has a mass, or carries another; two axes are parallel.
    heavy = tuple(Body('hip_1', 0.1, (0.0, 0.0, 0.0), (0.1, 0.1, 0.1)) if body.name == 'hip_1'
                  else body for body in mechanism.bodies)
    other = (*mechanism.bodies, Body('x', 1.0, (0.1, 0.0, 0.0), (0.1, 0.1, 0.1)))
    joints = (*mechanism.joints, Joint('x', 'revolute', 'hip_1', 'x', (0.0, 0.0, 0.0),
                                       axis=AXES[0]))
    for bodies, tree in ((heavy, mechanism.joints), (other, joints)):
        changed = validate_mechanism(Mechanism('m', bodies, tree, mechanism.cut_joints))
        assert len(triples(changed)) == 1
    assert len(triples(leg(cut='spherical', axes=(AXES[0], AXES[0], AXES[1])))) == 1


def test_they_cost_what_a_spherical_joint_costs(monkeypatch):
    hinges, balls = count_operations(leg()), count_operations(leg(balls=True))
    assert SpatialEngine(leg()).model.tree[1:, t.TYPE].tolist() == 7 * [t.REVOLUTE]
    # One by one each of the two takes 200 operations and more beyond a ball's.
    assert hinges - balls < 2 * 100
    monkeypatch.setattr(space, 'hinges', lambda *_: ())
    # Operations by each method are counted once.
    monkeypatch.setattr(routines, 'costs_by_method', {})
    assert count_operations(leg()) - balls > 2 * 200
