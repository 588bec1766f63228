# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Equations that repeat others: found, explained, free of charge, and exchanged where need be."""

from dataclasses import replace
from itertools import count, cycle
from types import SimpleNamespace

from closedloop_dynamics import (
    Body, CutJoint, Initial, Joint, load_scene, Mechanism, NumericalError, Simulation)
from closedloop_dynamics.cli import main
from closedloop_dynamics.codegen.routines import operations
from closedloop_dynamics.effects.registry import JointFriction
from closedloop_dynamics.engine.types import RANK_REVEALING_COUNT
from closedloop_dynamics.kinematics import loop_model
from closedloop_dynamics.kinematics.assembly import Assembler
from closedloop_dynamics.kinematics.geometry import Geometry
from closedloop_dynamics.kinematics.redundancy import ANY_LENGTHS, find_redundancy, THESE_LENGTHS
from closedloop_dynamics.mechanism.reader import with_cuts
from closedloop_dynamics.studies.check import describe
import numpy as np
import pytest

from ..reference import spatial_machines
from ..reference.compare import assert_agree
from ..reference.numbers import Numbers
from ..reference.scenes import scene, simulated
from ..simulation.test_space import tilted_four_bar, TURN

Y, Z = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
NOWHERE = (0.0, 0.0, 0.0)


def closed(mechanism, guess):
    """Return the geometry with repeated equations left out, and a position that closes."""
    geometry = Geometry(mechanism)
    geometry.leave_out_repeated(np.array(guess, dtype=float))
    return geometry, Assembler(mechanism, geometry.equations).positions(
        np.array(guess, dtype=float))


def linkages():
    """Return mechanisms with positions, and how many equations are left of how many."""
    planar, tilted, _ = tilted_four_bar(TURN)
    bricard, _ = spatial_machines.bricard()
    bennett = load_scene('bennett')
    return {'bricard': (bricard, np.zeros(5), 4, 5),
            'bennett': (bennett.mechanism, bennett.initial.position, 2, 5),
            'four_bar': (tilted, planar.initial.position, 2, 5)}


@pytest.mark.parametrize('name', ['bricard', 'bennett', 'four_bar'])
def test_it_is_reported_why_equations_repeat_others(name):
    mechanism, guess, left, count = linkages()[name]
    _, q = closed(mechanism, guess)
    found = find_redundancy(mechanism, q)
    # Bricard's and Bennett's linkages move for their lengths; pins of a plane repeat anyway.
    why = ANY_LENGTHS if name == 'four_bar' else THESE_LENGTHS
    cut, = mechanism.cut_joints
    assert [(joint, reason) for joint, _, reason in found.repeated] == [
        (cut.name, why)] * (count - left)
    # The whole ring, not the cut joint alone.
    assert set(found.shared) == {joint.name for joint in (*mechanism.joints, cut)}


def test_independent_equations_are_not_said_to_repeat():
    mechanism, _ = spatial_machines.rssr_four_bar()
    geometry = Geometry(spatial_machines.with_single_freedoms(mechanism))
    q = np.zeros(len(geometry.mechanism.joints))
    assert find_redundancy(geometry.mechanism, q) == ((), (), {})


def test_check_tells_what_repeats_and_whose_forces_are_shared():
    scene = load_scene('bricard')
    reported = describe(scene, Simulation(scene))
    assert 'Equations that repeat others: 1\n' in reported and THESE_LENGTHS in reported
    assert 'Forces that are not unique, of which the least are reported: 6\n' in reported


def test_simulate_tells_whose_forces_are_shared(capsys):
    assert main(['simulate', 'bricard', '--duration', '0.1']) == 0
    assert 'joint_6, joint_4 are not unique' in capsys.readouterr().out


# As many equations as are left, none of which repeats others: those of another joint.
STANDING_IN = {'bricard': 'universal', 'bennett': 'point_on_line', 'four_bar': 'point_on_line'}


@pytest.mark.parametrize('name', ['bricard', 'bennett'])
def test_loops_close_from_positions_where_repeated_equations_contradict(name):
    # Beside closed positions all equations are independent, and Newton's method is led astray.
    mechanism, position, *_ = linkages()[name]
    assembler = Assembler(mechanism, Geometry(mechanism).equations)
    rng = np.random.default_rng(1)
    for _ in range(8):
        q = assembler.positions(position + rng.uniform(-0.1, 0.1, len(position)))
        assert np.abs(assembler.closure(q)).max() < 1e-13


