# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop`` from the command line: what it prints, writes, refuses and returns."""

import csv
from importlib import import_module
import math
import os
from pathlib import Path
import shlex
import signal
import subprocess
import sys
import time
import warnings

from closedloop_dynamics import __version__, scene_names, Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.cli.commands import COMMANDS, parser
import pytest

PROGRAM = (sys.executable, '-m', 'closedloop_dynamics.cli')
ENVIRONMENT = {**os.environ, 'PYTHONPATH': str(Path(__file__).resolve().parents[1])}


def call(capsys, *arguments):
    """Return exit code, standard output and standard error of one call."""
    try:
        code = main([str(argument) for argument in arguments])
    except SystemExit as end:
        code = end.code
    return (code, *capsys.readouterr())


def done(capsys, *arguments):
    """Return the standard output of a call that ends well."""
    code, text, errors = call(capsys, *arguments)
    assert code == 0, errors
    return text


def refused(capsys, *arguments):
    """Return the standard error of a call that is refused as the user's mistake."""
    code, _, errors = call(capsys, *arguments)
    assert code == 2, errors
    return errors


def read(path):
    """Return the columns of a CSV file by name, as numbers."""
    with open(path) as file:
        names, *rows = csv.reader(file)
    assert all(len(row) == len(names) for row in rows)
    return {name: [float(row[i]) for row in rows] for i, name in enumerate(names)}


def test_help_teaches_every_command(capsys):
    text = done(capsys, '--help')
    for name, module in COMMANDS.items():
        command = import_module(f'closedloop_dynamics.cli.{module}').COMMAND
        words = ' '.join(text.split())
        assert command.name == name and f' {name} {command.summary} ' in words
        own = done(capsys, name, '--help')
        assert f' 0 done; 1 {command.failure}, or' in ' '.join(own.split())
        assert command.examples[0].split()[0] == name
        for example in command.examples:
            line = f'closedloop {example}'.split(' --')[0]
            assert line in own
            # What another command prepares is that one's.
            words = shlex.split(example)
            parser([words[0]]).parse_args(words)


def test_version_is_that_of_the_package(capsys):
    assert call(capsys, '--version')[:2] == (0, f'closedloop {__version__}\n')


def test_list_shows_every_scene(capsys):
    code, text, _ = call(capsys, 'list')
    lines = {line.split()[0]: line for line in text.splitlines() if line}
    assert code == 0 and set(scene_names()) < set(lines)
    assert lines['stewart_platform'].split()[1:5] == ['space', '13', '5', '6']


@pytest.mark.parametrize('line, expected', [
    ('closedloop check stew', 'stewart_platform '),
    ('closedloop simulate {folder}/sce', '{folder}/scene.yaml '),
    *(pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('closedloop wor', 'workspace '), ('closedloop compare four_bar thr', 'three_rrr'),
        ('closedloop simulate --integ', '--integrator ')))])
def test_shells_complete_commands_scenes_and_files(tmp_path, line, expected):
    pytest.importorskip('argcomplete', reason='the extra completion is not installed')
    (tmp_path / 'scene.yaml').touch()
    line, expected = (text.format(folder=tmp_path) for text in (line, expected))
    asked = {'_ARGCOMPLETE': '1', '_ARGCOMPLETE_STDOUT_FILENAME': str(tmp_path / 'words'),
             'COMP_LINE': line, 'COMP_POINT': str(len(line)), 'COMP_TYPE': '9'}
    subprocess.run(PROGRAM, env={**ENVIRONMENT, **asked}, check=True, timeout=120)
    words = (tmp_path / 'words').read_text().split('\013')
    assert expected in words if expected == 'three_rrr' else words == [expected]


def test_check_prints_the_description(capsys):
    text = done(capsys, 'check', 'three_rrr')
    assert text.startswith('Scene three_rrr') and 'elimination order' in text


START = """mechanism: four_bar
initial:
  position: {crank_joint: %s, coupler_joint: -0.5713, rocker_joint: %s}
  hold: [crank_joint, rocker_joint]
"""


