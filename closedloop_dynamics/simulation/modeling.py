# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""From a mechanism's description to the arrays that the kernels work on."""

import math

import numpy as np

from ..core import types as t
from ..core.codegen import plane
from ..mechanism.couplings import in_tree, measured
from ..mechanism.cut_freedoms import cut_freedoms
from ..mechanism.decomposition import decompose
from ..mechanism.mechanism import (
    Coupling, DISTANCE, DrivingConstraint, FIXED, GROUND, POINT_ON_LINE, PRISMATIC, REVOLUTE)

_CUT_TYPES = {
    REVOLUTE: t.CUT_REVOLUTE, PRISMATIC: t.CUT_PRISMATIC, FIXED: t.CUT_FIXED,
    DISTANCE: t.CUT_DISTANCE, POINT_ON_LINE: t.CUT_POINT_ON_LINE}


def build_model(mechanism, gravity=(0.0, 0.0), decomposition=None, kept=None):
    """
    Build the constant arrays of a mechanism.

    Parameters
    ----------
    mechanism : Mechanism
        What is described.
    gravity : sequence of 2 floats
        [m/s^2].
    decomposition : Decomposition, optional
        Found here when not given.
    kept : sequence of bool, optional
        Which equations the elimination is to work on, in the order of the cut joints; all when
        not given.

    """
    decomposition = decomposition or decompose(mechanism)
    tree, body, body_row = _tree_arrays(mechanism, decomposition)
    closures = _cut_arrays(mechanism, decomposition, tree, body_row)
    cut = closures[0]
    cut[:, t.POSSIBLE] = [plane.possible(kind) for kind in cut[:, t.CUT_TYPE].tolist()]
    if kept is None:
        kept = _changeable(cut, tree, closures[2])
    return complete(tree, body, gravity, *closures, decomposition, plane, kept)


def _changeable(cut, tree, path_body):
    """Tell, in the order of the cut joints, whether any motion may change each equation."""
    for one in cut[np.argsort(cut[:, t.CUT_NUMBER])]:
        kind, between = one[t.CUT_TYPE], path_body[one[t.PATH_A]:one[t.PATH_COMMON]]
        # Slides alone never change the angle between two bodies.
        parallel = kind in (t.CUT_PRISMATIC, t.CUT_FIXED) and (
            tree[between, t.TYPE] == t.PRISMATIC).all()
        yield from (not (parallel and plane.group_of(kind, n))
                    for n in range(6) if one[t.POSSIBLE] >> n & 1)


def complete(tree, body, gravity, cut, cut_point, path_body, decomposition, arrays, kept):
    """
    Return a model with all that follows from its bodies and its cut joints.

    Parameters
    ----------
    tree, body, gravity, cut, cut_point, path_body
        As ``core.types.Model`` has them; of ``cut`` the equations are not yet numbered.
    decomposition : Decomposition
        Of the mechanism.
    arrays : module
        ``plane`` or ``space``.
    kept : sequence of bool or None
        As for ``build_model``.

    Returns
    -------
    core.types.Model

    """
    cut[:, t.KEPT] = cut[:, t.POSSIBLE]
    if kept is not None:
        flags = iter(kept)
        for k in np.argsort(cut[:, t.CUT_NUMBER]):
            cut[k, t.KEPT] = sum(
                1 << n for n in range(6) if cut[k, t.POSSIBLE] >> n & 1 and next(flags))
    arrays.number_equations(cut)
    block, pair = block_arrays(cut, path_body)
    column, row, entry = factor_arrays(decomposition, cut, block)
    dependency, dependency_place = dependencies(column, row)
    return t.Model(
        tree=tree, body=body, gravity=np.array(gravity, dtype=float), cut=cut,
        cut_point=cut_point, path_body=path_body, pair=pair, block=block, column=column,
        row=row, entry=entry, dependency=dependency, dependency_place=dependency_place)


def body_rows(mechanism, decomposition):
    """Return the row of each body in the kernels' arrays (0 is the ground)."""
    rows = {GROUND: 0}
    for row, j in enumerate(decomposition.joint_order, start=1):
        rows[mechanism.joints[j].child] = row
    return rows


