# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Which code evaluates a scene: one routine of mechanism and effects, or the engine in parts.

A scene with reflected inertia is evaluated in parts, its effects one by one (``law_code``), and so
is any while one of them is switched off, several of many
joints under dry friction are at rest, or friction feels the reaction in its joint:
``engine/scene_code.cpp``.
"""

from functools import partial
from types import SimpleNamespace

from .element import (
    ACROSS_B, AXIS, FOLLOWED, IN_PLANE, POINT_A, POINT_B, RATE_ONLY, ROW_A, ROW_B, SCALE, SIDE_A,
    SIDE_B, SLIDES, ZERO)
from .force_law import FRICTION, INERTIA, MOTION
from ..codegen import function_table as calls, with_torque_response
from ..codegen.live_scene import address_of_scene, AT_ONCE, LiveForces
from ..codegen.machine_code import LANES, PACKED
from ..engine import native
from ..engine.types import BALL, DOF, TYPE

_CUT_COLUMNS = {'POINT_A': POINT_A, 'POINT_B': POINT_B, 'AXIS': AXIS, 'SIDE_A': SIDE_A,
                'SIDE_B': SIDE_B, 'ACROSS_B': ACROSS_B, 'SCALE': SCALE, 'ZERO': ZERO}
# With more frictions than these no routine has the responses: each is half an evaluation.
_MOST_FRICTIONS = 6
# Structures of the code behind addresses.
_known = {}


def structure(model, table):
    """
    Return the key of the code of a scene with a table of effects, beside its mechanism.

    None where an effect has no code.
    """
    balls = set(model.tree[model.tree[:, TYPE] == BALL, DOF].tolist())
    rows = table.rows
    if any(row.law.role == INERTIA or not row.law.in_balls and balls & set(row.joints)
           for row in rows):
        return None
    return tuple((
        row.law.name, *row.law.parts(row), row.state, *row.joints, *row.bodies, *row.equation,
        row.begin, row.count, row.summed, *row.law.terms(row)) for row in rows), len(
            table.states), table.cuts.index.tobytes()


def link(model, table, functions, scene=None):
    """
    Give a function table the evaluation of a scene with a table of effects, if there is one.

    ``scene``: structure that the effects had when code was generated; where they have another one
    now, there is no evaluation until they have this one again.
    """
    key, whole = structure(model, table), functions[calls.EVALUATION] != 0
    functions[list(calls.OF_SCENE)] = 0
    if key is not None and scene in (None, key):
        for place, address in _addresses(model, table, key).items():
            functions[place] = address
        _known[int(functions[calls.MOTION])] = key
    functions[list(calls.FUNCTIONS)] = list(map(native.library_function, calls.FUNCTIONS))
    table.code.fits[0] = functions[calls.MOTION] != 0
    if whole:
        link_evaluation(model, table, functions)


def link_evaluation(model, table, functions):
    """Give a function table the evaluation of a scene with multipliers, too, where it has one."""
    if table.code.fits[0]:
        functions[calls.EVALUATION] = address_of_scene(
            model, structure(model, table), lambda: SceneLaws(table), which=calls.EVALUATION)


def known_structure(functions):
    """Return the structure that the evaluation of a scene has in a function table; or None."""
    return _known.get(int(functions[calls.MOTION]))


def update(model, table, functions, scene):
    """Record whether the evaluation of a scene still is that of its effects; see ``link``."""
    known, present = known_structure(functions), structure(model, table)
    if known is None and scene is not None and present == scene:
        link(model, table, functions, scene)
    else:
        table.code.fits[0] = known is not None and known == present


def fit_lanes(table):
    """
    Return whether states with these effects may be evaluated in the lanes of a vector.

    Not where time ends steps, commands pass through drives, lists of numbers are searched or
    cables are watched: each lane would do that by itself.
    """
    return bool(table.code.fits[0] and table.enabled.all() and not table.loaded[0]
                and not len(table.cuts.index) and all(law.in_lanes for law in table.laws))


def addresses_in_lanes(model, tables, which):
    """
    Return the addresses of the evaluations of a scene in the lanes of a vector.

    By places of the function table, for one of the models and tables that ``fit_lanes``, one for
    each lane; None where they are not of one structure. ``which``: MOTION or EVALUATION.
    """
    first = tables[0]
    key = structure(model, first)
    if any(structure(model, table) != key for table in tables if table is not first):
        return None
    return _addresses(model, first, key, LANES, which)


def energies_in_lanes(model, table):
    """
    Return the address of the routine that finds the energies of states in the lanes of a vector.

    Parameters
    ----------
    model : Model
        Constant arrays of one of the mechanisms.
    table : EffectTable
        That ``fit_lanes``.

    Returns
    -------
    int

    """
    return address_of_scene(model, structure(model, table), lambda: SceneLaws(
        table, calls.AT_REST), LANES, calls.ENERGIES)


def balances_in_parts(table):
    """Return whether no evaluation of a scene has the responses to all frictions at rest."""
    balanced = table.role.tolist()
    return not len(table.cuts.index) and (
        INERTIA in balanced or balanced.count(FRICTION) > _MOST_FRICTIONS or (
            FRICTION in balanced and MOTION in balanced))


def _addresses(model, table, key, form=PACKED, evaluation=calls.MOTION):
    """Return the addresses of the evaluations of a scene by place of the function table."""
    found = {evaluation: address_of_scene(
        model, key, lambda: SceneLaws(table), form, evaluation)}
    # Motions and cut joints would respond to friction, too.
    frictions = table.role.tolist().count(FRICTION)
    if frictions and MOTION not in table.role and not len(table.cuts.index):
        several = (calls.RESPONSES,) if AT_ONCE < frictions <= _MOST_FRICTIONS else ()
        # An evaluation in parts has the response to one friction at nearly the same cost.
        one = () if form == PACKED and balances_in_parts(table) and with_torque_response(
            model) else (calls.AT_REST,)
        for which in (*one, *several):
            # Responses are found to multipliers, too.
            found[which] = address_of_scene(
                model, (*key, which), partial(SceneLaws, table, which), form,
                calls.EVALUATION if which == calls.RESPONSES else evaluation)
    return found


class SceneLaws:
    """
    The laws of a scene, for ``codegen.live_scene.LiveTrace``.

    Parameters
    ----------
    table : EffectTable
        Its structure counts, not its numbers.
    at_rest : int
        As of ``LiveTrace``: which joints under dry friction may be at rest.

    """

    def __init__(self, table, at_rest=calls.EVALUATION):
        self._rows = table.rows
        self.states, self.at_rest = len(table.states), at_rest
        self.columns = {place: array.shape[1] for place, array in (
            (calls.VALUES, table.values), (calls.PRESENT, table.code.present),
            (calls.GAPS, table.contacts.now), (calls.TRIALS, table.contacts.trial),
            (calls.CUT_VALUES, table.cuts.values))}
        self.columns[calls.SIDES] = 1
        self.cuts = [SimpleNamespace(
            slides=bool(row[SLIDES]), in_plane=bool(row[IN_PLANE]), row_a=int(row[ROW_A]),
            row_b=int(row[ROW_B]), followed=int(row[FOLLOWED]), rate_only=bool(row[RATE_ONLY]),
            columns=_CUT_COLUMNS) for row in table.cuts.index]

    def motions(self, trace):
        """Return value, rate and acceleration of prescribed motions by row and column."""
        forces, found = LiveForces(trace), {}
        for row in self._rows:
            if row.law.role == MOTION:
                forces.turn_to(row)
                row.law.act(forces)
                closure, _, column = row.equation
                *_, found[closure, column] = forces.driven[-1]
        return found

    def act(self, forces):
        """Apply all effects."""
        for row in self._rows:
            forces.turn_to(row)
            row.law.act(forces)