def test_check_assembles_as_simulate_does(capsys, tmp_path):
    scene = tmp_path / 'scene.yaml'
    scene.write_text(START % ('1.0472', '0.0'))
    code, text, refused = call(capsys, 'check', scene)
    refused = refused.splitlines()[-1]
    assert code == 2 and text.startswith('Scene scene')
    assert 'cannot be assembled' in refused or 'expected' in refused
    assert '1 degree of freedom' in refused
    code, _, errors = call(capsys, 'simulate', scene)
    assert code == 2
    assert errors.splitlines()[-1] == refused.replace('loop check', 'loop simulate')


def test_check_describes_machines_whose_inertia_overflows(capsys):
    key = 'mechanism.bodies.distal_1.center_of_mass.1'
    code, text, refused = call(capsys, 'check', 'three_rrr', '--set', f'{key}=-1e308')
    assert code == 2 and 'degrees of freedom' in text
    assert 'not finite numbers' in refused.splitlines()[-1]


def test_a_start_that_may_not_be_meant_is_reported_by_check_and_simulate(capsys, tmp_path):
    scene = tmp_path / 'scene.yaml'
    scene.write_text((START % ('7.33', '3.0')).replace(', rocker_joint]', ']'))
    code, text, reported = call(capsys, 'check', scene)
    assert code == 0 and 'closed position' in text
    assert 'beyond 2 pi: crank_joint = 7.33' in reported
    assert 'rocker_joint moved from 3 to 1.7' in reported
    code, _, simulated = call(capsys, 'simulate', scene, '--duration', '0.01')
    assert code == 0
    warned = [line for line in reported.splitlines() if line.startswith('closedloop')]
    assert len(warned) == 2
    for line in warned:
        assert line.replace('loop check', 'loop simulate') in simulated


@pytest.mark.parametrize('arguments, words', [
    ((), ['COMMAND']),
    (('fly',), ['fly', 'check', 'simulate']),
    (('check', 'four_barr'), ['four_barr', 'four_bar, ', 'did you mean']),
    (('check', './missing.yaml'), ['missing.yaml']),
    (('simulate', 'four_bar', '--duration', '-1'), ['--duration', '> 0', '-1']),
    (('simulate', 'four_bar', '--rate', 'nan'), ['--rate', 'nan']),
    (('simulate', 'four_bar', '--step-size', 'inf'), ['--step-size', 'inf']),
    (('simulate', 'four_bar', '--torque', 'crank_joint'), ['--torque', 'NAME=NUMBER']),
    (('simulate', 'four_bar', '--torque', 'crank_joint=nan'), ['--torque', 'NAME=NUMBER']),
    (('simulate', 'four_bar', '--torque', 'coupler_joint=1'),
     ['--torque', 'crank_joint', 'coupler_joint']),
    (('simulate', 'four_bar', '--torque', 'crank_joint=1', '--torque', 'crank_joint=2'),
     ['--torque crank_joint', 'once']),
    (('simulate', 'four_bar', '--integrator', 'magic'), ['--integrator', 'magic', 'rk4']),
])
def test_usage_errors_say_what_would_do(capsys, arguments, words):
    code, text, errors = call(capsys, *arguments)
    assert (code, text) == (2, '')
    assert 'Traceback' not in errors and len(errors.splitlines()) <= 2
    for word in words:
        assert word in errors


def test_a_scene_that_cannot_be_assembled_is_a_usage_error(capsys, tmp_path):
    scene = tmp_path / 'stretched.yaml'
    scene.write_text(
        'mechanism: four_bar\n'
        'initial:\n'
        '  position: {crank_joint: 1.0, coupler_joint: 0.0, rocker_joint: 0.0}\n'
        '  hold: [crank_joint, rocker_joint]\n')
    code, _, errors = call(capsys, 'simulate', scene)
    assert code == 2
    assert str(scene) in errors and 'Traceback' not in errors


