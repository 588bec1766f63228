# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Damaged scenes, mechanisms and command lines: refused in words, or right; never a traceback.

Seeded; a few hundred of each, thousands with ``--all``. Counts are printed (``-s`` shows them).
"""

from collections import Counter
import math
import re
import shutil

from closedloop_dynamics import load_scene, MechanismError, SceneError, Simulation
from closedloop_dynamics.mechanism.config import config_directory
import numpy as np
import pytest

from ..mechanism import test_between, test_expressions
from ..test_cli import call

SCENES = ('four_bar', 'slider_crank_end_stop', 'three_rrr')
# A mechanism in space and one in the plane with all that a description may use.
SPACE = ["""\
mechanism: ./machine.yaml
parameters: {drop: 9.81, start: -0.6, r: 0.1}
initial:
  position: {crank_joint: 0.0, rocker_joint: 0.0, turn: 2*0.4, tilt: start}
  hold: [crank_joint]
  velocity: {crank_joint: 0.1}
effects:
  gravity: {type: gravity, acceleration: [0, 0, -drop]}
  motor: {type: actuator, joint: crank_joint, max_torque: 2*r}
  spring: {type: joint_spring, joint: rocker_joint, stiffness: 1.5}
""", """\
name: rssr
parameters: {r: 0.1, rod: 5.2*r}
bodies:
  crank: {mass: 0.5, center_of_mass: [r/2, 0, 0], inertia: [2.5e-5, 4.3e-4, 4.3e-4]}
  rocker: {mass: 1.0, center_of_mass: [0, 0, 0.15], inertia: [7.6e-3, 7.6e-3, 1.1e-4, 0, 0, 0]}
  link: {massless: true}
  rod: {shape: {rod: {to: [rod, 0, 0], radius: 0.01}}, density: 4000}
joints:
  crank_joint: {type: revolute, parent: ground, child: crank, position: [0, 0, 0], axis: [0, 0, 1],
                actuated: true}
  rocker_joint: {type: revolute, parent: ground, child: rocker, position: [0.4, 0.3, 0],
                 axis: [1, 0, 0], orientation: {quaternion: [0, 0, 0, 1]}}
  turn: {type: revolute, parent: crank, child: link, position: [r, 0, 0], axis: [0, 0, 1],
         orientation: {rpy: [0, 0, 0]}}
  tilt: {type: revolute, parent: link, child: rod, position: [0, 0, 0], axis: [0, 1, 0]}
cut_joints:
  ball: {type: spherical, body_a: rod, point_a: [rod, 0, 0], body_b: rocker, point_b: [0, 0, 0.3]}
points:
  pin: {body: rod, position: [rod, 0, 0]}
