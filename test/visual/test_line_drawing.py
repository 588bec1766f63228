# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Line drawings for CAD, read back."""

import sys
from xml.etree import ElementTree

from closedloop_dynamics import load_scene
import numpy as np
import pytest

from ..test_cli import call, done, read, refused

SVG = '{http://www.w3.org/2000/svg}'
TURN = ('kinematics', 'four_bar', '--drive', 'crank_joint=60:420deg:121')


def drawn(capsys, tmp_path, suffix, *command):
    """Return the file of a drawing, and the columns of its motion."""
    rows, path = tmp_path / 'rows.csv', tmp_path / f'machine{suffix}'
    text = done(capsys, *command, '--output', rows, '--drawing', path)
    assert str(path) in text
    return path, read(rows)


def polylines(layer):
    """Return the kinds and points of the lines of a layer of an SVG file, y upwards [mm]."""
    return [(line.tag.removeprefix(SVG), np.array(
        [[float(each) for each in pair.split(',')] for pair in line.get('points').split()])
        * (1.0, -1.0)) for line in layer]


def test_svg_is_to_scale_with_a_layer_for_each_body_and_path(capsys, tmp_path):
    path, column = drawn(capsys, tmp_path, '.svg', *TURN)
    root = ElementTree.parse(path).getroot()
    *_, width, height = map(float, root.get('viewBox').split())
    assert float(root.get('width').removesuffix('mm')) == pytest.approx(width, rel=1e-5)
    assert float(root.get('height').removesuffix('mm')) == pytest.approx(height, rel=1e-5)
    layers = {layer.get('id'): layer for layer in root.iter(f'{SVG}g')}
    assert list(layers) == ['crank', 'coupler', 'rocker', 'path.coupler_point', 'joints']
    (kind, crank), = polylines(layers['crank'])
    assert kind == 'polyline'
    np.testing.assert_allclose(crank, [[0.0, 0.0], [50.0, 50.0 * 3.0 ** 0.5]], atol=1e-6)
    (kind, rocker), = polylines(layers['rocker'])
    assert np.linalg.norm(rocker[1] - rocker[0]) == pytest.approx(250.0, abs=1e-6)
    (kind, curve), = polylines(layers['path.coupler_point'])
    # A turn: the last place is the first one.
    assert kind == 'polygon' and len(curve) == 120
    np.testing.assert_allclose(curve, 1e3 * np.stack(
        [column['point.coupler_point.x'], column['point.coupler_point.y']], axis=1)[:-1],
        atol=1e-6)
    assert len(layers['joints']) == 4


def test_dxf_is_in_millimetres_with_a_layer_for_each_body_and_path(capsys, tmp_path):
    ezdxf = pytest.importorskip('ezdxf')
    path, column = drawn(capsys, tmp_path, '.dxf', *TURN)
    document = ezdxf.readfile(path)
    assert document.units == ezdxf.units.MM and not document.audit().errors
    found = {}
    for entity in document.modelspace():
        found.setdefault(entity.dxf.layer, []).append(entity)
    assert list(found) == ['crank', 'coupler', 'rocker', 'path.coupler_point', 'joints']
    curve, = found['path.coupler_point']
    assert curve.closed
    np.testing.assert_allclose(
        np.array(curve.get_points('xy')), 1e3 * np.stack(
            [column['point.coupler_point.x'], column['point.coupler_point.y']], axis=1)[:-1],
        atol=1e-9)
    assert {entity.dxftype() for entity in found['joints']} == {'CIRCLE'}


def test_dxf_in_space_keeps_three_coordinates(capsys, tmp_path):
    ezdxf = pytest.importorskip('ezdxf')
    path, column = drawn(capsys, tmp_path, '.dxf', 'kinematics', 'rssr_four_bar', '--drive',
                         'crank=0:1:11')
    points = [entity for entity in ezdxf.readfile(path).modelspace()
              if entity.dxftype() == 'POLYLINE' and entity.dxf.layer.startswith('path.')]
    names = [point.name for point in load_scene('rssr_four_bar').mechanism.points]
    assert [line.dxf.layer for line in points] == [f'path.{name}' for name in names]
    for line, name in zip(points, names):
        np.testing.assert_allclose([tuple(vertex.dxf.location) for vertex in line.vertices],
                                   1e3 * np.stack([column[f'point.{name}.{axis}']
                                                   for axis in 'xyz'], axis=1), atol=1e-9)


def test_plot_draws_a_recorded_run(capsys, tmp_path):
    drawn(capsys, tmp_path, '.svg', *TURN)
    again = tmp_path / 'again.svg'
    code, text, errors = call(capsys, 'plot', tmp_path / 'rows.csv', '--output', tmp_path / 'all',
                              '--drawing', again)
    assert code == 0 and str(again) in text, errors
    assert again.read_bytes() == (tmp_path / 'machine.svg').read_bytes()


@pytest.mark.parametrize('name, message', [
    ('machine.png', '--drawing: expected a name that ends with .dxf or .svg, got'),
    ('nowhere/machine.svg', '--drawing: expected an existing directory'),
    ('machine.dxf', 'DXF files need ezdxf: pip install ezdxf')])
def test_drawings_that_cannot_be_written_are_refused_first(
        capsys, tmp_path, monkeypatch, name, message):
    monkeypatch.setitem(sys.modules, 'ezdxf', None)
    assert message in refused(capsys, *TURN, '--drawing', tmp_path / name)
