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
Kernels unrolled for the topology of one mechanism.

The loops of ``core`` serve every planar mechanism; one of a few bodies spends most of its time
in them on indices. Here an evaluation is run once on symbols (``tape``): the recursions over the
bodies are those in space (``spatial``), which a mechanism in the plane reduces to its own
(``plane``); the elimination is that of the loops. The arithmetic that is left behind is compiled
(``emit``) to routines that compiled code calls by their address (``linkage``): one more second at
the first start, a third of the time ever after.

"""

from .linkage import ALWAYS, available, REFINED, take

__all__ = ['available', 'later', 'relink']


def relink(model, linkage):
    """
    Give a linkage the routines of a model, also when its topology has changed.

    Parameters
    ----------
    model : core.types.Model
        Constant arrays of the mechanism.
    linkage : ndarray of int
        Changed in place.

    """
    # Here, as there may be no compiler.
    from .routines import addresses
    take(linkage, addresses(model, ALWAYS))


def later(model, place):
    """
    Return the addresses of a model's routines that are not compiled before they are called.

    Parameters
    ----------
    model : core.types.Model
        Constant arrays of the mechanism.
    place : int
        Of one of them in the linkage; those with refinement come together.

    Returns
    -------
    dict of int to int

    """
    # Here, as there may be no compiler.
    from .routines import addresses
    return addresses(model, REFINED if place in REFINED else (place,))
