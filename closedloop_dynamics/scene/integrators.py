# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The integrators and stabilisations that a scene can name.

A new explicit method is a tableau and one line here. Nothing is compiled for it: launch files
read the names.
"""

from typing import NamedTuple, Optional

import numpy as np

from .tableau import DOP853, DOPRI5, HEUN, RK4, Tableau

FIXED, ADAPTIVE = 'fixed step', 'adaptive'
EXPLICIT, ROSENBROCK, SWITCHING = 'explicit', 'rosenbrock', 'switching'
# The default.
AUTO = 'auto'
# Order of RODAS4.
ROSENBROCK_ORDER = 4


class Integrator(NamedTuple):
    """An integrator by name."""

    # ``FIXED``: takes steps of ``step_size``; ``ADAPTIVE``: chooses its steps to keep the
    # local error below ``tolerance``.
    kind: str
    summary: str  # One line for people
    family: str  # ``EXPLICIT``, ``ROSENBROCK`` (stiff) or ``SWITCHING`` (between the two)
    stepper: str  # Its name in the engine (``engine/stepper.cpp``)
    tableau: Optional[Tableau] = None  # Of an explicit method

    @property
    def order(self):
        """Return the order of a method that can take fixed steps."""
        return self.tableau.order if self.tableau else ROSENBROCK_ORDER


_EULER = Tableau(np.zeros((1, 1)), np.zeros(0), np.zeros((2, 1)), np.zeros((1, 0)), 1, 0)

INTEGRATORS = {
    AUTO: Integrator(
        ADAPTIVE, 'keeps an accuracy: dop853, and dopri5 or rodas4 where cheaper', SWITCHING,
        'auto', DOP853),
    'semi_implicit_euler': Integrator(
        FIXED, 'order 1, one evaluation a step', EXPLICIT, 'fixed', _EULER),
    'heun': Integrator(FIXED, 'order 2, two evaluations a step', EXPLICIT, 'fixed', HEUN),
    'rk4': Integrator(FIXED, 'order 4, four evaluations a step', EXPLICIT, 'fixed', RK4),
    'dopri5': Integrator(
        ADAPTIVE, 'order 5(4), error control, dense output', EXPLICIT, 'explicit', DOPRI5),
    'dop853': Integrator(
        ADAPTIVE, 'order 8(5,3), error control, dense output', EXPLICIT, 'explicit', DOP853),
    'rodas4': Integrator(
        ADAPTIVE, 'stiff, L-stable, order 4(3), error control', ROSENBROCK, 'rodas4'),
    'rodas4_fixed': Integrator(FIXED, 'stiff, L-stable, order 4', ROSENBROCK, 'rodas4_fixed'),
}
# Integrators of earlier versions, and what does the same as well or better.
FORMER_INTEGRATORS = {'scipy_dop853': 'dop853', 'scipy_radau': 'rodas4', 'scipy_lsoda': AUTO}

# Baumgarte's terms are part of the accelerations; all others act after a step.
NONE, BAUMGARTE, VELOCITY, PROJECTION, INDEPENDENT = range(5)
STABILISATIONS = {
    'none': NONE,
    'baumgarte': BAUMGARTE,
    'velocity_projection': VELOCITY,
    'projection': PROJECTION,
    'independent': INDEPENDENT,
}
