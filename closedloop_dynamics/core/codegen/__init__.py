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
arithmetic that is left is compiled (``emit``) to routines that compiled code calls by their
address (``function_table``): a whole evaluation of a mechanism of a few bodies (``routines``), or
its stages for each kind of body, which the loops over bodies in ``core`` call (``pieces``).

"""

from .function_table import ALWAYS, available, REACTIONS, REFINED, take

__all__ = ['available', 'later', 'REACTIONS', 'REFINED', 'relink']


def relink(model, table):
    """
    Give a function table the routines of a model, also when its topology has changed.

    Parameters
    ----------
    model : core.types.Model
        Constant arrays of the mechanism.
    table : ndarray of int
        Changed in place.

    """
    # Here, as there may be no compiler.
    from .routines import addresses
    take(table, addresses(model, ALWAYS))


def later(model, place):
    """
    Return the address of a model's routine that is not compiled before it is called.

    Parameters
    ----------
    model : core.types.Model
        Constant arrays of the mechanism.
    place : int
        Of ``function_table.LATER``.

    Returns
    -------
    int

    """
    # Here, as there may be no compiler.
    from .routines import addresses
    return addresses(model, (place,))[place]
