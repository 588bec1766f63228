# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Accelerations of MJCF under all that acts in it: those of MuJoCo, by the engine itself."""

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.formats.registry import read_model
import numpy as np
import pytest

from .test_mjcf import BALL, compiled_or_skipped, of_mujoco, state, TREE, written

mujoco = pytest.importorskip('mujoco')

BELT = ('<tendon><fixed name="belt" {}><joint joint="hinge" coef="0.4"/>'
        '<joint joint="slide" coef="-1.5"/></fixed></tendon><actuator>')
CORD = ('<tendon><spatial name="cord" {}><site site="hook"/>{}<site site="tip"/></spatial>'
        '</tendon><actuator>')
SITES = [('<joint name="ball"', '<site name="tip" pos="0 0.2 0.1"/><joint name="ball"'),
         ('<light pos="0 0 1"/>', '<site name="hook" pos="0.5 0 2"/>'
                                  '<site name="guide" pos="0.1 0.2 1.6"/>')]
MOTOR = '<motor joint="hinge" gear="3"'
VARIANTS = {
    'as it is': [],
    'weights compensated': [('<body name="hand"', '<body gravcomp="1" name="hand"'), (
        '<body name="plate"', '<body gravcomp="0.5" name="plate"')],
    'dampers of balls and what floats': [
        (BALL, f'{BALL} damping="0.7"'),
        ('<freejoint name="drift"/>', '<joint type="free" name="drift" damping="0.4"/>')],
    'actuators': [(MOTOR, f'{MOTOR} damping="0.3" armature="0.02"')],
    'a spring between sites': [*SITES, ('<actuator>', CORD.format(
        'stiffness="40" damping="3" springlength="0.3"', ''))],
    'no gravity': [('contact=', 'gravity="disable" contact=')],
    'no springs': [('contact=', 'spring="disable" contact=')],
    'no dampers': [(MOTOR, f'{MOTOR} damping="0.3"'), (BALL, f'{BALL} damping="0.7"'),
                   ('contact=', 'damper="disable" contact=')],
    'a tendon of joints': [('<actuator>', BELT.format(
        'stiffness="30" damping="2" springlength="0.1"'))],
    'one with play': [('<actuator>', BELT.format('stiffness="30" springlength="-0.05 0.1"'))],
    'one of higher powers': [('<actuator>', BELT.format(
        'stiffness="30 -8 60" damping="2 0.5 0.7" springlength="0.1"'))],
    'joints of higher powers': [('stiffness="3"', 'stiffness="3 7 -9" damping="0.5 0.3 0.2"')],
    'only higher powers': [('stiffness="3"', 'stiffness="0 7 9"')],
    'a rope between sites': [*SITES, ('<actuator>', CORD.format(
        'stiffness="40" springlength="0 0.3" damping="3"', ''))],
    'a rope over a guide': [*SITES, ('<actuator>', CORD.format(
        'stiffness="40" springlength="0 0.9"', '<site site="guide"/>'))],
    'a fluid': [('<option ', '<option density="900" viscosity="2" wind="1 -2 0.5" ')],
    'armature of what floats': [('<freejoint name="drift"/>',
                                 '<joint type="free" name="drift" armature="0.3"/>')],
    'armature along a tendon': [('<actuator>', BELT.format('armature="3"'))],
    'a motor on a tendon, with armature and damping': [('<actuator>', BELT.format('')), (
        '<motor ', '<motor name="winch" tendon="belt" gear="3" armature="0.2" damping="0.1"/>'
        '<motor ')],
    'armature of a ball': [('<joint name="ball"', '<joint armature="0.2" name="ball"')],
    'springs of a ball and of what floats': [
        ('<joint name="ball"', '<joint stiffness="3" name="ball"'),
        ('<freejoint name="drift"/>', '<joint type="free" name="drift" stiffness="20"/>')],
    'weights compensated, without springs and dampers': [
        ('<body name="hand"', '<body gravcomp="1" name="hand"'),
        ('contact=', 'spring="disable" damper="disable" contact='),
        ('<option ', '<option density="900" ')]}
# Everything that acts along tendons and in a fluid.
ALONG = TREE.replace('<option ', '<option density="900" viscosity="2" ').replace('<actuator>', """
  <tendon><fixed name="belt" stiffness="30" damping="2" springlength="-0.05 0.1" limited="true"
  range="-1 1"><joint joint="hinge" coef="0.4"/><joint joint="slide" coef="-1.5"/></fixed>
  <spatial name="cord" stiffness="40" springlength="0 0.9" limited="true" range="0.1 2">
  <site site="hook"/><site site="guide"/><site site="tip"/></spatial></tendon><actuator>""")
for each in SITES:
    ALONG = ALONG.replace(*each)


