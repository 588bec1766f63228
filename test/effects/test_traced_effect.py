# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of a user's own, as classes with ``trace``."""

from dataclasses import dataclass
from pathlib import Path
import pickle
import subprocess
import sys

from closedloop_dynamics import load_scene, SceneError, Simulation, write_scene
from closedloop_dynamics.cli import main
from closedloop_dynamics.cli.commands import COMMANDS, parser
from closedloop_dynamics.codegen import law_routine
from closedloop_dynamics.codegen.expression_graph import chosen, exponential, larger
from closedloop_dynamics.effects import registration, registry
from closedloop_dynamics.effects.registry import EndStop, Law
from closedloop_dynamics.effects.traced_effect import TracedEffect
from closedloop_dynamics.effects.user_code import run_code
from closedloop_dynamics.mechanism.fields import FieldError
import numpy as np
import pytest

from .machines import assert_balanced, block, simulated, spatial_block

STOP = """\
from dataclasses import dataclass
from closedloop_dynamics.codegen.expression_graph import larger
from closedloop_dynamics.effects.registration import register
from closedloop_dynamics.effects.traced_effect import TracedEffect


@dataclass(frozen=True)
class Soft(TracedEffect):
    joint: str
    stiffness: float = 100.0

    def trace(self, law):
        x = law.joint(self.joint)
        x.push(-law.parameter('stiffness') * larger(x.value, 0.0))


register('soft', Soft)
"""
SCENE = """\
mechanism: slider_crank
initial:
  position: {crank_joint: 1.0472, rod_joint: -1.34, slider_joint: 0.3372}
  hold: [crank_joint]
effects: {mine: {type: soft, joint: crank_joint, stiffness: 5.0}}
"""


@dataclass(frozen=True)
class Stop(TracedEffect):
    """A stop that is elastic on one side of zero, whose rebound is read through a lag."""

    joint: str
    stiffness: float = 200.0
    lag: float = 0.05

    def trace(self, law):
        x, k = law.joint(self.joint), law.parameter('stiffness')
        depth = larger(-x.value, 0.0)
        x.push(chosen(x.value < 0.0, k * depth, 0.0))
        law.rate('felt', (k * depth - law.state('felt')) / law.parameter('lag'))
        law.store(0.5 * k * depth * depth)
        law.reading('depth', depth)


@dataclass(frozen=True)
class Free(TracedEffect):
    """A law that a test gives it."""

    joint: str = 'slide'

    def trace(self, law):
        LAWS[self.joint](law)


LAWS = {}


@pytest.fixture
def stated():
    """Return what lets ``Free`` have a law, by itself."""
    def state(law):
        LAWS['slide'] = law
        return Free()
    yield state
    LAWS.clear()


@pytest.mark.parametrize('machine', [block, spatial_block])
def test_a_stop_of_a_user_is_that_of_the_package(machine):
    one, two = (simulated(machine(), {'it': record}, [0.05], [-1.0], integrator='dop853',
                          tolerance=1e-10, step_size=0.001) for record in (
        Stop('slide'), EndStop('slide', 200.0, lower=0.0)))
    least = 0.0
    for _ in range(10):
        for each in (one, two):
            each.step(duration=0.05)
        least = min(least, one.position[0])
        assert one.position[0] == pytest.approx(two.position[0], abs=1e-8)
        assert one.energy == pytest.approx(two.energy, abs=1e-7)
    assert least < -0.03
    assert_balanced(one, 1e-8)
    assert one.effect_readings('it')['depth'] == 0.0


def test_parameters_change_without_compiling_and_in_rollouts():
    one = simulated(block(), {'it': Stop('slide')}, [-0.1])
    known = len(law_routine.compiled)
    one.set_effect('it', stiffness=50.0)
    assert one.acceleration[0] == pytest.approx(5.0)
    found = one.rollout(steps=100, every=100, parameters={
        'effects.it.stiffness': [10.0, 50.0, 300.0]})
    assert len(law_routine.compiled) == known
    for k, stiffness in enumerate((10.0, 50.0, 300.0)):
        alone = simulated(block(), {'it': Stop('slide', stiffness)}, [-0.1])
        alone.step(duration=100 * alone.step_size)
        assert found.position[k, -1, 0] == alone.position[0]


def test_a_class_and_a_scene_with_the_same_law_move_alike(stated):
    def trace(law):
        x, d = law.joint('slide'), law.distance('front', (1.0, 0.5))
        y = law.component('center', 'x')
        z = law.state('z', 0.2)
        law.rate('z', d.rate - 3.0 * z)
        x.push(-4.0 * x.value * exponential(-x.value) + z)
        d.push(-2.0 * d.value - 0.1 * abs(d.rate))
        y.push(0.5 * law.time)
    law = Law({'x': '-4*x*exp(-x) + z', 'd': '-2*d - 0.1*abs(w)', 'y': '0.5*t'},
              joints={'x': 'slide'}, distances={'d': ('front', (1.0, 0.5))},
              components={'y': ('center', 'x')}, rates={'w': 'd'},
              states={'z': 'w - 3*z'}, start={'z': 0.2})
    one, two = (simulated(block(), {'it': record}, [0.3], [0.2])
                for record in (stated(trace), law))
    for each in (one, two):
        each.step(duration=1.0)
    assert one.position[0] == pytest.approx(two.position[0], rel=1e-13)
    assert one.energy_balance.work == pytest.approx(two.energy_balance.work, rel=1e-12)


