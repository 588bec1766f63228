# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Read the CSV file of a run, with the scene beside it.

``closedloop simulate`` writes the simulated scene, all overrides included, as
``RUN.csv.scene.json``. A file without it is read with a scene that the caller names; either way
the rows have to be those of that machine: its columns, its points, its closure error. Pages of
``closedloop view`` write the same columns with units behind their names.
"""

import csv
import json
from pathlib import Path
import re

import numpy as np

from .errors import RecordingError
from ..kinematics.geometry import Geometry
from ..kinematics.modeling import extent
from ..kinematics.second_order import scene_as_it_moves
from ..mechanism.kinematics import body_poses, named_point
from ..scene.text import read_scene_text, scene_text
from ..visual.trajectory import from_rows, without_marks

# Share of the mechanism's size by which points and closure may differ from the rows', and share
# of a closure error itself: large ones depend on how directions are compared.
TOLERANCE, OF_CLOSURE = 1e-6, 0.01
# Largest share of a coordinate that single precision loses, which pages have.
SINGLE = 2.0 ** -24
# What may follow the name of a column.
UNIT = re.compile(r' \[[^]]*\]$')
# Parts of a mechanism's text that change nothing but its drawing.
DRAWN = ('name', 'description', 'ground_visual', 'visual')


def scene_path(path):
    """Return the file beside a CSV file that holds its scene."""
    return Path(f'{path}.scene.json')


def write_scene(path, scene):
    """Write the scene of a CSV file beside it."""
    scene_path(path).write_text(scene_text(scene) + '\n', encoding='utf-8')


def read_rows(path, scene=None):
    """
    Read the CSV file of a run; return its trajectory and scene.

    ``scene`` is needed where it is not beside the rows. RecordingError where it is unknown, or
    rows and scene are of different mechanisms; OSError, SceneError.
    """
    beside = scene_path(path)
    known = read_scene_text(beside.read_text(encoding='utf-8'))[0] if beside.is_file() else None
    if scene is None and known is None:
        raise RecordingError(f'{path}: expected its scene beside it, in {beside.name}, which '
                             'does not exist; add --scene')
    if known is not None:
        if scene is not None:
            require_same_mechanism(path, known, scene)
        scene = known
    names, table = read_table(path, lambda names: _require_columns(path, scene, names))
    motion = from_rows(scene.mechanism, names, table)
    _require_geometry(path, scene, motion, dict(zip(names, table.T)))
    return motion, scene


def read_table(path, require):
    """
    Read the numbers of a CSV file; return names, without units in brackets, and a table.

    ``require`` takes the names of the columns and refuses others than are expected. RecordingError
    where there are no rows, or something is no number; OSError.
    """
    with open(path, newline='', encoding='utf-8') as file:
        names, *rows = [*csv.reader(file)] or [[]]
    # Readers do not care which of several forces is given.
    names = without_marks([UNIT.sub('', name) for name in names])
    require(names)
    try:
        table = np.array(rows, dtype=float).reshape(len(rows), len(names))
    except ValueError as error:
        raise RecordingError(
            f'{path}: expected a number in each column of each row: {error}') from None
    if not len(table):
        raise RecordingError(f'{path}: expected rows, got none')
    return names, table


def require_same_mechanism(path, recorded, given):
    """Refuse, with RecordingError, a scene whose mechanism is not the recorded one."""
    one, other = (json.loads(scene_text(scene))['mechanism'] for scene in (recorded, given))
    place = _first_difference(one, other)
    if place is not None:
        raise RecordingError(
            f'{path}: expected the mechanism that was simulated, got a --scene with another one: '
            f'{".".join(("mechanism", *place))} differs; leave --scene out')


def _first_difference(one, other):
    """Return the key path at which two texts of mechanisms differ, or None."""
    if not (isinstance(one, dict) and isinstance(other, dict)):
        return None if one == other else ()
    for key in {**one, **other}:
        if key not in DRAWN:
            place = _first_difference(one.get(key), other.get(key))
            if place is not None:
                return key, *place
    return None


def _require_columns(path, scene, names):
    """Refuse columns that the scene's rows do not have, or lack."""
    mechanism = scene_as_it_moves(scene).mechanism
    axes = 'xy' if mechanism.planar else 'xyz'
    required = ['time', *(name for quantity in ('position', 'velocity', 'effort')
                          for name in mechanism.coordinates.columns(quantity))]
    required += [f'{kind}.{part.name}.{axis}' for kind, parts in (
        ('force', mechanism.cut_joints), ('point', mechanism.points))
        for part in parts for axis in axes]
    missing = [name for name in required if name not in names]
    joints = [joint.name for joint in (*mechanism.joints, *mechanism.cut_joints)]
    parts = {'position': joints, 'force': joints,
             'coupling': [coupling.name for coupling in mechanism.couplings],
             'point': [point.name for point in mechanism.points]}
    foreign = [name for name in names
               if (kind := name.split('.')[0]) in parts
               and name.split('.')[1:2] not in [[part] for part in parts[kind]]]
    if missing or foreign:
        raise RecordingError(
            f'{path}: expected the columns that `closedloop simulate {scene.name} --output` '
            f'writes; {f"{missing[0]} is missing" if missing else f"got {foreign[0]}"}')


def _require_geometry(path, scene, motion, columns):
    """Refuse rows whose points or closure errors are not those of the scene's mechanism."""
    mechanism = scene.mechanism
    poses = body_poses(mechanism, motion.position)
    size = max(extent(mechanism), np.abs(poses[..., :2]).max(initial=0.0))
    # Angles of many turns are known less well.
    limit = size * np.maximum(TOLERANCE, SINGLE * np.abs(motion.position).sum(axis=1))
    differences = {
        f'point {point.name}': np.stack(
            [columns[f'point.{point.name}.{axis}']
             for axis in ('xy' if mechanism.planar else 'xyz')], axis=-1)
        - named_point(mechanism, poses, point.name) for point in mechanism.points}
    if 'closure' in columns:
        equations, recorded = Geometry(mechanism).equations, columns['closure']
        found = np.array([equations.move(q).closure_error() for q in motion.position])
        differences['closure error'] = np.maximum(
            np.abs(found - recorded) - OF_CLOSURE * recorded, 0.0)[:, np.newaxis]
    for name, difference in differences.items():
        largest = np.abs(difference).max(axis=1)
        # False for NaN, too: the last rows of a failed run decide nothing.
        differs = np.isfinite(largest) & (largest > limit)
        if differs.any():
            row = differs.argmax()
            raise RecordingError(
                f'{path}: expected rows of the mechanism of {scene.name}, got those of another '
                f'one: at t = {motion.time[row]:.6g} s the {name} differs by '
                f'{largest[row]:.2g} m; give the scene that was simulated')