@pytest.mark.parametrize('name', STANDING_IN)
def test_repeated_equations_cost_no_more_than_independent_ones(name):
    mechanism, guess, left, _ = linkages()[name]
    geometry, _ = closed(mechanism, guess)
    assert len(geometry.model.column) - 1 == left
    cut, = mechanism.cut_joints
    axes = {'axis_a': tuple(np.roll(cut.axis_b, 1))} if name == 'bricard' else {'axis_a': None}
    other = replace(mechanism, cut_joints=(
        replace(cut, type=STANDING_IN[name], **axes),))
    independent = Geometry(other).model
    assert len(independent.column) - 1 == left
    assert operations(geometry.model) <= 1.5 * operations(independent)


def test_a_delta_robot_with_rods_between_balls_costs_what_its_rows_do():
    # Its six rods may spin; no equation repeats others, and the platform turns nowhere.
    mechanism = spatial_machines.with_single_freedoms(spatial_machines.delta_robot()[0])
    geometry, _ = closed(mechanism, np.zeros(len(mechanism.joints)))
    whole = Geometry(mechanism).model
    assert operations(geometry.model) == operations(whole)


def turntable(kind, **axes):
    """Return a four-bar in an upright plane on a table that turns, closed by a pin of a kind."""
    def bar(name, mass, length):
        across = mass * length ** 2 / 12.0
        return Body(name, mass, (0.5 * length, 0.0, 0.0), (0.01 * across, across, across))

    bodies = (Body('table', 5.0, NOWHERE, (0.2, 0.2, 0.4)), bar('crank', 0.5, 0.1),
              bar('coupler', 1.0, 0.35), bar('rocker', 0.8, 0.25))
    joints = (Joint('table', 'revolute', 'ground', 'table', NOWHERE, axis=Z, actuated=True),
              Joint('crank', 'revolute', 'table', 'crank', NOWHERE, axis=Y),
              Joint('coupler', 'revolute', 'crank', 'coupler', (0.1, 0.0, 0.0), axis=Y),
              Joint('rocker', 'revolute', 'table', 'rocker', (0.4, 0.0, 0.0), axis=Y))
    cut = CutJoint('pin', kind, 'coupler', 'rocker', (0.35, 0.0, 0.0), (0.25, 0.0, 0.0),
                   **axes)
    return scene(Mechanism('turntable', bodies, joints, (cut,)), (0.0, -1.0, 0.5, -1.7),
                 (3.0, 1.0, 0.0, 0.0), gravity=(0.0, 0.0, -9.81), integrator='dop853',
                 tolerance=1e-11)


def test_equations_are_exchanged_where_they_no_longer_serve():
    # The world's axes lie in the plane by turns; the axes of the rocker always do.
    one = Simulation(turntable('spherical'))
    other = Simulation(replace(turntable('point_on_line', axis_b=Y), initial=Initial(
        tuple(one.position), tuple(one.velocity))))
    assert len(one.data.system.lam) == len(other.data.system.lam) == 2
    start, states = one.energy, []
    for _ in range(30):
        one.step(None, 0.05)
        other.step(None, 0.05)
        assert_agree(one.position, other.position, 1e-8)
        assert one.closure < 1e-9
        states.append(one.state)
    assert one.position[0] > np.pi / 2.0
    assert one.data.exchanges > 0
    assert_agree(one.energy, start, 1e-8)
    # In the plane of the linkage the forces of the pin are those of the point.
    along = np.array([[np.cos(one.position[0]), np.sin(one.position[0]), 0.0], Z])
    assert_agree(along @ one.constraint_forces[0, 3:], along @ other.constraint_forces[0, 3:],
                 1e-6)
    # From there on it is quick again.
    slow = one.data.system.work.health[RANK_REVEALING_COUNT]
    one.step(None, 0.01)
    assert one.data.system.work.health[RANK_REVEALING_COUNT] == slow
    # The same again after a reset, to the last digit.
    one.reset()
    assert one.data.exchanges == 0
    for state in states:
        one.step(None, 0.05)
        assert np.array_equal(one.state, state)


