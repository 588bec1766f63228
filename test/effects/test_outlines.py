# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Outlines of cams and Geneva wheels from their numbers: touched by what they were made for."""

import math

from closedloop_dynamics.effects.outlines import cam, geneva, LAWS, lift
from closedloop_dynamics.scene.loading import load_scene, SceneError
import numpy as np
import pytest

DEGREE = math.pi / 180.0
MOTION = [{'over': 120 * DEGREE, 'to': 0.012}, {'over': 60 * DEGREE},
          {'over': 120 * DEGREE, 'to': 0.0}, {'over': 60 * DEGREE}]
SCENE = """\
mechanism: %s
initial: {position: {%s}}
effects:
  outline: {type: body_contact, point: %s, other: axle, shape: curve, stiffness: 2.0e+6, %s}
"""


def read(tmp_path, mechanism, start, point, keys):
    path = tmp_path / 'scene.yaml'
    path.write_text(SCENE % (mechanism, start, point, keys))
    return load_scene(path).effects['outline']


def of_cam(tmp_path, keys):
    return read(
        tmp_path, 'cam_follower', 'cam_joint: 90 deg, follower_joint: 5 cm', 'roller', keys)


def distance(outline, places):
    """Return how far places, shape (n, 2), are from a closed polygon, shape (n,)."""
    starts = np.transpose(outline)
    sides = np.roll(starts, -1, axis=0) - starts
    away = places[:, None] - starts
    share = np.clip((away * sides).sum(axis=2) / (sides ** 2).sum(axis=1), 0.0, 1.0)
    return np.linalg.norm(away - share[..., None] * sides, axis=2).min(axis=1)


@pytest.mark.parametrize('law, speed, acceleration', [
    ('cycloid', 2.0, 2.0 * math.pi), ('3-4-5', 1.875, 10.0 / math.sqrt(3.0)),
    ('modified_sine', 3.0 * math.pi / (4.0 + math.pi) + math.pi / (4.0 + math.pi),
     4.0 * math.pi ** 2 / (4.0 + math.pi))])
def test_laws_have_the_peaks_of_the_books(law, speed, acceleration):
    u = np.linspace(0.0, 1.0, 4001)
    share = LAWS[law](u)
    rate = np.gradient(share, u)
    assert share[0] == pytest.approx(0.0, abs=1e-15) and share[-1] == pytest.approx(1.0)
    assert rate.max() == pytest.approx(speed, rel=1e-5)
    assert np.abs(np.gradient(rate, u)[3:-3]).max() == pytest.approx(acceleration, rel=1e-4)


@pytest.mark.parametrize('law', LAWS)
def test_a_roller_follows_the_law_of_its_cam(law):
    motion = [{**piece, 'law': law} if 'to' in piece else piece for piece in MOTION]
    angle = np.linspace(0.0, 2.0 * math.pi, 720)
    away = 0.05 + lift(motion, angle)
    centre = np.column_stack([away * np.cos(-angle), away * np.sin(-angle)])
    # Chords of the polygon lie less than a micrometre inside.
    gap = distance(cam(0.01, 0.04, motion, 2000), centre)
    assert np.abs(gap - 0.01).max() < 2e-6
    assert lift(motion, [30 * DEGREE])[0] == pytest.approx(0.012 * LAWS[law](np.array([0.25]))[0])


def test_the_shipped_cam_is_made_so(tmp_path):
    shipped = load_scene('cam_follower').effects['outline']
    x, y = cam(0.01, 0.04, MOTION, len(shipped.x))
    # It is the same one seen from behind.
    assert np.allclose(x, shipped.x, atol=1e-9) and np.allclose(-y, shipped.y, atol=1e-9)
    made = of_cam(tmp_path, 'radius: 1 cm, outline: {cam: {base: 40 mm, motion: [{over: 120 deg, '
                  'to: 12 mm}, {over: 60 deg}, {over: 120 deg, to: 0}, {over: 60 deg}]}}')
    assert len(made.x) == 180 and made.interpolation is None
    assert np.allclose(cam(0.01, 0.04, MOTION), (made.x, made.y), atol=1e-15)


def test_the_shipped_geneva_wheel_is_made_so(tmp_path):
    shipped = load_scene('geneva_drive').effects['outline']
    made = read(tmp_path, 'geneva_drive', 'driver_joint: -1.2, wheel_joint: 45 deg', 'pin',
                'radius: 6 mm, outline: {geneva: {slots: 4, distance: 100 mm, clearance: 0.02 mm, '
                'tip: 4 mm}}')
    assert made.interpolation == shipped.interpolation == 'linear'
    found = np.transpose([made.x, made.y])
    for place in np.transpose([shipped.x, shipped.y]):
        assert np.linalg.norm(found - place, axis=1).min() < 1e-9


@pytest.mark.parametrize('slots', [3, 4, 5, 8])
def test_a_pin_goes_through_the_slots_of_its_wheel(slots):
    apart, radius, clearance, half = 0.1, 0.004, 2e-5, math.pi / slots
    outline = geneva(radius, slots, apart, clearance)
    crank = apart * math.sin(half)
    # While the driver turns through pi - 2 pi / slots, of which the wheel turns 2 pi / slots.
    turn = np.linspace(-1.0, 1.0, 201) * (0.5 * math.pi - half) * 0.9
    pin = np.column_stack([apart - crank * np.cos(turn), crank * np.sin(turn)])
    wheel = np.arctan2(pin[:, 1], pin[:, 0])
    length = np.linalg.norm(pin, axis=1)
    seen = np.column_stack([length, 0.0 * length])
    assert np.ptp(wheel) < 2.0 * half
    # Half a micrometre is what its edge is long between points.
    assert distance(outline, seen).min() > radius + 0.5 * clearance


@pytest.mark.parametrize('keys, words', [
    ('outline: {}', 'effects.outline.outline: expected one of cam, geneva'),
    ('outline: {disc: {}}', "expected one of the keys cam, geneva, got the unknown key 'disc'"),
    ('outline: {geneva: {slots: 2.5, distance: 1}}', 'slots: expected a whole number from 3'),
    ('radius: 5 cm, outline: {geneva: {slots: 5, distance: 0.1}}',
     'outline.geneva: expected a pin and tips that leave room for a locking disc'),
    ('x: [1], outline: {geneva: {slots: 5, distance: 0.1}}', 'expected this key or x, got both'),
    ('outline: {cam: {base: 0.1, motion: [{over: 90 deg, to: 0.1}]}}',
     'expected pieces that are a whole turn together'),
    ('outline: {cam: {base: 0.1, motion: [{over: 360 deg, law: cycloid}]}}',
     'motion[0].to: expected a lift to rise or fall to'),
    ('outline: {cam: {base: 0.1, motion: [{over: 360 deg, to: 1, law: sine}]}}',
     'law: expected one of cycloid, 3-4-5, modified_sine')])
def test_an_outline_that_cannot_be_is_refused(tmp_path, keys, words):
    with pytest.raises(SceneError) as caught:
        of_cam(tmp_path, keys)
    assert words in str(caught.value)
