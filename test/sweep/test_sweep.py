# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Sweeps: what is in their files, interrupted, continued, refused."""

import signal
import subprocess
import sys
from test.sweep.files import assert_same, ENVIRONMENT, need, read
from test.test_cli import call
import time

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.sweep import batch, sweep
from closedloop_dynamics.sweep.storage import StorageError
import numpy as np
import pytest

from .test_rollout import linkage

MASS = 'mechanism.bodies.crank.mass'
PROGRAM = (sys.executable, '-m', 'closedloop_dynamics.cli')
SUFFIXES = ['.nc', '.zarr']
VARY = {MASS: [1.0, 2.0, -3.0], 'torque.crank_joint': 'uniform:-1:1'}
SMALL = {'samples': 4, 'duration': 0.05, 'workers': 1}


@pytest.fixture(params=SUFFIXES)
def path(request, tmp_path):
    """Return a path of each kind that can be written here."""
    need(request.param)
    return tmp_path / f'results{request.param}'


@pytest.fixture
def netcdf(tmp_path):
    need('.nc')
    return tmp_path / 'results.nc'


def some(count):
    """Return what lets a sweep go on for some batches."""
    asked = iter([True] * count)
    return lambda: next(asked, False)


@pytest.mark.parametrize('build, size', [(lambda: load_scene('three_rrr'), 1.0),
                                         (lambda: linkage(integrator='rk4'), 0.02)],
                         ids=['three_rrr', 'linkage'])
def test_results_are_those_of_single_simulations(netcdf, build, size):
    scene = build()
    across = scene.effects['gravity'].acceleration[2:]
    torques = np.random.default_rng(0).normal(
        0.0, size, (3, 10, len(scene.mechanism.actuated_joints)))
    sweep(scene, {'effects.gravity.acceleration.1': [-9.81, -1.62, 0.0]}, netcdf, duration=0.1,
          torques=torques, workers=1,
          keep=('position', 'constraint_forces', 'joint_forces', 'points', 'energy'))
    data = read(netcdf)
    assert data['status'].tolist() == [1, 1, 1]
    np.testing.assert_array_equal(data['time'], np.arange(11) / 100)
    for sample, gravity in enumerate((-9.81, -1.62, 0.0)):
        simulation = Simulation(scene)
        simulation.set_effect('gravity', acceleration=[0.0, gravity, *across])
        simulation.reset()
        forces, initial = [], simulation.energy
        for instant in range(11):
            simulation.step(torques[sample][max(instant - 1, 0)], 0.01 if instant else 0.0)
            for name in ('position', 'constraint_forces', 'joint_forces', 'points'):
                np.testing.assert_array_equal(
                    data[name][sample, instant], getattr(simulation, name))
            assert data['energy'][sample, instant] == simulation.energy
            forces.append(simulation.constraint_forces)
        np.testing.assert_array_equal(data['final_velocity'][sample], simulation.velocity)
        assert data['initial_energy'][sample] == initial
        # A norm of the same forces may be rounded in another way.
        np.testing.assert_allclose(
            data['peak_force'][sample],
            np.linalg.norm(np.array(forces)[:, :, 3 if across else 1:], axis=2).max(axis=0),
            rtol=4e-16)
        assert 0.0 < data['peak_closure'][sample] < 1e-11


def test_steps_that_do_not_fit_the_instants_are_those_of_step(netcdf):
    sweep('four_bar', {'method.step_size': [0.003]}, netcdf, duration=0.05, workers=1)
    simulation = Simulation.from_scene('four_bar', step_size=0.003)
    for _ in range(5):
        simulation.step(duration=0.01)
    np.testing.assert_array_equal(read(netcdf)['final_position'][0], simulation.position)


def test_a_failed_sample_is_marked_with_its_reason(path):
    outcome = sweep('four_bar', VARY, path, **SMALL)
    assert (outcome.samples, outcome.done, outcome.failed) == (12, 12, 4) and outcome.finished
    assert list(outcome.reasons) == [
        "mechanism 'four_bar': bodies.crank.mass: expected a positive number, got ..."]
    data = read(path)
    failed = data[MASS] == -3.0
    assert failed.sum() == 4
    np.testing.assert_array_equal(data['status'] == 2, failed)
    final = data['final_energy']
    np.testing.assert_array_equal(np.isnan(final), failed)


def test_a_sample_that_fails_on_its_way_keeps_what_it_did(netcdf):
    sweep('four_bar', {'torque.crank_joint': [0.0, 3e6]}, netcdf, duration=0.5, workers=1)
    data = read(netcdf)
    assert data['status'].tolist() == [1, 2]
    reached = ~np.isnan(data['position'][1]).any(axis=1)
    assert reached[0] and not reached[-1]
    assert np.isnan(data['final_position'][1]).all() and np.isfinite(data['peak_force'][1]).all()
    assert 'smaller' in data['reason'][1]


