# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Scenes are read whole, and each fault is named by file, line, key path, expected and got."""

from dataclasses import replace
from pathlib import Path
import shutil

from closedloop_dynamics import load_scene, Mechanism, MechanismError, scene_names, SceneError
from closedloop_dynamics.effects.registry import effect_type, EFFECTS, Gravity
from closedloop_dynamics.mechanism import config
from closedloop_dynamics.mechanism.fields import among, FieldError
from closedloop_dynamics.scene.integrators import INTEGRATORS, STABILISATIONS
from closedloop_dynamics.scene.loading import (
    config_directory, Initial, load_scene_or_mechanism, Method, Scene)
import pytest

from ..reference import faults

GOOD = """\
mechanism: four_bar
description: a test
initial:
  position: {crank_joint: 1.0, coupler_joint: -0.5, rocker_joint: 2}
  hold: [crank_joint]
  velocity: {crank_joint: 3.0}
effects:
  gravity: {type: gravity, acceleration: [0, -9.81]}
  side_wind: {type: gravity, acceleration: [1.0, 0.0]}
method:
  integrator: semi_implicit_euler
  step_size: 5e-4
  stabilisation: baumgarte
  baumgarte_time_constant: 0.02
"""
MECHANISM = f'one of {among(config.shipped_names("mechanisms"))}, or the path of a YAML file'
NO_KEY = ('this required key', 'none', '')

