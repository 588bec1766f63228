# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Steps over a period, and their derivatives, that other programs call by address."""

from typing import NamedTuple

from ..engine.status import OPEN_LOOP
from ..simulation.stepper import ENDS, Stepper

# The engine returns 16 times the number of the state, plus a status.
STATUSES = 16
# What failed, by status.
WORDS = {**{status: words for status, (_, words) in ENDS.items()},
         OPEN_LOOP: 'it leaves the loops open, or they cannot be closed after the step'}


class Shapes(NamedTuple):
    """Lengths of q, qd and the torques of the actuated joints."""

    q: int
    qd: int
    torque: int


class CallableSteps:
    """
    The step of a model over a period, for programs that call the engine without Python.

    Parameters are those of ``Stepper``. ``shapes``: of the three inputs; ``address``: of the
    steps; ``step``, ``change`` and ``weight``: addresses of functions of rows, as
    callable.hpp has them. It is alive as long as anything calls these.
    """

    def __init__(self, model, period, method='rk4', steps=None):
        stepper = Stepper(model, period, method=method, steps=steps, jacobians=False)
        self._stepper = stepper
        self.shapes = Shapes(stepper.q.size, stepper.qd.size, stepper.tau.size)
        self._kept, addresses = stepper.called_by_address()
        self.address, self.step, self.change, self.weight = addresses

    def failure(self, code, q, qd):
        """Return words for a code other than 0, and the state that it is of."""
        return f'{failure(code)}{opened(self._stepper.simulation.data, code, q, qd)}'

    def __repr__(self):
        """Show the step."""
        return repr(self._stepper)


def opened(data, code, q, qd):
    """Return which loops a state leaves open, if that is what failed, behind a colon."""
    found = code % STATUSES == OPEN_LOOP and data.assembler.opened(
        q, qd, data.system.settings.closure_limit)
    return f': {found}' if found else ''


def failure(code):
    """Return the exception for a code other than 0 that a function of rows returned."""
    kind, _ = ENDS.get(code % STATUSES, (RuntimeError, None))
    return kind(f'state {code // STATUSES}: {WORDS.get(code % STATUSES, "it failed")}')
