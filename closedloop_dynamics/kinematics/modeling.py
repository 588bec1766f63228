# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""From a mechanism's description to the arrays that the kernels work on."""

from typing import NamedTuple

import numpy as np

from .changing_equations import changeable_in_plane, changeable_in_space
from .cut_rows import CutRows
from .tree_rows import SpatialTreeRows, TreeRows
from ..codegen import plane, space
from ..engine import types as t
from ..mechanism.decomposition import decompose
from ..mechanism.digits import extent


class MechanismArrays(NamedTuple):
    """Arrays of a mechanism, and where its bodies and joints are in them."""

    model: t.Model
    placements: dict  # By body, the ground among them (dict of str to tree_rows.Placement)
    rows: dict  # Rows of the tree by joint (dict of str to list of int)


def build_model(mechanism, gravity=None, decomposition=None, kept=None, with_constant=False):
    """Return the constant arrays of a mechanism; as for ``mechanism_arrays``."""
    return mechanism_arrays(mechanism, gravity, decomposition, kept, with_constant).model


def mechanism_arrays(
        mechanism, gravity=None, decomposition=None, kept=None, with_constant=False):
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
    with_constant : bool, optional
        Whether, in space, equations that no motion changes are among them, met or not.

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
    model = t.Arrays(
        tree=tree.tree, body=tree.body, gravity=np.array(
            np.zeros(2 if planar else 3) if gravity is None else gravity, dtype=float),
        cut=cut, cut_point=cuts.cut_point, path_body=cuts.path_body)
    if planar:
        cut[:, t.POSSIBLE] = [plane.possible(kind) for kind in cut[:, t.CUT_TYPE].tolist()]
        kept = changeable_in_plane(model) if kept is None else kept
    elif with_constant:
        cut[:, t.POSSIBLE] = [(1 << len(space.equation_names(kind, space.HELD))) - 1
                              for kind in cut[:, t.CUT_TYPE].tolist()]
    else:
        cut[:, t.POSSIBLE] = [sum(1 << n for n in possible) for possible in changeable_in_space(
            mechanism, model.replaced(cut=cut.copy()), extent(mechanism))]
    _keep(cut, kept)
    (plane if planar else space).number_equations(cut)
    return MechanismArrays(t.Model.of(**vars(model)), tree.placements, tree.rows)


def _keep(cut, kept):
    """Mark in ``Model.cut`` the equations that the elimination works on: all, or by flags."""
    cut[:, t.KEPT] = cut[:, t.POSSIBLE]
    if kept is not None:
        flags = iter(kept)
        for k in np.argsort(cut[:, t.CUT_NUMBER]):
            cut[k, t.KEPT] = sum(
                1 << n for n in range(6) if cut[k, t.POSSIBLE] >> n & 1 and next(flags))