def _tree_arrays(mechanism, decomposition):
    rows = body_rows(mechanism, decomposition)
    bodies = {body.name: body for body in mechanism.bodies}
    subsystem = {name: k for k, names in enumerate(decomposition.subsystems) for name in names}
    tree = np.zeros((len(mechanism.joints) + 1, t.TREE_COLUMNS), dtype=np.int64)
    constant = np.zeros((len(tree), t.BODY_COLUMNS))
    for row, j in enumerate(decomposition.joint_order, start=1):
        joint = mechanism.joints[j]
        tree[row, [t.PARENT, t.DOF, t.TYPE, t.SUBSYSTEM, t.COORDINATE]] = (
            rows[joint.parent], j,
            t.PRISMATIC if joint.type == PRISMATIC else t.REVOLUTE, subsystem[joint.name], j)
        constant[row, t.INERTIA + 1:] = *joint.position, joint.angle, 0.0
        weigh(constant[row], bodies[joint.child])
    return tree, constant, rows


def weigh(constant, body):
    """Write a body's mass, first moments and inertia into its row of ``Model.body``."""
    x, y = body.center_of_mass
    constant[[t.MASS, t.MASS_X, t.MASS_Y, t.INERTIA]] = (
        body.mass, body.mass * x, body.mass * y, body.inertia + body.mass * (x * x + y * y))


def _cut_arrays(mechanism, decomposition, tree, body_row):
    cut = np.zeros((len(mechanism.closures), t.CUT_COLUMNS), dtype=np.int64)
    points = []
    entries = []
    child = {joint.name: joint.child for joint in mechanism.joints}
    cut[:, t.CUT_NUMBER] = decomposition.cut_order
    for k, index in enumerate(decomposition.cut_order):
        joint = mechanism.closures[index]
        if isinstance(joint, Coupling) and measured(mechanism, joint):
            points.append(_coupled_place(mechanism, joint, cut[k], tree, body_row, child, entries))
            continue
        if isinstance(joint, Coupling) or getattr(joint, 'freedom', None) in child:
            cut[k, t.CUT_TYPE], factors, offset = _sum_held(mechanism, joint)
            factors = {body_row[child[name]]: factor for name, factor in factors.items()}
            points.append(couple(cut[k], tree, factors, offset, entries))
            tree[[*factors], t.READ] = 1
            continue
        kind, body_a, body_b, *numbers = _held(mechanism, joint)
        cut[k, [t.CUT_TYPE, t.BODY_A, t.BODY_B]] = kind, body_row[body_a], body_row[body_b]
        pass_bodies(cut[k], tree, entries)
        points.append(numbers)
    return (cut, filled(points, t.CUT_POINT_COLUMNS, asks(mechanism)),
            np.array(entries, dtype=np.int64))


def asks(mechanism):
    """Return what needs columns for its right-hand sides in ``Model.cut_point``."""
    return [*mechanism.motions, *(one for one in mechanism.couplings if measured(mechanism, one))]


def coupling_scales(mechanism):
    """
    Return what the multipliers of couplings are to be divided by.

    Those of a cut joint whose coordinate is no sum of those of the tree are written for that
    coordinate, without its factor.

    Parameters
    ----------
    mechanism : Mechanism
        In the plane or in space.

    Returns
    -------
    ndarray, shape (number of couplings,)

    """
    found = [measured(mechanism, one) for one in mechanism.couplings]
    return np.array([one.joints[cuts[0].name] if cuts else 1.0
                     for one, cuts in zip(mechanism.couplings, found)])


def relative(mechanism, coupling):
    """
    Return a coupling for the coordinate of the cut joint that ``measured`` tells.

    Parameters
    ----------
    mechanism : Mechanism
        In the plane or in space.
    coupling : Coupling
        Of one such cut joint.

    Returns
    -------
    cut : CutJoint
    factors : dict of str to float
        Of joints of the tree.
    offset : float
        What the sum with the coordinate of the cut joint is held at.

    """
    cut, = measured(mechanism, coupling)
    factors, offset = in_tree(mechanism, coupling)
    own = coupling.joints[cut.name]
    return cut, {name: factor / own for name, factor in factors.items()}, offset / own


def _coupled_place(mechanism, coupling, one, tree, body_row, child, entries):
    """Add a coupling of a cut joint that slides; return its row of ``Model.cut_point``."""
    cut, factors, offset = relative(mechanism, coupling)
    factors = {body_row[child[name]]: factor for name, factor in factors.items()}
    tree[[*factors], t.READ] = 1
    one[[t.CUT_TYPE, t.BODY_A, t.BODY_B]] = (
        t.COUPLED_PLACE, body_row[cut.body_a], body_row[cut.body_b])
    return np.concatenate([[*cut.point_a, *cut.point_b, cut.angle], couple(
        one, tree, factors, offset, entries, one[[t.BODY_A, t.BODY_B]].tolist())])


