# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The engine in space against known answers and against maximal coordinates."""

from dataclasses import replace

from closedloop_dynamics.codegen import expression_graph as graph, routines, space
from closedloop_dynamics.codegen.equations import Equations
from closedloop_dynamics.codegen.function_table import (
    ACCELERATION, CORRECTION, EVALUATION, REFINED_ACCELERATION, REFINED_CORRECTION)
from closedloop_dynamics.engine.types import ROWS
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.mechanism.mechanism import (
    Body, Coupling, CutJoint, Joint, Mechanism, SPATIAL_CUT_JOINT_EQUATIONS)
import numpy as np
import pytest

from .spatial_engine import motion_with_forces, SpatialEngine
from ..reference import cases, spatial_linkages, spatial_machines, spatial_maximal as twin
from ..reference.compare import assert_agree, IDENTITY
from ..reference.numbers import equations, Numbers


# All types of joints and cut joints are among the first.
@pytest.mark.parametrize('seed', cases.first(3, range(100)))
def test_random_mechanisms_move_as_in_maximal_coordinates(seed):
    rng = np.random.default_rng(seed)
    mechanism, q, qd = spatial_linkages.random_mechanism(rng)
    engine = SpatialEngine(mechanism)
    tau = rng.normal(size=engine.nv)
    expected = twin.forward_dynamics(mechanism, q, qd, tau)
    qdd, lam, _ = engine.forward_dynamics(q, qd, tau)
    found = engine.accelerations(q, qd, qdd)
    names = [body.name for body in mechanism.bodies]
    assert_agree([found[name] for name in names],
                 [expected.accelerations[name] for name in names], 1e-9)
    wrenches = engine.wrenches(q, qd, lam)
    assert_agree([wrenches[cut.name] for cut in mechanism.cut_joints],
                 [expected.wrenches[cut.name] for cut in mechanism.cut_joints], 1e-8)
    count = len(mechanism.couplings)
    assert_agree(lam[engine.nc - count:], list(expected.multipliers.values()), 1e-8)
    # The recursions on numbers solve for the same by dense matrices.
    numbers = Numbers(engine.model)
    numbers.move(q, qd)
    assert np.abs(numbers.closures()[:2]).max() < IDENTITY
    again, forces, rank = numbers.accelerations(tau, 0.0)
    assert rank == engine.nc
    assert_agree(again, qdd, 1e-10)
    assert_agree(forces, lam, 1e-9)
    # Constraint forces balance the equations of motion of the trees.
    inertia, force, qdd, lam = motion_with_forces(engine.model, q, qd, tau)
    assert_agree(inertia @ qdd, force + numbers.jacobian().T @ lam, 1e-9)


@pytest.mark.parametrize('seed', cases.first(1, range(4)))
@pytest.mark.parametrize('kind', SPATIAL_CUT_JOINT_EQUATIONS)
def test_rates_and_biases_are_derivatives_where_loops_are_open(kind, seed):
    rng = np.random.default_rng(seed)
    # Coordinates of others are no integrals of the rates.
    mechanism, q, qd = spatial_linkages.random_mechanism(rng, ('spherical', 'free', 'fixed'))
    motions = twin.forward(mechanism, q, qd, 0.0 * qd)[0]
    cut = spatial_linkages.random_cut(rng, 'cut', kind, mechanism.bodies[-1].name,
                                      mechanism.bodies[0].name, motions)
    numbers = Numbers(SpatialEngine(replace(mechanism, cut_joints=(cut,))).model)
    q, qd = q + rng.normal(size=len(q)), rng.normal(size=len(q))

    def axes():
        """Return those of places that turn with body B, which rates and biases do not count."""
        held = [one.on_a[3:] for _, _, one in equations(numbers.recursion, numbers.model)]
        return np.reshape(held, (-1, 3)) * space.is_carried(numbers.model, numbers.model.cut[0])

    def closures(step):
        """Return them along the axes of no step."""
        numbers.move(q + step * qd, qd)
        found, turned = numbers.closures(), axes()
        return found + found @ turned @ (start - turned).T

    numbers.move(q, qd)
    (_, rate, bias), start, step = numbers.closures(), axes(), 1e-5
    assert_agree(numbers.jacobian() @ qd, rate, 1e-12)
    before, after = closures(-step), closures(step)
    found = (after[:2] - before[:2]) / (2.0 * step)
    assert_agree(found[0], rate, 1e-8, smallest=1.0)
    assert_agree(found[1], bias, 1e-8, smallest=1.0)


