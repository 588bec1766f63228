# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters and expressions: computed as they are written, refused in words, and varied."""

import math
import random

from closedloop_dynamics import load_scene, MechanismError, read_mechanism, SceneError
from closedloop_dynamics.cli import main
from closedloop_dynamics.mechanism.expressions import FUNCTIONS, Parameters
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.reader import with_parameters
from closedloop_dynamics.scene.key_paths import changed, numbers, resolve
from closedloop_dynamics.sweep.plan import parse, Plan
import pytest

MECHANISM = """\
name: four_bar
parameters: {l: 0.1, k: 3.5*l}
bodies:
  crank: {shape: {rod: {to: [l, 0], radius: 0.01}}, density: 7800}
  coupler: {mass: 1.0, center_of_mass: [k/2, 0.0], inertia: k**2/12}
  rocker: {mass: 0.8, center_of_mass: [0.125, 0.0], inertia: 0.004}
joints:
  crank_joint: {type: revolute, parent: ground, child: crank, position: [0, 0], actuated: true}
  coupler_joint: {type: revolute, parent: crank, child: coupler, position: [l, 0]}
  rocker_joint: {type: revolute, parent: ground, child: rocker, position: [0.4, 0], angle: pi/16}
cut_joints:
  cut_1: {type: revolute, body_a: coupler, point_a: [k, 0], body_b: rocker, point_b: [0.25, 0]}
"""
SCENE = """\
mechanism: ./machine.yaml
parameters: {a: pi/3, b: a/2, l: 0.11}
initial: {position: {crank_joint: a, coupler_joint: -b, rocker_joint: 1.7}, hold: [crank_joint]}
effects: {gravity: {type: gravity, acceleration: [0, -9.81*l/0.11]}}
method: {integrator: rk4, step_size: 1/2000}
"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / 'machine.yaml').write_text(MECHANISM)
    (tmp_path / 'scene.yaml').write_text(SCENE)
    return tmp_path / 'scene.yaml'


@pytest.mark.parametrize('text, value', [
    ('l/2', 0.175), ('-l', -0.35), ('2*pi', 2.0 * math.pi), ('l**2 / 12', 0.35 ** 2 / 12.0),
    ('1/2 - (l + 1)', 0.5 - 1.35), ('sqrt(l)*sin(pi/6)', math.sqrt(0.35) * math.sin(math.pi / 6)),
    ('atan2(l, -1) + hypot(3, 4)', math.atan2(0.35, -1.0) + 5.0), ('radians(90)', math.pi / 2.0),
    ('max(l, 1) - min(l, 1) + abs(-2)', 2.65), ('1e-3 + .5', 0.501), ('0x10*l', 5.6)])
def test_an_expression_has_its_value(text, value):
    assert Parameters({'l': 0.35}).evaluated(text) == pytest.approx(value, rel=1e-15)


def test_expressions_are_computed_as_python_does():
    rng = random.Random(1)

    def drawn(depth):
        if depth == 0 or rng.random() < 0.2:
            return rng.choice(['l', 'pi', f'{rng.uniform(0.5, 2.0):.6f}', '3.0'])
        kind = rng.random()
        if kind < 0.2:
            name = rng.choice(list(FUNCTIONS))
            return f'{name}({", ".join(drawn(depth - 1) for _ in range(FUNCTIONS[name][0]))})'
        if kind < 0.4:
            return rng.choice(['-({})', '({})**2.0']).format(drawn(depth - 1))
        return f'({drawn(depth - 1)} {rng.choice("+-*/")} {drawn(depth - 1)})'

    names = {**{name: getattr(math, name) for name in FUNCTIONS if hasattr(math, name)},
             'abs': abs, 'min': min, 'max': max, 'pi': math.pi, 'l': 0.35, '__builtins__': {}}
    compared = 0
    while compared < 300:
        text = drawn(4)
        if len(text) > 400 or 'l' not in text:
            continue
        try:
            wanted = eval(text, names)
        except (ArithmeticError, ValueError):
            wanted = math.inf
        if math.isfinite(wanted):
            assert Parameters({'l': 0.35}).evaluated(text + ' + 0') == wanted
            compared += 1
        else:
            with pytest.raises(FieldError):
                Parameters({'l': 0.35}).evaluated(text)


@pytest.mark.parametrize('text, words', [
    ('m*2', "'m*2' with the unknown name 'm' (there are l, k, pi)"),
    ('l/0', "'l/0', which has no value"), ('sqrt(-l)', "'sqrt(-l)', which has no value"),
    ('(-l)**0.5', 'a root of a negative number'), ('10.0**l**-9', 'which has no value'),
    ('foo(l)', "the unknown function 'foo'"), ('max(l)', "'max(l)'"), ('l.real', "'l.real'"),
    ('l if l else 2', "'l if l else 2'"), ('1_0 + l', "'1_0 + l'"), ('1e999*l', 'which is inf'),
    ('lambda: l', "got the text 'lambda: l'"), ('__import__(l)', "unknown function '__import__'"),
    ('l*', "got the text 'l*'"), ('2 l', "got the text '2 l'"), ('l^2', "got the text 'l^2'")])
def test_what_has_no_value_is_named_by_file_line_and_key(tmp_path, text, words):
    path = tmp_path / 'machine.yaml'
    path.write_text(MECHANISM.replace('mass: 1.0', f'mass: "{text}"'))
    with pytest.raises(MechanismError) as error:
        read_mechanism(path)
    assert str(error.value).startswith(f'{path}:5: bodies.coupler.mass: expected ')
    assert words in str(error.value)


@pytest.mark.parametrize('section, words', [
    ('{l: k, k: 2*l}', ":2: parameters.l: expected a finite number, got the text 'k'"),
    ('{l: 1, sin: 2}', ':2: parameters.sin: expected a name'),
    ('{l: 1, k: [2]}', ':2: parameters.k: expected a finite number'),
    ('[1]', ':2: parameters: expected a mapping')])
def test_parameters_that_cannot_be_are_named(tmp_path, section, words):
    path = tmp_path / 'machine.yaml'
    path.write_text(MECHANISM.replace('{l: 0.1, k: 3.5*l}', section))
    with pytest.raises(MechanismError) as error:
        read_mechanism(path)
    assert words in str(error.value)


@pytest.mark.parametrize('before, after, words', [
    ('position: [0.4, 0]', 'position: [40 deg, 0]',
     "joints.rocker_joint.position[0]: expected a length [m], got the text '40 deg', an angle"),
    ('angle: pi/16', 'angle: 2*(40 mm)',
     "joints.rocker_joint.angle: expected an angle [rad], got the text '2*(40 mm)', a length"),
    ('mass: 1.0', 'mass: 40 mm',
     "bodies.coupler.mass: expected a number [kg], got the text '40 mm', a length"),
    ('radius: 0.01', 'radius: 1 deg',
     "bodies.crank.shape.rod.radius: expected a length [m], got the text '1 deg', an angle"),
    ('density: 7800', 'density: 7800 mm', 'bodies.crank.density: expected a number [kg/m^3]'),
    # By the units of the parameters that it is made of.
    ('parameters: {l: 0.1,', 'parameters: {l: 90 deg,',
     "bodies.crank.shape.rod.to[0]: expected a length [m], got the text 'l', an angle"),
    ('angle: pi/16', 'angle: 10 deg + 1 mm', 'expected a sum of lengths or of angles')])
def test_units_are_those_of_the_quantity(scene, before, after, words):
    machine = scene.with_name('machine.yaml')
    machine.write_text(MECHANISM.replace(before, after))
    with pytest.raises(MechanismError) as caught:
        read_mechanism(machine)
    assert words in str(caught.value)


@pytest.mark.parametrize('before, after', [
    ('position: [0.4, 0]', 'position: [4*(100 mm), 0.1 m - 10 cm]'),
    ('l: 0.1,', 'l: 100 mm,'), ('angle: pi/16', 'angle: 11.25 deg'),
    # A ratio of lengths, and their products, are what they are.
    ('angle: pi/16', 'angle: "atan2(40 mm, 2 m) + (10 mm)/(1 m)"'),
    ('angle: pi/16', 'angle: sin(11 deg)'),
    ('inertia: k**2/12', 'inertia: (350 mm)**2/12'), ('mass: 1.0', 'mass: 2*(500 mm)/(1 m)')])
def test_units_that_fit_are_read(scene, before, after):
    machine = scene.with_name('machine.yaml')
    machine.write_text(MECHANISM.replace(before, after))
    read_mechanism(machine)


def test_parameters_of_a_file_can_be_others(scene):
    path = scene.with_name('machine.yaml')
    for mechanism in (read_mechanism(path, {'l': 0.2}),
                      with_parameters(read_mechanism(path), {'l': 0.2})):
        assert mechanism.parameters == pytest.approx({'l': 0.2, 'k': 0.7})
        assert mechanism.cut_joints[0].point_a == pytest.approx((0.7, 0.0))
        assert mechanism.bodies[0].center_of_mass == (0.1, 0.0)
    with pytest.raises(MechanismError, match='parameters: expected one of the parameters l, k'):
        read_mechanism(path, {'m': 1.0})


def test_parameters_of_a_scene_are_those_of_its_mechanism_and_its_own(scene):
    read = load_scene(scene)
    assert read.parameters == pytest.approx(
        {'l': 0.11, 'k': 0.385, 'a': math.pi / 3.0, 'b': math.pi / 6.0})
    assert read.mechanism.joints[1].position == (0.11, 0.0)
    assert read.initial.position == pytest.approx((math.pi / 3.0, -math.pi / 6.0, 1.7))
    assert read.method.step_size == 0.0005
    scene.write_text(SCENE.replace('b: a/2', 'c: 1, b: a/2'))
    with pytest.raises(SceneError, match='scene.yaml:2: parameters.c: expected a parameter of '):
        load_scene(scene)


def test_parameters_are_varied_by_key_paths_beside_other_numbers(scene):
    read = load_scene(scene)
    new = changed(read, {resolve(read, 'parameters.l'): 0.12, resolve(read, 'parameters.a'): 1.0,
                         resolve(read, 'mechanism.bodies.coupler.mass'): 3.0})
    assert new.initial.position == (1.0, -0.5, 1.7)
    crank, coupler, _ = new.mechanism.bodies
    assert (coupler.mass, crank.center_of_mass) == (3.0, (0.06, 0.0))
    # What was changed beside them stays; what follows from a parameter follows again.
    again = changed(new, {resolve(new, 'parameters.l'): 0.11})
    assert again.mechanism.bodies[1].mass == 3.0 and again.initial == new.initial
    assert again.mechanism.cut_joints == read.mechanism.cut_joints
    assert numbers(again)['parameters.k'] == pytest.approx(0.385)
    with pytest.raises(FieldError, match='mechanism.bodies.crank.shape.rod.to: expected another'):
        changed(read, {resolve(read, 'parameters.l'): 0.0})


def test_parameters_reach_a_sweep_and_the_command_line(scene, capsys):
    plan = Plan(load_scene(scene), (parse('parameters.l=0.1:0.12:3'),))
    assert plan.paths == (('parameters', 'l'),) and plan.samples == 3
    assert main(['check', str(scene), '--set', 'parameters.l=0.12']) == 0
    assert '[0.06, 0]' in capsys.readouterr().out
    assert main(['check', str(scene), '--set', 'parameters.m=1']) == 2
    assert "expected one of l, k, a, b after parameters, got 'm'" in capsys.readouterr().err
