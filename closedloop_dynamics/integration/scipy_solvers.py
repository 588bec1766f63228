# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""SciPy's solvers as the well-known yardstick: offline, interpreted, no projection inside."""

from copy import copy

import numpy as np

from .control import DONE, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS, STEP_TOO_SMALL
from ..engine import native

# A solver that needs more evaluations than this to the next output has lost its way.
MOST_EVALUATIONS = 100_000


class SciPySolver:
    """
    One of SciPy's solvers, as the engine calls it (``engine/host_steps.hpp``).

    It keeps its own state between outputs, on which nothing is projected; the
    stabilisation corrects what is handed out.
    """

    def __init__(self, of, name, stabilisation, tolerance):
        """Step with the present ``of.system``; the solver is made where the first step starts."""
        # Not before it is wanted: a third of the time that loading the package would take.
        from scipy import integrate
        self._of, self._solver_type = of, getattr(integrate, name)
        self._stabilisation, self._tolerance = stabilisation, tolerance
        self._solver = self._dense = None

    def copy(self):
        """Return another one, which has yet to start."""
        return copy(self)

    def advance(self, memory, origin, done, step_size, steps, restarts):
        """
        Advance a state.

        Parameters
        ----------
        memory : memoryview
            Of the state, which is advanced in place.
        origin, step_size : float
            Time of step 0, and the size of steps [s].
        done, steps : int
            Steps made since then, and to make.
        restarts : bool
            Whether the state, torques or equations are others than they were.

        Returns
        -------
        status : int
            Of ``integration.control``.
        elapsed : float
            Time advanced by [s].

        """
        state = np.frombuffer(memory)
        self._start = origin + done * step_size, state
        self._evaluations = 0
        if restarts:
            self._solver = self._dense = None
        target, engine = origin + (done + steps) * step_size, self._of.system.native
        status = self._step_to(target)
        if status != DONE:
            self._solver = self._dense = None
            return status, 0.0
        out = self._dense(target) if self._dense is not None else state.copy()
        if not native.stabilise(engine, self._stabilisation, out):
            return OPEN_LOOP, 0.0
        if not native.equations_suffice(engine, self._stabilisation, out):
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

    def _slope(self, time, state):
        out = np.empty(len(state))
        native.derivative(self._of.system.native, np.ascontiguousarray(state), out)
        # SciPy's solvers would go on, some of them for ever.
        self._evaluations += 1
        if self._evaluations > MOST_EVALUATIONS:
            raise _GaveUp
        if not (np.isfinite(out).all() and np.isfinite(state).all()):
            raise FloatingPointError
        return out


class _GaveUp(Exception):
    """Too many evaluations between two outputs."""
