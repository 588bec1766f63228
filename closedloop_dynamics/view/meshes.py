# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Meshes of bodies from their files, with no more triangles than a page shows well."""

import numpy as np

from ..mechanism.extras import remedy

# Triangles of a mesh, and of all meshes of a machine, at most; cells along its longest side that
# the points of one with more are put into.
MOST_TRIANGLES, MOST_OF_ALL, CELLS = 6000, 24_000, 128
# Largest file [bytes].
LARGEST = 200_000_000
SUFFIXES = ('.stl', '.obj', '.ply', '.glb', '.gltf', '.off', '.dae')


class MeshError(ValueError):
    """A mesh that cannot be shown; the message names the file and says why."""


def read_mesh(path, most=MOST_TRIANGLES):
    """
    Read a mesh, of at most so many triangles; return points and triangles.

    STL, OBJ, PLY, GLB or OFF; COLLADA where trimesh can read it. Points, shape (n, 3), are as the
    file has them; triangles, shape (m, 3), are rows of them. MeshError for anything else.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise MeshError(f'{path}: expected a mesh ({", ".join(SUFFIXES)}), got another name')
    try:
        if path.stat().st_size > LARGEST:
            raise MeshError(f'{path}: expected at most {LARGEST / 1e6:g} MB, got a larger file')
    except OSError as error:
        raise MeshError(f'{path}: {error.strerror}') from None
    try:
        import trimesh
    except ImportError as error:
        raise MeshError(f'{path}: meshes need {remedy("trimesh", error)}') from None
    try:
        mesh = trimesh.load_mesh(path, skip_materials=True)
        points = np.array(mesh.vertices, dtype=float)
        triangles = np.array(mesh.faces, dtype=int).reshape(-1, 3)
    except Exception as error:  # noqa: B902
        # Readers of many formats, each with errors of its own.
        raise MeshError(f'{path}: expected a mesh that can be read, got: {error}') from None
    if not len(triangles) or not np.isfinite(points).all():
        raise MeshError(f'{path}: expected triangles between finite places, got none')
    cells = CELLS
    found = points, triangles
    while len(found[1]) > most:
        found = _merged(points, triangles, cells)
        # In the end there is one cell, and no triangle.
        cells = cells * 3 // 4
    return found


def _merged(points, triangles, cells):
    """Return a mesh with the points of each cell of a grid merged, in their middle."""
    low, size = points.min(axis=0), np.ptp(points, axis=0).max() or 1.0
    places = np.floor((points - low) * (cells / size)).astype(int)
    _, cell, counts = np.unique(places, axis=0, return_inverse=True, return_counts=True)
    cell = cell.reshape(-1)
    middles = np.zeros((len(counts), 3))
    np.add.at(middles, cell, points)
    triangles = cell[triangles]
    a, b, c = triangles.T
    kept = triangles[(a != b) & (b != c) & (c != a)]
    return middles / counts[:, None], np.unique(kept, axis=0)
