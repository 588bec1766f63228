# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Bodies that are described by their shape: the textbook's inertias, and integrals over points."""

import math

from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.reader import read_mechanism
from closedloop_dynamics.mechanism.shapes import as_data, visuals, with_shape
import numpy as np
import pytest


def derived(shape, spatial=True, **beside):
    """Return mass, centre of mass and inertia matrix (or moment) of a shape."""
    values = with_shape({'shape': shape, **beside}, spatial)
    inertia = values['inertia']
    if spatial:
        xx, yy, zz, xy, xz, yz = inertia
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return values['mass'], np.array(values['center_of_mass']), inertia


def test_shapes_have_the_inertias_of_textbooks():
    mass, center, inertia = derived({'box': {'size': [0.1, 0.2, 0.3]}}, density=1000.0)
    assert mass == pytest.approx(6.0) and not center.any()
    assert np.diag(inertia) == pytest.approx([0.065, 0.05, 0.025])
    mass, _, inertia = derived({'sphere': {'radius': 0.1}}, density=3.0 / (4.0 * math.pi))
    assert mass == pytest.approx(1e-3)
    assert inertia == pytest.approx(0.4 * 1e-3 * 0.01 * np.eye(3))
    rod = {'from': [0.1, 0.0, 0.0], 'to': [0.1, 0.4, 0.0], 'radius': 0.01}
    mass, center, inertia = derived({'rod': rod}, mass=0.8)
    assert center == pytest.approx([0.1, 0.2, 0.0])
    along, across = 0.5 * 0.8 * 1e-4, 0.8 * (3e-4 + 0.16) / 12.0
    assert inertia == pytest.approx(np.diag([across, along, across]))
    # The same as a cylinder, and as a thin one.
    _, _, same = derived({'cylinder': {'radius': 0.01, 'length': 0.4, 'axis': [0, -2, 0],
                                       'center': [0.1, 0.2, 0.0]}}, mass=0.8)
    assert same == pytest.approx(inertia)
    _, _, thin = derived({'rod': {'to': [0, 0.4, 0]}}, mass=0.8)
    assert thin == pytest.approx(np.diag([0.8 * 0.16 / 12.0, 0.0, 0.8 * 0.16 / 12.0]))


@pytest.mark.parametrize('shape, inside', [
    ({'box': {'size': [0.3, 0.2, 0.1], 'orientation': {'rpy': [0.3, -0.4, 0.5]}}}, 'box'),
    ({'cylinder': {'radius': 0.1, 'length': 0.3, 'axis': [1, 2, 2]}}, 'cylinder')])
def test_turned_shapes_are_their_integrals(shape, inside):
    rng = np.random.default_rng(3)
    points = rng.uniform(-0.25, 0.25, (400_000, 3))
    if inside == 'box':
        (cr, cp, cy), (sr, sp, sy) = np.cos([0.3, -0.4, 0.5]), np.sin([0.3, -0.4, 0.5])
        turned = (np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]])
                  @ np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
                  @ np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]]))
        kept = (np.abs(points @ turned) <= [0.15, 0.1, 0.05]).all(axis=1)
    else:
        along = points @ np.array([1.0, 2.0, 2.0]) / 3.0
        kept = (np.abs(along) <= 0.15) & (np.square(points).sum(axis=1) - along ** 2 <= 0.01)
    points = points[kept]
    squares = np.square(points).sum(axis=1)
    wanted = squares.mean() * np.eye(3) - points.T @ points / len(points)
    mass, _, inertia = derived(shape, density=100.0)
    assert mass == pytest.approx(100.0 * 0.125 * kept.mean(), rel=0.02)
    # Random points: three standard deviations.
    assert inertia / mass == pytest.approx(wanted, abs=0.01 * wanted.max())


def test_shapes_of_the_plane_turn_about_z():
    mass, center, inertia = derived({'rod': {'to': [0.3, 0.4]}}, spatial=False, mass=1.2)
    assert (mass, inertia) == pytest.approx((1.2, 0.025)) and tuple(center) == (0.15, 0.2)
    mass, center, inertia = derived(
        {'cylinder': {'radius': 0.2, 'length': 0.01, 'axis': [0, 0, 1], 'center': [0.5, 0]}},
        spatial=False, density=7800)
    assert inertia == pytest.approx(0.5 * mass * 0.04) and tuple(center) == (0.5, 0.0)


