# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop estimate``: what it writes, and what its exit code says of a record."""

import csv
import re
from test.estimation.recorded import SENSORS, states, write_bag, write_csv
from test.ros.bags import read_with_rosbags

from closedloop_dynamics.cli import main
import numpy as np
import pytest

COUNT = 60


@pytest.fixture(scope='module')
def run(tmp_path_factory):
    return write_csv(tmp_path_factory.mktemp('run') / 'run.csv', COUNT)


def estimate(capsys, recording, *more, scene='three_rrr', sensors=SENSORS):
    """Return exit code, output and errors of the command."""
    try:
        code = main(['estimate', str(recording), '--scene', scene, '--sensors', str(sensors),
                     *more])
    except SystemExit as end:
        code = end.code
    return (code, *capsys.readouterr())


def found(output):
    """Return value and standard deviation of the load in a table."""
    return map(float, re.search(r'^part +(\S+) +(\S+)', output, re.M).groups())


@pytest.mark.parametrize('way', [(), ('--filter',)])
def test_the_load_is_found_and_the_record_fits(capsys, run, way):
    code, output, errors = estimate(capsys, run, *way)
    assert code == 0, errors
    value, deviation = found(output)
    assert abs(value - 5.0) < 4.0 * deviation < 0.3
    assert 'the record is consistent with the model' in output


def test_numbers_have_deviations_in_a_file_and_bands_in_a_picture(capsys, run, tmp_path):
    path, picture = tmp_path / 'estimates.csv', tmp_path / 'bands.png'
    code, *_ = estimate(capsys, run, '--output', str(path), '--picture', str(picture))
    assert code == 0 and picture.stat().st_size > 10_000
    with path.open() as file:
        names, *rows = csv.reader(file)
    table = dict(zip(names, np.array(rows, dtype=float).T))
    assert np.isfinite(list(table.values())).all()
    joints, true = states(COUNT)
    times, places = (np.array([state[k] for state in true]) for k in (0, -1))
    for k, name in enumerate(joints):
        deviation = table[f'position.{name}.deviation']
        error = table[f'position.{name}'] - np.interp(
            table['time'], times - times[0], places[:, k])
        # Between two states the true ones are curved by 1e-5 rad at most.
        assert (deviation > 0.0).all() and (np.abs(error) < 5.0 * deviation + 1e-5).all(), name
    for name in ('velocity.theta_2', 'acceleration.theta_2', 'force.cut_1.x', 'force.theta_1.y',
                 'point.platform_center.x', 'position.cut_1', 'part'):
        assert (table[f'{name}.deviation'] > 0.0).all(), name
    # Once there, a file is not overwritten unless this is asked for.
    assert estimate(capsys, run, '--output', str(path))[0] == 2
    assert estimate(capsys, run, '--output', str(path), '--overwrite')[0] == 0


def test_bags_in_and_out(capsys, tmp_path):
    bag = write_bag(tmp_path / 'bag', COUNT)
    code, output, errors = estimate(capsys, bag, '--output', str(tmp_path / 'estimates'))
    assert code == 0, errors
    messages = read_with_rosbags(tmp_path / 'estimates')
    assert {'/estimated_joint_states', '/estimated_joint_deviations', '/constraint_forces/cut_1',
            '/joint_forces/theta_1'} <= set(messages)
    (_, last), (_, spread) = (messages[f'/estimated_joint_{topic}'][-1] for topic in (
        'states', 'deviations'))
    np.testing.assert_allclose(last.position, states(COUNT)[1][-1][-1], atol=2e-3)
    assert (spread.position > 0.0).all() and last.header.stamp.sec == 10 ** 9


def test_a_load_that_nobody_named_does_not_fit(capsys, run, tmp_path):
    """The machine of another mass: exit code 1, and what does not fit."""
    path = tmp_path / 'sensors.yaml'
    path.write_text(re.sub(r'unknowns:\n.*\n', '', SENSORS.read_text()))
    code, output, errors = estimate(capsys, run, sensors=path)
    assert code == 1 and 'does not fit the model' in errors
    assert 'not consistent' in output


def test_of_a_record_without_motion_it_is_said_what_it_does_not_tell(capsys, tmp_path):
    """Without weight and motion no mass is felt, and its table says so."""
    path = tmp_path / 'sensors.yaml'
    path.write_text(SENSORS.read_text())
    code, output, errors = estimate(
        capsys, write_csv(tmp_path / 'still.csv', COUNT, still=True),
        scene='three_rrr_horizontal', sensors=path)
    assert code == 1 and 'nothing of what is unknown can be estimated' in errors
    assert '(part): does the machine move in it?' in errors
    assert 'not observable in this record' in output


@pytest.mark.parametrize('change, problem', [
    ({'scene': 'four_bar'}, 'sensors.encoder_1.joint'), ({'sensors': 'none.yaml'}, 'none.yaml'),
    ({'scene': 'no_such'}, 'no_such')])
def test_what_does_not_fit_together_is_named(capsys, run, change, problem):
    code, _, errors = estimate(capsys, run, **change)
    assert code == 2 and problem in errors


@pytest.mark.parametrize('text, problem', [
    ('', 'none'), ('time,position.theta_1\n', 'rows'),
    ('time,position.theta_1\n1,0.5\n0,0.5\n', 'increases'),
    ('time,position.knee\n0,1\n', 'expected the columns')])
def test_damaged_records_are_refused(capsys, tmp_path, text, problem):
    path = tmp_path / 'run.csv'
    path.write_text(text)
    code, _, errors = estimate(capsys, path)
    assert code == 2 and problem in errors, errors
    assert estimate(capsys, tmp_path / 'none.csv')[0] in (1, 2)