def test_columns_and_digits_of_the_output(capsys, tmp_path):
    output = tmp_path / 'run.csv'
    code, text, errors = call(
        capsys, 'simulate', 'three_rrr', '--duration', '0.1', '--step-size', '1e-3',
        '--rate', '50', '--torque', 'theta_1=5', '--torque', 'theta_7=-2.5', '--output', output)
    assert (code, errors) == (0, '')
    joints = [f'theta_{i}' for i in range(1, 8)]
    data = read(output)
    points = ('platform_center', 'corner_1', 'corner_2', 'corner_3')
    assert list(data) == [
        'time', *(f'{quantity}.{joint}'
                  for quantity in ('position', 'velocity', 'acceleration', 'effort')
                  for joint in joints),
        'force.cut_1.x', 'force.cut_1.y', 'force.cut_2.x', 'force.cut_2.y',
        *(f'point.{point}.{axis}' for point in points for axis in 'xy'),
        *(f'{quantity}.{cut}' for quantity in ('position', 'velocity', 'acceleration', 'effort')
          for cut in ('cut_1', 'cut_2')), 'closure', 'energy']
    assert data['time'] == [k / 50 for k in range(6)]
    assert set(data['effort.theta_1']) == {5.0} and set(data['effort.theta_7']) == {-2.5}
    assert max(data['closure']) < 1e-10

    simulation = Simulation.from_scene('three_rrr', step_size=1e-3)
    for k in range(6):
        simulation.step({'theta_1': 5.0, 'theta_7': -2.5}, 0.02 if k else 0.0)
        assert [data[f'position.{joint}'][k] for joint in joints] == simulation.position.tolist()
        assert [data[f'acceleration.{joint}'][k]
                for joint in joints] == simulation.acceleration.tolist()
        assert [[0.0, data[f'force.{cut}.x'][k], data[f'force.{cut}.y'][k]]
                for cut in ('cut_1', 'cut_2')] == simulation.constraint_forces.tolist()
        assert data['energy'][k] == simulation.energy
        assert [data[f'position.{cut}'][k]
                for cut in ('cut_1', 'cut_2')] == simulation.cut_position.tolist()
    assert f'{output}: 6 rows of 51 columns' in text
    assert 'simulated 0.1 s' in text and 'CPU time' in text and 'energy' in text


def test_forces_of_all_joints_are_written_by_name(capsys, tmp_path):
    output = tmp_path / 'run.csv'
    assert call(capsys, 'simulate', 'four_bar', '--duration', '0.1', '--rate', '20',
                '--forces', 'all', '--output', output)[0] == 0
    data = read(output)
    simulation = Simulation.from_scene('four_bar')
    for k in range(3):
        simulation.step(None, 0.05 if k else 0.0)
        for joint in simulation.joint_names:
            assert [data[f'force.{joint}.{part}'][k] for part in ('torque', 'x', 'y')] == (
                simulation.force(joint).tolist())
        assert [data[f'point.coupler_point.{axis}'][k] for axis in 'xy'] == (
            simulation.point('coupler_point').tolist())


def test_warnings_are_reported_in_one_line(capsys, monkeypatch):
    report = Simulation.report

    def warn(simulation):
        warnings.warn('something to know', RuntimeWarning)
        return report(simulation)

    monkeypatch.setattr(Simulation, 'report', warn)
    code, _, errors = call(capsys, 'simulate', 'four_bar', '--duration', '0.01')
    assert code == 0
    assert 'closedloop simulate: something to know\n' in errors


@pytest.mark.parametrize('options, reported', [
    (('--step-size', '0.002'), 'in steps of 0.002 s ('),
    (('--step-size', '0.5'), 'in steps of 0.01 s, from row to row, instead of 0.5 s ('),
    (('--step-size', '0.004'), 'in steps of at most 0.004 s (')])
def test_simulate_tells_the_steps_that_were_made(capsys, options, reported):
    text = done(
        capsys, 'simulate', 'four_bar', '--duration', '0.02', '--integrator', 'rk4', *options)
    assert reported in text


# On scenes for which other tests compile these, too.
@pytest.mark.parametrize('scene, options', [
    ('four_bar', ('--integrator', 'semi_implicit_euler', '--stabilisation', 'none')),
    ('four_bar', ('--integrator', 'rk4', '--stabilisation', 'baumgarte'))])