@pytest.mark.parametrize('law, expected', [
    (lambda law: law.joint('slide').push(1.0 if law.joint('slide').value > 0.0 else 2.0),
     'a law without if'),
    (lambda law: law.joint('slide').push(max(law.joint('slide').value, 0.0)), 'a law without if'),
    (lambda law: law.state('z'), 'a rate of each state'),
    (lambda law: law.rate('z', 1.0), 'a rate of each state'),
    (lambda law: [law.joint('slide') for _ in range(17)], 'at most 16 coordinates'),
    (lambda law: [law.rate(f'z{k}', law.state(f'z{k}')) for k in range(17)],
     'at most 16 states'),
    (lambda law: [law.reading(f'r{k}', 1.0) for k in range(4)], 'at most 3 readings'),
    (lambda law: law.store('much'), 'arithmetic on symbols'),
    (lambda law: law.joint('slide').push(np.inf), 'finite'),
    (lambda law: law.joint('slid'), 'one of the joints'),
    (lambda law: law.distance('front', 'rear'), 'one of the points'),
    (lambda law: law.component('front', 'z'), 'x, y')])
def test_what_is_no_law_is_refused(stated, law, expected):
    with pytest.raises(FieldError, match=expected):
        simulated(block(), {'it': stated(law)}, [0.1])


def test_a_law_without_effect_moves_nothing(stated):
    one = simulated(block(), {'it': stated(lambda law: None)}, [0.1], [0.4])
    one.step(duration=0.5)
    assert one.position[0] == pytest.approx(0.3, abs=1e-14)


@pytest.fixture
def files(tmp_path):
    """Return a scene and the code that it needs; what is registered goes again."""
    known = dict(registry.EFFECTS)
    (tmp_path / 'scene.yaml').write_text(SCENE)
    (tmp_path / 'soft.py').write_text(STOP)
    yield tmp_path / 'scene.yaml', tmp_path / 'soft.py'
    for name in set(registry.EFFECTS) - set(known):
        registration.of_users.remove(name)
        del registry.EFFECTS[name]


def test_a_scene_runs_code_only_where_the_command_line_allows_it(files, capsys):
    scene, code = map(str, files)
    assert main(['simulate', scene, '--duration', '0.01']) != 0
    assert 'effects.mine.type' in capsys.readouterr().err
    assert main(['simulate', scene, '--duration', '0.01', '--allow-code', code]) == 0


def test_every_command_that_reads_scenes_may_run_code(files):
    _, code = map(str, files)
    for name in COMMANDS:
        one = parser([name])._subparsers._group_actions[0].choices[name]
        takes = '--allow-code' in one._option_string_actions
        assert takes == (name not in ('benchmark', 'import', 'list', 'synthesise'))


def test_an_effect_of_a_file_is_built_by_other_processes(files):
    scene, code = map(str, files)
    run_code(code)
    sent = pickle.dumps(load_scene(scene).effects['mine'])
    found = subprocess.run(
        [sys.executable, '-c', 'import pickle, sys; '
         'print(pickle.loads(sys.stdin.buffer.read()).numbers())'],
        input=sent, capture_output=True, timeout=120)
    assert found.stdout.decode().strip() == "{'stiffness': 5.0}"


def test_a_record_that_is_copied_is_of_the_same_class(files):
    scene, code = map(str, files)
    run_code(code)
    one = load_scene(scene).effects['mine']
    other = pickle.loads(pickle.dumps(one))
    assert other == one and type(other) is type(one)
    assert other.traced.arithmetic == one.traced.arithmetic


def test_code_that_fails_is_reported(files, capsys):
    scene, code = files
    code.write_text('raise RuntimeError("broken")')
    with pytest.raises(SystemExit) as end:
        main(['simulate', str(scene), '--allow-code', str(code)])
    assert end.value.code == 2
    assert 'RuntimeError: broken' in capsys.readouterr().err


def test_what_is_registered_is_read_and_written(files):
    scene, _ = files
    with pytest.raises(SceneError, match='effects.mine.type'):
        load_scene(scene)
    exec(compile(STOP, 'soft.py', 'exec'), {'__name__': 'soft'})
    read = load_scene(scene)
    assert read.effects['mine'].stiffness == 5.0
    write_scene(read, Path(scene).with_name('again.yaml'))
    again = load_scene(Path(scene).with_name('again.yaml'))
    assert again.effects == read.effects
    one, two = map(Simulation, (read, again))
    for each in (one, two):
        each.step(duration=0.05)
    assert np.array_equal(one.state, two.state)


@pytest.mark.parametrize('name, kind, expected', [
    ('law', Stop, 'no effect of the package'), ('actuator', Stop, 'no effect of the package'),
    ('a b', Stop, 'a name of letters'), ('mine', EndStop, 'TracedEffect'),
    ('mine', TracedEffect, 'a dataclass'), ('mine', 3, 'TracedEffect')])
def test_what_cannot_be_registered_is_refused(name, kind, expected):
    before = dict(registry.EFFECTS)
    with pytest.raises(FieldError, match=expected):
        registration.register(name, kind)
    assert registry.EFFECTS == before
