# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The services and the action of simulation_interfaces, asked from another process over DDS.

Where that package is not installed, ``python test/ros/build_interfaces.py`` builds it.
"""

from types import SimpleNamespace

from closedloop_dynamics import Simulation
from closedloop_dynamics.mechanism.kinematics import poses_in_space
import numpy as np
import pytest
from rclpy.action import ActionClient
from sensor_msgs.msg import JointState
from std_srvs.srv import SetBool, Trigger

pytest.importorskip(
    'simulation_interfaces', reason='needs the package simulation_interfaces, which '
    'test/ros/build_interfaces.py builds from its source')

from simulation_interfaces.action import SimulateSteps  # noqa: E402,I100
from simulation_interfaces.msg import (  # noqa: E402
    EntityCategory, EntityFilters, Result, SimulationState, SimulatorFeatures, TagsFilter)
from simulation_interfaces.srv import (  # noqa: E402
    GetEntities, GetEntitiesStates, GetEntityInfo, GetEntityState, GetSimulationState,
    GetSimulatorFeatures, ResetSimulation, SetEntityState, SetSimulationState, StepSimulation)

SIMULATOR = 'closedloop_simulator'
OK, FAILED = Result.RESULT_OK, Result.RESULT_OPERATION_FAILED
UNSUPPORTED = Result.RESULT_FEATURE_UNSUPPORTED
PLAYING, PAUSED, STOPPED = (
    SimulationState.STATE_PLAYING, SimulationState.STATE_PAUSED, SimulationState.STATE_STOPPED)
NAMES = {
    GetEntities: 'get_entities', GetEntitiesStates: 'get_entities_states',
    GetEntityInfo: 'get_entity_info', GetEntityState: 'get_entity_state',
    GetSimulationState: 'get_simulation_state', GetSimulatorFeatures: 'get_simulator_features',
    ResetSimulation: 'reset_simulation', SetEntityState: 'set_entity_state',
    SetSimulationState: 'set_simulation_state', StepSimulation: 'step_simulation'}


@pytest.fixture
def machine(processes, listener):
    """Return a paused manipulator on a table, by what a client sees of it."""
    process = processes.start(
        SIMULATOR, scene='three_rrr_horizontal', publish_clock='true').wait_until_ready()
    states = listener.listen('joint_states', JointState)

    def ask(service, **request):
        return listener.call(service, f'{SIMULATOR}/{NAMES[service]}', service.Request(**request))

    def go_to(state):
        return ask(SetSimulationState, state=SimulationState(state=state)).result

    go_to(PAUSED)
    return SimpleNamespace(
        process=process, ask=ask, go_to=go_to, states=states, listener=listener,
        now_in=lambda: ask(GetSimulationState).state.state,
        time=lambda: stamp(ask(GetEntityState, entity='platform').state) - 0.01)


def stamp(message):
    return message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec


def test_time_runs_stands_and_returns_as_the_standard_has_it(machine):
    already = SetSimulationState.Response.ALREADY_IN_TARGET_STATE
    assert machine.now_in() == PAUSED and machine.go_to(PAUSED).result == already
    assert machine.go_to(STOPPED).result == OK
    assert machine.now_in() == STOPPED and machine.time() == pytest.approx(0.0)
    # A step leaves the start.
    assert machine.ask(StepSimulation, steps=7).result.result == OK
    assert machine.now_in() == PAUSED and machine.time() == pytest.approx(7e-3)
    assert machine.go_to(PLAYING).result == OK and machine.now_in() == PLAYING
    machine.listener.wait(lambda: stamp(machine.states[-1]) > 0.1, 'motion')
    # The package's own services mean the same.
    machine.listener.call(SetBool, f'{SIMULATOR}/pause', SetBool.Request(data=True))
    assert machine.now_in() == PAUSED
    for scope in (ResetSimulation.Request.SCOPE_DEFAULT, ResetSimulation.Request.SCOPE_ALL, 3):
        assert machine.ask(ResetSimulation, scope=scope).result.result == OK
        assert machine.time() == pytest.approx(0.0)
        machine.ask(StepSimulation, steps=5)
    place = machine.states[-1].position[0]
    machine.ask(ResetSimulation, scope=ResetSimulation.Request.SCOPE_TIME)
    assert machine.time() == pytest.approx(0.0)
    machine.listener.wait(lambda: stamp(machine.states[-1]) < 0.012, 'the state')
    assert machine.states[-1].position[0] == place
    machine.ask(StepSimulation, steps=5)
    machine.ask(ResetSimulation, scope=ResetSimulation.Request.SCOPE_STATE)
    assert machine.time() == pytest.approx(5e-3)
    start = Simulation.from_scene('three_rrr_horizontal').position[0]
    machine.listener.wait(lambda: abs(machine.states[-1].position[0] - start) < 1e-12, 'the start')
    assert machine.ask(ResetSimulation, scope=4).result.result == UNSUPPORTED
    for state in (SimulationState.STATE_NO_WORLD, 77):
        assert machine.go_to(state).result == UNSUPPORTED
    assert machine.go_to(SimulationState.STATE_QUITTING).result == OK
    assert machine.process.wait() == 0


def test_steps_are_those_of_a_run_and_refused_while_time_runs(machine):
    machine.go_to(STOPPED)
    simulation = Simulation.from_scene('three_rrr_horizontal')
    simulation.step(duration=0.05)
    machine.ask(StepSimulation, steps=50)
    # Once, or again where the first answer was lost.
    while machine.time() > 0.051:
        machine.go_to(STOPPED)
        machine.ask(StepSimulation, steps=50)
    found = machine.ask(GetEntitiesStates, filters=EntityFilters(filter='^platform$'))
    assert found.entities == ['platform']
    state = found.states[0]
    row = [body.name for body in simulation.mechanism.bodies].index('platform')
    place, turn = state.pose.position, state.pose.orientation
    np.testing.assert_allclose(
        [place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w],
        poses_in_space(simulation.body_poses[row]), rtol=0, atol=1e-9)
    for steps in (0, 10 ** 9):
        assert machine.ask(StepSimulation, steps=steps).result.result == FAILED
    machine.go_to(PLAYING)
    refused = machine.ask(StepSimulation, steps=1).result
    assert refused.result == FAILED and 'paused' in refused.error_message


def test_the_action_tells_of_each_step_and_can_be_cancelled(machine):
    machine.go_to(STOPPED)
    client = ActionClient(machine.listener.node, SimulateSteps, f'{SIMULATOR}/simulate_steps')
    machine.listener.wait(client.server_is_ready, 'the action')
    wait = machine.listener.wait

    def begin(steps, seen):
        sent = client.send_goal_async(
            SimulateSteps.Goal(steps=steps), feedback_callback=lambda message: seen.append(
                (message.feedback.completed_steps, message.feedback.remaining_steps)))
        wait(sent.done, 'acceptance')
        return sent.result(), sent.result().get_result_async()

    goal, result = begin(10 ** 12, seen := [])
    wait(lambda: seen, 'feedback')
    # Others are answered meanwhile, and another one waits for its turn in vain.
    assert machine.ask(StepSimulation, steps=1).result.result == FAILED
    _, second = begin(1, [])
    wait(second.done, 'the refusal')
    assert 'simulate_steps is making' in second.result().result.result.error_message
    goal.cancel_goal_async()
    wait(result.done, 'the end')
    assert 'cancelled after' in result.result().result.result.error_message
    # By now its feedback is heard from the first step on.
    begun = machine.time()
    _, result = begin(9, seen := [])
    wait(result.done, 'the result')
    assert result.result().result.result.result == OK
    wait(lambda: len(seen) == 9, 'feedback')
    assert seen == [(n, 9 - n) for n in range(1, 10)]
    assert machine.time() == pytest.approx(begun + 9e-3)
    _, result = begin(10 ** 12, [])
    machine.listener.call(Trigger, f'{SIMULATOR}/reset', Trigger.Request())
    wait(result.done, 'the end')
    assert 'interrupted after' in result.result().result.result.error_message
    machine.go_to(PLAYING)
    _, result = begin(1, [])
    wait(result.done, 'the refusal')
    assert 'paused' in result.result().result.result.error_message
    client.destroy()


def test_bodies_are_entities_that_can_be_moved_as_far_as_the_loops_let_them(machine):
    machine.go_to(STOPPED)
    features = machine.ask(GetSimulatorFeatures).features.features
    assert {SimulatorFeatures.ENTITY_STATE_SETTING, SimulatorFeatures.STEP_SIMULATION_ACTION} < (
        set(features)) and SimulatorFeatures.SPAWNING not in features
    every = machine.ask(GetEntities).entities
    assert len(every) == 7 and 'platform' in every
    for filters, names in (
            (EntityFilters(filter='^distal_[12]$'), {'distal_1', 'distal_2'}),
            (EntityFilters(tags=TagsFilter(tags=['body', 'none'], filter_mode=1)), set()),
            (EntityFilters(categories=[EntityCategory(category=EntityCategory.CATEGORY_HUMAN)]),
             set())):
        assert set(machine.ask(GetEntities, filters=filters).entities) == names
    assert machine.ask(GetEntities, filters=EntityFilters(filter='(')).result.result == FAILED
    info = machine.ask(GetEntityInfo, entity='proximal_1')
    assert info.info.tags == ['body', 'three_rrr'] and 'kg' in info.info.description
    for service in (GetEntityInfo, GetEntityState, SetEntityState):
        assert machine.ask(service, entity='chair').result.result == Result.RESULT_NOT_FOUND

    state = machine.ask(GetEntityState, entity='platform').state
    state.pose.position.x += 0.02
    state.twist.linear.y, state.twist.angular.z = 0.05, 0.3
    assert machine.ask(SetEntityState, entity='platform', state=state, set_pose=True,
                       set_twist=True).result.result == OK
    found = machine.ask(GetEntityState, entity='platform').state
    assert found.pose.position.x == pytest.approx(state.pose.position.x, abs=1e-9)
    assert found.twist.linear.y == pytest.approx(0.05, abs=1e-7)
    assert found.twist.linear.x == pytest.approx(0.0, abs=1e-7)
    assert found.twist.angular.z == pytest.approx(0.3, abs=1e-7)
    # One flag leaves the other part as it is.
    found.pose.position.x -= 0.01
    found.twist.linear.y = 9.0
    machine.ask(SetEntityState, entity='platform', state=found, set_pose=True)
    assert machine.ask(GetEntityState, entity='platform').state.twist.angular.z == (
        pytest.approx(0.3, rel=0.2))

    invalid = SetEntityState.Response.INVALID_POSE
    for change, code in (
            (lambda s: setattr(s.pose.position, 'z', 0.1), invalid),
            (lambda s: setattr(s.pose.position, 'x', 9.0), invalid),
            (lambda s: setattr(s.pose.position, 'x', float('nan')), invalid),
            (lambda s: setattr(s.pose.orientation, 'w', 3.0), invalid),
            (lambda s: setattr(s.twist.linear, 'z', 1.0), FAILED),
            (lambda s: setattr(s.header, 'frame_id', 'moon'), UNSUPPORTED)):
        wrong = machine.ask(GetEntityState, entity='platform').state
        change(wrong)
        assert machine.ask(SetEntityState, entity='platform', state=wrong, set_pose=True,
                           set_twist=True).result.result == code
    assert machine.ask(SetEntityState, entity='platform', state=state,
                       set_acceleration=True).result.result == UNSUPPORTED
    # Nothing of this has harmed it.
    machine.go_to(PLAYING)
    before = stamp(machine.states[-1])
    machine.listener.wait(lambda: stamp(machine.states[-1]) > before + 0.05, 'motion')
    assert machine.process.stop() == 0
