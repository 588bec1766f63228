# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A replay meets every recorded state to the last bit, and sees what does not fit."""

from dataclasses import replace

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.effects.registry import JointDamping
from closedloop_dynamics.recording.recording import Log, Recording
from closedloop_dynamics.recording.replay import replay, table
from closedloop_dynamics.scene.text import read_scene_text, scene_text
from closedloop_dynamics.simulation.monitor import Monitor
from closedloop_dynamics.visual.pictures import deviations
from closedloop_dynamics.visual.trajectory import Trajectory
import numpy as np
import pytest

from ..reference import spatial_machines
from ..reference.scenes import scene

# With drives, friction that remembers, and a sensor's noise among them.
SCENES = ('carpet_scraper_on_carpet', 'four_bar', 'slider_crank', 'three_rrr',
          'three_rrr_payload_friction')


class Recorder:
    """Does what simulator and recorder do, without messages."""

    def __init__(self, scene):
        self.simulation = Simulation(scene)
        self.rows, self.jumps, self.index = [], 0, 0
        self.changes = [(scene, {'after': 0})]
        self.note(np.zeros(len(self.simulation.joint_names)))

    def note(self, tau, published=True):
        """Record the present state, or only that a command acted up to now."""
        simulation = self.simulation
        self.index += 1
        self.rows.append((
            published, self.index, self.jumps, simulation.time, tau.copy(), simulation.state,
            *simulation.measured(),
            simulation.effort, simulation.constraint_forces))

    def advance(self, steps, torque, published=True):
        """Advance as one tick does; the log has an entry even where no state is published."""
        tau = self.simulation.joint_torques(torque)
        if steps:
            self.simulation.advance(tau, steps)
        self.note(tau, published)

    def change(self, name, **values):
        """Change an effect between two ticks."""
        self.simulation.set_effect(name, **values)
        off = tuple(each for each in self.simulation.effects
                    if each not in self.simulation.data.enabled_effects)
        scene = replace(
            self.changes[-1][0], effects=self.simulation.effects, switched_off=off)
        self.changes.append((scene, {'after': self.index}))

    def recording(self, first=0, without=()):
        """Return what a bag holds, from some state on."""
        rows = [row for k, row in enumerate(self.rows) if k >= first and k not in without]
        published, index, jumps, time, torque, whole, *state = zip(*rows)
        published, index, jumps, time, torque, *state = map(
            np.array, (published, index, jumps, time, torque, *state))
        motion = Trajectory(self.simulation.mechanism, time[published], *(
            values[published] for values in state))
        numbers = np.where(published, np.cumsum(published) - 1, -1)
        return Recording(motion, self.changes[0][0], self.changes,
                         Log(index, jumps, time, torque, numbers, whole))


def drive(recorder, ticks, seed=3):
    """Let a controller and a clock with jitter drive it."""
    random = np.random.default_rng(seed)
    count = len(recorder.simulation.actuated_joints)
    torque = np.zeros(count)
    for _ in range(ticks):
        if random.random() < 0.6:
            torque = random.normal(size=count)
        recorder.advance(int(random.integers(0, 15)), torque, random.random() < 0.9)
    recorder.advance(1, torque)


@pytest.mark.parametrize('scene', SCENES)
def test_deviations_are_zero(scene):
    recorder = Recorder(load_scene(scene))
    drive(recorder, 60)
    result = replay(recorder.recording())
    for quantity in ('position', 'velocity', 'effort', 'forces'):
        assert not result.deviation(quantity).any(), quantity
    assert result.starts == [(0.0, 'from the initial state of the scene')]
    assert not result.notes


@pytest.mark.parametrize('name', [
    'rssr_four_bar', pytest.param('bricard', marks=pytest.mark.slow)])
