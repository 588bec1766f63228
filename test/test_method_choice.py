# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""``integrator: auto`` picks a method that keeps its word, and says which."""

from dataclasses import replace

from closedloop_dynamics import method_choice
from closedloop_dynamics.cli import main
from closedloop_dynamics.errors import SimulationError
from closedloop_dynamics.method_choice import choose_method
from closedloop_dynamics.scene import load_scene
from closedloop_dynamics.scene_records import Method
from closedloop_dynamics.simulation import Simulation
from closedloop_dynamics.studies.check import describe
import numpy as np
import pytest

SCENE = """
mechanism: four_bar
initial:
  position: {crank_joint: 1.0472, coupler_joint: -0.5713, rocker_joint: 1.7270}
  hold: [crank_joint]
method: {integrator: auto, accuracy: 1.0e-5}
"""


@pytest.mark.parametrize('accuracy', [1e-3, 1e-6, 1e-9])
def test_the_method_chosen_keeps_the_accuracy(accuracy):
    chosen = Simulation.from_scene('three_rrr', integrator='auto', accuracy=accuracy)
    exact = Simulation.from_scene('three_rrr', integrator='dopri5', tolerance=1e-13)
    worst = 0.0
    for _ in range(10):
        chosen.step(duration=0.1)
        exact.step(duration=0.1)
        worst = max(worst, np.abs(chosen.position - exact.position).max())
    assert worst <= accuracy
    method = chosen.scene.method
    assert method.integrator != 'auto' and method.accuracy is None
    for word in ('auto', method.integrator, f'{accuracy:g} wanted', '% of real time'):
        assert word in chosen.method_report


def test_a_scene_file_can_ask_for_it(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text(SCENE)
    simulation = Simulation.from_scene(path)
    assert simulation.method_report
    assert simulation.scene.method.integrator != 'auto'


def test_an_integrator_given_overrides_it(tmp_path):
    path = tmp_path / 'scene.yaml'
    path.write_text(SCENE)
    simulation = Simulation.from_scene(path, integrator='heun')
    assert simulation.scene.method.integrator == 'heun' and simulation.method_report == ''


def test_the_same_scene_is_looked_at_once():
    scene = replace(load_scene('four_bar'), method=Method(integrator='auto', accuracy=1e-4))
    built = []

    def build(scene):
        built.append(scene)
        return Simulation(scene)

    first = choose_method(scene, build)
    count = len(built)
    assert count > 2
    assert choose_method(scene, build) is first and len(built) == count


def test_a_shorter_horizon_where_computing_takes_long(monkeypatch):
    patience = iter([-1.0, -1.0])

    class Impatient(method_choice._Search):

        def _motion(self, simulation, horizon):
            monkeypatch.setattr(method_choice, 'PATIENCE', next(patience, 10.0))
            return super()._motion(simulation, horizon)

    scene = replace(load_scene('four_bar'), method=Method(integrator='auto', accuracy=1e-4))
    assert 'over 0.1 s' in Impatient(scene, Simulation).result().report


def test_a_scene_that_nothing_gets_through(monkeypatch):
    monkeypatch.setattr(method_choice, 'PATIENCE', -1.0)
    scene = replace(load_scene('four_bar'), method=Method(integrator='auto', accuracy=1.1e-4))
    with pytest.raises(SimulationError, match='No method can be chosen'):
        Simulation(scene)


def test_the_command_line_can_ask_for_it(capsys):
    assert main(['simulate', 'four_bar', '--duration', '0.1', '--accuracy', '1e-5']) == 0
    assert 'method    integrator auto: ' in capsys.readouterr().out
    assert main(['simulate', 'four_bar', '--accuracy', '1e-5', '--integrator', 'rk4']) == 2
    assert 'without --integrator' in capsys.readouterr().err


def test_check_shows_what_the_integrator_goes_by():
    scene = load_scene('four_bar')
    shown = {}
    for name, method in (('auto', Method(integrator='auto', accuracy=1e-5)),
                         ('adaptive', Method(integrator='dop853', tolerance=1e-8)),
                         ('fixed', Method())):
        shown[name] = describe(replace(scene, method=method))
    assert 'accuracy' in shown['auto'] and '1e-05 rad or m' in shown['auto']
    assert 'tolerance' in shown['adaptive'] and '1e-08' in shown['adaptive']
    assert 'tolerance' not in shown['fixed'] and '0.001 s' in shown['fixed']
