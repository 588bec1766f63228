# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Models in other formats in the place of mechanisms: simulated, checked, imported."""

import warnings

from closedloop_dynamics import AssemblyError, load_scene, SceneError, Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.scene.model_scene import ModelWarning
import numpy as np
import pytest

from ..formats import machines
from ..test_cli import done

SCENE = """\
mechanism: ./own.yaml
initial:
  position: {crank_joint: 0.8, coupler_joint: -1.5, rocker_joint: -1.8}
effects:
  gravity: {type: gravity, acceleration: [0, 0, -9.81]}
"""


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / 'robot.urdf').write_text(machines.four_bar())
    (tmp_path / 'own.yaml').write_text(machines.mechanism_text('revolute'))
    (tmp_path / 'scene.yaml').write_text(SCENE)
    return tmp_path


@pytest.mark.filterwarnings('ignore::closedloop_dynamics.scene.model_scene.ModelWarning')
def test_a_model_is_simulated_like_the_mechanism(files):
    model, own = (Simulation(load_scene(path))
                  for path in ('robot.urdf', 'scene.yaml'))
    assert model.closure < 1e-12
    own.set_state(model.position)
    for simulation in (model, own):
        simulation.step({'crank_joint': 0.1}, 0.2)
    np.testing.assert_allclose(model.acceleration, own.acceleration, rtol=1e-9)
    np.testing.assert_allclose(model.position, own.position, rtol=1e-10)


def test_how_a_model_was_closed_and_what_was_left_out_is_reported(files):
    with pytest.warns(ModelWarning) as reported:
        load_scene('robot.urdf')
    texts = [str(one.message) for one in reported]
    assert any('the loops are drawn open and were closed' in text for text in texts)
    assert any('left out' in text and 'limits of 1 drive(s)' in text for text in texts)


def test_a_scene_of_a_model_tells_its_loops_and_may_leave_out_the_start(files):
    (files / 'plain.urdf').write_text(machines.robot(machines.LINKS, machines.TREE))
    (files / 'plain.yaml').write_text(
        'mechanism: ./plain.urdf\nloops:\n  pin: {type: revolute, between: [coupler, rocker], '
        'points: [[0.4, 0, 0], [0.3, 0, 0]], axis: [0, 1, 0]}\n')
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', ModelWarning)
        scene = load_scene('plain.yaml')
    own = load_scene('scene.yaml')
    assert scene.mechanism.cut_joints == own.mechanism.cut_joints
    assert any(scene.initial.position)


@pytest.mark.parametrize('loops, said', [
    ('other: {type: hinge, between: [coupler, rocker]}',
     'loops.other.type: expected one of revolute'),
    ('other: {type: revolute, between: [coupler, x], axis: [0, 1, 0]}',
     r'loops.other.between\[1\]: expected one of the links and frames'),
    ('other: {type: revolute, between: [coupler, rocker]}', 'loops.other.axis: expected this key'),
    ('crank_joint: {type: fixed, between: [coupler, rocker]}',
     'loops.crank_joint: expected a name that no joint of the model has'),
])
def test_loops_of_a_scene_that_are_none(files, loops, said):
    (files / 'bad.yaml').write_text(f'mechanism: ./robot.urdf\nloops:\n  {loops}\n')
    with pytest.raises(SceneError, match=f'bad.yaml:3: {said}'):
        load_scene('bad.yaml')


@pytest.mark.filterwarnings('ignore::closedloop_dynamics.scene.model_scene.ModelWarning')
def test_a_scene_mends_inertias(files):
    text = machines.four_bar().replace('ixx="0.0002"', 'ixx="0.00005"')
    assert text != machines.four_bar()
    (files / 'robot.urdf').write_text(text)
    for key, said in (('', "robot.urdf:.*<link name='coupler'>: expected moments"),
                      ('mend_inertias: often\n', 'mend_inertias: expected true or false')):
        (files / 'bad.yaml').write_text(f'mechanism: ./robot.urdf\n{key}')
        with pytest.raises(SceneError, match=said):
            load_scene('bad.yaml')
    (files / 'good.yaml').write_text('mechanism: ./robot.urdf\nmend_inertias: true\n')
    inertia = load_scene('good.yaml').mechanism.bodies[1].inertia
    assert max(inertia) == pytest.approx(sum(inertia) / 2.0)


def test_loops_belong_to_models(files):
    (files / 'bad.yaml').write_text(SCENE + 'loops: {}\n')
    with pytest.raises(SceneError, match='loops: expected one of the keys'):
        load_scene('bad.yaml')


def test_a_model_that_cannot_close_tells_the_loop(files):
    text = machines.four_bar().replace('<origin xyz="0.3 0 0"/></successor>',
                                       '<origin xyz="3 0 0"/></successor>')
    (files / 'robot.urdf').write_text(text)
    # 3 m less 0.35 m between the pins, 0.1 m of the crank and 0.4 m of the coupler.
    with pytest.raises(AssemblyError, match=(
            'four_bar cannot be assembled: pin stays open by 2.15 .*, these stay open by '
            'themselves, each moved by its own joints alone: pin by 2.15')):
        load_scene('robot.urdf')


def test_check_tells_loops_and_freedoms(files, capsys):
    output = done(capsys, 'check', 'robot.urdf')
    assert 'degrees of freedom    1 = 3 joints - 2 equations\n' in output
    assert '\nLoops: 1\n' in output
    assert '\n  left out, give them as effects of type actuator: limits of 1 drive(s)' in output


def test_import_writes_what_runs(files, capsys):
    assert main(['import', 'robot.urdf', '--output', 'my.yaml', '--scene', 'my_scene.yaml']) == 0
    assert capsys.readouterr().out == 'my.yaml: 3 bodies, 3 joints, 1 that close loops\n'
    mine, own = load_scene('my_scene.yaml'), load_scene('scene.yaml')
    assert mine.mechanism.bodies == own.mechanism.bodies
    assert mine.mechanism.cut_joints == own.mechanism.cut_joints
    assert Simulation(mine).closure < 1e-12
    assert main(['import', 'robot.urdf', '--output', 'my.yaml']) == 2
    assert '--output: my.yaml exists' in capsys.readouterr().err
