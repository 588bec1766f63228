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

"""Whether a method that lets errors grow is still worth following."""

import math
import warnings

from .core.types import SINGULAR_COUNT
from .errors import ClosureError, NumericalError, SingularityError
from .integration.registry import ADAPTIVE, INTEGRATORS

# Steps between two looks; and where the method keeps energy and closure by itself.
LOOK_EVERY, LOOK_RARELY = 500, 5000
# Closure error, against the size of the mechanism, at which loops count as open.
OPEN = 1e-3
# Energy from nowhere, against the most that has ever moved, at which a motion is none any more.
ENERGY_LIMIT = 0.1
# Less energy than this share of all there is may be rounding.
ROUNDING = 1e-6
# What keeps the loops closed to rounding.
CLOSING = ('projection', 'independent')
# Methods of a lower order lose energy visibly at ordinary steps.
TRUSTED_ORDER = 4


class DriftGuard:
    """
    Looks now and then at energy and closure, more often where the method alone does not keep them.

    A method that does is warned of, once, where its steps do not follow the motion.

    Parameters
    ----------
    method : Method
        Of the scene.
    extent : float
        Size of the mechanism [m].

    Attributes
    ----------
    active : bool
        Whether to refuse what is found: not with projection and a method of order 4.

    """

    def __init__(self, method, extent):
        """Decide whether to look at all."""
        tableau = getattr(INTEGRATORS[method.integrator], 'tableau', None)
        coarse = tableau is not None and tableau.order < TRUSTED_ORDER
        self.active = coarse or method.stabilisation not in CLOSING
        self._method, self._extent = method, extent
        self.restart()

    def restart(self):
        """Forget what has been seen."""
        self._steps, self._start, self._most, self._warned = 0, None, 0.0, False

    @property
    def until_look(self):
        """Return the steps left until energy and closure are looked at."""
        return LOOK_EVERY - self._steps

    def look(self, simulation, steps):
        """
        Raise where the motion since the start has become meaningless.

        Parameters
        ----------
        simulation : Simulation
            After some steps.
        steps : int
            How many.

        Raises
        ------
        SingularityError
            Where a singular configuration was met without any stabilisation.
        ClosureError
            Where the loops have drifted apart.
        NumericalError
            Where energy appeared from nowhere.

        """
        method = self._method
        if method.stabilisation == 'none' and simulation.system.work.health[SINGULAR_COUNT] > 0.0:
            raise SingularityError(
                f'A singular configuration was met up to t = {simulation.time:.9g} s: closure '
                'equations vanish there, and with the drift that stabilisation: none allows the '
                'branch on which the mechanism goes on cannot be told. Take stabilisation: '
                'projection.')
        closure = simulation.closure
        if not closure <= OPEN * self._extent:
            raise ClosureError(
                f'The loops have drifted apart by {closure:.3g} m (or rad) at t = '
                f'{simulation.time:.9g} s: stabilisation: {method.stabilisation} does not close '
                'them again. Take stabilisation: projection, or a smaller step.')
        self._steps += steps
        if self._steps >= LOOK_EVERY:
            self._steps = 0
            problem = self._energy_problem(simulation)
            if problem:
                raise NumericalError(
                    f'{problem} Take integrator: rk4 and stabilisation: projection, or a smaller '
                    'step.')

    def count(self, simulation, steps):
        """
        Warn where a method that is trusted does not follow the motion.

        Parameters
        ----------
        simulation : Simulation
            After some steps.
        steps : int
            How many.

        """
        self._steps += steps
        if self._steps >= LOOK_RARELY and not self._warned:
            self._steps, first = 0, self._start is None
            problem = self._energy_problem(simulation)
            # At the first look it is not known yet how much energy moves.
            if problem and not first:
                self._warned = True
                warnings.warn(f'{problem} Take a smaller step, or integrator: dop853.',
                              RuntimeWarning, stacklevel=2)

    def _energy_problem(self, simulation):
        """Return in words what is wrong with the energy; empty where nothing is."""
        balance = simulation.energy_balance
        if self._start is None:
            self._start = balance.stored
        moved = balance.kinetic + abs(balance.dissipated) + abs(balance.work)
        self._most = max(self._most, moved + abs(balance.stored - self._start))
        residual = abs(balance.residual)
        allowed = max(ENERGY_LIMIT * self._most, ROUNDING * (moved + abs(balance.stored)))
        if math.isfinite(residual) and residual <= allowed:
            return ''
        method = self._method
        adaptive = INTEGRATORS[method.integrator].kind == ADAPTIVE
        setting = (f'tolerance {method.tolerance:g}' if adaptive
                   else f'steps of {method.step_size:g} s')
        return (
            f'{residual:.3g} J appeared from nowhere or vanished up to t = '
            f'{simulation.time:.9g} s, of {self._most:.3g} J that moved at most: '
            f'{method.integrator} with {setting} and stabilisation: {method.stabilisation} '
            'does not follow this motion.')
