# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Laws of force that a scene writes as expressions."""

from dataclasses import astuple
import math

from closedloop_dynamics import load_scene, Simulation, SimulationError, write_scene
from closedloop_dynamics.codegen import law_routine
from closedloop_dynamics.effects.registry import (
    Actuator, ExternalForce, JointDamping, JointSpring, Law, PointSpring, PrescribedForce)
from closedloop_dynamics.mechanism.fields import FieldError
import numpy as np
import pytest

from .machines import assert_balanced, block, flyer, simulated, spatial_block
from .test_space import point_mass
from ..reference import cases

X = {'joints': {'x': 'slide'}, 'rates': {'v': 'x'}}
SPRING = {'parameters': {'k': 40.0, 'l0': 0.2, 'c': 0.7}, 'rates': {'v': 'd'},
          'energy': 'k*(d - l0)**2/2', 'dissipation': 'c*v**2'}
IN_PLANE = (flyer, [0.3, 0.1, 0.4], [0.2, -0.5, 2.0])
IN_SPACE = (point_mass, [0.3, -0.2, 0.4], [0.5, 0.4, -0.3])


def assert_same_motion(machine, position, velocity, law, other, command=0.0, tolerance=1e-13):
    """Assert that two effects move a machine alike and have the same energies."""
    one, two = (simulated(machine(), {'it': record}, position, velocity, step_size=0.002)
                for record in (law, other))
    actuated = len(one.mechanism.actuated_joints)
    for _ in range(5):
        for each in (one, two):
            each.step([command] * actuated, 0.1)
        assert one.position == pytest.approx(two.position, rel=tolerance, abs=tolerance)
        assert one.velocity == pytest.approx(two.velocity, rel=tolerance, abs=tolerance)
        assert astuple(one.energy_balance)[:4] == pytest.approx(
            astuple(two.energy_balance)[:4], rel=1e-11, abs=1e-12)
    assert not np.array_equal(one.position, position)
    return one


@pytest.mark.parametrize('machine', [block, spatial_block])
def test_springs_and_dampers_in_a_joint_are_those_of_the_package(machine):
    law = Law({'x': '-k*(x - x0)'}, parameters={'k': 30.0, 'x0': 0.1}, energy='k*(x - x0)**2/2',
              **X)
    assert_same_motion(machine, [0.4], [1.0], law, JointSpring('slide', 30.0, 0.1))
    law = Law({'x': '-c*v'}, parameters={'c': 3.0}, dissipation='c*v*v', **X)
    assert_same_motion(machine, [0.4], [1.0], law, JointDamping('slide', 3.0))


@pytest.mark.parametrize('start, ends', [
    (IN_PLANE, ('rim', (0.5, 0.9))), (IN_PLANE, ('ball', (-1.0, 0.0))),
    (IN_SPACE, ('center', (1.0, 0.5, -0.8)))])
def test_a_spring_along_a_distance_is_that_between_points(start, ends):
    law = Law({'d': '-k*(d - l0) - c*v'}, distances={'d': ends}, **SPRING)
    other = PointSpring(ends[0], anchor=ends[1], stiffness=40.0, damping=0.7, free_length=0.2)
    assert_balanced(assert_same_motion(*start, law, other), 1e-7)


def test_a_distance_of_two_points_that_both_move():
    law = Law({'d': '-k*(d - l0) - c*v'}, distances={'d': ('rim', 'ball')}, **SPRING)
    one = simulated(flyer(), {'it': law}, *IN_PLANE[1:])
    two = simulated(flyer(), {}, *IN_PLANE[1:])
    for each in (one, two):
        each.step(None, 0.5)
    # Points of one body: the spring does nothing.
    assert one.position == pytest.approx(two.position, abs=1e-14)
    assert one.effect_readings('it')['stored_energy'] == pytest.approx(0.0, abs=1e-30)


@pytest.mark.parametrize('start, point, force', [
    (IN_PLANE, 'rim', (1.5, -2.0)), (IN_SPACE, 'center', (1.5, -2.0, 0.5))])
def test_forces_along_components_of_a_place_are_those_at_a_point(start, point, force):
    names = 'xyz'[:len(force)]
    law = Law(dict(zip(names, force)),
              components={name: (point, name) for name in names})
    other = ExternalForce(point, force)
    assert_same_motion(*start, law, other)


