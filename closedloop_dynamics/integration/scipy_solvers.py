# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""SciPy's solvers as the well-known yardstick: offline, interpreted, no projection inside."""

import math
from types import SimpleNamespace

import numpy as np

from .control import DONE, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS, STEP_TOO_SMALL
from ..engine import native

# A solver that needs more evaluations than this to the next output has lost its way.
MOST_EVALUATIONS = 100_000


class SciPySolver:
    """
    One of SciPy's solvers behind the interface of the drivers.

    It keeps its own state between outputs, on which nothing is projected; the
    stabilisation corrects what is handed out.
    """

    def __init__(self, system, name, stabilisation, tolerance):
        """Start with nothing; the solver is made where the first step starts."""
        # Not before it is wanted: a third of the time that loading the package would take.
        from scipy import integrate
        self._system = system
        self._solver_type = getattr(integrate, name)
        self._stabilisation, self._tolerance = stabilisation, tolerance
        self._solver = self._dense = None

    def advance(self, state, origin, done, step_size, steps):
        """Advance a state by ``steps`` times ``step_size``; see ``Stepper.advance``."""
        target = origin + (done + steps) * step_size
        self._start = origin + done * step_size, state
        self._evaluations = 0
        status = self._step_to(target)
        if status != DONE:
            self.restart()
            return status, 0.0
        out = self._dense(target) if self._dense is not None else state.copy()
        if not native.stabilise(self._system.native, self._stabilisation, out):
            return OPEN_LOOP, 0.0
        if not native.equations_suffice(self._system.native, self._stabilisation, out):
            return POOR_EQUATIONS, 0.0
        state[:] = out
        return DONE, steps * step_size

    def _step_to(self, target):
        """Advance the solver past a time; its own steps need not end there."""
        try:
            if self._solver is None:
                time, state = self._start
                self._solver = self._solver_type(
                    self._slope, time, state.copy(), np.inf, rtol=max(self._tolerance, 3e-14),
                    atol=self._tolerance)
            while self._solver.t < target:
                self._solver.step()
                if self._solver.status == 'failed':
                    return STEP_TOO_SMALL
                self._dense = self._solver.dense_output()
        except FloatingPointError:
            return NOT_FINITE
        except _GaveUp:
            return STEP_TOO_SMALL
        return DONE

    def rebind(self, system):
        """Step with a system that works on other equations."""
        self._system = system

    def go_on(self):
        """Restart with the next call, which is the same again."""
        self.restart()

    # The engine leaves the steps to Python; nothing outlasts ``restart``, or is known of steps.
    native, memory = None, np.zeros(0)
    report = SimpleNamespace(**dict.fromkeys(('accepted', 'accuracy'), math.nan))

    def clear_report(self):
        """Count from here on: nothing."""

    def restart(self, moved=False):
        """Forget the past: torques, or with ``moved`` the state have changed."""
        self._solver = self._dense = None

    def rewind(self):
        """Begin as a new driver would."""
        self.restart()

    def _slope(self, time, state):
        out = np.empty(len(state))
        native.derivative(self._system.native, np.ascontiguousarray(state), out)
        # SciPy's solvers would go on, some of them for ever.
        self._evaluations += 1
        if self._evaluations > MOST_EVALUATIONS:
            raise _GaveUp
        if not (np.isfinite(out).all() and np.isfinite(state).all()):
            raise FloatingPointError
        return out


class _GaveUp(Exception):
    """Too many evaluations between two outputs."""
