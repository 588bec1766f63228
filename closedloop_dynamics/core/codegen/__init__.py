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
    ALWAYS, BODY, LEAST_FORCES, LEFT_OUT, LOOP_EQUATIONS, OF_FORCES, REACTIONS, REFINED, WRENCHES)
from .machine_code import announced_by
from .routines import addresses, unrolled_size

__all__ = ['ALWAYS', 'announced_by', 'LEAST_FORCES', 'LEFT_OUT', 'link', 'LOOP_EQUATIONS',
           'OF_FORCES', 'REACTIONS', 'REFINED', 'relink', 'unrolled_size', 'WRENCHES']


def link(model, table, which=ALWAYS, joints=None):
    """
    Give a function table routines of a model, by their places in it.

    ``joints`` are for LEAST_FORCES and LEFT_OUT.
    """
    for place, address in addresses(model, which, joints=joints).items():
        table[place] = address


def relink(model, table, joints=None, but=()):
    """
    Replace the routines of a function table, when the structure of the model has changed.

    Those at the places ``but`` are left as they are.
    """
    link(model, table, tuple(
        one for one in np.flatnonzero(table[:BODY]).tolist() if one not in but), joints)