def test_refinement_counts_the_angles_that_a_coupling_reads():
    # Of the geared joints one carries the other; two others, not parallel to them, carry both.
    carriers, z = ('ground', 'table', 'arm', 'first'), (0, 0, 1)
    names = (*carriers[1:], 'second')
    mechanism = Mechanism(
        'wrist', tuple(Body(name, 1.0, (0.1, 0.0, 0.05), (0.01, 0.02, 0.03)) for name in names),
        tuple(Joint(f'{name}_joint', 'revolute', carrier, name, (0.2, 0.1, 0.0), axis=axis)
              for name, carrier, axis in zip(names, carriers, (z, (1, 0, 0), z, z))), (),
        couplings=(Coupling('gears', {'first_joint': 1.0, 'second_joint': 2.0}),))
    engine = SpatialEngine(mechanism)
    q, qd, tau = np.array([0.3, 0.4, 0.2, -0.1]), np.zeros(4), np.arange(1.0, 5.0)
    found, good = engine.in_parts(ACCELERATION, q, qd, tau)
    refined, as_good = engine.in_parts(REFINED_ACCELERATION, q, qd, tau)
    assert good and as_good
    assert_agree(refined, found, 1e-10)


@pytest.mark.parametrize('light', [1.0, 1e-4])
# What is chosen among in refinement is known for all but the first.
@pytest.mark.parametrize('seed', cases.first(3, (8, *range(8), *range(9, 12))))
def test_parts_of_an_evaluation_and_refinement_agree_with_dense_matrices(seed, light):
    rng = np.random.default_rng(seed)
    mechanism, q, qd = spatial_linkages.random_mechanism(rng)
    chosen = rng.integers(len(mechanism.bodies))
    mechanism = replace(mechanism, bodies=tuple(
        replace(body, mass=light * body.mass, inertia=tuple(light * np.array(body.inertia)))
        if k == chosen else body for k, body in enumerate(mechanism.bodies)))
    engine, tau = SpatialEngine(mechanism), rng.normal(size=6 * len(mechanism.bodies))
    tau = tau[:engine.nv]
    numbers = Numbers(engine.model)
    numbers.move(q, qd)
    expected, _, _ = numbers.accelerations(tau, 0.0)
    found, _ = engine.in_parts(ACCELERATION, q, qd, tau)
    refined, _ = engine.in_parts(REFINED_ACCELERATION, q, qd, tau)
    # Dense matrices lose the digits by which masses differ.
    assert_agree(refined, expected, 1e-10 if light == 1.0 else 1e-9)
    if light == 1.0:
        assert_agree(found, expected, 1e-10)
        # Loops opened a little, by rates that they do not allow.
        rates = qd + rng.normal(size=engine.nv)
        numbers.move(q, rates)
        change = numbers.correction(numbers.closures()[1])
        for which in (CORRECTION, REFINED_CORRECTION):
            assert_agree(engine.corrections(which, q, rates)[1], change, 1e-9)
        numbers.move(q, rates + change)
        assert np.abs(numbers.closures()[1]).max() < 1e-12 * np.abs(rates).max() * 100.0


