# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Key paths: every number of a scene can be reached, changed, and is named when it cannot."""

from closedloop_dynamics import load_scene, MechanismError, scene_names
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.scene.key_paths import changed, numbers, resolve
import pytest

from ..reference import cases


PLANAR = [name for name in scene_names() if load_scene(name).mechanism.planar]


@pytest.mark.parametrize('name', cases.only(
    [name for name in cases.CLASSES if name in PLANAR], PLANAR))
def test_every_number_can_be_reached_and_changed_alone(name):
    scene = load_scene(name)
    before = numbers(scene)
    assert len(before) > 30
    for key, value in before.items():
        # Other numbers follow from a parameter.
        if value is None or key.startswith('parameters'):
            continue
        new = value * 1.0001 + (1e-9 if key.startswith('initial') else 0.0)
        try:
            after = numbers(changed(scene, {resolve(scene, key): new}))
        except (FieldError, MechanismError) as error:
            # An angle that its type of joint has not, a mass of what has none.
            assert key.split('.')[-1] in str(error)
            continue
        assert after.pop(key) == new
        assert after == {other: before[other] for other in before if other != key}


def test_several_changes_at_once_and_brackets():
    scene = load_scene('three_rrr')
    new = changed(scene, {
        resolve(scene, 'mechanism.bodies.platform.center_of_mass[1]'): 0.2,
        resolve(scene, 'mechanism.bodies.platform.mass'): 9,
        resolve(scene, 'initial.velocity.theta_6'): 1.5})
    platform = next(body for body in new.mechanism.bodies if body.name == 'platform')
    assert (platform.mass, platform.center_of_mass) == (9.0, (0.2, 0.2))
    assert new.initial.velocity == (0.0, 0.0, 0.0, 0.0, 0.0, 1.5, 0.0)
    assert scene == load_scene('three_rrr')


@pytest.mark.parametrize('key, words', [
    ('mecanism.bodies.platform.mass', ["'mecanism'", "did you mean 'mechanism'?"]),
    ('mechanism.bodies.platfrom.mass', ['after mechanism.bodies', "did you mean 'platform'?"]),
    ('mechanism.bodies.platform.mas', ['center_of_mass', "did you mean 'mass'?"]),
    ('mechanism.bodies.platform', ['several', 'mass, center_of_mass, inertia']),
    ('mechanism.bodies.platform.mass.0', ['remove .0']),
    ('effects.gravity.acceleration.2', ['0, 1', "'2'"]),
    ('mechanism.joints.theta_1.type', ['position', "'type'"]),
    ('initial.velocity.theta_2', ['theta_1, theta_6, theta_7', "'theta_2'"]),
    ('', ["''"]),
])
def test_a_key_path_that_leads_nowhere_is_refused(key, words):
    with pytest.raises(FieldError) as error:
        resolve(load_scene('three_rrr'), key)
    for word in words:
        assert word in str(error.value)


@pytest.mark.parametrize('key, value, words', [
    ('mechanism.bodies.platform.mass', -1.0, ['bodies.platform.mass', 'positive', '-1']),
    ('method.step_size', 0.0, ['method.step_size', 'positive']),
    ('effects.gravity.acceleration.0', float('nan'), ['effects.gravity.acceleration', 'finite']),
])
def test_an_impossible_value_is_refused_by_name(key, value, words):
    scene = load_scene('three_rrr')
    with pytest.raises((FieldError, MechanismError)) as error:
        changed(scene, {resolve(scene, key): value})
    for word in words:
        assert word in str(error.value)
