# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Descriptions for a page of shapes, springs, cables and contacts, and the arrows of these."""

from dataclasses import fields, replace
import struct
import sys

from closedloop_dynamics import Body, Joint, load_scene, Mechanism, Point
from closedloop_dynamics.effects.registry import BodyContact, Contact, effect_type, ExternalForce
from closedloop_dynamics.mechanism.mechanism import Visual
from closedloop_dynamics.view import meshes
from closedloop_dynamics.view.columns import motion_columns, SimulationRows
from closedloop_dynamics.view.description import describe
from closedloop_dynamics.view.effect_shapes import normal_of, outline_of
import numpy as np
import pytest

from ..reference.scenes import simulated


def described(name):
    scene = load_scene(name)
    return describe(scene.mechanism, motion_columns(scene.mechanism), scene.effects)


def body(reported, name):
    return next(body for body in reported['bodies'] if body['name'] == name)


def test_bodies_with_shapes_are_drawn_as_these():
    reported = described('excavator_arm')
    box, = body(reported, 'rocker')['shapes']
    assert (box['kind'], box['size'], box['center']) == (
        'box', [0.62, 0.3, 0.12], [0.31, 0.0, 0.0])
    rod, = body(reported, 'boom_rod')['shapes']
    assert rod['kind'] == 'cylinder' and rod['radius'] == 0.045
    np.testing.assert_allclose(rod['to'], [-1.4, 0.0, 0.0], atol=1e-15)
    np.testing.assert_allclose(rod['from'], [0.0, 0.0, 0.0], atol=1e-15)
    # Others through their joints and points.
    assert {'bar', 'faces'} == {shape['kind'] for shape in body(reported, 'boom')['shapes']}


def test_the_ground_is_drawn_and_shapes_have_colors_of_their_own():
    mechanism = load_scene('four_bar').mechanism
    drawn = (Visual('box', (1.0, 2.0, 3.0), color=(1.0, 0.5, 0.0)), Visual('sphere', (0.1,)))
    reported = describe(replace(mechanism, ground_visual=drawn), motion_columns(mechanism))
    assert [shape.get('color') for shape in reported['ground']] == ['#ff8000', None]
    assert describe(mechanism, motion_columns(mechanism))['ground'] == []


def test_springs_and_cables_are_lines_between_their_points():
    spring, tyre = described('double_wishbone')['lines']
    assert (spring['kind'], spring['name'], tyre['name']) == ('spring', 'spring', 'tyre')
    assert spring['ends'] == [[0, [0.0, 0.55, 0.25]], [1, [0.0, 0.28, 0.0]]]
    rope, = described('rope_hoist')['lines']
    assert rope['kind'] == 'cable' and rope['radii'] == [0.0, 0.1, -0.1, 0.0]
    assert [number for number, _ in rope['ends']] == [-1, 0, -1, 1]


def test_an_outline_leads_the_roller_that_it_touches():
    reported = described('cam_follower')
    cam, roller = sorted(reported['wires'], key=lambda wire: wire['body'])
    np.testing.assert_allclose(cam['places'][0], cam['places'][-1], atol=1e-15)
    radii = np.hypot(*np.array(cam['places'])[:, :2].T)
    assert radii.min() == pytest.approx(0.04, abs=1e-4)
    assert radii.max() == pytest.approx(0.052, abs=1e-4)
    contact = load_scene('cam_follower').effects['outline']
    outline = outline_of(contact)
    for angle in np.linspace(0.0, 6.0, 13):
        place = 0.07 * np.array([np.cos(angle), np.sin(angle)])
        normal = normal_of(contact, place, outline)
        # Outwards, and no more aslant than the cam rises.
        assert normal @ place / 0.07 > 0.8


def sliding(normal=(0.0, 0.6, 0.8)):
    """Return a block that is pressed on a slope in space and slides along it."""
    mechanism = Mechanism('block', (Body('block', 2.0, (0.0, 0.0, 0.0), (0.1, 0.1, 0.1)),), (
        Joint('free', 'free', 'ground', 'block', (0.0, 0.0, 0.0)),), (),
        (Point('foot', 'block', (0.0, 0.0, 0.0)),))
    position = np.array([*(-0.01 * np.array(normal)), 0.0, 0.0, 0.0, 1.0])
    effects = {
        'slope': Contact(point='foot', origin=(0.0, 0.0, 0.0), normal=normal, stiffness=1e3,
                         friction=0.5, slip_velocity=1e-4),
        'push': ExternalForce(point='foot', force=(1.0, 0.0, 0.0), axes='body')}
    velocity = np.array([0.3, 0.4, -0.3, 0.0, 0.0, 0.0])
    return mechanism, effects, position, velocity