def test_method_options_replace_those_of_the_scene(capsys, scene, options):
    text = done(capsys, 'simulate', scene, '--duration', '0.01', *options)
    assert all(value in text for value in options[1::2])


def test_rows_go_to_the_standard_output_and_the_summary_does_not(capsys):
    code, text, errors = call(
        capsys, 'simulate', 'four_bar', '--duration', '0.02', '--output', '-')
    assert code == 0
    assert [line.split(',')[0] for line in text.splitlines()] == ['time', '0.0', '0.01', '0.02']
    assert 'CPU time' in errors


def test_an_existing_file_is_replaced_only_when_asked_for(capsys, tmp_path):
    output = tmp_path / 'run.csv'
    output.write_text('precious')
    arguments = ('simulate', 'four_bar', '--duration', '0.01', '--output', output)
    code, _, errors = call(capsys, *arguments)
    assert code == 2 and 'exists' in errors and '--overwrite' in errors
    assert output.read_text() == 'precious'
    assert call(capsys, *arguments, '--overwrite')[0] == 0
    assert len(read(output)['time']) == 2


def test_a_full_disk_is_named(capsys):
    code, _, errors = call(capsys, 'simulate', 'four_bar', '--output', '/dev/full')
    assert code == 1
    assert 'Traceback' not in errors and '/dev/full: No space left' in errors


@pytest.mark.parametrize('arguments, words', [
    ('simulate four_bar --output no/run.csv', '--output: expected an existing directory'),
    ('simulate four_bar --output .', '--output: expected a file'),
    ('simulate four_bar --output run.txt', '--output: expected a name that ends with .csv'),
    ('simulate four_bar --budget 0.1 --tolerance 1e-9', 'dop853, got auto'),
    ('simulate four_bar --integrator rk4 --tolerance 1e-9', 'dop853, got rk4'),
    ('simulate four_bar --duration 1e-12', '--duration: expected at least 1e-09 s'),
    ('simulate four_bar --duration 1e300 --rate 1e300', '--rate: expected at most'),
    ('simulate four_bar --output run.csv', '--output: run.csv exists'),
    ('simulate four_bar --torque elbow=1', '--torque: expected actuated joints (crank_joint)'),
    ('simulate four_bar --motion crank_joint=t --torque crank_joint=1', '--torque: expected none'),
    ('simulate four_bar --motion elbow=t', '--motion'),
    ('simulate four_bar --set mechanism.bodies.crank.weight=1', '--set'),
    ('sweep four_bar --vary mechanism.bodies.crank.mass=1,2 --output no/x.nc', '--output'),
    ('sweep four_bar --vary mechanism.bodies.crank.mass=1,2 --output x.nc --torque elbow=1',
     'torque: expected one of the actuated joints'),
    ('accuracy four_bar --output run.csv', '--output: expected a directory'),
    ('accuracy four_bar --torque elbow=1', '--torque'),
    ('accuracy four_bar --target 1e-6 --budget 0.1', '--budget: not allowed'),
    ('effects carpet_scraper --output run.csv/in', 'run.csv is a file'),
    ('effects carpet_scraper --torque elbow=1', '--torque'),
    ('effects carpet_scraper --joint-rate elbow=1', '--joint-rate'),
    ('effects three_rrr_payload_friction --output run.csv', '--output'),
    ('export four_bar --output no/x.xml', '--output'),
    ('urdf four_bar --output no/x.urdf', '--output'),
    ('urdf four_bar --srdf no/x.srdf', '--srdf'),
    ('report four_bar --output x.txt', '.html, .pdf, got x.txt'),
    ('kinematics four_bar --drive crank_joint=0:1:3 --output x.txt', '.csv, got x.txt'),
    ('workspace three_rrr --point platform_center --show force', '--show: expected it with'),
    ('sweep four_bar --output x.nc --resume --overwrite', '--overwrite: not allowed'),
    ('sweep four_bar --output x.nc --scheduler here', 'with a port, such as tcp://192.0.2.1:8786'),
    ('plot run.csv --scene four_bar --output run.csv', '--output: expected a directory'),
    ('plot none.csv --scene four_bar --output here', 'none.csv'),
    ('plot none --output here', 'expected a rosbag2 bag'),
    ('animate run.csv --scene four_bar --output no/x.gif', '--output'),
    ('forces none --scene four_bar --output x.csv', 'expected a rosbag2 bag'),
    ('replay none', 'expected a rosbag2 bag'),
    ('replay none --picture x.docx', '--picture: expected a name that ends with'),
    ('identify run.csv four_bar --vary mechanism.bodies --picture x.docx',
     '--picture: expected a name that ends with'),
    ('recover none', 'recover is no longer a command'),
    ('stability --quick', 'python benchmark/stability.py --help'),
    ('mirror four_bar', 'doc/examples/derived_machines mirror'),
    ('view four_bar --save no/x.html', '--save'),
    ('view four_bar --save x.html --torque elbow=1', '--torque'),
    ('view four_bar --port 70000', '--port'),
    ('view four_bar --port x', '--port'),
    ('view four_bar --rate 3', '--rate: expected it with --save'),
    ('view four_bar --namespace arm', '--namespace: expected a recording, got four_bar'),
])
def test_arguments_are_checked_before_anything_compiles(
        capsys, tmp_path, monkeypatch, arguments, words):
    def fail(*arguments, **options):
        raise AssertionError('began to compile')

    monkeypatch.chdir(tmp_path)
    (tmp_path / 'run.csv').write_text('time\n')
    monkeypatch.setattr(Simulation, '__init__', fail)
    code, text, errors = call(capsys, *arguments.split())
    assert (code, text) == (2, '')
    assert words in errors and 'Traceback' not in errors
    assert (tmp_path / 'run.csv').read_text() == 'time\n'