FAULTS = {
    'mechanism_misspelt': (
        'mechanism: four_bar', 'mechanism: for_bar', 1, 'mechanism',
        f'{MECHANISM} (./NAME.yaml)', "the text 'for_bar'",
        "did you mean 'four_bar'?"),
    'mechanism_missing': ('mechanism: four_bar\n', '', 1, 'mechanism', *NO_KEY),
    'mechanism_inline': (
        'mechanism: four_bar', 'mechanism: {name: four_bar}', 1, 'mechanism.bodies', *NO_KEY),
    'section_unknown': (
        'effects:', 'effect:', 7, 'effect',
        'one of the keys mechanism, initial, description, effects, method, parameters',
        "the unknown key 'effect'", "did you mean 'effects'?"),
    'description_list': (
        'description: a test', 'description: [a]', 2, 'description', 'text', "['a']", ''),
    'initial_empty': (
        GOOD[GOOD.index('initial:'):], 'initial:\n', 3, 'initial', 'a mapping (key: value)',
        'nothing', ''),
    'joint_missing': (
        ', rocker_joint: 2', '', 4, 'initial.position.rocker_joint', *NO_KEY),
    'joint_unknown': (
        'rocker_joint: 2', 'roker_joint: 2', 4, 'initial.position.roker_joint',
        'one of the keys crank_joint, coupler_joint, rocker_joint',
        "the unknown key 'roker_joint'", "did you mean 'rocker_joint'?"),
    'position_not_finite': (
        'rocker_joint: 2', 'rocker_joint: .nan', 4, 'initial.position.rocker_joint',
        'a finite number', 'nan', ''),
    'hold_unknown': (
        'hold: [crank_joint]', 'hold: [crank_joint, crank]', 5, 'initial.hold[1]',
        'one of the joints crank_joint, coupler_joint, rocker_joint', "the text 'crank'",
        "did you mean 'crank_joint'?"),
    'hold_twice': (
        'hold: [crank_joint]', 'hold: [crank_joint, crank_joint]', 5, 'initial.hold[1]',
        'every joint once', "'crank_joint' again", ''),
    'hold_no_list': (
        'hold: [crank_joint]', 'hold: crank_joint', 5, 'initial.hold', 'a list',
        "the text 'crank_joint'", ''),
    'velocity_unknown': (
        'velocity: {crank_joint: 3.0}', 'velocity: {crank: 3.0}', 6, 'initial.velocity.crank',
        'one of the keys crank_joint, coupler_joint, rocker_joint', "the unknown key 'crank'",
        "did you mean 'crank_joint'?"),
    'velocity_not_held': (
        'velocity: {crank_joint: 3.0}', 'velocity: {rocker_joint: 3.0}', 6,
        'initial.velocity.rocker_joint', 'velocities of held joints only (crank_joint)',
        "one of 'rocker_joint'",
        'the others follow from the loops; add the joint to hold, or remove its velocity'),
    'velocity_text': (
        'velocity: {crank_joint: 3.0}', 'velocity: {crank_joint: fast}', 6,
        'initial.velocity.crank_joint', 'a finite number', "the text 'fast'", ''),
    'effect_without_type': (
        'type: gravity, acceleration: [0,', 'acceleration: [0,', 8, 'effects.gravity.type',
        *NO_KEY),
    'effect_type_unknown': (
        'type: gravity, acceleration: [0,', 'type: gravitation, acceleration: [0,', 8,
        'effects.gravity.type', f'one of the effects {among(EFFECTS)}', "the text 'gravitation'",
        "did you mean 'gravity'?"),
    'effect_key_unknown': (
        'acceleration: [0, -9.81]', 'acceleration: [0, -9.81], g: 1', 8, 'effects.gravity.g',
        'one of the keys type, acceleration', "the unknown key 'g'", ''),
    'effect_key_missing': (
        ', acceleration: [0, -9.81]', '', 8, 'effects.gravity.acceleration', *NO_KEY),
    'effect_value': (
        '[0, -9.81]', '-9.81', 8, 'effects.gravity.acceleration',
        'a list of 2 finite numbers [x, y]', '-9.81', ''),
    'effect_is_a_vector': (
        '{type: gravity, acceleration: [0, -9.81]}', '[0, -9.81]', 8, 'effects.gravity',
        'a mapping (key: value)', '[0, -9.81]', ''),
    'effect_name': (
        'side_wind:', 'side wind:', 9, 'effects.side wind',
        'a name of letters, digits and underscores that starts with a letter',
        "the text 'side wind'", ''),
    'effects_list': (
        GOOD[GOOD.index('  gravity:'):GOOD.index('method:')], '- gravity\n', 7, 'effects',
        'a mapping (key: value)', "['gravity']", ''),
    'integrator': (
        'semi_implicit_euler', 'rk45', 11, 'method.integrator',
        f'one of {", ".join(INTEGRATORS)}', "the text 'rk45'",
        "did you mean 'rk4'?"),
    'step_size_zero': (
        'step_size: 5e-4', 'step_size: 0.0', 12, 'method.step_size', 'a positive number', '0.0',
        ''),
    'stabilisation_boolean': (
        'stabilisation: baumgarte', 'stabilisation: false', 13, 'method.stabilisation',
        f'one of {", ".join(STABILISATIONS)}', 'the truth value false', ''),
    'baumgarte_without': (
        'stabilisation: baumgarte', 'stabilisation: none', 14, 'method.baumgarte_time_constant',
        'this key only with stabilisation: baumgarte',
        'it with integrator: semi_implicit_euler, stabilisation: none',
        'remove it'),
    'baumgarte_negative': (
        'constant: 0.02', 'constant: -0.02', 14, 'method.baumgarte_time_constant',
        'a positive number', '-0.02', ''),
    'formulation': (
        'step_size: 5e-4', 'formulation: augmented', 12, 'method.formulation', 'no such key',
        "the key with the text 'augmented'", 'every scene is evaluated subsystem by subsystem, '
        'the fastest way to the same accelerations: leave the key out'),
    'integrator_of_scipy': (
        'integrator: semi_implicit_euler', 'integrator: scipy_radau', 11, 'method.integrator',
        f'one of {among(INTEGRATORS)}', "the text 'scipy_radau'",
        "SciPy's solvers are not part of the package any more: take rodas4"),
    'accuracy_without_auto': (
        'step_size: 5e-4', 'accuracy: 1.0e-6', 12, 'method.accuracy',
        'this key only with integrator: auto',
        'it with integrator: semi_implicit_euler, stabilisation: baumgarte', 'remove it'),
    'method_key': (
        'step_size: 5e-4', 'stepsize: 5e-4', 12, 'method.stepsize',
        'one of the keys integrator, step_size, stabilisation, tolerance, '
        'baumgarte_time_constant, accuracy, budget',
        "the unknown key 'stepsize'", "did you mean 'step_size'?"),
    'a_mechanism': (
        GOOD, 'name: x\nbodies: {}\n', 2, 'bodies', 'a scene', 'a mechanism',
        'a scene names one under `mechanism` and says under `initial` where it starts'),
}


def write(directory, text, name='scene.yaml'):
    return faults.write(directory, text, name)


def refusal(name_or_path, load=load_scene):
    return faults.refusal(name_or_path, load, SceneError)


