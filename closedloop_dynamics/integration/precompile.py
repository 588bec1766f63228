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

"""The rank-revealing path ahead of time: whether it is on disk, and getting it ready."""

from .evaluation import apply_listed
from ..core import compiled, kinematics, rank_revealing


def is_stored(system):
    """
    Tell whether the kernels of the rank-revealing path are on disk.

    Parameters
    ----------
    system : System
        What moves.

    Returns
    -------
    bool

    """
    return all(compiled.is_stored(kernel, signature)
               for kernel, signature in _kernels(system))


def preparations(system):
    """
    Return what gets the kernels of the rank-revealing path ready, from disk if they are there.

    Parameters
    ----------
    system : System
        What moves.

    Returns
    -------
    list of callables
        One for each kernel; empty where nothing is compiled at all.

    """
    return [lambda kernel=kernel, signature=signature: kernel.compile(signature)
            for kernel, signature in _kernels(system)]


def _kernels(system):
    """Return the kernels with the types that they are called with."""
    if not hasattr(rank_revealing.accelerate, 'compile'):
        return []
    from numba import typeof
    model, work, q, qdd = system.model, system.work, system.qdd, system.qdd
    manifold, effects = system.manifold, system.effects
    calls = [
        (kinematics.outward, (model, q, q, work)),
        (rank_revealing.accelerate,
         (model, work, system.applied, 0.0, 0.0, manifold, q, q, qdd, system.lam)),
        (rank_revealing.correct, (model, work, rank_revealing.POSITION, qdd))]
    if effects is not None:
        calls.append((apply_listed, (manifold, effects, work, q, q, system.tau)))
    return [(kernel, tuple(typeof(each) for each in arguments)) for kernel, arguments in calls]