def test_a_planar_loop_that_turns_keeps_its_equations():
    # A revolute or fixed joint holds places along the axes of the rocker, of which one is across.
    start = turntable('spherical')
    one = Simulation(start)
    others = [Simulation(replace(turntable(kind, **axes), initial=replace(
        start.initial, position=tuple(one.position), velocity=tuple(one.velocity))))
        for kind, axes in (
            ('revolute', {'axis_a': Y, 'axis_b': Y}), ('point_on_line', {'axis_b': Y}))]
    for _ in range(30):
        one.step(None, 0.05)
        for other in others:
            other.step(None, 0.05)
            assert_agree(other.position, one.position, 1e-8)
    assert one.data.exchanges > 0
    assert [other.data.exchanges for other in others] == [0, 0]
    along = np.array([[np.cos(one.position[0]), np.sin(one.position[0]), 0.0], Z])
    forces = [along @ other.constraint_forces[0, 3:] for other in (one, *others)]
    for found in forces[1:]:
        assert_agree(found, forces[0], 1e-6)


def test_components_that_are_not_unique_are_those_that_other_multipliers_change():
    scene = load_scene('bricard')
    reported = find_redundancy(scene.mechanism, np.zeros(5)).components
    for name in ('joint_3', 'joint_4', 'joint_5', 'joint_6'):
        one = Simulation(replace(
            scene, mechanism=with_cuts(scene.mechanism, (name,)),
            initial=Initial((0.0,) * 5, (0.0,) * 5, ('joint_1',))))
        # Those of least multipliers, which no two trees have in common.
        numbers = Numbers(one.data.system.model)
        numbers.move(one.position, one.velocity)
        lam = numbers.accelerations(np.zeros(5), 0.0)[1]
        least = numbers.recursion.cut_wrench(one.data.system.model, 0, lam)
        changed = {f'force {axis}' for axis, change in zip(
            'xyz', (one.constraint_forces[0] - least)[3:]) if abs(change) > 1e-6}
        assert changed == {part for part in reported[name] if part.startswith('force')}
        assert len(changed) == 3


def test_joints_outside_the_loop_bear_nothing_that_is_not_unique():
    one = Simulation(turntable('spherical'))
    components = find_redundancy(one.mechanism, one.position).components
    assert set(components) == {'crank', 'coupler', 'rocker', 'pin'}
    # Pins of a plane: the force along the pins, and moments across them.
    for parts in components.values():
        assert 'force y' in parts and 'moment y' not in parts


def test_friction_that_depends_on_a_force_that_is_not_unique_is_warned_of():
    scene = load_scene('bennett')
    loaded = replace(scene, effects={
        **scene.effects, 'dry': JointFriction(joint='joint_2', friction_coefficient=0.2)})
    with pytest.warns(RuntimeWarning, match='dry depends on the force in joint_2, .*not unique'):
        simulation = Simulation.from_scene(loaded)
    assert 'joint_2' in simulation.report().findings[0]
    simulation.set_effect('dry', enabled=False)
    assert simulation.report().findings == () and simulation.data.load_notes() == []
    with pytest.warns(RuntimeWarning, match='dry depends'):
        simulation.set_effect('dry', enabled=True)
    plain = replace(scene, effects={
        **scene.effects, 'dry': JointFriction(joint='joint_2', coulomb=0.2)})
    assert Simulation(plain).data.load_notes() == []
    # Of independent equations all forces are unique.
    assert Simulation(replace(load_scene('four_bar'), effects={'dry': JointFriction(
        joint='crank_joint', friction_coefficient=0.2)})).data.load_notes() == []


def test_no_equations_are_chosen_twice_where_no_step_was_made(monkeypatch):
    simulation = Simulation.from_scene('bennett')
    first = simulation.data.loop_model.equations.kept
    # Code is for several choices: none is kept for the sake of its code.
    assert simulation.data.exchange_is_cheap
    choices, marks = cycle((np.roll(first, 1), first)), count()
    # Two choices, each better than the other.
    monkeypatch.setattr(loop_model, 'independent', lambda *_: (next(choices), 0.0))
    monkeypatch.setattr(loop_model, 'distinctness', lambda *_: 10.0 ** -next(marks))
    # The other choice, the present one leniently, and all equations.
    for or_these, kept in ((True, np.roll(first, 1)), (True, np.roll(first, 1)), (False, True)):
        assert simulation.stepping.choose_equations(
            SimpleNamespace(nearby=False, or_these=or_these))
        assert (simulation.data.loop_model.equations.kept == kept).all()
    assert simulation.data.exchanges == 2 and not simulation.data.has_redundant_constraints