def test_a_contact_in_space_has_arrows_along_its_normal_and_against_the_sliding():
    mechanism, effects, position, velocity = sliding()
    simulation = simulated(mechanism, position.tolist(), velocity.tolist(), effects)
    rows = SimulationRows(simulation)
    assert rows.columns.loads == [
        {'name': 'slope', 'kind': 'normal'}, {'name': 'slope', 'kind': 'friction'},
        {'name': 'push', 'kind': 'force'}]
    layout, row = rows.columns.layout, rows.row()
    first = layout['columns']['loads']
    normal, friction, push = row[first:first + 18].reshape(3, 6)[:, 3:]
    np.testing.assert_allclose(normal, 10.0 * np.array([0.0, 0.6, 0.8]), rtol=1e-5)
    # The coefficient times the normal force, against the velocity, which is along the slope.
    sliding_along = velocity[:3] / np.linalg.norm(velocity[:3])
    np.testing.assert_allclose(friction, -5.0 * sliding_along, atol=1e-4)
    np.testing.assert_allclose(push, [1.0, 0.0, 0.0], atol=1e-6)
    # What accelerates the block is the sum of the arrows.
    np.testing.assert_allclose(
        2.0 * simulation.acceleration[:3], normal + friction + push, rtol=1e-4)
    plots = [(plot['group'], plot['name']) for plot in layout['plots']]
    assert row[layout['columns']['plots'] + plots.index(('force of effects', 'slope, normal'))] \
        == pytest.approx(10.0)
    surface, = describe(mechanism, rows.columns, effects)['surfaces']
    assert surface['normal'] == [0.0, 0.6, 0.8]


@pytest.mark.parametrize('shape', [
    {'shape': 'plane', 'normal': (0.0, 0.6, 0.8)}, {'shape': 'sphere', 'other_radius': 0.3},
    {'shape': 'cylinder', 'other_radius': 0.3, 'axis': (1.0, 0.0, 0.0)}])
def test_a_contact_of_bodies_in_space_has_arrows_along_its_normal_and_against_the_sliding(shape):
    mechanism = Mechanism(
        'balls', (Body('ball', 2.0, (0.0, 0.0, 0.0), (0.1, 0.2, 0.3)),
                  Body('other', 3.0, (0.1, 0.0, 0.0), (0.3, 0.2, 0.2))),
        (Joint('free', 'free', 'ground', 'ball', (0.0, 0.0, 0.0)),
         Joint('other_free', 'free', 'ground', 'other', (0.0, 0.0, 0.0))), (),
        (Point('center', 'ball', (0.0, 0.0, 0.0)), Point('base', 'other', (0.1, 0.0, 0.0))))
    effects = {'touch': BodyContact(
        point='center', other='base', stiffness=1e3, radius=0.1, friction=0.5,
        slip_velocity=1e-4, **shape)}
    reach = 0.39 if 'other_radius' in shape else 0.09
    velocity = np.array([0.3, 0.4, -0.3, 1.0, -2.0, 0.5, -0.2, 0.1, 0.3, -0.4, 0.6, 1.5])
    # Both are turned by no angle; the other one's point is at 0.1, 0, 0.
    position = np.array([0.1, *(reach * np.array([0.6, 0.8])), 0.0, 0.0, 0.0, 1.0,
                         *np.zeros(6), 1.0])
    simulation = simulated(mechanism, position.tolist(), velocity.tolist(), effects)
    rows = SimulationRows(simulation)
    assert [load['kind'] for load in rows.columns.loads] == ['normal', 'friction']
    first = rows.columns.layout['columns']['loads']
    (foot, normal), (_, friction) = rows.row()[first:first + 12].reshape(2, 2, 3)
    np.testing.assert_allclose(normal, 10.0 * np.array([0.0, 0.6, 0.8]), rtol=1e-5, atol=1e-5)
    assert friction @ normal == pytest.approx(0.0, abs=1e-4)
    assert np.linalg.norm(friction) == pytest.approx(5.0, rel=1e-4)
    # What accelerates the ball, and turns it, are the arrows, where their feet are.
    np.testing.assert_allclose(
        2.0 * simulation.acceleration[:3], normal + friction, atol=1e-4)
    turning = np.cross(foot - position[:3], friction)
    spin = velocity[3:6]
    np.testing.assert_allclose(
        np.array([0.1, 0.2, 0.3]) * simulation.acceleration[3:6]
        + np.cross(spin, np.array([0.1, 0.2, 0.3]) * spin), turning, atol=1e-4)