def test_deviations_in_space_are_zero(name):
    mechanism, _ = getattr(spatial_machines, name)()
    mechanism = spatial_machines.with_single_freedoms(mechanism)
    mechanism = replace(mechanism, joints=(
        replace(mechanism.joints[0], actuated=True), *mechanism.joints[1:]))
    recorder = Recorder(scene(mechanism, gravity=(0.0, -9.81, 0.0), effects={
        'grease': JointDamping(mechanism.joints[1].name, 0.01)}))
    drive(recorder, 30)
    recorder.simulation.reset()
    recorder.jumps += 1
    drive(recorder, 10, seed=6)
    recording = recorder.recording()
    # As a bag has it.
    reported, _ = read_scene_text(scene_text(recording.scene))
    result = replay(replace(
        recording, scene=reported, changes=[(reported, recording.changes[0][1])]))
    for quantity in ('position', 'velocity', 'effort', 'forces'):
        assert not result.deviation(quantity).any(), quantity
    assert result.recorded.forces.shape[1:] == (1, 6)
    assert [why for _, why in result.starts] == [
        'from the initial state of the scene', 'after a reset']
    assert f'{mechanism.cut_joints[0].name} (force)' in table(result)
    assert len(deviations(result, name).axes) == 3


def test_resets_and_changed_effects_are_followed():
    recorder = Recorder(load_scene('three_rrr_payload_friction'))
    drive(recorder, 20)
    recorder.change('gravity', acceleration=(0.0, -1.62))
    drive(recorder, 20, seed=4)
    recorder.change('gravity', enabled=False)
    drive(recorder, 5, seed=5)
    recorder.simulation.reset()
    recorder.jumps += 1
    drive(recorder, 20, seed=6)
    result = replay(recorder.recording())
    assert result.largest == 0.0
    assert not result.deviation('forces').any()
    assert [why for _, why in result.starts][1:] == ['after a reset']


def test_methods_changed_while_running_are_followed():
    recorder = Recorder(load_scene('three_rrr'))
    drive(recorder, 20)
    recorder.simulation.stepping.prepare_method(integrator='semi_implicit_euler', step_size=5e-4)()
    recorder.changes.append((recorder.simulation.scene, {'after': recorder.index}))
    drive(recorder, 20, seed=4)
    assert replay(recorder.recording()).largest == 0.0


def test_late_recordings_and_states_set_from_outside_begin_again():
    recorder = Recorder(load_scene('three_rrr'))
    drive(recorder, 20)
    simulation = recorder.simulation
    simulation.set_state(simulation.position + 0.01, simulation.velocity)
    recorder.jumps += 1
    recorder.note(np.zeros(7))
    drive(recorder, 20, seed=8)
    late = recorder.recording(first=10)
    result = replay(late)
    assert result.largest == 0.0
    assert [why for _, why in result.starts] == [
        'from the first recorded state: the recording began later',
        'a state was set from outside']
    # Bags of earlier versions lack whole states: closing the loops moves by rounding.
    assert replay(replace(late, log=replace(late.log, whole=None))).largest < 1e-9


# Friction that remembers, a sensor's noise, a drive's lag and a delayed command; error control.
@pytest.mark.parametrize('scene, method', [
    ('carpet_scraper_on_carpet', {}), ('four_bar', {}), ('slider_crank', {}),
    ('three_rrr_payload_friction', {}), ('three_rrr_payload_friction', {'integrator': 'dopri5'}),
    ('three_rrr', {'integrator': 'rodas4'}),
    ('three_rrr', {'integrator': 'rk4', 'stabilisation': 'independent'})])
def test_a_late_recording_is_met_to_the_last_bit(scene, method):
    scene = load_scene(scene)
    recorder = Recorder(replace(scene, method=replace(scene.method, **method)))
    drive(recorder, 50)
    result = replay(recorder.recording(first=20))
    for quantity in ('position', 'velocity', 'effort', 'forces'):
        deviation = result.deviation(quantity)
        assert not deviation[np.isfinite(deviation)].any(), quantity
    # Where an integrator remembers, or commands are late, it takes a moment until all is known.
    compared = np.isfinite(result.simulated.position).all(axis=1)
    assert compared.mean() > 0.6
    assert result.unexplained is None
    assert result.starts[-1][0] == result.recorded.time[compared][0]


@pytest.mark.parametrize('integrator', ['auto', 'dopri5'])
def test_a_late_start_under_a_held_torque_with_error_control_is_said_to_be_inexact(integrator):
    scene = load_scene('three_rrr')
    recorder = Recorder(replace(scene, method=replace(scene.method, integrator=integrator)))
    for _ in range(20):
        recorder.advance(7, [5.0, -3.0, 2.0])
    result = replay(recorder.recording(first=9))
    assert 0.0 < result.largest < 1e-6
    assert 'what the integrator' in result.notes[0]
    # The method may make this error, and no more.
    assert result.unexplained is None
    off = replace(result.recorded, position=result.recorded.position + 1e-4)
    assert replace(result, recorded=off).unexplained is not None