def _sum_held(mechanism, one):
    """Return CUT_TYPE, factors by joint, and sum of a coupling or a joint's prescribed motion."""
    if isinstance(one, DrivingConstraint):
        return t.PRESCRIBED_JOINT, {one.freedom: 1.0}, 0.0
    return t.CUT_COUPLING, *in_tree(mechanism, one)


def _held(mechanism, joint):
    """Return CUT_TYPE, both bodies and a row of ``Model.cut_point``."""
    if isinstance(joint, DrivingConstraint):
        if joint.freedom is not None:
            _, cut, slides, *_ = cut_freedoms(mechanism)[joint.freedom]
            kind = t.PRESCRIBED_PLACE if slides else t.PRESCRIBED_TURN
            return kind, cut.body_a, cut.body_b, *cut.point_a, *cut.point_b, cut.angle
        point = mechanism.point(joint.point)
        x, y = joint.direction
        return (t.PRESCRIBED_PLACE, point.body, GROUND, *point.position, 0.0, 0.0,
                math.atan2(y, x))
    return (_CUT_TYPES[joint.type], joint.body_a, joint.body_b, *joint.point_a, *joint.point_b,
            joint.length if joint.type == DISTANCE else
            0.0 if joint.type == REVOLUTE else joint.angle)


def filled(points, columns, motions=()):
    """
    Return rows of ``Model.cut_point`` of different lengths as an array.

    Parameters
    ----------
    points : list of sequences of floats
        The rows.
    columns : int
        It is at least so wide.
    motions : sequence
        Prescribed ones: where there are any, columns for their right-hand sides are added.

    Returns
    -------
    ndarray, shape (number of rows, columns or more)

    """
    array = np.zeros((len(points), max([columns, *map(len, points)]) + (
        t.MOTION_COLUMNS if motions else 0)))
    for row, values in zip(array, points):
        row[:len(values)] = values
    return array


def couple(cut, tree, factors, offset, entries, bodies=()):
    """
    Add a coupling to the arrays of a model.

    Parameters
    ----------
    cut : ndarray of int, shape (CUT_COLUMNS,)
        Its row of ``Model.cut``; its entries are written.
    tree : ndarray of int
        ``Model.tree``.
    factors : dict of int to float
        Of joints' coordinates, by row of the tree.
    offset : float
        What the sum of the coordinates times their factors is held at.
    entries : list of int
        ``Model.path_body`` so far; what the coupling's forces pass is added.
    bodies : sequence of int
        Rows of bodies that it acts on, too.

    Returns
    -------
    ndarray
        Its row of ``Model.cut_point``.

    """
    own = sorted({row for joint in (*factors, *bodies) for row in path(tree, joint)}, reverse=True)
    cut[[t.PATH_A, t.PATH_B, t.PATH_COMMON, t.PATH_END]] = (
        len(entries), *3 * (len(entries) + len(own),))
    entries += own
    return np.array([offset, *(factors.get(row, 0.0) for row in own)])


def pass_bodies(cut, tree, entries):
    """Add to ``Model.path_body`` the bodies that a cut joint's forces pass, as ``couple``."""
    path_a, path_b = path(tree, cut[t.BODY_A]), path(tree, cut[t.BODY_B])
    shared = set(path_b)
    common = [row for row in path_a if row in shared]
    own_a = path_a[:len(path_a) - len(common)]
    own_b = path_b[:len(path_b) - len(common)]
    start, middle = len(entries), len(entries) + len(own_a)
    entries += own_a + own_b + common
    cut[[t.PATH_A, t.PATH_B, t.PATH_COMMON, t.PATH_END]] = (
        start, middle, middle + len(own_b), len(entries))


def path(tree, row):
    """Return the rows from ``row`` inward, the ground left out."""
    path = []
    while row > 0:
        path.append(row)
        row = int(tree[row, t.PARENT])
    return path


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
    """Return the sparsity of L by columns, and where each block goes."""
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


def extent(mechanism):
    """
    Return the size that tolerances are relative to: the longest distance on any body [m].

    Returns
    -------
    float
        At least the smallest positive float of any use, never zero.

    """
    places = [joint.position for joint in mechanism.joints]
    places += [p for cut in mechanism.cut_joints for p in (cut.point_a, cut.point_b)]
    longest = max((math.hypot(*place) for place in places), default=0.0)
    return longest or 1.0