def test_a_file_whose_name_is_no_text_is_written_with_its_report(capsys, tmp_path):
    output = tmp_path / 'run_\udc81.csv'
    assert call(capsys, 'simulate', 'four_bar', '--duration', '0.01', '--output', output)[0] == 0
    assert read(output)['time'][-1] == 0.01
    report = output.with_name(output.name + '.report.txt').read_text(encoding='utf-8')
    assert 'run_\\udc81.csv' in report


def test_a_failing_simulation_leaves_its_rows(capsys, tmp_path):
    output = tmp_path / 'run.csv'
    code, text, errors = call(
        capsys, 'simulate', 'four_bar', '--torque', 'crank_joint=3e6', '--rate', '1000',
        '--output', output)
    assert code == 1
    assert 'smaller' in errors and 'Traceback' not in errors
    data = read(output)
    assert data['time'] and all(math.isfinite(value) for column in data.values()
                                for value in column)
    assert f'{len(data["time"])} row' in text


@pytest.mark.parametrize('number, expected', [
    (signal.SIGINT, 130), pytest.param(signal.SIGTERM, 143, marks=pytest.mark.slow)])
def test_an_interrupted_run_leaves_whole_rows_and_says_so(tmp_path, number, expected):
    # More rows than fit into memory.
    output = tmp_path / 'run.csv'
    process = subprocess.Popen(
        [*PROGRAM, 'simulate', 'four_bar', '--duration', '1e9', '--output', str(output)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ENVIRONMENT)
    try:
        while not (output.exists() and output.stat().st_size > 10000):
            assert process.poll() is None, process.communicate()
            time.sleep(0.01)
        process.send_signal(number)
        text, errors = process.communicate(timeout=300)
    finally:
        process.kill()
    assert process.returncode == expected
    assert 'interrupted at t = ' in errors and 'Traceback' not in errors
    assert output.read_text().endswith('\n')
    assert f'{len(read(output)["time"])} rows' in text


def test_a_reader_that_has_enough_is_no_error():
    command = f'{sys.executable} -m closedloop_dynamics.cli simulate four_bar --output - | head -1'
    done = subprocess.run(['bash', '-o', 'pipefail', '-c', command], text=True, env=ENVIRONMENT,
                          capture_output=True)
    assert done.stdout.startswith('time,')
    assert done.returncode == 141
    assert 'Traceback' not in done.stderr and 'BrokenPipe' not in done.stderr
