# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms in space read from YAML, and what is wrong with them."""

import math

from closedloop_dynamics.mechanism.mechanism import MechanismError
from closedloop_dynamics.mechanism.reader import read_mechanism
from closedloop_dynamics.simulation.scene import load_scene, load_scene_or_mechanism
import pytest
import yaml


def described():
    """Return the data of a crank, a rocker across it, and a rod between them."""
    return yaml.safe_load("""
        name: rssr
        bodies:
          crank: {mass: 0.5, center_of_mass: [0.05, 0, 0], inertia: [1e-5, 4e-4, 4e-4]}
          rocker: {mass: 1.0, center_of_mass: [0, 0, 0.15],
                   inertia: [7e-3, 7e-3, 1e-4, 0, 0, 0]}
          link: {massless: true}
          rod: {mass: 0.8, center_of_mass: [0.2, 0, 0], inertia: [1e-4, 0.02, 0.02]}
        joints:
          crank: {type: revolute, parent: ground, child: crank, position: [0, 0, 0],
                  axis: [0, 0, 2], actuated: true}
          rocker: {type: revolute, parent: ground, child: rocker, position: [0.4, 0.3, 0],
                   axis: [1, 0, 0]}
          turn: {type: revolute, parent: crank, child: link, position: [0.1, 0, 0],
                 orientation: {rpy: [0, 0, 0.5]}, axis: [0, 0, 1]}
          tilt: {type: revolute, parent: link, child: rod, position: [0, 0, 0],
                 orientation: {quaternion: [0, 0, 0, 1]}, axis: [0, 1, 0]}
        cut_joints:
          end: {type: spherical, body_a: rod, point_a: [0.4, 0, 0],
                body_b: rocker, point_b: [0, 0, 0.3]}
        points:
          end: {body: rod, position: [0.4, 0, 0]}
        """)


def read(tmp_path, data):
    """Return the mechanism that data describe."""
    path = tmp_path / 'mechanism.yaml'
    path.write_text(yaml.safe_dump(data, sort_keys=False))
    return read_mechanism(path)


def test_a_mechanism_in_space_is_read(tmp_path):
    mechanism = read(tmp_path, described())
    assert not mechanism.planar
    assert mechanism.joints[0].axis == (0.0, 0.0, 1.0)
    assert mechanism.joints[2].orientation == pytest.approx(
        (0.0, 0.0, math.sin(0.25), math.cos(0.25)))
    assert mechanism.joints[3].orientation == (0.0, 0.0, 0.0, 1.0)
    link = mechanism.bodies[2]
    assert (link.mass, link.center_of_mass, link.inertia) == (0.0, (0.0, 0.0, 0.0), 0.0)
    # Three equations hold its point; the same for a file that is read again.
    assert mechanism.number_of_equations == 3
    assert read(tmp_path, described()) == mechanism


def test_roll_pitch_and_yaw_are_those_of_urdf(tmp_path):
    data = described()
    data['joints']['tilt']['orientation'] = {'rpy': [0.1, 0.2, 0.3]}
    x, y, z, w = read(tmp_path, data).joints[3].orientation
    # Rz(yaw) Ry(pitch) Rx(roll), its last row and first column.
    assert 2.0 * (x * z - w * y) == pytest.approx(-math.sin(0.2))
    assert 2.0 * (y * z + w * x) == pytest.approx(math.cos(0.2) * math.sin(0.1))
    assert 2.0 * (x * y + w * z) == pytest.approx(math.cos(0.2) * math.sin(0.3))


