# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tests of what controls a running simulation, by calling the node's callbacks."""

import math
import os
import time
from types import SimpleNamespace

from closedloop_dynamics import Simulation
from closedloop_dynamics.recording.cost import Cost
from closedloop_dynamics.ros import loading
from closedloop_dynamics.ros.background import set_priority
from closedloop_dynamics.ros.diagnostics import method_finding, OK, WARN
from closedloop_dynamics.ros.loading import log_cost
from closedloop_dynamics.ros.process import StartError
from closedloop_dynamics.ros.simulator_node import SimulatorNode
import numpy as np
import pytest
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger


class FakeClock:
    """A steady clock that a test sets."""

    def __init__(self):
        self.now = 50.0

    def __call__(self):
        return self.now


@pytest.fixture
def build(make_node, monkeypatch):
    """Return a function that builds a node whose clock the test sets."""
    def make(scene='three_rrr', **parameters):
        node = make_node(SimulatorNode, scene=scene, **parameters)
        node.clock = node.pacer.clock = FakeClock()
        node.warnings, node.stamps_seen = [], []
        if node.running:
            node.mode.start()
        node.live.on_published.append(
            lambda stamp: node.stamps_seen.append(10 ** 9 * stamp.sec + stamp.nanosec))
        monkeypatch.setattr(node, 'warn', lambda throttle, text: node.warnings.append(text))
        return node
    return make


def advance(node, duration, ticks=1):
    for _ in range(ticks):
        node.clock.now += duration / ticks
        node.tick()


def trigger(callback):
    return callback(Trigger.Request(), Trigger.Response())


def pause(node, value=True):
    return node.on_pause(SetBool.Request(data=value), SetBool.Response())


def test_time_stands_still_while_paused_and_goes_on_without_a_jump(build):
    node = build()
    advance(node, 0.05, ticks=5)
    assert pause(node).success
    advance(node, 3.0, ticks=5)
    assert node.simulation.time == pytest.approx(0.05)
    assert 'not paused' in pause(node, False).message
    advance(node, 0.05, ticks=5)
    assert node.simulation.time == pytest.approx(0.1)
    assert node.pacer.dropped == 0.0


def test_steps_are_made_only_while_paused(build):
    node = build(step_count=25)
    response = trigger(node.on_step)
    assert not response.success
    assert '~/pause' in response.message
    pause(node)
    assert trigger(node.on_step).success
    assert node.simulation.time == pytest.approx(0.025, abs=1e-15)
    node.set_parameters([Parameter('step_count', value=1000)])
    trigger(node.on_step)
    reference = Simulation.from_scene('three_rrr')
    reference.step(duration=1.025)
    assert node.simulation.position.tolist() == reference.position.tolist()


def test_reset_returns_to_the_start_without_torque_and_waits_again(build):
    node = build(wait_for_command=True)
    node.on_torque_command(Float64MultiArray(data=[5.0, 1.0, 2.0]))
    advance(node, 0.1, ticks=10)
    assert node.simulation.time > 0.09
    response = trigger(node.on_reset)
    assert response.success
    assert 'waiting for the first command' in response.message
    advance(node, 0.1, ticks=10)
    assert node.simulation.time == 0.0
    assert not node.simulation.effort.any()
    start = Simulation.from_scene('three_rrr').position
    assert node.simulation.position.tolist() == start.tolist()
    node.on_torque_command(Float64MultiArray(data=[5.0, 1.0, 2.0]))
    advance(node, 0.1, ticks=10)
    assert node.simulation.time == pytest.approx(0.1)
    assert node.command.counts['accepted'] == 2


def test_reset_leaves_a_pause_as_it_is(build):
    node = build()
    pause(node)
    assert 'paused' in trigger(node.on_reset).message
    advance(node, 0.1)
    assert node.simulation.time == 0.0


def test_state_of_all_joints_is_assembled(build):
    node = build()
    wanted = Simulation.from_scene('three_rrr')
    wanted.step({'theta_1': 20.0}, 0.3)
    names = list(wanted.joint_names)
    # As a message of another node has them, in an order of its own, and rounded.
    order = np.random.default_rng(1).permutation(len(names))
    node.on_set_state(JointState(
        name=[names[k] for k in order],
        position=[round(wanted.position[k], 4) for k in order],
        velocity=[round(wanted.velocity[k], 4) for k in order]))
    assert node.warnings == []
    assert node.counts['states set'] == 1
    assert node.simulation.position == pytest.approx(wanted.position, abs=3e-4)
    assert node.simulation.velocity == pytest.approx(wanted.velocity, abs=2e-3)
    assert node.simulation.closure < 1e-12


