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

"""Drives, springs, dampers and stops of joints that close loops are imported with them."""

from closedloop_dynamics import Simulation
from closedloop_dynamics.formats.registry import read_model
from closedloop_dynamics.simulation.scene import load_scene
import numpy as np
import pytest

from .test_sdf import FOUR_BAR, written

PIN = """<joint name="pin" type="revolute"><parent>rocker</parent><child>tip</child>
    <axis><xyz expressed_in="__model__">0 1 0</xyz><limit><lower>-1.5</lower><upper>1.0</upper>
    <effort>5</effort></limit><dynamics><damping>0.2</damping><friction>0.05</friction>
    <spring_stiffness>2</spring_stiffness><spring_reference>0.1</spring_reference></dynamics>
    </axis></joint>"""
CLOSES = ('<physics><simbody><must_be_loop_joint>true</must_be_loop_joint></simbody></physics>'
          '</joint>')


def model(tmp_path, cut):
    """Return the file of a four-bar with a spring at its pin, cut at one of its joints."""
    text = FOUR_BAR.replace(
        '<joint name="pin" type="ball"><parent>rocker</parent><child>tip</child></joint>', PIN)
    before, joint, rest = text.partition(f'<joint name="{cut}"')
    return written(tmp_path, before + joint + rest.replace('</joint>', CLOSES, 1), f'{cut}.sdf')


def test_what_acts_in_a_joint_that_closes_a_loop_is_kept(tmp_path):
    imported = read_model(model(tmp_path, 'pin'), end_stops=100.0)
    cut, = imported.mechanism.cut_joints
    # The coordinate is that of the child on the parent.
    assert (cut.name, cut.body_a, cut.body_b, cut.actuated) == ('pin', 'coupler', 'rocker', True)
    assert imported.effects['damping_pin']['coefficient'] == 0.2
    assert imported.effects['friction_pin']['coulomb'] == 0.05
    assert imported.effects['stiffness_pin']['rest'] == 0.1
    assert imported.effects['end_stop_pin']['upper'] == 1.0
    assert not any('pin' in what for what in imported.ignored)


START = {'crank_joint': 0.8, 'coupler_joint': -0.755, 'rocker_joint': 0.64, 'pin': -0.6}


@pytest.mark.slow
def test_it_acts_as_in_the_tree(tmp_path):
    found = []
    for cut in ('pin', 'rocker_joint'):
        scene = tmp_path / f'{cut}.yaml'
        start = ', '.join(f'{name}: {value}' for name, value in START.items() if name != cut)
        scene.write_text(f'mechanism: {model(tmp_path, cut).name}\ninitial: {{position: '
                         f'{{{start}}}, hold: [crank_joint]}}\n')
        simulation = Simulation.from_scene(load_scene(scene), integrator='rk4')
        for _ in range(3):
            simulation.step({'crank_joint': 0.2, 'pin': 0.5}, 0.1)
            place = simulation.joint_names.index('crank_joint')
            found.append((simulation.position[place], simulation.velocity[place]))
    np.testing.assert_allclose(found[:3], found[3:], rtol=0.0, atol=1e-9)
