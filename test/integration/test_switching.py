# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0
"""Tests of the default method: it keeps its accuracy, and steps as its steps ask for."""

from dataclasses import replace

from closedloop_dynamics import load_scene, Method, scene_names, Simulation
from closedloop_dynamics.effects.end_stop import EndStop
from closedloop_dynamics.engine.types import EVALUATIONS
import numpy as np
import pytest

from ..effects.machines import block, simulated
from ..reference import cases, famous, peaucellier

# An accuracy counts as kept up to this factor.
KEPT = 3.0
# Where the memory of the method has whether its error is monitored, and when that changes: behind
# the control records of both runs (``engine/switching.hpp``).
OPEN, UNTIL = 54, 55


def worst_error(scene, torque, accuracy, change=None, duration=1.0):
    """Return the largest error of coordinates over a time, and the run."""
    scene = load_scene(scene) if isinstance(scene, str) else scene
    runs = [Simulation(replace(scene, method=method)) for method in (
        Method(accuracy=accuracy), Method(integrator='dop853', tolerance=1e-13))]
    worst = 0.0
    for number in range(20):
        if change:
            torque = change(number)
        for one in runs:
            one.step(torque, 0.05 * duration)
        worst = max(worst, np.abs(runs[0].position - runs[1].position).max())
    return worst, runs[0]


@pytest.mark.parametrize('scene', cases.only(cases.CLASSES, scene_names()))
def test_every_shipped_scene_is_right_to_the_default_accuracy(scene):
    accuracy = Method().accuracy
    asked = min(accuracy, load_scene(scene).method.accuracy)
    error, simulation = worst_error(scene, None, asked)
    assert error <= accuracy and simulation.report().findings == ()


@pytest.mark.parametrize('scene, torque', [
    ('three_rrr', [5.0, -3.0, 2.0]), ('three_rrr_horizontal', [5.0, -3.0, 2.0]),
    ('carpet_scraper', [30.0])])
@pytest.mark.parametrize('accuracy', [1e-3, 1e-6, 1e-9])
def test_the_accuracy_is_kept_under_torques(scene, torque, accuracy):
    error, simulation = worst_error(scene, torque, accuracy)
    assert error <= KEPT * accuracy
    # What it says of itself is no less than a third of the truth, and no empty warning.
    assert simulation.report().error_bound > 0.3 * error
    assert simulation.report().error_bound < KEPT * accuracy


@pytest.mark.parametrize('make, torque', [
    (famous.jansen, None), (famous.jansen, [20.0]), (famous.four_rrr, [5.0, -3.0, 2.0, 1.0])])
def test_the_accuracy_is_kept_by_well_known_linkages(make, torque):
    error, simulation = worst_error(make(), torque, 1e-6)
    assert error <= 1e-6 and simulation.report().findings == ()


@pytest.mark.parametrize('accuracy', [1e-3, 1e-6, 1e-9])
def test_the_accuracy_is_kept_through_a_singular_position(accuracy):
    simulation = Simulation(replace(peaucellier.scene(), method=Method(accuracy=accuracy)))
    times, found = 0.02 * np.arange(1, 11), []
    for _ in times:
        simulation.step(duration=0.02)
        found.append(simulation.position[0])
    error = np.abs(found - peaucellier.crank_angles(times)).max()
    assert error <= KEPT * accuracy
    assert simulation.report().error_bound <= KEPT * accuracy


def test_the_accuracy_is_kept_by_a_mechanism_of_grams_and_milliseconds():
    scene, small, light = load_scene('four_bar'), 0.02, 1e-3
    mechanism = scene.mechanism

    def shrunk(place):
        return tuple(small * value for value in place)

    tiny = replace(
        mechanism,
        bodies=tuple(replace(
            body, mass=light * body.mass, inertia=light * small ** 2 * body.inertia,
            center_of_mass=shrunk(body.center_of_mass)) for body in mechanism.bodies),
        joints=tuple(replace(joint, position=shrunk(joint.position))
                     for joint in mechanism.joints),
        cut_joints=tuple(replace(cut, point_a=shrunk(cut.point_a), point_b=shrunk(cut.point_b))
                         for cut in mechanism.cut_joints))
    torque = [2e-2]
    start = Simulation(replace(scene, mechanism=tiny))
    start.step(torque, 0.0)
    assert np.abs(start.acceleration).max() > 1e4
    error, _ = worst_error(replace(scene, mechanism=tiny), torque, 1e-6, duration=0.03)
    assert error <= KEPT * 1e-6


def test_the_accuracy_is_kept_under_torques_that_change():
    error, _ = worst_error('three_rrr', None, 1e-6,
                           lambda number: [20.0 * np.sin(number), -3.0, 5.0 * np.cos(number)])
    assert error <= 1e-6


def test_a_motion_too_sensitive_for_its_accuracy_is_reported():
    simulation = Simulation.from_scene('three_rrr')
    simulation.step({'theta_1': 3000.0}, 1.0)
    finding, = simulation.report().findings
    assert 'was not kept' in finding and 'rounding errors grow to that size' in finding


@pytest.mark.parametrize('integrator', ['auto', 'dop853'])
def test_a_run_does_not_depend_on_how_often_it_is_looked_at(integrator):
    once, often = (Simulation.from_scene('three_rrr', integrator=integrator) for _ in range(2))
    tau = once.joint_torques([5.0, -3.0, 2.0])
    once.advance(tau, 1025)
    # 0.825 s and 200 steps of 0.001 s are not 1.025 s to the last bit.
    for steps in (1, 24, *50 * (20,)):
        often.advance(tau, steps)
    assert np.array_equal(once.position, often.position)