@pytest.mark.parametrize('first', ['', 'a'])
def test_a_long_reason_ends_with_a_whole_character(path, monkeypatch, first):
    reason = first + 'ü' * 300

    def refuse(*_):
        raise ValueError(reason)

    monkeypatch.setattr(batch, 'changed', refuse)
    sweep('four_bar', {MASS: [1.0]}, path, duration=0.05, workers=1)
    kept, = read(path)['reason'].tolist()
    assert reason.startswith(kept) and len(kept.encode()) in (399, 400)


def test_all_kinds_hold_the_same(tmp_path):
    for suffix in SUFFIXES:
        need(suffix)
        sweep('four_bar', VARY, tmp_path / f'a{suffix}', **SMALL)
    one, other = read(tmp_path / 'a.nc'), read(tmp_path / 'a.zarr')
    reasons = one['reason'].tolist()
    assert sum('positive' in reason for reason in reasons) == 4
    assert_same(one, other)


def test_an_interrupted_sweep_goes_on_and_leaves_the_same(path):
    whole = path.with_name('whole' + path.suffix)
    sweep('four_bar', VARY, whole, **SMALL)
    outcome = sweep('four_bar', VARY, path, **SMALL, keep_going=some(5))
    assert not outcome.finished and 0 < outcome.done < 12
    again = sweep('four_bar', VARY, path, **SMALL, resume=True)
    assert again.before == outcome.done and again.done == 12 - outcome.done and again.finished
    assert_same(read(path), read(whole))
    nothing = sweep('four_bar', VARY, path, **SMALL, resume=True)
    assert (nothing.before, nothing.done) == (12, 0)


@pytest.mark.parametrize('change, words', [
    ({'seed': 1}, ['seed was 0, now it is 1']),
    ({'duration': 0.1}, ['duration was 0.05, now it is 0.1']),
    ({'torque': {'crank_joint': 1.0}}, ['torques']), ({'keep': ()}, ['keep'])])
def test_another_sweep_is_not_continued(netcdf, change, words):
    vary = {MASS: 'uniform:1:2'}
    sweep('four_bar', vary, netcdf, **SMALL, keep_going=some(1))
    with pytest.raises(FieldError) as error:
        sweep('four_bar', vary, netcdf, **{**SMALL, **change}, resume=True)
    for word in words:
        assert word in str(error.value)


def test_a_changed_mechanism_is_another_sweep(netcdf, tmp_path):
    scene = tmp_path / 'scene.yaml'
    text = ('mechanism: four_bar\ninitial:\n'
            '  position: {crank_joint: 1.05, coupler_joint: -0.6, rocker_joint: 1.7}\n'
            '  hold: [crank_joint]\n')
    scene.write_text(text)
    sweep(scene, {MASS: [1.0, 2.0]}, netcdf, duration=0.01, workers=1, keep_going=some(1))
    scene.write_text(text.replace('1.05', '1.06'))
    with pytest.raises(FieldError, match='contents of scene and mechanism'):
        sweep(scene, {MASS: [1.0, 2.0]}, netcdf, duration=0.01, workers=1, resume=True)


def test_an_existing_file_is_replaced_only_when_asked_for(path):
    arguments = ('four_bar', {MASS: [1.0]}, path)
    sweep(*arguments, duration=0.01, workers=1)
    with pytest.raises(FieldError, match='--resume'):
        sweep(*arguments, duration=0.01, workers=1)
    sweep('four_bar', {MASS: [1.0, 2.0]}, path, duration=0.01, workers=1, overwrite=True)
    assert len(read(path)['status']) == 2


def test_what_is_no_sweep_is_neither_continued_nor_removed(path):
    path.mkdir()
    precious = path / 'precious'
    precious.write_text('text')
    for option in ('resume', 'overwrite'):
        with pytest.raises(StorageError):
            sweep('four_bar', {MASS: [1.0]}, path, duration=0.01, workers=1, **{option: True})
    assert precious.read_text() == 'text'


def test_workers_change_nothing(netcdf):
    vary = {MASS: 'uniform:1:2', 'torque.crank_joint': [0.0, 1.0]}
    alone = netcdf.with_name('alone.nc')
    sweep('four_bar', vary, alone, samples=6, duration=0.05, workers=1)
    sweep('four_bar', vary, netcdf, samples=6, duration=0.05, workers=2)
    assert_same(read(netcdf), read(alone))