def test_joints_that_a_state_does_not_name_follow_those_it_names(build):
    node = build('four_bar')
    node.on_set_state(JointState(
        name=['crank_joint'], position=[1.3], velocity=[2.0]))
    index = node.simulation.joint_names.index('crank_joint')
    assert node.simulation.position[index] == 1.3
    assert node.simulation.velocity[index] == 2.0
    assert node.simulation.closure < 1e-12


@pytest.mark.parametrize('message, problem', [
    (JointState(), 'names no joint'),
    (JointState(name=['wheel'], position=[1.0]), "'wheel' is not a joint"),
    (JointState(name=['theta_1', 'theta_1'], position=[1.0, 1.0]), 'twice'),
    (JointState(name=['theta_1']), 'one position per name'),
    (JointState(name=['theta_1'], position=[math.nan]), "position of 'theta_1' is nan"),
    (JointState(name=['theta_1'], position=[1.0], velocity=[1.0, 2.0]), 'no velocity, or one'),
    (JointState(name=['theta_1'], position=[1.0]), 'not a complete choice'),
    (JointState(name=['theta_1', 'theta_6', 'theta_7'], position=[3.7, 0.5, 1.5]),
     'cannot be assembled'),
    (JointState(name=['theta_1', 'theta_6', 'theta_7'], position=[1.0, 4.2, 5.8],
                velocity=[1e8, 0.0, 0.0]), 'at most 1000 can be followed'),
    (JointState(name=['theta_1', 'theta_6', 'theta_7'], position=[1.0, 4.2, 5.8],
                velocity=[1e308, 0.0, 0.0]), 'largest velocity'),
])
def test_state_that_makes_no_sense_is_refused_with_the_reason_and_counted(
        build, message, problem):
    node = build()
    advance(node, 0.02)
    before = node.simulation.position.tolist(), node.simulation.velocity.tolist()
    node.on_set_state(message)
    assert (node.simulation.position.tolist(), node.simulation.velocity.tolist()) == before
    assert node.counts['states refused'] == 1
    assert node.warnings[0].startswith('set_state refused: ')
    assert problem in node.warnings[0]


def run_lockstep(node, disturb=lambda node: None):
    """Drive a node in lockstep by a law of the state; return all states and stamps."""
    states = []
    for _ in range(50):
        position = node.simulation.position
        torque = np.sin(7.0 * position[[0, 5, 6]]) + 3.0
        node.on_torque_command(Float64MultiArray(data=torque.tolist()))
        disturb(node)
        states.append(node.simulation.position.tobytes() + node.simulation.velocity.tobytes())
    return states, node.stamps_seen


@pytest.mark.parametrize('integrator', ['rk4', 'dop853'])
def test_lockstep_is_the_same_bit_for_bit_whatever_happens_in_between(build, integrator):
    def disturb(node):
        node.tick()
        node.simulation.report(), node.simulation.health, node.simulation.constraint_forces
        node.clock.now += 17.0

    runs = [run_lockstep(build(mode='lockstep', integrator=integrator), disturbance)
            for disturbance in (lambda node: None, disturb)]
    assert runs[0][0] == runs[1][0]
    # The first tick of the second run published the state that nobody had answered yet.
    assert runs[0][1] == [10_000_000 * k for k in range(1, 51)]
    assert [stamp for stamp in runs[1][1] if stamp] == runs[0][1]


def test_lockstep_after_a_reset_is_the_same_run_again(build):
    node = build(mode='lockstep')
    first = run_lockstep(node)[0]
    trigger(node.on_reset)
    assert run_lockstep(node)[0] == first


def test_lockstep_needs_whole_periods(build):
    with pytest.raises(StartError, match='whole number of steps'):
        build(mode='lockstep', publish_rate=300.0)
    node = build(mode='lockstep')
    for name, value in (('publish_rate', 300.0), ('step_size', 0.003)):
        result, = node.set_parameters([Parameter(name, value=value)])
        assert not result.successful
        assert 'whole number of steps' in result.reason
    # Neither a rate of zero nor the scene's own step is divided by.
    assert not node.set_parameters([Parameter('publish_rate', value=0.0)])[0].successful
    assert node.set_parameters([Parameter('step_size', value=0.0)])[0].successful
    together = node.set_parameters_atomically([
        Parameter('publish_rate', value=200.0), Parameter('step_size', value=0.0025)])
    assert together.successful
    node.on_torque_command(Float64MultiArray(data=[0.0, 0.0, 0.0]))
    assert node.simulation.time == pytest.approx(0.005)