def stl(path, triangles):
    with open(path, 'wb') as file:
        file.write(bytes(80) + struct.pack('<I', len(triangles)))
        for triangle in triangles:
            file.write(struct.pack('<12fH', 0, 0, 0, *np.ravel(triangle), 0))


def globe(rings):
    """Return the triangles of a sphere of radius one."""
    u, v = np.meshgrid(np.linspace(0, np.pi, rings), np.linspace(0, 2 * np.pi, 2 * rings),
                       indexing='ij')
    places = np.stack([np.sin(u) * np.cos(v), np.sin(u) * np.sin(v), np.cos(u)], axis=-1)
    corners = places[:-1, :-1], places[1:, :-1], places[1:, 1:], places[:-1, 1:]
    return np.concatenate([np.stack([corners[k] for k in face], axis=2).reshape(-1, 3, 3)
                           for face in ((0, 1, 2), (0, 2, 3))])


def with_mesh(path, scale=(1.0, 1.0, 1.0)):
    mechanism = load_scene('delta_robot').mechanism
    first = replace(mechanism.bodies[0], visual=(Visual(
        'mesh', scale, (0.0, 0.0, 0.5), (0.0, 0.0, 0.0, 1.0), str(path)),))
    return replace(mechanism, bodies=(first, *mechanism.bodies[1:]))


def test_meshes_are_shown_with_fewer_triangles(tmp_path):
    pytest.importorskip('trimesh')
    stl(tmp_path / 'globe.stl', globe(80))
    mechanism = with_mesh(tmp_path / 'globe.stl', (2.0, 2.0, 2.0))
    reported = describe(mechanism, motion_columns(mechanism))
    mesh, = reported['bodies'][0]['shapes']
    assert reported['missing'] == []
    assert 1000 < len(mesh['triangles']) <= meshes.MOST_TRIANGLES < len(globe(80))
    away = np.linalg.norm(np.array(mesh['points']) - [0.0, 0.0, 0.5], axis=1)
    assert 1.9 < away.min() and away.max() < 2.01
    stl(tmp_path / 'globe.stl', globe(8))
    few = describe(mechanism, motion_columns(mechanism))['bodies'][0]['shapes'][0]
    # Without those at the poles, which are none.
    assert len(few['triangles']) <= len(globe(8))


@pytest.mark.parametrize('name, content, problem', [
    ('none.stl', None, 'No such file'), ('mesh.step', b'', 'expected a mesh (.stl'),
    ('mesh.stl', b'nonsense', 'expected triangles'),
    ('mesh.obj', b'', 'expected')])
def test_a_mesh_that_is_missing_is_reported_and_drawn_as_lines(tmp_path, name, content, problem):
    pytest.importorskip('trimesh')
    if content is not None:
        (tmp_path / name).write_bytes(content)
    mechanism = with_mesh(tmp_path / name)
    reported = describe(mechanism, motion_columns(mechanism))
    named, = reported['missing']
    assert named.startswith(f'{mechanism.bodies[0].name}: {tmp_path / name}: ')
    assert problem in named
    bare = replace(mechanism, bodies=(
        replace(mechanism.bodies[0], visual=()), *mechanism.bodies[1:]))
    assert reported['bodies'][0]['shapes'] == describe(
        bare, motion_columns(bare))['bodies'][0]['shapes']


def test_without_trimesh_meshes_say_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, 'trimesh', None)
    stl(tmp_path / 'globe.stl', globe(4))
    with pytest.raises(meshes.MeshError, match='pip install trimesh'):
        meshes.read_mesh(tmp_path / 'globe.stl')


def test_parameters_of_effects_have_their_meaning_and_unit():
    meanings = described('slider_crank_end_stop')['meanings']
    assert meanings['end_stop']['stiffness']['unit'].startswith('N')
    for effect in load_scene('slider_crank_end_stop').effects.values():
        kind = meanings[effect_type(effect)]
        assert set(kind) == {field.name for field in fields(effect)}