def test_good_scene_is_read_whole(tmp_path):
    path = write(tmp_path, GOOD, 'my-scene.yaml')
    scene = load_scene(path)
    assert (scene.name, scene.path, scene.description) == ('my-scene', path, 'a test')
    assert scene.mechanism == load_scene('four_bar').mechanism
    assert scene.initial == Initial((1.0, -0.5, 2.0), (3.0, 0.0, 0.0), ('crank_joint',))
    assert scene.effects == {'gravity': Gravity((0.0, -9.81)), 'side_wind': Gravity((1.0, 0.0))}
    assert list(scene.effects) == ['gravity', 'side_wind']
    assert scene.method == Method(
        'semi_implicit_euler', 5e-4, 'baumgarte', baumgarte_time_constant=0.02)
    assert load_scene(str(path)) == scene


@pytest.mark.parametrize('fault', FAULTS)
def test_fault_is_named(tmp_path, fault):
    faults.require_named(tmp_path / 'scene.yaml', GOOD, FAULTS[fault], load_scene, SceneError)


def test_optional_parts_have_defaults(tmp_path):
    text = GOOD[:GOOD.index('  hold:')].replace('description: a test\n', '')
    scene = load_scene(write(tmp_path, text))
    assert scene == load_scene(write(tmp_path, text + 'effects:\nmethod:\n'))
    assert (scene.description, scene.effects) == ('', {})
    assert scene.initial == Initial((1.0, -0.5, 2.0), (0.0, 0.0, 0.0), ())
    assert scene.method == Method('auto', 0.001, 'projection', 1e-6, None, 1e-6)


def test_velocity_of_any_joint_where_none_is_held(tmp_path):
    text = GOOD.replace('  hold: [crank_joint]\n', '').replace(
        'velocity: {crank_joint', 'velocity: {rocker_joint')
    assert load_scene(write(tmp_path, text)).initial.velocity == (0.0, 0.0, 3.0)


def test_mechanism_path_is_relative_to_the_scene(tmp_path, monkeypatch):
    (tmp_path / 'machines').mkdir()
    (tmp_path / 'elsewhere').mkdir()
    shutil.copy(config_directory() / 'mechanisms' / 'four_bar.yaml',
                tmp_path / 'machines' / 'mine.yaml')
    write(tmp_path, GOOD.replace('four_bar', './machines/mine.yaml'))
    monkeypatch.chdir(tmp_path / 'elsewhere')
    assert load_scene('../scene.yaml').mechanism.name == 'four_bar'


def test_fault_of_the_mechanism_names_both_files(tmp_path):
    machine = write(tmp_path, 'name: x\n', 'machine.yaml')
    path = write(tmp_path, GOOD.replace('four_bar', 'machine.yaml'))
    assert refusal(path) == (
        f'{path}:1: mechanism: expected a valid mechanism, got this error in its file:\n'
        f'{machine}:1: bodies: expected this required key, got none')
    gone = write(tmp_path, GOOD.replace('four_bar', 'gone.yaml'))
    assert f'{tmp_path / "gone.yaml"}: expected a YAML file that can be read' in refusal(gone)


def test_unknown_scene_name_lists_the_shipped_ones():
    assert refusal('tree_rrr') == (
        f'scene: expected one of {among(scene_names())}, or the path of a YAML file '
        "(./NAME.yaml), got the text 'tree_rrr' (did you mean 'three_rrr'?)")
    assert refusal('./tree_rrr.yaml') == (
        'tree_rrr.yaml: expected a YAML file that can be read, got: No such file or directory')


def test_either_a_scene_or_a_mechanism(tmp_path):
    directory = config_directory()
    assert load_scene_or_mechanism('three_rrr') == load_scene('three_rrr')
    assert isinstance(load_scene_or_mechanism(directory / 'scenes' / 'four_bar.yaml'), Scene)
    assert isinstance(load_scene_or_mechanism(str(directory / 'mechanisms' / 'four_bar.yaml')),
                      Mechanism)
    with pytest.raises(MechanismError, match=r'machine.yaml:1: bodies: expected a mapping'):
        load_scene_or_mechanism(write(tmp_path, 'bodies: 3\nname: x\njoints: {}', 'machine.yaml'))
    assert 'did you mean' in refusal('tree_rrr', load_scene_or_mechanism)
    assert refusal(tmp_path / 'gone.yaml', load_scene_or_mechanism).startswith(str(tmp_path))