def compared(tmp_path, text, few):
    """Assert that the engine's accelerations of a tree are MuJoCo's."""
    compiled, path = compiled_or_skipped(text), written(tmp_path, text)
    imported, rng = read_model(path), np.random.default_rng(0)
    assert not imported.omitted
    simulation = Simulation(load_scene(path))
    for _ in range(4):
        data, q, qd = state(compiled, imported, rng)
        theirs = of_mujoco(compiled, data, imported)
        np.testing.assert_allclose(simulation.forward_dynamics(q, qd)[0], theirs, rtol=few,
                                   atol=few * np.abs(theirs).max())
    return imported


@pytest.mark.parametrize('variant', VARIANTS)
def test_accelerations_are_those_of_mujoco(tmp_path, variant):
    text = TREE
    for old, new in VARIANTS[variant]:
        assert old in text
        text = text.replace(old, new)
    compared(tmp_path, text, 1e-11)


@pytest.mark.parametrize('size', [0.05, 30.0])
def test_friction_along_a_tendon_is_that_of_mujoco_made_hard(tmp_path, size):
    """It slides at most of its force; at rest its length stays, as far as MuJoCo is stiff."""
    text = TREE.replace('<actuator>', BELT.format(
        f'frictionloss="{size}" solimpfriction="0.9999 0.9999 0.001" '
        'solreffriction="-1 -1e7"')).replace(
        ' range="-90 45"', '')
    compiled, path = compiled_or_skipped(text), written(tmp_path, text)
    imported, rng = read_model(path), np.random.default_rng(1)
    assert imported.effects['tendon_friction_belt']['coulomb'] == size
    simulation = Simulation(load_scene(path))
    places = [imported.mechanism.coordinates.index[name] for name in ('hinge', 'slide')]
    for rest in (False, True):
        data, q, qd = state(compiled, imported, rng)
        if rest:
            data.qvel[:], qd[:] = 0.0, 0.0
        mujoco.mj_forward(compiled, data)
        theirs = of_mujoco(compiled, data, imported)
        ours = simulation.forward_dynamics(q, qd)[0]
        sticks = rest and size > 1.0
        # MuJoCo's gives way by one part in ten thousand.
        np.testing.assert_allclose(
            ours, theirs, rtol=0.0, atol=(1e-3 if sticks else 1e-7) * np.abs(theirs).max())
        assert (abs(ours[places] @ [0.4, -1.5]) < 1e-12) == sticks


def test_limits_of_tendons_are_end_stops_where_they_are_asked_for(tmp_path):
    text = TREE
    for old, new in (*SITES, ('<actuator>', CORD.format(
            'limited="true" range="0.1 0.7"', '<site site="guide"/>').replace(
            '<actuator>', '') + BELT.format('limited="true" range="-0.2 0.3"'))):
        text = text.replace(old, new)
    path = written(tmp_path, text)
    ignored = read_model(path).ignored
    assert ignored['limits of 2 tendon(s)'] == 'no end stops unless they are asked for'
    assert ignored['the least length of tendon cord'] == 'cables pull and never push'
    found = read_model(path, end_stops=1e4)
    assert 'limits of 2 tendon(s)' not in found.ignored
    assert found.effects['cable_cord_limit'] == {
        'type': 'cable', 'points': ['cord_limit_end_1', 'cord_limit_end_2', 'cord_limit_end_3'],
        'stiffness': 1e4, 'free_length': 0.7}
    assert found.effects['tendon_belt_limit'] == {
        'type': 'tendon', 'arms': {'hinge': 0.4, 'slide': -1.5}, 'stiffness': (1e4,),
        'damping': (), 'rest': (-0.2, 0.3)}


def test_drag_on_ellipsoids_is_named_with_its_share(tmp_path):
    text = ('<mujoco model="m"><option density="500" viscosity="3"/><worldbody><body><freejoint/>'
            '<geom type="box" size="0.1 0.2 0.3" density="1000" fluidshape="ellipsoid"/></body>'
            '</worldbody></mujoco>')
    compiled = mujoco.MjModel.from_xml_string(text.replace('fluidshape="ellipsoid"', ''))
    data = mujoco.MjData(compiled)
    data.qvel[0] = 1.0
    mujoco.mj_forward(compiled, data)
    omission, = read_model(written(tmp_path, text)).omitted
    assert omission.size == pytest.approx(-data.qfrc_passive[0])
    share = 100 * omission.size / (48 * 9.81)
    assert omission.quantity == f'drag at 1 m/s, {share:.2g} % of the weight,'
    assert omission.reason == ('bodies are boxes in a fluid, not ellipsoids (density 500 kg/m^3, '
                               'viscosity 3 Pa s)')