def test_a_law_over_time_is_a_prescribed_force():
    law = Law({'x': '2*sin(3*t) - exp(-t)*cos(sin(t))'}, joints={'x': 'slide'})
    other = PrescribedForce(
        'expression', 'slide', expression='2*sin(3*t) - exp(-t)*cos(sin(t))')
    assert_same_motion(block, [0.4], [1.0], law, other)
    # The time goes on where a law is switched on, and begins again with the run.
    one = simulated(block(), {'it': law}, [0.0])
    one.step(None, 0.5)
    one.set_effect('it', enabled=False)
    one.step(None, 0.25)
    one.set_effect('it', enabled=True)
    wanted = 2.0 * math.sin(2.25) - math.exp(-0.75) * math.cos(math.sin(0.75))
    assert one.acceleration[0] == pytest.approx(wanted, rel=1e-12)
    one.reset()
    assert one.acceleration[0] == pytest.approx(-1.0, rel=1e-12)


def test_a_state_of_its_own_answers_as_a_lag_of_first_order():
    law = Law({'x': 'z'}, joints={'x': 'slide'}, parameters={'T': 0.05, 'u': 3.0},
              states={'z': '(u - z)/T'}, readings={'torque': 'z'})
    one = simulated(block(), {'it': law}, [0.0])
    two = simulated(block(), {'it': Actuator('slide', lag=0.05)}, [0.0])
    one.step(None, 0.1)
    two.step([3.0], 0.1)
    assert one.effect_readings('it')['torque'] == pytest.approx(
        3.0 * (1.0 - math.exp(-2.0)), rel=1e-7)
    assert one.velocity[0] == pytest.approx(
        3.0 * (0.1 - 0.05 * (1.0 - math.exp(-2.0))), rel=1e-7)
    assert one.velocity[0] == pytest.approx(two.velocity[0], rel=1e-14)
    assert_balanced(one, 1e-9)
    begun = simulated(block(), {'it': Law(
        {'x': 'z'}, joints={'x': 'slide'}, states={'z': '-z'}, start={'z': 2.0})}, [0.0])
    begun.step(None, 1.0)
    assert begun.velocity[0] == pytest.approx(2.0 * (1.0 - math.exp(-1.0)), rel=1e-10)


@pytest.mark.parametrize('integrator', ['rk4', 'auto', 'dop853', 'rodas4'])
def test_the_energy_of_a_law_that_tells_it_is_balanced(integrator):
    law = Law({'x': '-k*x**3 - c*v*abs(v)'}, parameters={'k': 50.0, 'c': 0.4},
              energy='k*x**4/4', dissipation='c*abs(v)**3', **X)
    one = simulated(block(), {'it': law}, [0.5], [1.0], integrator=integrator, step_size=0.001)
    one.step(None, 2.0)
    balance = one.energy_balance
    assert balance.dissipated > 0.1 and balance.work == 0.0
    assert_balanced(one, 1e-6)


def test_an_energy_that_the_law_does_not_have_is_found_out():
    law = Law({'x': '-k*x'}, parameters={'k': 50.0}, energy='k*x**2', **X)
    one = simulated(block(), {'it': law}, [0.5], [1.0])
    with pytest.raises(SimulationError, match='energy'):
        one.step(None, 5.0)


def test_work_from_outside_is_what_a_law_that_tells_no_energy_does():
    one = simulated(block(), {'it': Law({'x': '5*v'}, **X)}, [0.0], [0.1])
    one.step(None, 0.5)
    assert one.velocity[0] == pytest.approx(0.1 * math.exp(2.5), rel=1e-9)
    assert one.energy_balance.work == pytest.approx(0.005 * (math.exp(5.0) - 1.0), rel=1e-9)
    assert one.effect_readings('it')['power'] == pytest.approx(5.0 * one.velocity[0] ** 2)


