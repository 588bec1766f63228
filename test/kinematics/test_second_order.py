# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Motions that loops forbid to second order do not happen; real ones beside them go on."""

from dataclasses import replace

from closedloop_dynamics import (
    AssemblyError, codegen, load_scene, Method, Model, scene_names, Simulation)
from closedloop_dynamics.kinematics.assembly import Assembler
from closedloop_dynamics.kinematics.geometry import Geometry
from closedloop_dynamics.kinematics.motions import with_motions
from closedloop_dynamics.kinematics.second_order import find_degrees_of_freedom, find_second_order
from closedloop_dynamics.mechanism.mechanism import REVOLUTE
from closedloop_dynamics.recording.design import degrees_of_freedom
from closedloop_dynamics.recording.kinematics import Drive, DrivenRun
from closedloop_dynamics.studies.check import describe
import hard_machines
import numpy as np
import pytest

from ..reference import taut
from ..reference.redundant_loops import random_loops
from ..reference.scenes import scene
from ..reference.special import ladder, parallelogram, scissor_lift

METHODS = [Method(), Method(integrator='dop853', tolerance=1e-12), Method(integrator='rodas4'),
           Method(integrator='rk4', stabilisation='baumgarte'),
           Method(integrator='rk4', stabilisation='none'), Method(stabilisation='independent')]


@pytest.mark.parametrize('method', METHODS, ids=lambda method: '-'.join((
    method.integrator, method.stabilisation)))
@pytest.mark.parametrize('tilt', [0.0, 0.3])
def test_a_taut_bar_keeps_carriages_abreast(tilt, method):
    simulation = Simulation(scene(
        taut.gantry(tilt), np.zeros(3), method=method, gravity=(0.0, -9.81)))
    assert simulation.data.degrees_of_freedom() == 1
    simulation.step({'rail_0': 1.0}, 0.5)
    # One body of 5 kg on a slope, for both carriages.
    expected = 1.0 / 5.0 - 9.81 * np.sin(tilt)
    assert np.abs(simulation.acceleration - (expected, expected, 0.0)).max() < 1e-11
    assert np.abs(simulation.position - (0.125 * expected, 0.125 * expected, 0.0)).max() < 1e-9
    assert simulation.closure < 1e-12
    assert not simulation.report().findings


@pytest.mark.parametrize('count', [4, pytest.param(100, marks=[
    pytest.mark.slow, pytest.mark.timeout(3600)])])
def test_taut_gantries_on_an_arm_move_as_one_carriage(count, monkeypatch):
    # Loops over bodies are compiled once for all topologies.
    monkeypatch.setattr(codegen, 'MOST_UNROLLED_OPERATIONS', 0)
    worst = 0.0
    for number in range(count):
        rng = np.random.default_rng([3, number])
        several = int(rng.integers(2, 5))
        parts = {'tilt': rng.uniform(-3.0, 3.0),
                 'carriages': tuple(rng.uniform(0.5, 3.0, several)),
                 'bars': tuple(rng.uniform(0.2, 2.0, several - 1)),
                 'length': rng.uniform(0.2, 2.0)}
        start, torque = rng.uniform(-0.5, 0.5, 2), {'shoulder': 5.0, 'rail_0': rng.normal()}
        rate, weight = rng.uniform(-0.5, 0.5, 2), (0.0, -9.81)
        many = Simulation(scene(
            taut.gantry(**parts, arm=True), (start[0], *several * [start[1]],
                                             *(several - 1) * [0.0]),
            (rate[0], *several * [rate[1]], *(several - 1) * [0.0]), gravity=weight))
        one = Simulation(scene(taut.carriage(**parts), start, rate, gravity=weight))
        assert many.data.degrees_of_freedom() == 2
        for simulation in (many, one):
            simulation.step(torque, 0.2)
        assert np.abs(many.position[several + 1:]).max() < 1e-9
        worst = max(worst, np.abs(many.position[:2] - one.position).max())
    print(f'{count} gantries: apart by {worst:.1e}')
    # Ten times the accuracy of either run.
    assert worst < 1e-5


@pytest.mark.parametrize('lean', [1e-9, 1e-6, 1e-3, 0.1])
def test_a_start_that_leans_is_closed_upright(lean):
    simulation = Simulation(scene(taut.gantry(), (0.0, 0.0, lean)))
    # Beside the position the loops are open by the square of the lean: as closed, if 1e-12.
    assert abs(simulation.position[2]) < 1e-9
    assert simulation.data.degrees_of_freedom() == 1


def test_unequal_rates_become_those_of_one_body():
    simulation = Simulation(scene(taut.gantry(), np.zeros(3), (1.0, 0.0, 0.0)))
    assert np.abs(np.diff(simulation.velocity[:2])).max() < 1e-12
    assert abs(simulation.velocity[2]) < 1e-12
    assert any('became' in note for note in simulation.data.start_notes())


def test_notes_and_check_say_what_is_forbidden():
    made = scene(taut.gantry(), np.zeros(3))
    simulation = Simulation(made)
    note, = (note for note in simulation.data.start_notes() if 'second order' in note)
    assert note.startswith('high_0 forbids a motion of low_0 to second order only')
    assert 'low_0 = 0 by held_low_0' in note
    text = describe(made, simulation)
    assert ('1 = 3 joints - 1 independent equations (1 of 2 repeat others) - 1 that loops forbid '
            'to second order only') in text
    assert find_degrees_of_freedom(made.mechanism) == 1
    # The force along the bar has no effect on the motion: the least is reported, and marked.
    assert simulation.data.redundancy().shared


