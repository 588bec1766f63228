# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Results do not depend on how calls are cut."""

from dataclasses import replace
import itertools
import warnings

from closedloop_dynamics import load_scene, Method, NumericalError, Simulation
from closedloop_dynamics.effects.registry import Contact, JointFriction, JointSpring
from closedloop_dynamics.mechanism.config import shipped_names
import numpy as np
import pytest


CUTS = (1, 2, 5, 10, 50)
DURATION = 0.1


def bennett():
    """Return Bennett's linkage, turning, with a pin under friction and a link on a plane."""
    scene = load_scene('bennett')
    return replace(
        scene, initial=replace(scene.initial, velocity=(-25.0, 0.0, 0.0)), effects={
            **scene.effects,
            'dry': JointFriction(joint='joint_2', coulomb=0.05),
            'floor': Contact(point='elbow', origin=(0.0, 0.0, -0.3), normal=(0.0, 0.0, 1.0),
                             stiffness=1e5, damping=1.0, friction=0.3)})


def ends(scene, cuts=CUTS, duration=DURATION, kept=None):
    """Return the positions after a duration in calls of so many steps, with some equations."""
    found = []
    for cut in cuts:
        simulation = Simulation(scene)
        if kept is not None:
            simulation.data.use_equations(simulation.data.loop_model.select(kept))
        for _ in range(round(duration / (cut * simulation.step_size))):
            simulation.step(None, cut * simulation.step_size)
        found.append(simulation.position)
    return np.array(found)


@pytest.mark.slow
def test_left_out_equations_are_looked_at_however_calls_are_cut():
    # Two of five equations, chosen well and ill: each pair comes to depend on the other somewhere.
    pairs = itertools.combinations(range(5), 2)
    found = np.array([ends(bennett(), (1, 20, 400), 0.4, np.isin(np.arange(5), pair))
                      for pair in pairs])
    assert np.ptp(found, axis=1).max() == 0.0
    assert np.ptp(found, axis=0).max() < 1e-7


@pytest.mark.parametrize('name', ['bricard', 'four_bar', *(
    pytest.param(name, marks=pytest.mark.slow) for name in shipped_names('scenes'))])
def test_results_do_not_depend_on_how_calls_are_cut(name):
    scene = load_scene(name)
    with warnings.catch_warnings():
        warnings.simplefilter('ignore')
        found = ends(scene)
    assert np.abs(found - found[0]).max() < scene.method.accuracy


def rattling(**method):
    """Return a slider-crank whose crank swings 5,000 times within a time of output of 20 ms."""
    return replace(load_scene('slider_crank'), method=Method(step_size=0.02, **method),
                   effects={'spring': JointSpring('crank_joint', 1e9, 1.0)})


@pytest.mark.parametrize('method', [
    {'accuracy': 1e-9}, {'integrator': 'rodas4', 'tolerance': 1e-9}])
def test_the_limit_on_work_does_not_depend_on_how_calls_are_cut(method):
    found = set()
    for cut in (1, 2, 10):
        simulation = Simulation(rattling(**method))
        with pytest.raises(NumericalError, match='more than 200000 .* effect that is so fast'):
            for _ in range(10 // cut):
                simulation.advance(simulation.joint_torques(None), cut)
        found.add((simulation.time, *simulation.position))
    assert len(found) == 1


def test_one_call_may_take_more_than_one_time_of_output():
    simulation = Simulation(rattling(integrator='dop853', tolerance=1e-9))
    simulation.advance(simulation.joint_torques(None), 20)
    assert simulation.time == 20 * 0.02
    assert simulation.report().evaluations > 200_000


@pytest.mark.parametrize('method', [
    {}, {'integrator': 'dopri5', 'tolerance': 1e-8}, {'integrator': 'dop853', 'tolerance': 1e-9}])
@pytest.mark.parametrize('name', ['delta_robot', 'stewart_platform'])
def test_independent_coordinates_do_not_depend_on_where_states_are_asked_for(name, method):
    scene = replace(load_scene(name), method=Method(stabilisation='independent', **method))
    found = ends(scene, (1, 3, 10, 60), 0.24)
    assert np.ptp(found, axis=0).max() == 0.0


@pytest.mark.slow
def test_independent_coordinates_pass_a_singular_position_as_projection_does():
    # Arms and rods of a delta robot come to lie in planes, within a third of a second. Steps of an
    # accuracy of 1e-9 would be as small as what accelerations from places around are off by.
    scene, found = load_scene('delta_robot'), []
    for stabilisation in ('projection', 'independent'):
        simulation = Simulation(replace(
            scene, effects={'gravity': scene.effects['gravity']},
            method=Method(accuracy=1e-8, stabilisation=stabilisation)))
        simulation.step(duration=0.32)
        found.append(simulation.position)
    assert found[1] == pytest.approx(found[0], abs=1e-9)
