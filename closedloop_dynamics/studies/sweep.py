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

"""Which methods a study tries, and with which step sizes or tolerances."""

from dataclasses import dataclass, replace

from ..integration.registry import ADAPTIVE, INTEGRATORS, STABILISATIONS
from ..simulation.scene_records import FORMULATIONS

DEFAULT_INTEGRATOR, DEFAULT_STABILISATION, DEFAULT_FORMULATION = 'rk4', 'projection', 'subsystem'

# Shares of the time between two outputs. Where a step covers several, they are compared alone.
STEP_SHARES = (5, 2, 1, 1 / 2, 1 / 5, 1 / 10, 1 / 20, 1 / 50, 1 / 100, 1 / 200, 1 / 500, 1 / 1000,
               1 / 2000)
TOLERANCES = tuple(10.0 ** -k for k in range(2, 14))
QUICK_STEP_SHARES = (2, 1, 1 / 2, 1 / 5, 1 / 10, 1 / 20, 1 / 50, 1 / 100)
QUICK_TOLERANCES = tuple(10.0 ** -k for k in range(3, 13, 2))


@dataclass(frozen=True)
class Line:
    """One line of a work-precision diagram: a method but for its step size or tolerance."""

    integrator: str
    stabilisation: str = DEFAULT_STABILISATION
    formulation: str = DEFAULT_FORMULATION

    @property
    def adaptive(self):
        """Whether the integrator takes a tolerance instead of a step size."""
        return INTEGRATORS[self.integrator].kind == ADAPTIVE

    def __str__(self):
        """Return the names of what the line is made of."""
        return f'{self.integrator}, {self.stabilisation}, {self.formulation}'


def default_lines():
    """
    Return what there is to choose from, one thing varied at a time.

    Returns
    -------
    list of Line
        Every integrator with full projection; RK4 with every stabilisation; RK4 in every
        formulation.

    """
    lines = [Line(integrator) for integrator in INTEGRATORS]
    lines += [Line(DEFAULT_INTEGRATOR, stabilisation=name) for name in STABILISATIONS]
    lines += [Line(DEFAULT_INTEGRATOR, formulation=name) for name in FORMULATIONS]
    return list(dict.fromkeys(lines))


@dataclass(frozen=True)
class Setting:
    """
    A method to be measured.

    Attributes
    ----------
    line : Line
    value : float
        Its step size [s], or its tolerance.
    steps, stride : int
        Steps from one compared output to the next, and outputs that lie between these
        (1: all of them are compared).

    """

    line: Line
    value: float
    steps: int
    stride: int

    def method(self, scene, interval):
        """Return the scene's method with this setting; ``interval`` is that of outputs [s]."""
        line = self.line
        keys = {'step_size': interval, 'tolerance': self.value} if line.adaptive else {
            'step_size': self.value}
        return replace(
            scene.method, integrator=line.integrator, stabilisation=line.stabilisation,
            formulation=line.formulation, baumgarte_time_constant=None, **keys)


def settings(line, interval, quick=False):
    """
    Return the settings of a line, from coarse to fine.

    Parameters
    ----------
    line : Line
        What they have in common.
    interval : float
        Time between two outputs [s].
    quick : bool
        Fewer of them.

    """
    if line.adaptive:
        return [Setting(line, tolerance, 1, 1)
                for tolerance in (QUICK_TOLERANCES if quick else TOLERANCES)]
    return [Setting(line, interval * share, max(1, round(1 / share)), max(1, round(share)))
            for share in (QUICK_STEP_SHARES if quick else STEP_SHARES)]
