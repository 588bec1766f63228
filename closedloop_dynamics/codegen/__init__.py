# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Code generated for one mechanism.

The recursions over the bodies are written once, in space (``spatial``), and run on symbols
(``expression_graph``); a mechanism in the plane (``plane``) reduces them to its own. The
arithmetic that is left is compiled (``emit``) to routines that the engine calls by their address
(``function_table``): a whole evaluation of a mechanism of a few bodies (``routines``), or its
kernels for each kind of body, which the engine's loops over bodies call (``joint_kernels``).
"""

import numpy as np

from .function_table import (
    ALWAYS, BODY, EVALUATION, LEAST_FORCES, LEFT_OUT, LOOP_EQUATIONS, MOTION, OF_BRANCHES,
    OF_FORCES, OF_SCENE, REACTIONS, REFINED, TORQUE_RESPONSE, WRENCHES)
from .machine_code import announced_by, PLACES
from .routines import addresses, unrolled_size, with_torque_response
from .space import is_spatial

__all__ = ['ALWAYS', 'announced_by', 'can_be_unrolled', 'EVALUATION', 'LEAST_FORCES',
           'LEFT_OUT', 'link', 'MOST_UNROLLED_OPERATIONS', 'MOTION', 'OF_BRANCHES',
           'OF_FORCES', 'OF_SCENE', 'REACTIONS', 'REFINED', 'relink', 'TORQUE_RESPONSE',
           'unrolled_size', 'WRENCHES']

# Unrolled code is three to twenty times as fast as loops over bodies. It grows with the mechanism:
# up to so many operations of an evaluation, as they are traced, it is compiled in fifteen seconds
# at most, once. In the plane, 0.02 rad beside the flat position of 40 loops in a row, its
# accelerations are off by 8e-6 m/s^2, those by loops over bodies by 4e-8.
MOST_UNROLLED_OPERATIONS, MOST_UNROLLED_IN_PLANE = 50_000, 4_000
# A link of a chain in the plane takes more.
LEAST_OPERATIONS_OF_A_JOINT = 30


def link(model, table, which=ALWAYS, joints=None):
    """
    Give a function table routines of a model, by their places in it.

    ``joints`` are for LEAST_FORCES and LEFT_OUT.
    """
    found = with_torque_response(model) if TORQUE_RESPONSE in which else {}
    others = tuple(one for one in which if one not in (*found, TORQUE_RESPONSE, LOOP_EQUATIONS))
    found |= addresses(model, others, joints=joints)
    if LOOP_EQUATIONS in which:
        found |= addresses(model, (LOOP_EQUATIONS,), PLACES)
    for place, address in found.items():
        table[place] = address


def can_be_unrolled(model):
    """Return whether the routines of a mechanism are small enough to be compiled."""
    most = MOST_UNROLLED_OPERATIONS if is_spatial(model) else MOST_UNROLLED_IN_PLANE
    if LEAST_OPERATIONS_OF_A_JOINT * len(model.tree) > most:
        # Tracing would take long, and end with this, too.
        return False
    return unrolled_size(model, MOST_UNROLLED_OPERATIONS) <= most


def relink(model, table, joints=None, but=()):
    """
    Replace the routines of a function table, when the structure of the model has changed.

    Those at the places ``but`` are left as they are; TORQUE_RESPONSE goes, as there is room for
    the factors of the former structure.
    """
    table[TORQUE_RESPONSE] = 0
    link(model, table, tuple(
        one for one in np.flatnonzero(table[:BODY]).tolist() if one not in but), joints)
