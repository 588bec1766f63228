# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Which code evaluates a scene: one routine of mechanism and effects, or the engine in parts.

A scene with an effect that has no law on symbols (``live_laws``) is evaluated in parts, its
effects one by one (``law_code``), and so is any while one of them is switched off, several of many
joints under dry friction are at rest, or friction feels the reaction in its joint:
``engine/scene_code.cpp``.
"""

from functools import partial

from .live_laws import COURSES, joints_of, law_of, LAWS, LiveLaws, shape, USER_LAWS
from .smooth_laws import FORCE_TABLES
from .table import (
    ACTUATOR, CABLE, CURVE_CONTACT, DATA, END_STOP, ENTRIES, FACE_CONTACT, FIRST,
    JOINT_FORCE_TABLE, JOINT_FRICTION, JOINT_SPRING, PRESCRIBED_MOTION, SECOND, STATE, TENDON)
from ..core.codegen import function_table as calls
from ..core.codegen.live_scene import address_of_scene
from ..core.codegen.machine_code import LANES, SCALAR
from ..core.types import BALL, DOF, TYPE
from ..engine import native

# Columns of EffectTable.values that only the code may depend on, of an effect's kind.
_CONSTANT = {TENDON: (0, 1), PRESCRIBED_MOTION: (3,)}
_IN_JOINTS = (ACTUATOR, END_STOP, JOINT_FORCE_TABLE, JOINT_FRICTION, JOINT_SPRING, TENDON)
_NOT_IN_LANES = {*COURSES, *FORCE_TABLES, ACTUATOR, CABLE, CURVE_CONTACT, FACE_CONTACT}
# With more frictions than these no routine has the responses: each is half an evaluation.
_MOST_FRICTIONS = 6
# Structures of the code behind addresses.
_known = {}


def structure(model, table):
    """
    Return the key of the code of a scene with a table of effects, beside its mechanism.

    None where an effect has no law on symbols.
    """
    kinds = table.kind.tolist()
    balls = set(model.tree[model.tree[:, TYPE] == BALL, DOF].tolist())
    for row, kind in enumerate(kinds):
        if kind not in LAWS or (kind in _IN_JOINTS and balls & set(joints_of(table, row))) or (
                kind in USER_LAWS and law_of(table, row) is None):
            return None
    # An address is another one in the next process.
    rows = tuple((kind, *table.index[row, [STATE, FIRST, DATA, ENTRIES]].tolist(),
                  0 if kind in USER_LAWS else int(table.index[row, SECOND]),
                  *table.values[row, list(_CONSTANT.get(kind, ()))].tolist(),
                  *shape(table, row)) for row, kind in enumerate(kinds))
    return rows, len(table.states), table.cuts.index.tobytes()


def link(model, table, functions, scene=None):
    """
    Give a function table the evaluation of a scene with a table of effects, if there is one.

    ``scene``: structure that the effects had when code was generated; where they have another one
    now, there is no evaluation until they have this one again.
    """
    key = structure(model, table)
    functions[list(calls.OF_SCENE)] = 0
    if key is not None and scene in (None, key):
        for place, address in _addresses(model, table, key).items():
            functions[place] = address
        _known[int(functions[calls.EVALUATION])] = key
    functions[list(calls.FUNCTIONS)] = list(map(native.library_function, calls.FUNCTIONS))
    table.code.fits[0] = functions[calls.EVALUATION] != 0


def known_structure(functions):
    """Return the structure that the evaluation of a scene has in a function table; or None."""
    return _known.get(int(functions[calls.EVALUATION]))


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
                and not len(table.cuts.index) and _NOT_IN_LANES.isdisjoint(table.kind.tolist()))


def addresses_in_lanes(model, tables):
    """
    Return the addresses of the evaluations of a scene in the lanes of a vector.

    By places of the function table, for one of the models and tables that ``fit_lanes``, one for
    each lane; None where they are not of one structure.
    """
    first = tables[0]
    key = structure(model, first)
    if any(structure(model, table) != key for table in tables if table is not first):
        return None
    return _addresses(model, first, key, LANES)


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
    return address_of_scene(model, structure(model, table), lambda: LiveLaws(
        table, calls.AT_REST), LANES, calls.ENERGIES)


def _addresses(model, table, key, form=SCALAR):
    """Return the addresses of the evaluations of a scene by place of the function table."""
    found = {calls.EVALUATION: address_of_scene(model, key, lambda: LiveLaws(table), form)}
    # Motions and cut joints would respond to friction, too.
    frictions = table.kind.tolist().count(JOINT_FRICTION)
    if frictions and PRESCRIBED_MOTION not in table.kind and not len(table.cuts.index):
        several = (calls.RESPONSES,) if 1 < frictions <= _MOST_FRICTIONS else ()
        for which in (calls.AT_REST, *several):
            found[which] = address_of_scene(
                model, (*key, which), partial(LiveLaws, table, which), form)
    return found
