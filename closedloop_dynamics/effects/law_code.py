# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of effects, each compiled by itself, from the symbols that the code of a scene is made of.

They act where that code does not (``scene_code``). One routine serves all effects of a kind,
whatever terms they have: a change of these compiles nothing.
"""

from . import live_laws
from .table import (
    ACTUATOR, END_STOP, JOINT_DAMPING, JOINT_FORCE_TABLE, JOINT_SPRING, ORIENTATION_SPRING,
    PRESCRIBED_TORQUE, SPATIAL_BODY_CONTACT, SPATIAL_BUSHING, SPATIAL_CONTACT, SPATIAL_FLUID_DRAG,
    SPATIAL_FORCE, SPATIAL_FORCE_TABLE, SPATIAL_POINT_SPRING, SPATIAL_PRESCRIBED_FORCE, TENDON,
    VALUE_COLUMNS)
from ..core.codegen import plane, space
from ..core.codegen.law_routine import addresses_of_laws, FIRST_BODY, JOINT, SECOND_BODY
from ..engine import native

_IN_JOINTS = (ACTUATOR, END_STOP, JOINT_DAMPING, JOINT_FORCE_TABLE, JOINT_SPRING,
              PRESCRIBED_TORQUE)
_IN_SPACE = (ORIENTATION_SPRING, SPATIAL_BODY_CONTACT, SPATIAL_BUSHING, SPATIAL_CONTACT,
             SPATIAL_FLUID_DRAG, SPATIAL_FORCE, SPATIAL_FORCE_TABLE, SPATIAL_POINT_SPRING,
             SPATIAL_PRESCRIBED_FORCE)
# The engine has the law of a tendon, which acts in any number of joints.
LAWS = {kind: law for kind, law in live_laws.ALONE.items() if kind != TENDON}
# At most so many numbers are in the entries of a law that reads them one by one.
_MOST_ENTRIES = 30


def link(table):
    """Give the engine the laws of the kinds in a table that it does not have itself."""
    known = addresses_of_laws({kind: (space if kind in _IN_SPACE else plane, _law(kind))
                               for kind in set(table.kind.tolist()) & LAWS.keys()}, VALUE_COLUMNS)
    for kind, address in known.items():
        native.keep_law(kind, address)


def _law(kind):
    """Return the law of a kind for ``core.codegen.law_routine.RowTrace``."""
    first, second = (JOINT, JOINT) if kind in _IN_JOINTS else (FIRST_BODY, SECOND_BODY)
    return lambda forces: LAWS[kind](
        forces, first, second, forces.numbers(0),
        live_laws.numbers_of_entries(forces, kind, _MOST_ENTRIES))