def test_shipped_mechanism_without_a_scene_goes_by_its_name(tmp_path, monkeypatch):
    shutil.copytree(config_directory(), tmp_path / 'config')
    (tmp_path / 'config' / 'scenes' / 'four_bar.yaml').unlink()
    monkeypatch.setattr(config, '__file__', str(tmp_path / 'package' / 'mechanism' / 'config.py'))
    assert 'four_bar' not in scene_names()
    assert isinstance(load_scene_or_mechanism('four_bar'), Mechanism)
    assert "got the text 'four_bar'" in refusal('four_bar')


@pytest.mark.parametrize('package, data', [
    ('checkout/closedloop_dynamics', 'checkout/config'),
    ('install/closedloop_dynamics/lib/python3.12/site-packages/closedloop_dynamics',
     'install/closedloop_dynamics/share/closedloop_dynamics/config'),
    ('venv/lib/python3.12/site-packages/closedloop_dynamics',
     'venv/share/closedloop_dynamics/config'),
    ('target/closedloop_dynamics', 'target/share/closedloop_dynamics/config'),
])
def test_config_is_found_where_it_is_installed(tmp_path, monkeypatch, package, data):
    (tmp_path / package).mkdir(parents=True)
    for kind in ('mechanisms', 'scenes'):
        (tmp_path / data / kind).mkdir(parents=True)
    monkeypatch.setattr(config, '__file__', str(tmp_path / package / 'mechanism' / 'config.py'))
    assert config_directory() == tmp_path / data


def test_missing_config_says_where_it_was_sought(tmp_path, monkeypatch):
    monkeypatch.setattr(config, '__file__', str(
        tmp_path / 'closedloop_dynamics' / 'mechanism' / 'config.py'))
    with pytest.raises(FileNotFoundError, match='install the package with its data files'):
        config_directory()


@pytest.mark.parametrize('build, message', [
    (lambda: Gravity(-9.81), 'acceleration: expected a list of 2 finite numbers'),
    (lambda: Gravity((0.0, float('nan'))), r'acceleration\[1\]: expected a finite number'),
    (lambda: Method(step_size=0), 'step_size: expected a positive number, got 0'),
    (lambda: replace(Method(), integrator='euler'), 'integrator: expected one of'),
    (lambda: Initial((0.0, None), (0.0, 0.0)), r'position\[1\]: expected a finite number'),
    (lambda: Initial((), (), ('a', 'a')), r"hold\[1\]: expected every joint once, got 'a' again"),
    (lambda: built(initial=Initial((0.0,), (0.0,) * 3)),
     'initial.position: expected 3 numbers, one for each joint, got 1'),
    (lambda: built(initial=Initial((0.0,) * 3, (0.0,) * 4)), 'initial.velocity: expected 3'),
    (lambda: built(initial=Initial((0.0,) * 3, (0.0,) * 3, ('elbow',))),
     r'initial.hold\[0\]: expected one of the joints crank_joint'),
    (lambda: built(effects={'gravity': -9.81}), 'effects.gravity: expected a record of'),
    (lambda: built(effects={'a b': Gravity((0, 0))}), 'effects.a b: expected a name'),
    (lambda: built(effects=[Gravity((0, 0))]), 'effects: expected a mapping'),
])
def test_records_built_in_python_obey_the_same_rules(build, message):
    with pytest.raises(FieldError, match=message):
        build()


def built(**changes):
    parts = {'name': 'mine', 'path': None, 'description': '',
             'mechanism': load_scene('four_bar').mechanism,
             'initial': Initial((0.0,) * 3, (0.0,) * 3), **changes}
    return Scene(**parts)


def test_scene_built_in_python_is_normalised():
    scene = built(initial=Initial([1, 2, 3], [0, 0, 0]), effects={'g': Gravity([0, -9])})
    assert scene.initial.position == (1.0, 2.0, 3.0)
    assert scene.effects['g'].acceleration == (0.0, -9.0)
    assert type(scene.effects['g'].acceleration[1]) is float
    assert scene.method == Method()
    with pytest.raises(MechanismError, match='bodies: expected at least one entry'):
        built(mechanism=replace(scene.mechanism, bodies=()))


def test_registry_names_every_record():
    assert {effect_type(kind.__new__(kind)) for kind in EFFECTS.values()} == set(EFFECTS)


def test_shipped_names_are_sorted():
    assert scene_names() == sorted(scene_names())
    assert {'three_rrr', 'carpet_scraper', 'four_bar'} <= set(scene_names())
    assert Path(load_scene('four_bar').path).parent == config_directory() / 'scenes'
