# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Several threads: each has its own numbers, or a refusal."""

import copy
import pickle
import sys
import threading

from closedloop_dynamics import Model, Simulation, SimulationError
import numpy as np
import pytest


@pytest.fixture
def hasty():
    """Let threads change places as often as they can."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    yield
    sys.setswitchinterval(before)


def in_threads(*tasks):
    """Do tasks at once, and raise what any of them raised."""
    raised = []

    def run(task):
        try:
            task()
        except BaseException as error:
            raised.append(error)

    threads = [threading.Thread(target=run, args=(task,)) for task in tasks]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    if raised:
        raise raised[0]


@pytest.mark.parametrize('scene', ['four_bar', 'excavator_arm'])
def test_a_model_serves_all_threads_whatever_they_ask(hasty, scene):
    model = Model.from_scene(scene)
    simulation = Simulation(model)
    states = [simulation.snapshot()]
    for _ in range(3):
        simulation.step(duration=0.02)
        states.append(simulation.snapshot())
    expected = [model.evaluate(state).acceleration for state in states]
    forces = [model.readings(state).joint_forces for state in states]
    assert all(not np.array_equal(expected[0], other) for other in expected[1:])
    wrong = []

    def evaluate():
        for n in range(1500):
            if not np.array_equal(model.evaluate(states[n % 2]).acceleration, expected[n % 2]):
                wrong.append('evaluate')

    def read(which):
        for _ in range(1500):
            readings = model.readings(states[which])
            if not (np.array_equal(readings.acceleration, expected[which])
                    and np.array_equal(readings.joint_forces, forces[which])):
                wrong.append('readings')

    in_threads(evaluate, lambda: read(2), lambda: read(3))
    assert not wrong


def test_a_second_thread_in_a_simulation_is_refused():
    simulation = Simulation.from_scene('three_rrr', integrator='rk4')
    tau, begun, over = simulation.joint_torques(None), threading.Event(), threading.Event()
    refused = []

    def run():
        begun.set()
        try:
            simulation.advance(tau, 300_000)
        except RuntimeError as error:
            # The other one came between two calls of the engine.
            refused.append(str(error))
        over.set()

    def disturb():
        assert begun.wait(100)
        while not over.is_set():
            for use in (lambda: simulation.advance(tau, 1), lambda: simulation.step(duration=0.01),
                        lambda: simulation.set_state(simulation.position), simulation.reset,
                        lambda: simulation.forward_dynamics(tau, tau)):
                try:
                    use()
                except RuntimeError as error:
                    refused.append(str(error))

    in_threads(run, disturb)
    assert any('another thread computes with this simulation' in one for one in refused)
    # It goes on.
    simulation.advance(tau, 10)


def twins(simulation):
    """Return a copy of a simulation, and what its pickle becomes."""
    return copy.copy(simulation), copy.deepcopy(simulation), pickle.loads(
        pickle.dumps(simulation))


@pytest.mark.parametrize('integrator', ['rk4', 'auto', 'rodas4', 'dop853'])
@pytest.mark.parametrize('scene', ['four_bar', 'three_rrr_payload_friction', 'bennett'])
def test_copies_go_on_as_the_simulation_does(scene, integrator):
    try:
        simulation = Simulation.from_scene(scene, integrator=integrator, tolerance=1e-9)
    except SimulationError:
        pytest.skip('an integrator that does not serve this scene')
    torque = np.linspace(0.02, 0.05, len(simulation.actuated_joints))
    simulation.step(torque, 0.03)
    *copies, pickled = twins(simulation)
    for one in (*copies, pickled):
        assert one.time == simulation.time
        np.testing.assert_array_equal(one.data.integrated, simulation.data.integrated)
        np.testing.assert_array_equal(one.acceleration, simulation.acceleration)
        assert one.energy_balance.residual == pytest.approx(
            simulation.energy_balance.residual, abs=1e-15)
    state = simulation.state
    for one in (*copies, pickled):
        one.step(torque, 0.02)
    # Nothing is shared.
    np.testing.assert_array_equal(simulation.state, state)
    simulation.step(torque, 0.02)
    for one in copies:
        assert one.energy_balance == simulation.energy_balance
        np.testing.assert_array_equal(one.state, simulation.state)
    # The error control of what was pickled begins again: a thousand tolerances of a step.
    tolerance = 0.0 if integrator == 'rk4' else 1e-6
    for one in (*copies, pickled):
        np.testing.assert_allclose(
            one.data.integrated, simulation.data.integrated, rtol=tolerance, atol=tolerance)
        assert one.time == simulation.time


def test_copies_have_effects_methods_and_starts_as_they_are():
    model = Model.from_scene('three_rrr')
    simulation = Simulation(model, model.assemble(velocity={'theta_1': 0.5}), 'rk4')
    start = simulation.state
    simulation.step(duration=0.02)
    simulation.set_effect('gravity', acceleration=(0.0, -1.0))
    simulation.stepping.prepare_method(step_size=5e-4, integrator='heun')()
    others = twins(simulation)
    simulation.step(duration=0.01)
    for one in others:
        assert one.effects == simulation.effects
        assert one.scene.method == simulation.scene.method
        one.step(duration=0.01)
        np.testing.assert_array_equal(one.state, simulation.state)
        one.reset()
        np.testing.assert_array_equal(one.state, start)
        assert one.effects['gravity'].acceleration == (0.0, -1.0)


@pytest.mark.parametrize('scene', ['bennett', 'stewart_platform', 'cam_follower', 'differential'])
def test_systems_are_pickled_as_what_they_are_built_from(scene):
    simulation = Simulation.from_scene(scene)
    system = simulation.data.system
    system.tau[:] = np.linspace(0.1, 0.2, len(system.tau))
    other = pickle.loads(pickle.dumps(system))
    state = simulation.data.integrated
    for each in (system, other):
        each.native.evaluate_with_poses(state)
    np.testing.assert_array_equal(other.qdd, system.qdd)
    np.testing.assert_array_equal(other.lam, system.lam)
    assert other.routines == system.routines
    assert not np.may_share_memory(other.qdd, system.qdd)


def test_what_scripts_see_is_little():
    simulation = Simulation.from_scene('four_bar')
    for one, most in ((simulation, 30), (Model(simulation.scene), 21)):
        names = [name for name in dir(one) if not name.startswith('_')]
        assert len(names) <= most, names
    # Quantities of the present state are passed on, and nothing else.
    np.testing.assert_array_equal(simulation.acceleration, simulation.data.acceleration)
    for name in Simulation.__annotations__:
        getattr(simulation, name)
    assert not hasattr(simulation, 'system')