"""]
PLANE = [test_expressions.SCENE, test_expressions.MECHANISM.replace(
    'rod: {to: [l, 0], radius: 0.01}', 'cylinder: {radius: l, length: l/10, axis: [0, 0, 1]}'
    ).replace('mass: 1.0, center_of_mass: [k/2, 0.0], inertia: k**2/12',
              'shape: {box: {size: [k, l/10, l/20], center: [k/2, 0]}}, mass: sqrt(k)')]
BETWEEN = ["""\
mechanism: ./machine.yaml
initial: {position: {crank_joint: 1, coupler_joint: -0.5, tip: 0, rocker_joint: 1.7}}
effects: {lamp: {type: payload, body: coupler, mass: 1, position: [0.1, 0.0]}}
""", test_between.FOUR_BAR.replace('[0.25, 0]]}', '[0.25, 0]], cut: true}')]
VALUES = (
    '0', '-1', '1e999', '-1e308', '1e-320', '.nan', '-.inf', '9' * 5000, '0x' + 'f' * 5000, '1_0',
    '', '~', 'true', 'yes', '[]', '{}', '[1, 2, 3]', '{x: 1}', "''", '"\\0"', '"a\\0.yaml"',
    '"\\ud800.yaml"', '*a', '&a 1', '!!python/name:os.system x', '|', '>', '%', '@', '?', '- 1',
    'ground', 'revolute', 'fixed', '/', '..', '.', '/dev/null', '\t', '\u2028', '\U0001f600',
    'l/0', 'r*1e308*10', '2*r', 'sqrt(-1)', '(1+2', 'x+1', '__import__(1)', '9**9**9**9',
    '[' * 2000, 'a' * 3000, '60', '1 kg', '2026-11-21', '0.1, 0.2', '\x07', "it's")
NUMBER = re.compile(r'(?<![\w.])-?\d+\.?\d*(?:[eE][-+]?\d+)?')
WORD = re.compile(r'[A-Za-z_]\w*')


def swap(rng, text, pattern):
    """Exchange two places that a pattern finds."""
    found = list(pattern.finditer(text))
    if len(found) < 2:
        return text[::-1]
    one, other = sorted(rng.choice(len(found), 2, replace=False))
    one, other = found[one], found[other]
    return (text[:one.start()] + other.group() + text[one.end():other.start()]
            + one.group() + text[other.end():])


def put(rng, text, pattern, value):
    """Put a value at a place that a pattern finds."""
    found = list(pattern.finditer(text)) or list(re.finditer('(?s).', text))
    place = found[rng.integers(len(found))]
    return text[:place.start()] + value + text[place.end():]


def mutated(rng, text):
    """Return a text with one to three damages, as bytes."""
    for _ in range(rng.integers(1, 4)):
        lines, kind = text.splitlines(keepends=True), rng.integers(9)
        line, place = rng.integers(len(lines)), rng.integers(len(text))
        if kind < 3:
            text = put(rng, text, (NUMBER, WORD, NUMBER)[kind], str(rng.choice(VALUES)))
        elif kind == 3:
            text = swap(rng, text, WORD)
        elif kind == 4:
            factor = 10.0 ** rng.uniform(-12.0, 12.0)
            text = put(rng, text, NUMBER, f'{rng.normal() * factor:g}')
        elif kind == 5:
            del lines[line]
            text = ''.join(lines)
        elif kind == 6:
            text = ''.join([*lines[:line], lines[line], *lines[line:]])
        elif kind == 7:
            text = text[:place] + chr(rng.choice((0, 9, 10, 32, 34, 58, 91, 125, 0x85))) + text[
                place + rng.integers(2):]
        else:
            text = text[:place] if rng.random() < 0.2 else text[:place] + text[place + 1:]
        text = text or ' '
    content = text.encode()
    if rng.random() < 0.05:
        place = rng.integers(len(content))
        content = content[:place] + rng.bytes(2) + content[place + 1:]
    return content


def accepted_state(path, notes):
    """Return whether what was accepted stands closed to what notes say, and finite, by itself."""
    simulation = Simulation(load_scene(path))
    finite = np.isfinite([*simulation.position, *simulation.velocity, simulation.energy]).all()
    largest = max((abs(value) for cut in simulation.mechanism.cut_joints
                   for value in (*cut.point_a, *cut.point_b)), default=0.0)
    size = max([largest, *(math.hypot(*joint.position) for joint in simulation.mechanism.joints)])
    # Angles of 1e8 rad have no digits to close loops better.
    enough = simulation.mechanism.tolerance if 'taken as closed' in notes else 1e-9
    return finite and simulation.closure <= enough * max(size, 1.0)


def reported(counts):
    print(', '.join(f'{name} {counts[name]}' for name in (
        'tried', 'clean errors', 'accepted', 'tracebacks', 'silent')))


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('count', [
    100, pytest.param(2700, marks=(pytest.mark.slow, pytest.mark.timeout(3600)))])
def test_mutated_scenes_are_refused_in_words_or_right(tmp_path, capsys, count):
    rng, counts, bad = np.random.default_rng(20261121), Counter(), []
    sources = [[(config_directory() / kind / f'{file}.yaml').read_text() for kind, file in (
        ('scenes', name), ('mechanisms', load_scene(name).mechanism.name))] for name in SCENES]
    sources += [SPACE, PLANE, BETWEEN]
    for number in range(count):
        scene, mechanism = sources[number % len(sources)]
        scene = re.sub(r'(?m)^mechanism: \S+', 'mechanism: ./machine.yaml', scene)
        parts = [scene.encode(), mechanism.encode()]
        which = int(rng.integers(2))
        parts[which] = mutated(rng, (scene, mechanism)[which])
        path = tmp_path / 'scene.yaml'
        path.write_bytes(parts[0])
        (tmp_path / 'machine.yaml').write_bytes(parts[1])
        kept = tmp_path / f'{number}'
        outcome = 'tracebacks'
        try:
            try:
                load_scene(path)
                refused = ''
            except (SceneError, MechanismError) as error:
                refused = str(error)
            code, output, errors = call(capsys, 'check', str(path))
            said = errors.splitlines()
            if code == 0:
                # Above the tables stand descriptions, which may say anything.
                tables = output[output.index('\nBodies: '):]
                right = not refused and accepted_state(path, errors) and not re.search(
                    r'\b(nan|inf)\b', tables)
                outcome = 'accepted' if right else 'silent'
            elif code == 2 and said and said[-1].strip() and (not refused or refused in errors):
                outcome = 'clean errors'
            else:
                outcome = 'silent'
        except Exception as error:
            bad.append(f'{number}: {type(error).__name__}: {error}')
        counts[outcome] += 1
        if outcome in ('tracebacks', 'silent'):
            kept.mkdir()
            for name in ('scene.yaml', 'machine.yaml'):
                shutil.copy(tmp_path / name, kept)
            bad.append(f'{kept}: {outcome}')
    counts['tried'] = count
    reported(counts)
    assert not bad, '\n'.join(bad)
    # Damages that nobody notices would test nothing.
    assert min(counts['clean errors'], counts['accepted']) > 0.05 * count


# What a shell can hand over: no NUL.
SUBJECTS = ('four_bar', 'four_barr', '', '.', './none.yaml', '/dev/null', '\udc81', '-',
            '--', '-1', "it's", 'good.yaml', 'bad.yaml', 'x' * 5000)
NUMBERS = ('0.01', '0.02', '0', '-1', 'nan', 'inf', '1e-320', '1e999', '9' * 5000, '', 'x', '1_0')
TORQUES = ('crank_joint=1', 'crank_joint=', '=1', 'coupler_joint=1', 'crank_joint=nan',
           'crank_joint=1e308', 'crank_joint', '\x07=1')
NAMES = ('rk4', 'dopri5', 'auto', 'rk45', 'none', 'projection', 'independent', 'baumgarte',
         'subsystem', 'augmented', '', '\x07')
OPTIONS = {
    '--duration': NUMBERS[:-6] + ('x',), '--rate': ('100', *NUMBERS[2:]),
    '--step-size': ('0.001', *NUMBERS[2:]), '--tolerance': ('1e-6', *NUMBERS[2:]),
    '--torque': TORQUES, '--integrator': NAMES, '--stabilisation': ('projection', *NAMES),
    '--output': ('run.csv', 'none/run.csv', '.', '-', '', '\udc81'),
    '--scene': SUBJECTS, '--namespace': ('', 'a', '//', '\x07'), '--point': ('x', ''),
    '--vary': ('method.step_size=1:2', 'x=1', 'x', ''), '--samples': ('-1', '0', 'x'),
    '--overwrite': None, '--resume': None, '--nothing': None}
# What takes minutes where it is not refused; beside it always stands what no command takes.
LONG = ('sweep', 'accuracy', 'effects')
COMMANDS = ('check', 'simulate', 'simulate', 'urdf', 'replay', 'plot', 'animate', *LONG)


def drawn(rng, values):
    """Return the first value, which is a good one, as often as any other."""
    return values[rng.integers(len(values)) if rng.random() < 0.5 else 0]


def command_line(rng):
    """Return the arguments of a command, mostly wrong ones."""
    command = str(rng.choice(COMMANDS)) if rng.random() > 0.03 else 'fly'
    arguments = [command]
    if rng.random() > 0.1:
        arguments.append(drawn(rng, SUBJECTS))
    if command == 'simulate':
        arguments += ['--duration', '0.01']
    for option in rng.choice(list(OPTIONS), rng.integers(4)):
        values = OPTIONS[str(option)]
        arguments.append(str(option))
        if values:
            arguments.append(drawn(rng, values))
    return [*arguments, '--nothing'] if command in LONG else arguments


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('count', [
    60, pytest.param(1500, marks=(pytest.mark.slow, pytest.mark.timeout(3600)))])
def test_command_lines_are_refused_in_words_or_done(tmp_path, monkeypatch, capsys, count):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'good.yaml').write_text(
        'mechanism: four_bar\ninitial: {position: {crank_joint: 1, coupler_joint: -0.5, '
        'rocker_joint: 1.7}}\n')
    (tmp_path / 'bad.yaml').write_bytes(b'mechanism: \xff')
    rng, counts, bad = np.random.default_rng(20261122), Counter(), []
    for _ in range(count):
        arguments, outcome = command_line(rng), 'tracebacks'
        try:
            code, output, errors = call(capsys, *arguments)
            if code == 0:
                outcome = 'accepted' if output else 'silent'
            else:
                outcome = 'clean errors' if code in (1, 2) and errors.strip() else 'silent'
        except Exception as error:
            bad.append(f'{type(error).__name__}: {error}')
        counts[outcome] += 1
        if outcome in ('tracebacks', 'silent'):
            bad.append(f'{outcome}: {" ".join(map(repr, arguments))[:200]}')
    counts['tried'] = count
    reported(counts)
    assert not bad, '\n'.join(bad)
    assert min(counts['clean errors'], counts['accepted']) > 0.02 * count
