# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""From a mechanism's description to the arrays that the kernels work on."""

from typing import NamedTuple

import numpy as np

from .changing_equations import changeable_in_plane, changeable_in_space
from .cut_rows import CutRows
from .tree_rows import SpatialTreeRows, TreeRows
from ..core import types as t
from ..core.codegen import plane, space
from ..mechanism.decomposition import decompose
from ..mechanism.digits import extent


class MechanismArrays(NamedTuple):
    """Arrays of a mechanism, and where its bodies and joints are in them."""

    model: t.Model
    placements: dict  # By body, the ground among them (dict of str to tree_rows.Placement)
    rows: dict  # Rows of the tree by joint (dict of str to list of int)


def build_model(mechanism, gravity=None, decomposition=None, kept=None):
    """Return the constant arrays of a mechanism; as for ``mechanism_arrays``."""
    return mechanism_arrays(mechanism, gravity, decomposition, kept).model


def mechanism_arrays(mechanism, gravity=None, decomposition=None, kept=None):
    """
    Build the constant arrays of a mechanism.

    Parameters
    ----------
    mechanism : Mechanism
        What is described; in space its vectors have three numbers.
    gravity : sequence of 2 or 3 floats, optional
        [m/s^2]; zero when not given.
    decomposition : Decomposition, optional
        Found here when not given.
    kept : sequence of bool, optional
        Which of the equations that do not always hold the elimination is to work on, in the order
        of the cut joints; all that a motion may change when not given.

    Returns
    -------
    MechanismArrays

    Raises
    ------
    MechanismError
        Where a loop in space cannot close: a cut joint's equation that no motion changes is not
        met.

    """
    planar, decomposition = mechanism.planar, decomposition or decompose(mechanism)
    tree = (TreeRows if planar else SpatialTreeRows)(mechanism, decomposition)
    cuts = CutRows(mechanism, decomposition, tree)
    cut = cuts.cut
    model = t.Model(
        tree.tree, tree.body, np.array(
            np.zeros(2 if planar else 3) if gravity is None else gravity, dtype=float),
        cut, cuts.cut_point, cuts.path_body, *(7 * (None,)))
    if planar:
        cut[:, t.POSSIBLE] = [plane.possible(kind) for kind in cut[:, t.CUT_TYPE].tolist()]
        kept = changeable_in_plane(model) if kept is None else kept
    else:
        cut[:, t.POSSIBLE] = [sum(1 << n for n in possible) for possible in changeable_in_space(
            mechanism, model._replace(cut=cut.copy()), extent(mechanism))]
    _keep(cut, kept)
    (plane if planar else space).number_equations(cut)
    block, pair = block_arrays(cut, cuts.path_body)
    column, row, entry = factor_arrays(decomposition, cut, block)
    dependency, dependency_place = dependencies(column, row)
    return MechanismArrays(model._replace(
        pair=pair, block=block, column=column, row=row, entry=entry, dependency=dependency,
        dependency_place=dependency_place), tree.placements, tree.rows)


def _keep(cut, kept):
    """Mark in ``Model.cut`` the equations that the elimination works on: all, or by flags."""
    cut[:, t.KEPT] = cut[:, t.POSSIBLE]
    if kept is not None:
        flags = iter(kept)
        for k in np.argsort(cut[:, t.CUT_NUMBER]):
            cut[k, t.KEPT] = sum(
                1 << n for n in range(6) if cut[k, t.POSSIBLE] >> n & 1 and next(flags))


def block_arrays(cut, path_body):
    """Return the blocks below the diagonal and, for each, the entries that meet on a body."""
    visitors = {}
    for k in range(len(cut)):
        for entry in range(cut[k, t.PATH_A], cut[k, t.PATH_END]):
            visitors.setdefault(int(path_body[entry]), []).append((k, entry))
    meeting = {}
    for visits in visitors.values():
        for m, (earlier, entry) in enumerate(visits):
            for later, later_entry in visits[m + 1:]:
                meeting.setdefault((earlier, later), []).append((later_entry, entry))
    block, pair = [], []
    for (earlier, later), entries in sorted(meeting.items()):
        block.append((later, earlier, len(pair), len(pair) + len(entries)))
        pair += entries
    return (np.array(block, dtype=np.int64).reshape(-1, 4),
            np.array(pair, dtype=np.int64).reshape(-1, 2))


def factor_arrays(decomposition, cut, block):
    """Return the sparsity of L by columns, and the place of each block."""
    column, row = [0], []
    place_of = {}
    for k, later in enumerate(decomposition.structure):
        first, rows = cut[k, t.ROW], cut[k, t.ROWS]
        below = []
        for m in sorted(later):
            below += range(cut[m, t.ROW], cut[m, t.ROW] + cut[m, t.ROWS])
        for c in range(rows):
            start = len(row)
            row += [*range(first + c, first + rows), *below]
            column.append(len(row))
            place = start + rows - c
            for m in sorted(later):
                place_of[m, k, c] = place
                place += cut[m, t.ROWS]
    entry = np.zeros((len(block), max(3, cut[:, t.ROWS].max(initial=0))), dtype=np.int64)
    for n, (later, earlier) in enumerate(block[:, :2]):
        for c in range(cut[earlier, t.ROWS]):
            entry[n, c] = place_of[int(later), int(earlier), c]
    return np.array(column, dtype=np.int64), np.array(row, dtype=np.int64), entry


def dependencies(column, row):
    """Return, for each row of L, the entries left of its diagonal."""
    rows = len(column) - 1
    left = [[] for _ in range(rows)]
    for k in range(rows):
        for place in range(column[k] + 1, column[k + 1]):
            left[row[place]].append((k, place))
    start = np.cumsum([0] + [len(places) for places in left], dtype=np.int64)
    return start, np.array([p for places in left for p in places], dtype=np.int64).reshape(-1, 2)