def test_paused_lockstep_takes_the_command_when_it_goes_on(build):
    node = build(mode='lockstep')
    pause(node)
    node.on_torque_command(Float64MultiArray(data=[0.0, 0.0, 0.0]))
    assert node.simulation.time == 0.0
    pause(node, False)
    assert node.simulation.time == pytest.approx(0.01)


def test_method_changes_while_time_runs(build):
    node = build()
    advance(node, 0.05, ticks=5)
    before = node.simulation.position.tolist()
    result = node.set_parameters_atomically([
        Parameter('integrator', value='heun'), Parameter('step_size', value=0.0005),
        Parameter('stabilisation', value='velocity_projection')])
    assert result.successful
    assert node.simulation.position.tolist() == before
    assert node.simulation.time == pytest.approx(0.05)
    advance(node, 0.05, ticks=5)
    assert node.simulation.time == pytest.approx(0.1)
    assert node.simulation.report().steps == 100
    reference = Simulation.from_scene('three_rrr')
    reference.step(duration=0.1)
    assert node.simulation.position == pytest.approx(reference.position, abs=1e-4)
    # Empty values are the scene's own again.
    assert node.set_parameters_atomically([
        Parameter('integrator', value=''), Parameter('step_size', value=0.0),
        Parameter('stabilisation', value='')]).successful
    method = node.simulation.scene.method
    assert (method.integrator, method.step_size, method.stabilisation) == (
        'auto', 0.001, 'projection')


def test_accuracy_and_budget_change_while_time_runs(build, counted):
    node = build(accuracy=1e-7)
    assert node.simulation.accuracy == 1e-7
    advance(node, 0.05, ticks=5)
    assert node.set_parameters_atomically([
        Parameter('budget', value=5e-4), Parameter('accuracy', value=1e-5)]).successful
    assert node.simulation.accuracy == 1e-5
    advance(node, 1.0, ticks=100)
    assert node.simulation.accuracy > 1e-5
    values = method_finding(node.simulation.report(), 0.1).values
    assert values['accuracy [rad or m within a second]'] == node.simulation.accuracy
    assert values['budget [share of real time]'] == 5e-4
    assert 'exclude each other' in method_finding(node.simulation.report(), 0.1).message or (
        'exceeded even' in method_finding(node.simulation.report(), 0.1).message)
    # A slow pace has time for more.
    assert node.set_parameters_atomically([
        Parameter('real_time_factor', value=0.1), Parameter('accuracy', value=0.0)]).successful
    advance(node, 20.0, ticks=200)
    assert node.simulation.accuracy < 1e-5
    refused = node.set_parameters_atomically([Parameter('integrator', value='rk4')])
    assert not refused.successful and 'expected integrator: auto with it' in refused.reason
    assert node.set_parameters_atomically([Parameter('budget', value=0.0)]).successful
    assert node.simulation.scene.method.budget is None and node.simulation.accuracy == 1e-6
    assert node.exit_code is None


@pytest.mark.parametrize('key', ['accuracy', 'budget'])
def test_what_the_integrator_knows_nothing_of_is_refused_at_the_start(build, key):
    with pytest.raises(StartError, match='expected integrator: auto'):
        build(integrator='rk4', **{key: 0.01})


def test_the_log_tells_of_changes_of_the_accuracy(build, monkeypatch):
    node = build(budget=0.5)
    noted = []
    monkeypatch.setattr(node.log, 'write_row', lambda *stamp: noted.append(
        (node.simulation.time, node.simulation.accuracy)))
    advance(node, 0.05, ticks=5)
    del noted[:]
    node.simulation.stepping.run.aim(1e-4)
    advance(node, 0.01)
    # With the accuracy of the steps that follow, before they are made; then the state.
    assert noted == [(pytest.approx(0.05), 1e-4), (pytest.approx(0.06), 1e-4)]


def test_the_cost_is_reported_at_the_start(monkeypatch):
    def found(simulation, duration, rate, longest):
        assert duration == 10.0
        return costs

    monkeypatch.setattr(loading, 'probe', found)
    simulation = Simulation.from_scene('four_bar', budget=0.3)
    lines = []
    costs = [Cost('accuracy', 1e-6, 10.0, 1.0, 1.0, 10.0),
             Cost('accuracy', 1e-9, 10.0, 2.0, 2.0, 10.0)]
    log_cost(simulation, 2.0, SimpleNamespace(info=lines.append))
    assert lines == [
        'without torques, computing is expected to take 20.00% of a core with accuracy 1e-06, '
        '40.00% of a core with accuracy 1e-09',
        'a budget of 0.3 of real time allows an accuracy of about 1e-07']
    costs[1] = Cost('accuracy', 1e-9, 10.0, 2.0, 2.0, 0.3, 'the loops cannot be closed')
    log_cost(Simulation.from_scene('four_bar'), 1.0, SimpleNamespace(info=lines.append))
    assert 'not known with accuracy 1e-09, as the motion ends at t = 0.3 s' in lines[-1]


