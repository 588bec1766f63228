# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Code generated for one mechanism.

The recursions over the bodies are written once, in space (``spatial``), and run on symbols
(``expression_graph``); a mechanism in the plane (``plane``) reduces them to its own. The
arithmetic that is left is compiled (``emit``) to routines that the engine calls by their address
(``function_table``): a whole evaluation of a mechanism of a few bodies (``routines``), or its
stages for each kind of body, which the engine's loops over bodies call (``pieces``).

"""

import numpy as np

from .function_table import ALWAYS, BODY, REACTIONS, REFINED
from .routines import addresses

__all__ = ['ALWAYS', 'link', 'REACTIONS', 'REFINED', 'relink']


def link(model, table, which=ALWAYS):
    """
    Give a function table routines of a model.

    Parameters
    ----------
    model : core.types.Model
        Constant arrays of the mechanism.
    table : ndarray of int
        Changed in place.
    which : tuple of int
        Places of the routines in it.

    """
    for place, address in addresses(model, which).items():
        table[place] = address


def relink(model, table):
    """
    Replace the routines of a function table, when the structure of the model has changed.

    Parameters
    ----------
    model, table
        As for ``link``.

    """
    link(model, table, tuple(np.flatnonzero(table[:BODY]).tolist()))
