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

"""How well posed the equations of motion are where a simulation stands."""

from dataclasses import dataclass

from .core.types import (
    CLOSURE, EVALUATIONS, PROJECTION_ITERATIONS, RANK, RANK_REVEALING_COUNT, SMALLEST_PIVOT,
    SMALLEST_PIVOT_EVER)

# Smallest pivots below this (about 2 degrees from a singular configuration) are worth a
# warning: forces grow with the inverse distance, errors of the input with them.
WARN_BELOW = 1e-3


@dataclass(frozen=True)
class Health:
    """
    Condition of the latest evaluation, and of all since the last reset.

    Attributes
    ----------
    smallest_pivot : float
        Of the block elimination, relative to the largest diagonal entry of its cut point: about
        the squared sine of the angle between one closure equation and the others. 1: as
        independent as can be; 0: dependent, or a link without inertia.
    smallest_pivot_ever : float
        Since the last reset.
    rank : int
        Closure equations that took part.
    equations : int
        All closure equations.
    rank_revealing_count : int
        Evaluations since the last reset that took the rank-revealing path.
    evaluations : int
        All evaluations since the last reset.
    projection_iterations : int
        Corrections of the positions after the latest step.
    closure : float
        Closure error that projection left after the latest step [m or rad].

    """

    smallest_pivot: float
    smallest_pivot_ever: float
    rank: int
    equations: int
    rank_revealing_count: int
    evaluations: int
    projection_iterations: int
    closure: float

    @property
    def unique_forces(self):
        """Whether the constraint forces are the only ones possible, not just the least."""
        return self.rank == self.equations

    @property
    def near_singular(self):
        """Whether constraint forces deserve a warning: they are about to lose their meaning."""
        return not self.smallest_pivot >= WARN_BELOW

    def __str__(self):
        """Return the record in words, one line for each thing worth knowing."""
        lines = [f'smallest pivot {self.smallest_pivot:.2g} (worst {self.smallest_pivot_ever:.2g})'
                 f', closure {self.closure:.2g} after {self.projection_iterations} corrections, '
                 f'{self.rank_revealing_count} of {self.evaluations} evaluations rank-revealing']
        if not self.unique_forces:
            lines.append(
                f'the constraint forces are not unique: {self.equations - self.rank} of '
                f'{self.equations} closure equations depend on the others; the least forces '
                'that give the motion are shown')
        elif self.near_singular:
            lines.append('a singular configuration is near: constraint forces may be very large, '
                         'and small errors of the state show in them')
        return '\n'.join(lines)


def health_of(work, equations):
    """
    Return the record of a workspace.

    Parameters
    ----------
    work : core.types.Workspace
        After an evaluation.
    equations : int
        Number of closure equations.

    Returns
    -------
    Health

    """
    values = work.health
    return Health(
        smallest_pivot=float(values[SMALLEST_PIVOT]),
        smallest_pivot_ever=float(values[SMALLEST_PIVOT_EVER]),
        rank=int(values[RANK]), equations=equations,
        rank_revealing_count=int(values[RANK_REVEALING_COUNT]),
        evaluations=int(values[EVALUATIONS]),
        projection_iterations=int(values[PROJECTION_ITERATIONS]),
        closure=float(values[CLOSURE]))