@pytest.mark.parametrize('values, words', [
    ({'shape': {'box': {'size': [1, 2, 3]}}, 'mass': 1.0, 'inertia': [1, 1, 1]},
     'inertia: expected either shape or inertia, which follows from the shape, got both'),
    ({'shape': {'sphere': {'radius': 1}}, 'mass': 1.0, 'center_of_mass': [0, 0, 0]},
     'center_of_mass: expected either shape or center_of_mass'),
    ({'shape': {'sphere': {'radius': 1}}}, 'mass: expected either mass or density with a shape'),
    ({'shape': {'sphere': {'radius': 1}}, 'mass': 1.0, 'density': 1.0}, 'got both'),
    ({'density': 1.0}, 'density: expected a density only with a shape'),
    ({'shape': {'ball': {'radius': 1}}, 'mass': 1.0},
     'shape: expected a mapping with one of box, cylinder, sphere, rod, got one with ball'),
    ({'shape': 'box', 'mass': 1.0}, "shape: expected a mapping .* got the text 'box'"),
    ({'shape': {'sphere': {'radius': 0}}, 'mass': 1.0},
     'shape.sphere.radius: expected a positive number, got 0'),
    ({'shape': {'sphere': {'diameter': 1}}, 'mass': 1.0},
     'shape.sphere.diameter: expected one of the keys radius, center, got the unknown key'),
    ({'shape': {'box': {'size': [1, 0, 3]}}, 'mass': 1.0}, r'shape.box.size\[1\]: expected a pos'),
    ({'shape': {'cylinder': {'radius': 1, 'length': 1, 'axis': [0, 0, 0]}}, 'mass': 1.0},
     'shape.cylinder.axis: expected a direction'),
    ({'shape': {'rod': {'to': [0, 0, 0]}}, 'mass': 1.0}, 'shape.rod.to: expected another place'),
    ({'shape': {'rod': {'to': [1, 0, 0]}}, 'density': 1.0},
     r'shape.rod: expected a volume above zero with density, got none \(a rod needs a radius'),
    *(({'shape': shape, key: 1.0}, 'shape.*: expected a size whose volume and inertia are finite')
      for key, shape in [
          ('mass', {'sphere': {'radius': 1e308}}), ('density', {'sphere': {'radius': 1e200}}),
          ('mass', {'rod': {'to': [1, 0, 0], 'radius': 1e155}}),
          ('density', {'cylinder': {'radius': 1e308, 'length': 1, 'axis': [0, 0, 1]}}),
          ('mass', {'box': {'size': [1e308, 1, 1]}})]),
    ({'shape': {'sphere': {'radius': 1e-200}}, 'density': 1.0},
     'shape.sphere: expected a volume above zero with density, got none$'),
    ({'shape': {'sphere': {'radius': 1}}, 'massless': True}, 'either massless: true or a shape'),
    ({'shape': {'sphere': {'radius': 1}}, 'density': -1}, 'density: expected a positive number')])
def test_mistakes_in_shapes_are_named(values, words):
    with pytest.raises(FieldError, match=words):
        with_shape(values, True)


def test_a_body_is_drawn_as_its_shape_unless_a_visual_says_otherwise():
    rod = {'rod': {'from': [0.1, 0.0, 0.0], 'to': [0.1, 0.4, 0.0], 'radius': 0.01}}
    drawn, = with_shape({'shape': rod, 'mass': 1.0}, True)['visual']
    assert (drawn.kind, drawn.size, drawn.center) == ('cylinder', (0.01, 0.4), (0.1, 0.2, 0.0))
    # The turn leads from z to the rod's direction.
    x, y, z, w = drawn.orientation
    axis = [2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)]
    assert axis == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
    ball = visuals([{'sphere': {'radius': 0.2}}], True)
    assert with_shape({'shape': rod, 'mass': 1.0, 'visual': ball}, True)['visual'] == ball


@pytest.mark.parametrize('spatial', [True, False])
def test_what_is_drawn_is_read_again_as_it_was(spatial):
    place = [0.1, 0.2, 0.3][:3 if spatial else 2]
    shapes = visuals([
        {'box': {'size': [1, 2, 3], 'center': place, 'orientation': {'rpy': [0.1, 0.2, 0.3]}}},
        {'cylinder': {'radius': 1, 'length': 2, 'axis': [0, 0, -1]}},
        {'sphere': {'radius': 1, 'center': place, 'color': [0.1, 0, 1]}}, {'rod': {'to': place}},
        {'mesh': {'file': 'a/b.stl', 'scale': [1e-3, 1e-3, 1e-3], 'center': place}}], spatial)
    again = visuals([as_data(shape, spatial) for shape in shapes], spatial)
    for one, other in zip(shapes, again, strict=True):
        assert (one.kind, one.file, one.color) == (other.kind, other.file, other.color)
        assert one.size == pytest.approx(other.size) and one.center == pytest.approx(other.center)
        assert one.orientation == pytest.approx(other.orientation, abs=1e-15)


def test_paths_of_meshes_are_no_expressions_and_begin_at_the_file(tmp_path):
    path = tmp_path / 'pendulum.yaml'
    path.write_text("""
name: pendulum
parameters: {l: 0.5}
bodies:
  bob: {mass: 1, center_of_mass: [0, 0], inertia: 0.1,
        visual: [{mesh: {file: parts/l-2.stl, scale: [l, l, l]}}, {sphere: {radius: l/5}}]}
joints: {pivot: {type: revolute, parent: ground, child: bob, position: [0, 0]}}
""")
    mesh, ball = read_mechanism(path).bodies[0].visual
    assert mesh.file == str(tmp_path / 'parts' / 'l-2.stl')
    assert mesh.size == (0.5, 0.5, 0.5) and ball.size == (0.1,)


@pytest.mark.parametrize('shapes, problem', [
    ({'box': {}}, 'a list of shapes'), ([{'cone': {}}], r'\[0\]: expected a mapping with one of'),
    ([{'box': {'size': [1, 2, 0]}}], r'\[0\].box.size\[2\]'),
    ([{'mesh': {'file': 3}}], r'\[0\].mesh.file: expected text'),
    ([{'sphere': {'radius': 1, 'color': [0, 0, 2]}}], r'\[0\].sphere.color\[2\]'),
    ([{'mesh': {'file': 'a.stl', 'size': 1}}], "the unknown key 'size'")])
def test_what_cannot_be_drawn_is_refused(shapes, problem):
    with pytest.raises(FieldError, match=problem):
        visuals(shapes, True)