CHANGES = {
    'a vector of the plane': (
        ('bodies', 'rod', 'center_of_mass'), [0.2, 0.0],
        r'bodies.rod.center_of_mass: expected a list of 3 finite numbers \[x, y, z\], got .*'
        'length 2'),
    'a moment of inertia': (
        ('bodies', 'rod', 'inertia'), 0.02, r'bodies.rod.inertia: expected a list of 3 .* or 6'),
    'moments that no body has': (
        ('bodies', 'rod', 'inertia'), [0.1, 0.02, 0.02],
        'bodies.rod.inertia: expected moments .* the other two, got principal moments 0.02, 0.02, '
        '0.1'),
    'products that make one negative': (
        ('bodies', 'rod', 'inertia'), [0.02, 0.02, 0.02, 0.03, 0, 0],
        'bodies.rod.inertia: expected moments'),
    'an axis of no length': (
        ('joints', 'crank', 'axis'), [0, 0, 0], r'joints.crank.axis: expected a direction'),
    'no axis': (('joints', 'crank', 'axis'), None,
                'joints.crank.axis: expected this key of a revolute joint, got none'),
    'an axis too many': (
        ('cut_joints', 'end', 'axis_a'), [1, 0, 0],
        'cut_joints.end.axis_a: expected no such key of a spherical joint'),
    'a quaternion of another norm': (
        ('joints', 'tilt', 'orientation'), {'quaternion': [0, 0, 1, 1]},
        'joints.tilt.orientation.quaternion: expected a unit quaternion .* norm 1.41421'),
    'an orientation without a name': (
        ('joints', 'tilt', 'orientation'), [0, 0, 0], 'joints.tilt.orientation: expected a mapping'
        ' with rpy'),
    'an angle of the plane': (
        ('joints', 'tilt', 'angle'), 0.5,
        'joints.tilt.angle: expected nothing: only a mechanism in the plane has this key'),
    'a lead': (('joints', 'tilt', 'lead'), 0.01,
               'joints.tilt.lead: expected no such key of a revolute joint, but of helical'),
    'an unknown type': (('joints', 'tilt', 'type'), 'revolut',
                        "joints.tilt.type: expected one of revolute, .*did you mean 'revolute'"),
}


@pytest.mark.parametrize('case', CHANGES)
def test_mistakes_are_named(tmp_path, case):
    (section, name, key), value, expected = CHANGES[case]
    data = described()
    data[section][name][key] = value
    with pytest.raises(MechanismError, match=expected):
        read(tmp_path, data)


def test_a_rod_without_mass_leaves_orientations_free(tmp_path):
    data = described()
    data['cut_joints']['end'].update(
        type='distance', length=0.1, orientation={'rpy': [0, 0, 1]})
    with pytest.raises(MechanismError, match='cut_joints.end.orientation: expected no orientation '
                       'of a distance joint'):
        read(tmp_path, data)


def test_universal_axes_must_differ(tmp_path):
    data = described()
    data['joints']['tilt'].update(type='universal', second_axis=[0, 1, 0])
    with pytest.raises(MechanismError, match='joints.tilt.second_axis: expected a second axis'):
        read(tmp_path, data)


def test_keys_of_space_are_refused_in_the_plane(tmp_path):
    data = {'name': 'arm', 'bodies': {'arm': {
        'mass': 1.0, 'center_of_mass': [0.1, 0.0], 'inertia': 0.01}}, 'joints': {'pivot': {
            'type': 'revolute', 'parent': 'ground', 'child': 'arm', 'position': [0.0, 0.0]}}}
    assert read(tmp_path, data).planar
    for key, value in (('axis', [0, 0, 1]), ('orientation', {'rpy': [0, 0, 1]})):
        data['joints']['pivot'][key] = value
        with pytest.raises(MechanismError, match=f'pivot.{key}: .*only a mechanism in space'):
            read(tmp_path, data)
        del data['joints']['pivot'][key]


def test_mechanisms_in_space_are_known_as_such(tmp_path):
    read(tmp_path, described())
    path = tmp_path / 'scene.yaml'
    path.write_text(yaml.safe_dump({'mechanism': 'mechanism.yaml', 'initial': {
        'position': dict.fromkeys(described()['joints'], 0.0)}}))
    for read_in in (load_scene(path).mechanism, load_scene_or_mechanism(path).mechanism,
                    load_scene_or_mechanism(tmp_path / 'mechanism.yaml')):
        assert not read_in.planar
