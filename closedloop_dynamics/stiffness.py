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
Whether explicit steps of a size can be stable, and what to say where they cannot.

The fastest rate of the motion, the largest eigenvalue of the derivative's
Jacobian J, is estimated by a power iteration on differences of the derivative, J v =
(f(y + e v) - f(y)) / e. It is taken in pairs, J J v, as oscillations have conjugate pairs
of eigenvalues. States of effects take part where the motion depends on them: a bristle that
sticks is a spring, the lag of a drive a rate of its own.

"""

from dataclasses import dataclass
import math

import numpy as np

from .errors import StiffnessError
from .integration.registry import EXPLICIT, FIXED, INTEGRATORS
from .integration.system import derivative

# Step size times fastest rate at which the explicit methods leave stability, along the
# imaginary axis (springs without damping) or the negative real one (dampers).
STABILITY_LIMITS = {'semi_implicit_euler': 2.0, 'heun': 2.0, 'rk4': 2.78}
# Error-controlled explicit methods stay stable by taking steps as small as it needs; more than
# this many of them for one step of the raster is no simulation but a standstill.
MOST_SMALL_STEPS = 3000.0
# Steps between two looks.
LOOK_EVERY = 100
PAIRS = 4
DIFFERENCE = 1e-7
# Energy that appears from nowhere, relative to all that moves, between two looks.
ENERGY_TOLERANCE = 0.1


def fastest_rate(system, state, own=()):
    """
    Estimate the largest eigenvalue, in magnitude, of the derivative's Jacobian.

    Parameters
    ----------
    system : System
        What moves.
    state : ndarray, shape (ns,)
        Where.
    own : sequence of int
        Places, among the effects' states, of those that act back on the motion, such as the
        stretch of a bristle or the lag of a drive; dissipated energy and work do not.

    Returns
    -------
    float
        [1/s].

    """
    nv = len(system.qdd)
    silent = np.ones(len(state), dtype=bool)
    silent[:2 * nv] = False
    silent[2 * nv + np.array(own, dtype=int)] = False
    slope, moved = np.zeros_like(state), np.zeros_like(state)
    derivative(system, state.copy(), slope)
    direction = np.random.default_rng(0).normal(size=len(state))
    direction[silent] = 0.0

    def turned(vector):
        size = DIFFERENCE / max(np.abs(vector).max(), 1e-300)
        derivative(system, state + size * vector, moved)
        result = (moved - slope) / size
        result[silent] = 0.0
        return result

    rate = 0.0
    for _ in range(PAIRS):
        norm = np.linalg.norm(direction)
        if not (math.isfinite(norm) and norm > 0.0):
            return rate
        direction = turned(turned(direction / norm))
        rate = math.sqrt(np.linalg.norm(direction))
    return rate


@dataclass
class Look:
    """
    Where a simulation stood when the guard looked at it.

    Attributes
    ----------
    balance : effects.accounts.EnergyBalance
    state : ndarray, shape (ns,)
        A copy.
    time : float
        [s].
    steps : int
        Made since.

    """

    balance: object
    state: np.ndarray
    time: float
    steps: int = 0


class StiffnessGuard:
    """
    Refuses explicit steps that cannot be stable, before and while they are made.

    Parameters
    ----------
    system : System
    method : Method
    own : sequence of int
        As for ``fastest_rate``.

    Attributes
    ----------
    active : bool
        Whether to look while the steps are made: a fixed-step explicit method, and effects
        with force laws of their own.

    """

    def __init__(self, system, method, own=()):
        """Decide whether to look at all."""
        integrator = INTEGRATORS[method.integrator]
        self._system, self._name, self._own = system, method.integrator, own
        self._fixed = integrator.kind == FIXED
        self._limit = STABILITY_LIMITS.get(
            method.integrator, math.inf if self._fixed else 3.0 * MOST_SMALL_STEPS)
        self._explicit = integrator.family == EXPLICIT and system.effects is not None
        self.active = self._explicit and self._fixed

    def stable(self, state, step_size):
        """Return whether steps of ``step_size`` from ``state`` can be stable."""
        return not self._explicit or self.rate(state) * step_size <= self._limit

    def rate(self, state):
        """Return the fastest rate of the motion in a state [1/s]."""
        return fastest_rate(self._system, state, self._own)

    def check(self, state, step_size):
        """
        Raise where steps of ``step_size`` from ``state`` cannot be stable.

        Raises
        ------
        StiffnessError

        """
        if not self.stable(state, step_size):
            raise StiffnessError(self.message(self.rate(state), step_size))

    def message(self, rate, step_size):
        """Return what to say of a rate that is too fast for the step."""
        if not self._fixed:
            return (f'The scene is stiff: its fastest motion has a rate of about {rate:.3g} 1/s, '
                    f'which {self._name} follows with steps up to {3.0 / rate:.3g} s only, '
                    f'{rate * step_size / 3.0:.2g} of them for each step of {step_size:g} s. Take '
                    'integrator: rodas4, or softer springs, dampers and contacts.')
        return (f'The scene is stiff: its fastest motion has a rate of about {rate:.3g} 1/s, for '
                f'which {self._name} is stable with steps up to {self._limit / rate:.3g} s only; '
                f'the step is {step_size:g} s. Take integrator: rodas4 (or rodas4_fixed), which '
                'keeps its step, a smaller step, or softer springs, dampers and contacts.')

    def check_energy(self, before, after, state, step_size):
        """
        Raise where energy has appeared from nowhere between two looks.

        Parameters
        ----------
        before, after : EnergyBalance
            At the two looks.
        state : ndarray, shape (ns,)
            After it.
        step_size : float
            [s].

        Raises
        ------
        StiffnessError

        """
        change = abs(after.residual - before.residual)
        moving = (before.kinetic + abs(after.stored - before.stored)
                  + abs(after.dissipated - before.dissipated) + abs(after.work - before.work))
        if math.isfinite(change) and change <= ENERGY_TOLERANCE * moving + 1e-9:
            return
        rate = self.rate(state)
        raise StiffnessError(
            f'{change:.3g} J appeared from nowhere within {LOOK_EVERY} steps: the steps of '
            f'{step_size:g} s are too large for a stiff contact, stop or spring of the scene'
            + (f' (fastest rate about {rate:.3g} 1/s, for which {self._name} is stable with steps '
               f'up to {self._limit / rate:.3g} s)' if rate > 0.0 else '')
            + '. The state before it is kept. Take integrator: rodas4, or a smaller step.')