def test_bricard_has_one_equation_too_many():
    mechanism, _ = spatial_machines.bricard()
    engine = SpatialEngine(mechanism)
    numbers = Numbers(engine.model)
    engine.model.gravity[:] = (0.0, -9.81, 0.0)
    numbers.move(np.zeros(5), np.zeros(5))
    qdd, _, rank = numbers.accelerations(np.zeros(5), 0.0)
    assert (engine.nc, rank) == (5, 4)
    # All joints turn alike, in turns.
    assert_agree(qdd / (1, -1, 1, -1, 1), np.full(5, qdd[0]), 1e-12)


def in_space(mechanism):
    """Return a planar mechanism written down in space, in the plane of its first two axes."""
    up = (0.0, 0.0, 1.0)
    turned = [np.array([0.0, 0.0, np.sin(0.5 * joint.angle), np.cos(0.5 * joint.angle)])
              for joint in mechanism.joints]
    return Mechanism(
        mechanism.name,
        tuple(Body(body.name, body.mass, (*body.center_of_mass, 0.0),
                   (0.5 * body.inertia, 0.5 * body.inertia, body.inertia))
              for body in mechanism.bodies),
        tuple(Joint(joint.name, joint.type, joint.parent, joint.child, (*joint.position, 0.0),
                    orientation=tuple(orientation),
                    axis=up if joint.type == 'revolute' else (1.0, 0.0, 0.0))
              for joint, orientation in zip(mechanism.joints, turned)),
        tuple(CutJoint(cut.name, cut.type, cut.body_a, cut.body_b, (*cut.point_a, 0.0),
                       (*cut.point_b, 0.0), axis_a=up, axis_b=up)
              for cut in mechanism.cut_joints))


def operations(model):
    """Return how many additions, multiplications and divisions an evaluation takes."""
    routine = routines.MechanismTrace(model).routine(EVALUATION)
    kinds = (graph.ADD, graph.SUBTRACT, graph.MULTIPLY, graph.DIVIDE, graph.NEGATE)
    return sum(routine.graph.operations[place][0] in kinds for place in routine.needed())


@pytest.mark.parametrize('name', cases.SHIPPED)
def test_planar_mechanisms_written_in_space_cost_no_more(name):
    rng, mechanism, q, qd = cases.drawn(name)
    plane = build_model(mechanism, (0.0, -9.81))
    engine = SpatialEngine(in_space(mechanism))
    engine.model.gravity[:] = (0.0, -9.81, 0.0)
    # Of five equations of a revolute joint three always hold.
    assert sorted(engine.model.cut[:, ROWS]) == sorted(plane.cut[:, ROWS])
    assert operations(engine.model) <= 1.03 * operations(plane)
    tau = rng.normal(size=engine.nv)
    found = engine.forward_dynamics(q, qd, tau)
    planar = routines.MechanismTrace(plane)
    expected = SpatialEngine.interpreted(planar, plane, q, qd, tau)
    refined, good = engine.in_parts(REFINED_ACCELERATION, q, qd, tau)
    assert good
    for one in found[0], refined:
        assert_agree(one, expected[0], 1e-11)
    # Multipliers are along axes of body B where a moving body carries the loop.
    assert_agree(forces(engine.model, q, found[1])[:, 3:5], forces(plane, q, expected[1])[:, 1:],
                 1e-11)


def forces(model, q, multipliers):
    """Return the wrenches at the cut joints of a model in the plane or in space."""
    equations = Equations(model).move(q)
    return equations.cut_wrenches(multipliers, equations.work.body)


def test_routines_follow_the_structure_of_a_description():
    mechanism, _ = spatial_machines.rssr_four_bar()
    model = SpatialEngine(mechanism).model
    same, other = (model.replaced(body=model.body.copy()) for _ in range(2))
    heavy, moved = model.body[:, 0] > 0.0, np.flatnonzero(model.body[:, 10] != 0.0)[0]
    same.body[heavy, 0] *= 2.0
    same.body[moved, 10] *= 1.5
    assert routines.topology(same) == routines.topology(model)
    # A length that becomes zero is another structure.
    other.body[moved, 10] = 0.0
    assert routines.topology(other) != routines.topology(model)
