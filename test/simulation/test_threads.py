# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Several threads: each has its own numbers, or is told that it cannot."""

import copy
import pickle
import sys
import threading

from closedloop_dynamics import Model, Simulation
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


@pytest.mark.parametrize('copied', [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_simulation_is_not_copied(copied):
    simulation = Simulation.from_scene('four_bar', integrator='rk4')
    with pytest.raises(TypeError, match='Simulation: expected no copy, as two would work on the'):
        copied(simulation)
    # As the message says.
    simulation.step(duration=0.05)
    other = Simulation(simulation.scene)
    other.restore(simulation.state, simulation.time)
    here = simulation.state
    other.step(duration=0.05)
    np.testing.assert_array_equal(simulation.state, here)
    simulation.step(duration=0.05)
    np.testing.assert_array_equal(simulation.state, other.state)
    assert copied(Model(simulation.scene))