def test_a_flat_arch_is_rigid():
    with pytest.raises(AssemblyError, match=r'flat_arch cannot move: c forbids .* \(a, b\)'):
        Simulation(scene(taut.flat_arch(), np.zeros(2), gravity=(0.0, -9.81)))
    assert find_degrees_of_freedom(taut.flat_arch()) == 0


def test_kinematics_and_report_count_real_freedoms():
    made = scene(taut.gantry(), np.zeros(3))
    assert degrees_of_freedom(made, np.zeros(3)) == 1
    run = DrivenRun(made, {'rail_0': Drive(0.0, 0.5)}, 5, 1.0)
    assert np.abs(run.position - np.outer(np.linspace(0.0, 0.5, 5), (1.0, 1.0, 0.0))).max() < 1e-9


def test_models_solve_and_roll_out_with_real_freedoms():
    model = Model(scene(taut.gantry(), np.zeros(3)))
    assert np.abs(model.solve({'rail_0': 0.3}).q - (0.3, 0.3, 0.0)).max() < 1e-9
    found = model.assemblies({'rail_0': 0.3})
    assert np.abs(found.states.q - (0.3, 0.3, 0.0)).max() < 1e-9
    simulation = Simulation(model)
    rolled = simulation.rollout(np.ones((2, 1, 1)), duration=0.5)
    assert np.abs(rolled.position[:, -1] - (0.025, 0.025, 0.0)).max() < 1e-9


def _held(arms, turn, ball):
    """Return a box in two hands, angles of the left arm 0.3 and 0.8, the box turned about y."""
    mechanism = taut.box_in_two_hands(**arms, ball=ball)
    upper, lower = arms.get('upper', (0.3, 0.3)), arms.get('lower', (0.25, 0.25))
    left = 0.3, 0.8
    reach = (upper[0] * np.cos(0.3) + lower[0] * np.cos(1.1),
             1.0 - upper[0] * np.sin(0.3) - lower[0] * np.sin(1.1))
    right = taut.hand_angles(reach, upper[1], lower[1], arms.get('apart', 0.0))
    tail = (turn,) if ball == REVOLUTE else (0.0, np.sin(0.5 * turn), 0.0, np.cos(0.5 * turn))
    return scene(mechanism, (*left, *right, *tail), gravity=(0.0, 0.0, -9.81))


@pytest.mark.parametrize('arms', [
    {}, {'upper': (0.3, 0.4), 'lower': (0.25, 0.22), 'apart': -0.1}],
    ids=['equal arms', 'different arms'])
def test_a_box_between_two_arms_moves_as_with_a_hinge(arms):
    # The balls let the box turn about the line between them only, as a hinge does: the twin.
    simulation, twin = (Simulation(_held(arms, 0.4, ball)) for ball in ('spherical', REVOLUTE))
    assert simulation.data.degrees_of_freedom() == twin.data.degrees_of_freedom() == 3
    torque = {'ls': 1.0, 'le': -2.0, 'rs': 0.5, 're': 0.2}
    for one in (simulation, twin):
        one.step(torque, 0.3)
    # Angles of the arms; the box turns about y as a quaternion, and does not tilt.
    # 1e-6, what both runs keep, about ten times over.
    assert np.abs(simulation.position[:4] - twin.position[:4]).max() < 1e-5
    x, y, z, w = simulation.position[4:]
    assert max(abs(x), abs(z)) < 1e-9
    assert abs(2.0 * np.arctan2(y, w) - twin.position[4]) < 1e-5


def singular_starts():
    """Yield mechanisms and closed positions, many of them singular, in all of which they move."""
    for name in scene_names():
        simulation = Simulation(load_scene(name))
        yield replace(with_motions(simulation.scene), motions=()), simulation.position
    for tilt in (0.5 * np.pi, 0.5 * np.pi - 1e-6, 0.5 * np.pi - 1e-3):
        for loops in (1, 2, 3):
            yield ladder(loops, tilt)[:2]
        yield parallelogram(tilt)[:2]
        yield scissor_lift(2, tilt - 0.5 * np.pi)[:2]
        yield hard_machines.pantograph(-1.9, -1.9 + tilt - 0.5 * np.pi, 1.0, 1.0)[:2]
    for made in (hard_machines.three_rockers(), hard_machines.welded_twice(),
                 hard_machines.change_point_linkage()):
        yield made[:2]
        yield hard_machines.doubled(made[0]), made[1]
    # Flat: the crank points back, 3 - 1 = 4 - 2.
    yield hard_machines.change_point_linkage()[0], np.array([np.pi, -np.pi, np.pi])


def test_singular_starts_are_no_forbidden_motions():
    for mechanism, position in singular_starts():
        closed = Assembler(mechanism, Geometry(mechanism).equations).positions(position)
        assert find_second_order(mechanism, closed) is None, mechanism.name


@pytest.mark.parametrize('count', [12, pytest.param(300, marks=[
    pytest.mark.slow, pytest.mark.timeout(3600)])])
def test_redundant_loops_are_no_forbidden_motions(count):
    found = []
    for number in range(count):
        loops = random_loops(np.random.default_rng([7, number]))
        # Also where equations that repeat others are known as such, which is all of them.
        if find_second_order(loops.mechanism, np.array(loops.q)) is not None:
            found.append(number)
    print(f'tried {count}, called forbidden: {found}')
    assert not found