def refused(monkeypatch, choose):
    """Return a simulation whose steps are refused, and what is wanted of other equations."""
    simulation, asked = Simulation.from_scene('bennett', integrator='rk4', step_size=1e-3), []
    # The pivot below which other equations are looked for.
    simulation.data.system.whole.numbers[0] = 2.0

    def choose_equations(report):
        asked.append((report.nearby, report.or_these))
        return choose(simulation)

    monkeypatch.setattr(simulation.stepping, 'choose_equations', choose_equations)
    return simulation, asked


def test_where_no_equations_are_better_steps_are_accepted_leniently(monkeypatch):
    simulation, asked = refused(monkeypatch, lambda _: True)
    simulation.step(duration=0.01)
    assert asked == [(False, True)] and simulation.time == pytest.approx(0.01)


def test_a_run_without_other_equations_ends_before_the_step(monkeypatch):
    simulation, asked = refused(monkeypatch, lambda _: False)
    before = simulation.state
    with pytest.raises(NumericalError, match='No step at t = 0 s is small enough'):
        simulation.step(duration=0.01)
    assert asked == [(False, True)] and simulation.time == 0.0
    np.testing.assert_array_equal(simulation.state, before)


def test_equations_are_exchanged_so_often_and_no_more(monkeypatch):
    def exchange(simulation):
        chosen = simulation.data.loop_model
        simulation.data.use_equations(chosen.select(np.roll(chosen.equations.kept, 1)))
        simulation.data.system.whole.numbers[0] = 2.0
        return True

    simulation, asked = refused(monkeypatch, exchange)
    with pytest.raises(NumericalError, match=r'not go on at t = 0 s, whichever.*\(20 choices'):
        simulation.step(duration=0.1)
    assert len(asked) == simulation.data.exchanges == 20


def closed_here(mechanism, q):
    """Return a mechanism with the cut joint's point and axis on B as they are in a position."""
    geometry, (cut,) = Geometry(mechanism), mechanism.cut_joints

    def placed(body, vectors):
        origin = geometry.point(q, body, np.zeros(3))
        return origin, np.array([geometry.point(q, body, each) - origin for each in vectors]).T

    (origin_a, ends), (origin_b, frame) = placed(cut.body_a, (cut.point_a, cut.axis_a)), placed(
        cut.body_b, np.eye(3))
    return replace(mechanism, cut_joints=(replace(
        cut, point_b=tuple(frame.T @ (origin_a + ends[:, 0] - origin_b)),
        axis_b=tuple(frame.T @ ends[:, 1])),))


@pytest.mark.parametrize('digits', [
    3e-7, 1e-8, *(pytest.param(digits, marks=pytest.mark.slow) for digits in (1e-9, 1e-7))])
def test_axes_that_are_parallel_but_for_the_digits_of_a_file_hinder_no_motion(digits):
    planar, tilted, _ = tilted_four_bar(TURN)
    q = Simulation(planar).position
    rng, found = np.random.default_rng(3), []
    for size in (0.0, digits):
        mechanism = closed_here(replace(tilted, joints=tuple(replace(
            joint, axis=tuple(joint.axis + size * rng.uniform(-1.0, 1.0, 3)))
            for joint in tilted.joints)), q)
        simulation = simulated(mechanism, q, planar.initial.velocity, accuracy=1e-8)
        assert len(simulation.data.system.lam) == 2
        simulation.step({simulation.actuated_joints[0]: 0.2}, 1.0)
        assert simulation.data.exchanges == 0 and simulation.closure <= 30.0 * size + 1e-10
        assert simulation.data.system.work.health[RANK_REVEALING_COUNT] == 0.0
        found.append(simulation.position)
    assert np.abs(found[0] - q).max() > 0.3
    assert np.abs(found[1] - found[0]).max() <= 100.0 * digits + 1e-7
