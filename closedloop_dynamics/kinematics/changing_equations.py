# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Closure equations that a motion can change, and those that it cannot."""

from functools import cache, partial

import numpy as np

from ..codegen import plane, space
from ..codegen.expression_graph import ExpressionGraph, LOAD
from ..codegen.spatial import Recursion
from ..codegen.vectors import is_zero
from ..engine import types as t
from ..mechanism.mechanism import MechanismError

# Share of the size: below it errors of equations that no motion changes are rounding.
NEVER_CLOSED = 1e-9


def changeable_in_plane(model):
    """
    Yield whether any motion may change each equation of a planar model, by cut joint.

    Its equations are not chosen yet.
    """
    for one in model.cut[np.argsort(model.cut[:, t.CUT_NUMBER])]:
        kind, between = one[t.CUT_TYPE], model.path_body[one[t.PATH_A]:one[t.PATH_COMMON]]
        # Slides alone never change the angle between two bodies.
        parallel = kind in (t.CUT_PRISMATIC, t.CUT_FIXED) and (
            model.tree[between, t.TYPE] == t.PRISMATIC).all()
        yield from (not (parallel and plane.group_of(kind, n))
                    for n in range(6) if one[t.POSSIBLE] >> n & 1)


_always_held = {}


def changeable_in_space(mechanism, model, size):
    """
    Yield the numbers of the equations of each cut joint in space that do not hold anyway.

    Cut joint by cut joint in the order of elimination; the equations of ``model`` are not chosen
    yet. MechanismError where a loop cannot close: an equation that no motion changes is not met.
    """
    # Lengths and masses may differ: they are symbols.
    shape = tuple((array.shape, array.tobytes()) for array in (
        *space.structure(model), model.tree, model.cut, model.path_body))
    if shape not in _always_held:
        _always_held[shape] = _is_held(model)
    held, somewhere = _always_held[shape], None
    for a, one in enumerate(model.cut):
        # Bodies that are fixed to one another are one row of the tree.
        joined = one[t.CUT_TYPE] not in (t.CUT_COUPLING, t.PRESCRIBED_JOINT) and (
            one[t.BODY_A] == one[t.BODY_B])
        fixed = [joined or always for always in held[a]]
        if any(fixed) and somewhere is None:
            somewhere = _outward(
                model, model.body.astype(object), model.cut_point.astype(object),
                mechanism.coordinates.start().tolist(), [0.0] * (len(model.tree) - 1))
        for always, equation in zip(fixed, somewhere.equations(model, a) if any(fixed) else ()):
            if always and not abs(equation.value) <= NEVER_CLOSED * size:
                name = mechanism.closures[one[t.CUT_NUMBER]].name
                raise MechanismError(
                    f'cut_joints.{name}: expected axes and points that the joints of the tree '
                    'can bring together, got an equation that no motion changes and that is not '
                    f'met: {equation.value:.3g} instead of 0')
        yield [n for n, always in enumerate(fixed) if not always]


def _outward(model, bodies, cuts, q, qd):
    """Return the recursion at coordinates and rates, symbols or numbers."""
    recursion = Recursion(space.bodies(model, bodies), space.cuts(model, cuts), (0.0, 0.0, 0.0))
    recursion.outward(model, q, qd, None)
    return recursion


def _is_held(model):
    """Return for each equation of each cut joint whether no motion changes it."""
    nv, nq = len(model.tree) - 1, t.number_of_coordinates(model)
    graph = ExpressionGraph()

    def symbols(source, shape):
        found = np.empty(shape, dtype=object)
        found.flat = [graph.put(LOAD, source, place) for place in range(found.size)]
        return found

    inputs = [symbols(*each) for each in enumerate(
        (model.body.shape, model.cut_point.shape, (nq,), (nv,)))]
    by_carriers, on_ground = {}, cache(partial(_on_ground, model))

    def held(a, model, carriers):
        """Return that of a cut joint's equations, the bodies that carry its loop at rest."""
        key = id(model), *carriers
        if key not in by_carriers:
            q, qd = inputs[2:]
            still = np.isin(np.arange(nv), model.tree[list(carriers), t.DOF])
            by_carriers[key] = model, _outward(
                model, *inputs[:2], q, np.where(still, 0.0, qd))
        return [isinstance(equation.value, float) or is_zero((equation.rate,))
                for equation in by_carriers[key][1].equations(model, a)]

    found = []
    for a, cut in enumerate(model.cut):
        # However these move, it changes nothing that the loop holds.
        carriers = model.path_body[cut[t.PATH_COMMON]:cut[t.PATH_END]].tolist()
        found.append(held(a, model, carriers))
        for carrier in carriers[:1]:
            here, along = held(a, on_ground(carrier), ()), len(space.HELD[cut[t.CUT_TYPE]][1])
            if along == 3 and not space.is_carried(model, cut) and not all(here[:along]):
                # These are along the world's axes, in which it turns.
                here[:along] = along * [False]
            found[-1] = [one or other for one, other in zip(found[-1], here)]
    return found


def _on_ground(model, carrier):
    """Return a model in which what a body carries is on the ground."""
    tree, cut = model.tree.copy(), model.cut.copy()
    for array, column in ((tree, t.PARENT), (cut, t.BODY_A), (cut, t.BODY_B)):
        array[array[:, column] == carrier, column] = 0
    return model.replaced(tree=tree, cut=cut)