def test_method_that_the_scene_is_too_stiff_for_is_refused(build, tmp_path):
    scene = tmp_path / 'sprung.yaml'
    scene.write_text(
        'mechanism: slider_crank\n'
        'initial:\n'
        '  position: {crank_joint: 1.0472, rod_joint: -1.34, slider_joint: 0.3372}\n'
        '  hold: [crank_joint]\n'
        'effects:\n'
        '  spring: {type: joint_spring, joint: crank_joint, stiffness: 5000.0, rest: 1.0}\n')
    node = build(str(scene))
    before = node.simulation.scene.method
    result = node.set_parameters_atomically([
        Parameter('integrator', value='rk4'), Parameter('step_size', value=0.05)])
    assert not result.successful
    assert 'stiff' in result.reason
    assert node.simulation.scene.method == before
    advance(node, 0.05, ticks=5)
    assert node.exit_code is None


def test_states_of_late_ticks_are_a_period_apart_in_every_respect(build):
    node = build(publish_rate=200.0)
    node.live.stamps.now = lambda: round(1e9 * node.clock.now)
    times = []
    node.live.on_published.append(lambda stamp: times.append(node.simulation.time))
    for late in (0.005, 0.006, 0.016, 0.0035, 0.005):
        advance(node, late)
    assert times == pytest.approx([0.005 * k for k in range(1, 8)])
    assert np.diff(node.stamps_seen) == pytest.approx(5_000_000, abs=2)
    # A clock that was set back is followed.
    node.live.stamps.now = lambda: 1_000_000_000
    advance(node, 0.005)
    assert node.stamps_seen[-1] == pytest.approx(1_000_000_000, abs=1_000_000)


def test_stamps_never_go_back_while_the_clock_does_not(build):
    node = build(publish_rate=200.0)
    node.live.stamps.now = lambda: round(1e9 * node.clock.now)
    advance(node, 0.005)
    # A state that was set from outside is reported in between, when the tick was due already.
    advance(node, 0.005)
    node.clock.now += 0.007
    node.jump()
    node.tick()
    assert np.all(np.diff(node.stamps_seen) > 0)


def test_stamps_of_a_clock_that_others_publish_are_its_own(build):
    node = build(use_sim_time=True)
    advance(node, 0.01)
    advance(node, 0.035)
    assert node.stamps_seen == [0, 0, 0, 0]


def test_core_is_kept_awake_while_asked_to_and_time_runs(build):
    free = os.sched_getaffinity(0)
    node = build()
    awake = node.idle_states
    assert awake.process is None
    for ask, kept in (
            (lambda: node.set_parameters([Parameter('keep_core_awake', value=True)]), True),
            (lambda: pause(node), False), (lambda: pause(node, False), True),
            (lambda: trigger(node.on_reset), True),
            (lambda: node.set_parameters([Parameter('keep_core_awake', value=False)]), False),
            (lambda: node.set_parameters([Parameter('keep_core_awake', value=True)]), True)):
        ask()
        assert (awake.process is not None) == kept
        # On one core, together.
        assert os.sched_getaffinity(0) <= free
        assert (len(os.sched_getaffinity(0)) == 1) == kept or len(free) == 1
    process = awake.process
    deadline = time.monotonic() + 240.0
    while os.sched_getscheduler(process.pid) != os.SCHED_IDLE or (
            os.sched_getaffinity(process.pid) != os.sched_getaffinity(0)):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    node.close()
    assert process.poll() is not None
    assert os.sched_getaffinity(0) == free


def test_user_without_real_time_priorities_is_warned_and_goes_on(make_node, monkeypatch, capfd):
    def refuse(*arguments):
        raise PermissionError(1, 'Operation not permitted')

    monkeypatch.setattr('os.sched_setscheduler', refuse)
    node = make_node(SimulatorNode, scene='four_bar', scheduling_priority=50)
    assert node.exit_code is None
    assert 'scheduling_priority 50: not allowed here' in capfd.readouterr().err


