# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Drives, springs, dampers and stops of joints that close loops are imported with them."""

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.formats.registry import read_model
from closedloop_dynamics.kinematics.global_assembly import find_closed
from closedloop_dynamics.scene.model_scene import assembled
import numpy as np
import pytest

from . import machines
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


@pytest.mark.parametrize('way', ['loop', 'drake'])
def test_rounded_digits_of_a_file_are_closed_by_moving_the_anchor(tmp_path, way):
    # Four bars in a plane, one anchor beside it by less than a millionth of the machine.
    text = machines.four_bar(way).replace('0.4 0 0"', '0.4 8.9e-9 0"')
    imported = read_model(written(tmp_path, text, 'digits.urdf'))
    moved, found, notes = assembled(imported)
    assert found.closed and max(found.closure_errors.values()) < 1e-15
    assert notes[-1].endswith('was moved by 8.9e-09 m, as rounded digits of the file keep its '
                              'loop open')
    cut, = moved.mechanism.cut_joints
    drawn, = imported.mechanism.cut_joints
    assert np.subtract(cut.point_b, drawn.point_b) == pytest.approx((0.0, 8.9e-9, 0.0), abs=1e-10)
    # And closed wherever else it goes: the loop is planar now.
    q = found.q.copy()
    q[0] += 0.4
    again = find_closed(moved.mechanism, 0.4, q, ('crank_joint',), starts=0)
    assert again.closed and abs(moved.mechanism.cut_joints[0].point_b[1] - 8.9e-9) < 1e-20
    # What is open by more is an error in the file.
    odd = text.replace('8.9e-9', '1e-6')
    imported, found, notes = assembled(read_model(written(tmp_path, odd, 'odd.urdf')))
    assert not found.closed and 'cannot be assembled' in notes[0]