def test_steps_end_where_torques_are_expected_to_change():
    free, held = (Simulation.from_scene('three_rrr', integrator='dop853') for _ in range(2))
    for number in range(50):
        held.step([5.0 + 1e-9 * number, -3.0, 2.0], 0.01)
    free.step([5.0, -3.0, 2.0], 0.5)
    steps = held.stepping.run.steps.accepted
    # One for each torque, but for the first interval, of which nothing was known.
    assert steps <= 60
    assert np.abs(held.position - free.position).max() < 1e-5


def test_what_is_stiff_is_stepped_stiffly_and_back():
    scene = load_scene('carpet_scraper_on_carpet')
    drive = scene.effects
    name = next(key for key, one in drive.items() if type(one).__name__ == 'Actuator')
    stiff = replace(drive[name], lag=1e-6)
    simulation = Simulation(replace(scene, effects={**drive, name: stiff}))
    tau = simulation.joint_torques([30.0])
    was_stiff = False
    for _ in range(20):
        simulation.advance(tau, 10)
        was_stiff = was_stiff or simulation.stepping.run.steps.stiff
    assert was_stiff
    # An explicit method would need a million steps a second.
    assert simulation.stepping.run.steps.accepted < 3e4
    assert simulation.report().findings == ()


@pytest.mark.parametrize('rate', [100, 1000])
@pytest.mark.parametrize('accuracy', [1e-3, 1e-6, 1e-9])
def test_torques_held_for_short_do_not_double_the_evaluations(rate, accuracy):
    scene = load_scene('three_rrr')
    runs = {name: Simulation(replace(scene, method=Method(step_size=1.0 / rate, **method)))
            for name, method in (('auto', {'accuracy': accuracy}),
                                 ('one', {'integrator': 'dop853', 'tolerance': 1e-3 * accuracy}),
                                 ('exact', {'integrator': 'dop853', 'tolerance': 1e-13}))}
    auto, worst = runs['auto'], 0.0
    for number in range(rate):
        swing = 1.0 + np.cos(4.0 * np.pi * number / rate)
        for one in runs.values():
            one.advance(one.joint_torques([5.0 * swing, -3.0 * swing, 2.0 * swing]), 1)
        worst = max(worst, np.abs(auto.position - runs['exact'].position).max())
    # The companion takes no evaluations for steps that would be those of the run; at 1e-9 the run
    # divides some of them.
    own, companion = auto.stepping.monitor.work
    made = runs['one'].data.system.work.health[EVALUATIONS]
    most = {1e-3: 1.05, 1e-6: 1.05, 1e-9: 1.5}[accuracy] if rate == 1000 else 2.2
    assert auto.data.system.work.health[EVALUATIONS] < most * made
    assert own + companion < most * own
    # The error is reported all the same.
    assert worst <= accuracy and 0.3 * worst <= auto.report().error_bound <= accuracy


@pytest.mark.parametrize('rate', [100, 1000])
def test_the_run_does_not_depend_on_its_companion(rate):
    # Nothing that the companion does, or is spared, changes a digit of the run.
    free, watched = (Simulation.from_scene('three_rrr', step_size=1.0 / rate) for _ in range(2))
    for number in range(300):
        torque = [5.0 + 0.01 * number, -3.0, 2.0 * np.sin(0.1 * number)]
        for one in (free, watched):
            one.advance(one.joint_torques(torque), 1)
        # From the first step on no window is open.
        whole = free.state
        whole[[len(free.data.integrated) + OPEN, len(free.data.integrated) + UNTIL]] = 0.0, np.inf
        free.stepping.run.recall(whole)
    assert free.stepping.monitor.work[1] < 0.1 * watched.stepping.monitor.work[0]
    assert np.array_equal(free.data.integrated, watched.data.integrated)


def test_the_companion_takes_the_steps_that_events_end():
    stop = EndStop('slide', 1e4, lower=-0.01, upper=0.01)
    simulation = simulated(block(), {'stop': stop}, [0.0], [1.0], integrator='auto')
    for number in range(500):
        simulation.advance(simulation.joint_torques([1e-9 * number]), 1)
    own, companion = simulation.stepping.monitor.work
    assert companion < 0.02 * own


def test_without_new_torques_the_steps_are_those_of_dop853():
    one, auto = (Simulation.from_scene('three_rrr', **method) for method in (
        {'integrator': 'dop853', 'tolerance': 1e-9}, {'accuracy': 1e-6}))
    for _ in range(10):
        for run in (one, auto):
            run.advance(run.joint_torques([5.0, -3.0, 2.0]), 50)
    assert np.array_equal(one.data.integrated, auto.data.integrated)


@pytest.mark.parametrize('scene', ['three_rrr', 'carpet_scraper', 'stewart_platform'])
def test_steps_between_torques_are_those_of_the_lower_order_where_these_are_accurate(scene):
    simulation = Simulation.from_scene(scene)
    run, short, evaluations = simulation.stepping.run, 0, []
    for number in range(200):
        tau = np.full(len(simulation.torque_names), 0.1 + 1e-3 * (number % 3))
        before = run.steps.work
        simulation.advance(tau, 1)
        short += run.steps.is_short
        evaluations.append(run.steps.work - before)
    # Six evaluations, and that of the end, for the error, are not twelve.
    assert short > 150 and np.median(evaluations) == 6.0
    # Torques that are held for longer than expected: DOP853 goes on.
    simulation.advance(tau, 100)
    assert not run.steps.is_short


def test_a_lower_order_that_is_too_coarse_is_tried_rarely():
    simulation = Simulation.from_scene('three_rrr', accuracy=1e-9, step_size=0.02)
    short = 0
    for number in range(200):
        simulation.advance(simulation.joint_torques([5.0 + 0.01 * number, -3.0, 2.0]), 1)
        short += simulation.stepping.run.steps.is_short
    assert short <= 5
