# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A scene that went through text is the same scene."""

from dataclasses import replace
import json

from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.scene.loading import load_scene, scene_names, SceneError
from closedloop_dynamics.scene.text import read_scene_text, scene_data, scene_text, write_scene
import pytest


@pytest.mark.parametrize('name', scene_names())
def test_shipped_scenes_come_back(name):
    scene = load_scene(name)
    off = tuple(name for name, record in scene.effects.items() if record.motion(name) is None)[:1]
    back, facts = read_scene_text(scene_text(scene, switched_off=off, simulated_time=0.1 + 0.2))
    assert back == replace(scene, path=None, switched_off=off)
    assert facts == {'simulated_time': 0.1 + 0.2}


@pytest.mark.parametrize('name', scene_names())
def test_shipped_scenes_come_back_as_data_and_from_one_file(name, tmp_path):
    scene, path = load_scene(name), tmp_path / f'{name}.yaml'
    write_scene(scene, path)
    for back in (load_scene(scene_data(scene)), load_scene(path)):
        assert back == replace(scene, name=back.name, path=back.path)
        assert back.mechanism.ground_visual == scene.mechanism.ground_visual
    assert back.name == name


def test_changed_effects_and_methods_are_reported():
    scene = load_scene('three_rrr')
    changed = replace(scene.effects['gravity'], acceleration=(1e-7, -1.62))
    slower = replace(scene, method=replace(scene.method, step_size=1e-5),
                     description='Gr\u00fc\u00dfe, "quoted" \\ \U0001f600')
    back, _ = read_scene_text(scene_text(slower, {'gravity': changed}))
    assert back.effects == {'gravity': changed}
    assert back.description == slower.description
    assert (back.mechanism, back.initial, back.method) == (
        slower.mechanism, slower.initial, slower.method)


@pytest.mark.parametrize('text', ['', 'mechanism: three_rrr', '[]', '{}', 'null'])
def test_other_text_is_refused(text):
    with pytest.raises(SceneError, match='text of a scene'):
        read_scene_text(text)


def test_a_newer_format_is_named():
    data = json.loads(scene_text(load_scene('four_bar')))
    with pytest.raises(SceneError, match='format 1, got 2'):
        read_scene_text(json.dumps({**data, 'format': 2}))
    data['scene']['initial'] = {}
    with pytest.raises(SceneError, match='initial'):
        read_scene_text(json.dumps(data))


def test_turns_of_cut_joints_in_space_travel():
    scene = load_scene('bennett')
    cut, = scene.mechanism.turning_cuts
    turned = replace(scene, initial=replace(scene.initial, turned={cut: 12.0}))
    assert read_scene_text(scene_text(turned))[0].initial == turned.initial
    with pytest.raises(FieldError, match='initial.position.wheel: .*that turn in space'):
        replace(scene, initial=replace(scene.initial, turned={'wheel': 1.0}))
    assert load_scene('four_bar').mechanism.turning_cuts == ()
