# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms in space read from YAML."""

import math

from closedloop_dynamics import load_scene, MechanismError, read_mechanism
from closedloop_dynamics.scene.loading import load_scene_or_mechanism
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