@pytest.mark.parametrize('text, function', [
    ('sin(x)', np.sin), ('cos(x)', np.cos), ('tan(x)', np.tan), ('asin(x)', np.arcsin),
    ('acos(x)', np.arccos), ('atan(3*x)', lambda x: np.arctan(3 * x)), ('sqrt(x)', np.sqrt),
    ('exp(x)', np.exp), ('log(x)', np.log), ('radians(x)', np.radians),
    ('degrees(x)', np.degrees), ('abs(-x)', np.abs), ('atan2(x, -2)', lambda x: np.arctan2(x, -2)),
    ('hypot(x, 2)', lambda x: np.hypot(x, 2)), ('min(x, 0.5)', lambda x: np.minimum(x, 0.5)),
    ('max(x, 0.5)', lambda x: np.maximum(x, 0.5)), ('x**7', lambda x: x ** 7),
    ('x**-3', lambda x: x ** -3), ('x**0', lambda x: 1.0), ('x**2.5', lambda x: x ** 2.5),
    ('2**x', lambda x: 2 ** x), ('x**x', lambda x: x ** x), ('-x**2', lambda x: -x ** 2),
    ('+x - -1', lambda x: x + 1), ('x/7 - 7/x', lambda x: x / 7 - 7 / x),
    ('pi*x', lambda x: np.pi * x), ('sin(cos(sin(x)))', lambda x: np.sin(np.cos(np.sin(x)))),
    ('3', lambda x: 3.0), ('(((x)))', lambda x: x)])
def test_expressions_have_their_values(text, function):
    for place in (0.3, 0.9):
        one = simulated(block(), {'it': Law({'x': text}, joints={'x': 'slide'})}, [place])
        assert one.acceleration[0] == pytest.approx(function(place), rel=1e-14)


def test_a_change_of_parameters_compiles_nothing():
    law = Law({'x': '-k*x - c*v'}, parameters={'k': 10.0, 'c': 0.0}, **X)
    one = simulated(block(), {'it': law}, [0.5])
    known = len(law_routine.compiled)
    for stiffness in (20.0, 0.0, 1.0):
        one.set_effect('it', parameters={'k': stiffness, 'c': 0.5})
        assert one.acceleration[0] == pytest.approx(-0.5 * stiffness)
    assert len(law_routine.compiled) == known
    with pytest.raises(FieldError, match='effects.it'):
        one.set_effect('it', parameters={'k': 1.0})
    with pytest.raises(FieldError, match='effects.it.parameters.k'):
        one.set_effect('it', parameters={'k': math.nan, 'c': 0.5})
    assert one.acceleration[0] == pytest.approx(-0.5)


def test_a_change_to_what_is_not_finite_is_refused():
    law = Law({'x': '-k/x'}, parameters={'k': 10.0}, **X)
    one = simulated(block(), {'it': law}, [0.5])
    with pytest.raises(FieldError, match=r'effects.it.forces.*finite'):
        one.set_effect('it', forces={'x': 'log(-k*x)'})
    assert one.effects['it'] is law
    assert one.acceleration[0] == pytest.approx(-20.0)


def test_rollouts_are_runs_of_their_own_to_the_last_bit():
    law = Law({'x': '-k*x - c*v*abs(v) + sin(t)'}, parameters={'k': 10.0, 'c': 0.2}, **X)
    one = simulated(block(), {'it': law}, [0.5])
    stiffness = [5.0, 10.0, 40.0, 80.0, 1.0]
    found = one.rollout(steps=200, every=200, threads=2,
                        parameters={'effects.it.parameters.k': stiffness})
    for k, value in enumerate(stiffness):
        alone = simulated(block(), {'it': Law(
            law.forces, parameters={'k': value, 'c': 0.2}, **X)}, [0.5])
        alone.step(None, 200 * alone.step_size)
        assert found.position[k, -1, 0] == alone.position[0]
        assert found.velocity[k, -1, 0] == alone.velocity[0]


def test_a_scene_file_has_laws_and_is_written_again(tmp_path):
    law = Law({'x': '-k*x - c*v*abs(v)', 'd': '-z'}, distances={'d': ('front', (1.0, 2.0))},
              parameters={'k': 3.0, 'c': 0.5}, states={'z': 'd - z'}, start={'z': 0.5},
              readings={'lag': 'z'}, **X)
    one = simulated(block(), {'it': law}, [0.5])
    write_scene(one.scene, tmp_path / 'scene.yaml')
    scene = load_scene(tmp_path / 'scene.yaml')
    assert scene.effects['it'] == law
    two = Simulation.from_scene(scene)
    for each in (one, two):
        each.step(None, 0.5)
    assert np.array_equal(one.state, two.state)