def test_the_command_says_what_it_did(capsys, netcdf, tmp_path):
    np.save(tmp_path / 'torques.npy', np.zeros((2, 1)))
    code, text, errors = call(
        capsys, 'sweep', 'four_bar', '--vary', f'{MASS}=-1:2:4', '--output', netcdf, '--workers',
        '1', '--duration', '0.1', '--keep', 'nothing', '--torques', tmp_path / 'torques.npy')
    assert (code, errors) == (0, '')
    assert f'{netcdf}: 4 of 4 samples' in text
    assert 'failed    2 of 4' in text and 'expected a positive number, got ...' in text
    assert 'position' not in read(netcdf)


@pytest.mark.parametrize('arguments, words', [
    (['--vary', 'mechanism.bodies.crnk.mass=1:2:3'], ['crnk', "did you mean 'crank'?"]),
    (['--vary', f'{MASS}=1:2'], [MASS, 'FROM:TO:COUNT']), (['--vary', 'mass'], ['KEY=VALUES']),
    (['--samples', 'x'], ['--samples', 'whole number']), (['--samples', '3'], ['distribution']),
    (['--keep', 'speed'], ['--keep', 'speed']), (['--workers', '0'], ['workers', '> 0']),
    (['--torque', 'crank=1'], ['torque', "did you mean 'crank_joint'?"]),
    (['--torques', 'none.npy'], ['--torques', 'none.npy', 'No such file']),
    (['--output', 'results.csv'], ['output', '.nc, .zarr', 'results.csv'])])
def test_usage_errors_say_what_would_do(capsys, netcdf, arguments, words):
    code, text, errors = call(capsys, 'sweep', 'four_bar', '--output', netcdf, *arguments)
    assert (code, text) == (2, '')
    assert 'Traceback' not in errors and len(errors.splitlines()) <= 2
    for word in words:
        assert word in errors
    assert not netcdf.exists()


def test_a_library_that_is_missing_is_named(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, 'netCDF4', None)
    with pytest.raises(StorageError, match='pip install netCDF4'):
        sweep('four_bar', {MASS: [1.0]}, tmp_path / 'a.nc')


def test_no_sample_at_all_is_a_failure(capsys, netcdf):
    code, text, _ = call(capsys, 'sweep', 'four_bar', '--vary', f'{MASS}=-1', '--output', netcdf)
    assert code == 1 and 'failed    1 of 1' in text


LONG = ('sweep', 'four_bar', '--vary', f'{MASS}=uniform:1:2', '--samples', '600', '--duration',
        '20', '--workers', '2')


@pytest.mark.parametrize('number, code', [(signal.SIGINT, 130), (signal.SIGKILL, -9)])
def test_a_stopped_program_leaves_a_valid_file_and_no_process(netcdf, number, code):
    process = subprocess.Popen([*PROGRAM, *LONG, '--output', str(netcdf)], env=ENVIRONMENT,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        while not has_samples(netcdf):
            assert process.poll() is None, process.communicate()
            time.sleep(0.05)
        workers = children(process.pid)
        process.send_signal(number)
        text, errors = process.communicate(timeout=300)
    finally:
        process.kill()
    assert process.returncode == code
    if number == signal.SIGINT:
        assert 'interrupted' in errors and '--resume' in errors and 'Traceback' not in errors
        assert 'of 600 samples' in text
    deadline = time.monotonic() + 300
    while any(is_running(worker) for worker in workers):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    data = read(netcdf)
    done = data['status'] == 1
    assert 0 < done.sum() < 600
    assert np.isfinite(data['position'][done]).all()
    outcome = sweep('four_bar', {MASS: 'uniform:1:2'}, netcdf, samples=600, duration=20,
                    workers=1, resume=True, keep_going=some(1))
    assert outcome.before == done.sum()


def has_samples(netcdf):
    """Return whether samples are marked as done in a file that is being written."""
    import netCDF4
    try:
        # The status alone: other numbers of a sample may be half written.
        with netCDF4.Dataset(netcdf) as file:
            return bool((file['status'][:] == 1).any())
    except (OSError, IndexError):
        # Not there, or its header is not yet whole.
        return False


def children(pid):
    """Return the processes below one, all generations."""
    with open(f'/proc/{pid}/task/{pid}/children') as file:
        below = [int(word) for word in file.read().split()]
    return below + [grandchild for child in below for grandchild in children(child)]


def is_running(pid):
    try:
        with open(f'/proc/{pid}/stat') as file:
            return file.read().rpartition(')')[2].split()[0] != 'Z'
    except OSError:
        return False