def test_threads_take_the_priority_and_what_they_start_does_not(monkeypatch):
    taken = {}
    monkeypatch.setattr('os.sched_setscheduler', lambda thread, policy, parameter: taken.update(
        {str(thread): (policy, parameter.sched_priority)}))
    set_priority(0)
    assert taken == {}
    set_priority(7)
    assert set(taken) == set(os.listdir('/proc/self/task'))
    assert set(taken.values()) == {(os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, 7)}


def test_ticks_that_the_process_makes_itself_come_on_a_grid(build, monkeypatch):
    node = build(publish_rate=100.0)
    steady = FakeClock()
    monkeypatch.setattr('closedloop_dynamics.ros.simulator_node.time.monotonic', steady)
    assert node.due() is None
    node.take_over()
    assert node.timer is None
    begin, ticks = steady.now, []
    monkeypatch.setattr(node, 'tick', lambda: ticks.append(node.due()))
    for late in (0.0, 0.004, 0.0, 0.035, 0.0):
        steady.now = max(steady.now, node.due() + late)
        node.act()
    assert node.due() - begin == pytest.approx(0.09)
    assert len(ticks) == 5
    # While time stands still a timer does.
    pause(node)
    assert node.due() is None
    assert node.timer is not None
    pause(node, False)
    assert node.due() == pytest.approx(steady.now + 0.01)


def test_system_that_does_not_let_a_core_be_kept_awake_is_reported(build, monkeypatch):
    def refuse(awake):
        raise OSError('no')

    node = build()
    said = []
    monkeypatch.setattr(node, 'get_logger', lambda: type('', (), {'warning': said.append}))
    monkeypatch.setattr(node.idle_states, 'keep', refuse)
    assert node.set_parameters([Parameter('keep_core_awake', value=True)])[0].successful
    assert said == ['keep_core_awake: not on this system (no)']


def test_clock_follows_the_state_that_it_belongs_to(build, monkeypatch):
    node, order = build(publish_clock=True), []
    node.live.on_published.append(lambda stamp: order.append('state'))
    monkeypatch.setattr(node.live.stamps, 'publish', lambda: order.append('clock'))
    advance(node, 0.03, ticks=3)
    assert order == ['state', 'clock'] * 3


def test_stamps_are_those_of_simulated_time_when_the_clock_is_published(build):
    node = build(publish_clock=True, real_time_factor=0.5)
    advance(node, 0.1, ticks=10)
    # From one period on.
    assert node.stamps_seen[-1] == 60_000_000
    pause(node)
    seen = len(node.stamps_seen)
    advance(node, 0.1, ticks=10)
    # Nothing new: no flood of messages with one and the same stamp.
    assert len(node.stamps_seen) == seen


@pytest.mark.parametrize('mode', ['realtime', 'lockstep', 'as_fast_as_possible'])
def test_time_waits_for_subscribers(build, listener, mode):
    node = build(mode=mode, wait_for_subscribers=1)
    node.on_torque_command(Float64MultiArray(data=[1.0, 2.0, 3.0]))
    advance(node, 0.05, ticks=5)
    assert node.simulation.time == 0.0
    assert node.standing.startswith('waiting for 1 subscribers of joint_states, there are 0')
    listener.listen('joint_states', JointState)
    listener.wait(lambda: node.states.subscribers, 'a subscriber')
    advance(node, 0.05, ticks=5)
    assert node.simulation.time > 0.0 and not node.standing


def test_diagnostics_tell_how_the_run_goes(make_node):
    node = make_node(SimulatorNode, namespace='/cell', scene='three_rrr', integrator='heun',
                     step_size=0.0005)
    sent = []
    node.diagnostics._publisher = SimpleNamespace(publish=sent.append)
    pause(node)
    assert trigger(node.on_step).success
    node.on_torque_command(Float64MultiArray(data=[1.0]))
    node.publish_diagnostics()
    reported = {status.name.removeprefix(f'cell/{node.get_name()}: '): (
        status.level, {pair.key: pair.value for pair in status.values})
        for status in sent[0].status}
    assert set(reported) == {
        'time', 'method', 'closure', 'energy', 'elimination', 'commands', 'effects', 'graph'}
    assert reported['time'][1]['mode'] == 'realtime'
    method = reported['method'][1]
    assert method['method'] == 'heun, projection' and float(method['step size [s]']) == 0.0005
    assert float(method['compute time per step [us]']) > 0.0
    assert float(reported['closure'][1]['closure error [m or rad]']) < 1e-10
    assert reported['closure'][0] == OK and reported['commands'][0] == WARN
    assert reported['effects'][1]['gravity'] == 'gravity'
    assert reported['commands'][1]['accepted'] == '0'
