# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The shipped mechanisms are those of the theory, and their scenes start closed.

The cut equations of the scraper, the leg and the 3-RRR are written out by hand (psi = p_A - p_B,
with the absolute angles alpha_i) and compared with the twin's at random coordinates.
"""

from closedloop_dynamics.scene.loading import load_scene
import numpy as np
import pytest

from ..reference.dense import closure
from ..reference.states import assemble
from ..reference.trees import body_frames, placed

# Bodies, equations, degrees of freedom, largest closure error of the start as given [m]
# (the angles of the three_rrr are published ones, see its scene).
SCENES = {
    'carpet_scraper': (7, 6, 1, 5e-4),
    'four_bar': (3, 2, 1, 1e-4),
    'hoeken_pantograph_leg': (7, 6, 1, 1e-4),
    'slider_crank': (3, 2, 1, 1e-4),
    'three_rrr': (7, 4, 3, 9.5e-3),
}
HOEKEN = {
    'carpet_scraper': {
        'a1': 0.038, 'a2': 0.1152, 'a3': 0.1152, 'a39': 0.1152, 'a46': 0.39, 'a56': 0.26,
        'a97': 0.26, 'a59': 0.13, 'a67': 0.13, 'a6': 0.39,
        'O1': (0.0, 0.0), 'O2': (-0.0895, 0.0), 'O4': (-0.0895, 0.40),
        'masses': (1.5, 3.0, 5.0, 3.0, 1.0, 3.0, 2.0)},
    'hoeken_pantograph_leg': {
        'a1': 0.025, 'a2': 0.0625, 'a3': 0.0625, 'a39': 0.0625, 'a46': 0.2, 'a56': 0.15,
        'a97': 0.15, 'a59': 0.075, 'a67': 0.075, 'a6': 0.3,
        'O1': (0.0, 0.0), 'O2': (0.05, 0.0), 'O4': (0.07, -0.03),
        'masses': (0.0047, 0.0117, 0.0234, 0.0374, 0.014, 0.0562, 0.0281)},
}


def e(angle):
    return np.array([np.cos(angle), np.sin(angle)])


def closed(scene, held=None, guess=None):
    """Return the coordinates that close the loops with those in hold as given."""
    q = np.array(scene.initial.position if guess is None else guess)
    if held is not None:
        q[[scene.mechanism.joint_names.index(joint) for joint in scene.initial.hold]] = held
    return assemble(scene.mechanism, q, scene.initial.hold)


def named_point(scene, q, name):
    point = next(point for point in scene.mechanism.points if point.name == name)
    return placed(body_frames(scene.mechanism, q)[point.body], point.position)


def hoeken_closure(p, q):
    """Return psi of the three cuts of the scraper and of the leg."""
    t1, t2, t3, t4, t5, t6, t7 = q
    alpha_2, alpha_3 = t2, np.pi + t2 + t3
    p_9 = p['O2'] + p['a2'] * e(alpha_2) - p['a39'] * e(alpha_3)
    elbow = p['O4'] + (p['a46'] - p['a56']) * e(t4) + p['a59'] * e(t4 + t5)
    return np.concatenate([
        p['O1'] + p['a1'] * e(t1) - (p['O2'] + p['a2'] * e(alpha_2) + p['a3'] * e(alpha_3)),
        p_9 - elbow,
        p['O4'] + p['a46'] * e(t4) + p['a67'] * e(t4 + t6) + p['a97'] * e(t4 + t6 + t7) - elbow])


def three_rrr_closure(q):
    """Return psi of the two cuts of the 3-RRR, both elbows."""
    t1, t2, t3, t4, t5, t6, t7 = q
    a, b, d = 0.4, 0.6, 0.4
    alpha_7 = t1 + t2 + t3
    alpha_5 = alpha_7 + t4 - np.pi
    alpha_6 = alpha_7 + t5 - (np.pi - np.pi / 3)
    leg = a * e(t1) + b * e(t1 + t2)
    return np.concatenate([
        leg + d * e(alpha_7) - b * e(alpha_5) - ((1.0, 0.0) + a * e(t6)),
        leg + d * e(alpha_7 + np.pi / 3) - b * e(alpha_6) - ((0.5, np.sqrt(3) / 2) + a * e(t7))])


@pytest.mark.parametrize('name', SCENES)
def test_counts_and_start(name):
    bodies, equations, freedoms, error = SCENES[name]
    scene = load_scene(name)
    mechanism = scene.mechanism
    assert mechanism.name == scene.name == name
    assert len(mechanism.bodies) == len(mechanism.joints) == bodies
    assert mechanism.number_of_equations == equations
    assert bodies - equations == freedoms == len(scene.initial.hold)
    assert set(scene.initial.hold) == set(mechanism.actuated_joints)
    assert list(scene.effects) == ['gravity']
    assert scene.effects['gravity'].acceleration == (0.0, -9.81)
    residual = np.abs(closure(mechanism, scene.initial.position)).max()
    assert residual <= error
    assert np.abs(closure(mechanism, closed(scene))).max() < 1e-12


@pytest.mark.parametrize('name', HOEKEN)
def test_hoeken_pantograph_is_that_of_the_theory(name):
    p, mechanism = HOEKEN[name], load_scene(name).mechanism
    assert mechanism.joint_names == tuple(f'theta_{i}' for i in range(1, 8))
    assert [cut.name for cut in mechanism.cut_joints] == ['cut_1', 'cut_2', 'cut_3']
    assert mechanism.actuated_joints == ('theta_1',)
    rng = np.random.default_rng(1)
    for q in rng.uniform(-np.pi, np.pi, (20, 7)):
        np.testing.assert_allclose(closure(mechanism, q), hoeken_closure(p, q), atol=1e-14)
    lengths = [p['a1'], p['a2'], p['a3'] + p['a39'], p['a46'], p['a59'], p['a6'], p['a97']]
    for body, mass, length in zip(mechanism.bodies, p['masses'], lengths):
        middle = 0.0 if body.name == 'coupler' else length / 2
        assert body.mass == mass
        assert body.center_of_mass == pytest.approx((middle, 0.0), abs=1e-16)
        assert body.inertia == pytest.approx(mass * length**2 / 12, rel=1e-15)


def test_three_rrr_is_that_of_the_theory():
    mechanism = load_scene('three_rrr').mechanism
    assert mechanism.joint_names == tuple(f'theta_{i}' for i in range(1, 8))
    assert [cut.name for cut in mechanism.cut_joints] == ['cut_1', 'cut_2']
    assert mechanism.actuated_joints == ('theta_1', 'theta_6', 'theta_7')
    rng = np.random.default_rng(2)
    for q in rng.uniform(-np.pi, np.pi, (20, 7)):
        np.testing.assert_allclose(closure(mechanism, q), three_rrr_closure(q), atol=1e-14)
    for body in mechanism.bodies:
        kind = body.name.partition('_')[0]
        mass, length = {'proximal': (3.0, 0.4), 'distal': (4.0, 0.6), 'platform': (8.0, 0.4)}[kind]
        assert body.mass == mass
        if kind != 'platform':
            assert np.hypot(*body.center_of_mass) == pytest.approx(length / 2, rel=1e-15)
            assert body.inertia == pytest.approx(mass * length**2 / 12, rel=1e-15)
        else:
            assert (body.center_of_mass, body.inertia) == ((0.2, 0.1155), 0.16)


def test_three_rrr_start_is_open_as_published():
    """The loops are open by 9.5 mm; assembly moves leg 1 and the elbows by 0.014 rad at most."""
    scene = load_scene('three_rrr')
    start, end = np.array(scene.initial.position), closed(scene)
    assert np.abs(closure(scene.mechanism, start)).max() == pytest.approx(9.5e-3, abs=5e-5)

    def published(q):
        alpha_7 = q[:3].sum()
        return np.array([q[1], q[2], alpha_7 + q[3] - np.pi - q[5],
                         alpha_7 + q[4] - 2 * np.pi / 3 - q[6]])
    np.testing.assert_allclose(published(start)[2:], (-2.0939, -0.9869), atol=1e-4)
    assert np.abs(published(end) - published(start)).max() == pytest.approx(0.014, abs=5e-4)
    np.testing.assert_array_equal(end[[0, 5, 6]], start[[0, 5, 6]])


@pytest.mark.parametrize('name, factor', [('carpet_scraper', 3), ('hoeken_pantograph_leg', 4)])
def test_pantograph_magnifies_p9_about_o4(name, factor):
    scene = load_scene(name)
    o_4 = np.array(HOEKEN[name]['O4'])
    tool = {'carpet_scraper': 'tool', 'hoeken_pantograph_leg': 'foot'}[name]
    q = scene.initial.position
    for crank in np.linspace(0.0, 2 * np.pi, 13):
        q = closed(scene, crank, q)
        np.testing.assert_allclose(named_point(scene, q, tool) - o_4,
                                   factor * (named_point(scene, q, 'p9') - o_4), atol=1e-10)


def test_scraper_works_on_a_straight_stroke():
    scene = load_scene('carpet_scraper')
    q, path = scene.initial.position, []
    for crank in np.linspace(0.0, 2 * np.pi, 181):
        q = closed(scene, crank, q)
        path.append(named_point(scene, q, 'tool'))
    path = np.array(path)
    stroke = path[path[:, 1] < -0.2223]
    assert stroke[:, 1].min() == pytest.approx(-0.2243, abs=5e-5)
    assert stroke[:, 0].min() == pytest.approx(-0.343, abs=0.01)
    assert stroke[:, 0].max() == pytest.approx(0.164, abs=0.01)
    assert len(stroke) / len(path) == pytest.approx(0.53, abs=0.02)
    assert path[:, 1].max() == pytest.approx(-0.126, abs=5e-4)


def test_platform_points():
    mechanism = load_scene('three_rrr').mechanism
    points = {point.name: point for point in mechanism.points}
    assert points['platform_center'].position == mechanism.bodies[2].center_of_mass
    corners = np.array([points[f'corner_{i}'].position for i in (1, 2, 3)])
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=0), axis=1)
    np.testing.assert_allclose(sides, 0.4, rtol=1e-15)


@pytest.mark.parametrize('name', ['four_bar', 'slider_crank'])
def test_crank_of_the_examples_turns_fully(name):
    scene = load_scene(name)
    q = scene.initial.position
    for crank in np.linspace(1.0472, 1.0472 + 2 * np.pi, 73):
        q = closed(scene, crank, q)
        assert np.abs(closure(scene.mechanism, q)).max() < 1e-12
    np.testing.assert_allclose(q[1:], closed(scene)[1:] + [-2 * np.pi, 0.0], atol=1e-9)