def test_a_gap_is_reported_and_costs_nothing_else():
    scene = load_scene('three_rrr')
    recorder = Recorder(replace(scene, method=replace(scene.method, integrator='rk4')))
    drive(recorder, 40)
    result = replay(recorder.recording(without=range(10, 14)))
    assert result.largest == 0.0
    assert [why for _, why in result.starts][1:] == ['4 entries with their commands are missing']


def test_growth_tells_rounding_from_another_machine():
    """A difference grows as two runs of the simulation show; a deviation beyond is found."""
    recorder = Recorder(load_scene('three_rrr'))
    for _ in range(100):
        recorder.advance(10, [5.0, -3.0, 2.0])
    honest = recorder.recording()
    result = replay(honest)
    # 1 s of tumbling: what was 1e-12 is visible long before it is large.
    assert result.growth[0] < 10.0 and np.all(np.diff(result.growth) >= 0.0)
    twin, grown = Simulation(recorder.simulation.scene), []
    start = twin.state
    for seed in range(4):
        state = start.copy()
        state[:7] += 1e-9 * np.random.default_rng(seed).standard_normal(7)
        twin.restore(state, 0.0)
        for _ in range(100):
            twin.advance(twin.joint_torques([5.0, -3.0, 2.0]), 10)
        grown.append(np.abs(twin.position - recorder.simulation.position).max() / 1e-9)
    # By how much depends on the direction of the difference, here by a factor of ten.
    assert 0.5 * min(grown) < result.growth[-1] < 2.0 * max(grown)
    # Rounding elsewhere is explained, another millimetre of a radian is not.
    for size, unexplained in ((1e-13, False), (1e-6, True)):
        motion = replace(honest.motion, position=honest.motion.position + size)
        assert (replay(replace(honest, motion=motion)).unexplained is not None) == unexplained


def test_another_machine_is_noticed():
    recorder = Recorder(load_scene('three_rrr'))
    drive(recorder, 40)
    honest = recorder.recording()
    scene = load_scene('three_rrr')
    bodies = [replace(body, mass=1.01 * body.mass) for body in scene.mechanism.bodies]
    other = replace(scene, mechanism=replace(scene.mechanism, bodies=tuple(bodies)))
    result = replay(replace(honest, scene=other, changes=[]))
    assert result.largest > 1e-5
    assert result.unexplained is not None
    assert 'theta_1' in table(result) and 'cut_2 (force)' in table(result)


def test_without_a_log_stamps_and_efforts_serve():
    recorder = Recorder(load_scene('three_rrr'))
    random = np.random.default_rng(1)
    for _ in range(50):
        recorder.advance(10, random.normal(size=3))
    whole = recorder.recording()
    motion = whole.motion
    shaken = replace(motion, time=motion.time + random.uniform(0.0, 3e-4, len(motion.time)))
    result = replay(replace(whole, log=None, motion=shaken))
    assert result.largest < 1e-9
    assert 'no replay_log' in result.notes[0]


def test_a_budget_is_replayed_by_the_accuracies_of_the_log(counted, monkeypatch):
    recorder = Recorder(load_scene('three_rrr').with_method({'budget': 2e-3}))
    simulation, found = recorder.simulation, []
    for tick in range(60):
        torque = np.array([5.0, -3.0, 2.0 + 0.1 * (tick // 20)])
        found.append(simulation.accuracy)
        simulation.stepping.keep_budget()
        if simulation.accuracy != found[-1]:
            # As the node logs it.
            recorder.note(recorder.rows[-1][4], published=False)
        recorder.advance(20, torque)
    assert len(set(found)) > 1
    # A replay measures other times.
    monkeypatch.setattr(Monitor, 'measured', property(lambda self: counted(self) * 7.0))
    result = replay(recorder.recording())
    assert not result.deviation('position').any() and not result.deviation('velocity').any()
    assert not result.notes