# Damaged pieces of programs and numbers.
EVIL = ('__import__("os").system("true")', 'x.__class__', 'x.real', '(lambda: 1)()', 'open("f")',
        '[1][0]', '{1: 2}', 'x if x else 1', 'x and 1', 'not x', 'x < 1', 'x == x', 'x // 2',
        'x % 2', 'x @ x', 'x << 2', '~1', "'a'*9", 'f"{x}"', '9**9**9', '10**400', '1/0',
        'sqrt(-1)', '(-8)**0.5', 'log(0)', 'nan', 'inf', 'None', 'True', '1j', '1_000', '...',
        '*x', '**x', 'x:=1', 'print(x)', 'eval(x)', 'exec', 'sin', 'sin()', 'sin(x, x)',
        'sin(x=1)', 'min(*x)', 'math.sin(x)', 'y', 'x y', '', ' ', '(', 'x)', '\n', 'x;x', '#',
        '1e999', '-1e999', 'x' * 501, 'x\u0301', 'yield', 'await x',
        'import os', 'del x', 'x\\', '\x00', 'int(x)', 'abs', 'rate(x)', 't(1)', 'pi()')


@pytest.mark.parametrize('text', EVIL)
def test_what_is_no_expression_is_refused_with_its_key(text):
    for key, values in {
            'forces.x': {'forces': {'x': text}},
            'states.z': {'forces': {'x': 'z'}, 'states': {'z': text}},
            'readings.r': {'forces': {'x': 'x'}, 'readings': {'r': text}},
            'energy': {'forces': {'x': 'x'}, 'energy': text},
            'dissipation': {'forces': {'x': 'x'}, 'dissipation': text}}.items():
        with pytest.raises(FieldError) as caught:
            Law(joints={'x': 'slide'}, **values)
        assert str(caught.value).startswith(f'{key}: expected an expression')


@pytest.mark.parametrize('seed', cases.first(10, range(40)))
def test_random_texts_do_no_harm(seed):
    rng = np.random.default_rng(seed)
    alphabet = ['x', 'v', 't', 'pi', '1', '2.5', '1e9', '+', '-', '*', '/', '**', '(', ')', ',',
                'sin', 'max', 'log', '.', '_', 'a', ' ', '[', '"', 'lambda', ':', '=', '<']
    for _ in range(50):
        text = ''.join(rng.choice(alphabet, rng.integers(1, 12)))
        try:
            law = Law({'x': text}, **X)
            simulation = simulated(block(), {'it': law}, [0.5], [0.2])
        except (FieldError, SimulationError) as error:
            assert 'forces' in str(error) or isinstance(error, SimulationError)
        else:
            assert np.isfinite(simulation.acceleration).all()


@pytest.mark.parametrize('text', ['1/(x - 0.5)', 'log(x - 0.5)', 'log(x - 1)', 'x**1e6/x**1e9',
                                  '1e308*10*x', 'x/0', '(x - 1)**0.5', 'exp(exp(exp(9*x)))'])
@pytest.mark.parametrize('machine', [block, spatial_block])
def test_what_is_not_finite_at_the_start_is_refused(machine, text):
    for key, values in {'forces.x': {'forces': {'x': text}},
                        'states.z': {'forces': {'x': 'z'}, 'states': {'z': text}},
                        'readings.r': {'forces': {'x': 0.0}, 'readings': {'r': text}},
                        'dissipation': {'forces': {'x': 0.0}, 'dissipation': text},
                        'energy': {'forces': {'x': 0.0}, 'energy': text}}.items():
        law = Law(joints={'x': 'slide'}, **values)
        with pytest.raises(FieldError, match=f'effects.it.{key}: expected a finite value'):
            simulated(machine(), {'it': law}, [0.5])


@pytest.mark.parametrize('machine, key, values', [
    (block, 'joints.x', {'forces': {'x': '1'}, 'joints': {'x': 'slid'}}),
    (block, r'distances.d\[1\]', {'distances': {'d': ['center', 'rear']}}),
    (block, r'distances.d\[1\]', {'distances': {'d': ['center', [0.0, 0.0, 1.0]]}}),
    (spatial_block, r'distances.d\[0\]', {'distances': {'d': [[0.0, 0.0], 'center']}}),
    (block, r'components.c\[0\]', {'components': {'c': ['rear', 'x']}}),
    (block, r'components.c\[1\]', {'components': {'c': ['center', 'z']}})])
def test_a_mechanism_without_what_is_named_is_refused(machine, key, values):
    law = Law(**{'forces': {'x': '-x'}, 'joints': {'x': 'slide'}, **values})
    with pytest.raises(FieldError, match=f'effects.it.{key}'):
        simulated(machine(), {'it': law}, [0.5])
