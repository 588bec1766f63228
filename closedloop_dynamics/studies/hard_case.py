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

"""What a hard case is, and how it is judged."""

from dataclasses import dataclass
import math
from typing import Callable

from ..simulation.errors import SimulationError

ACCURATE, DEGRADED, REFUSED, UNSTABLE, SKIPPED = (
    'accurate', 'degraded but stable', 'refused with reason', 'unstable', 'not run')


@dataclass(frozen=True)
class Case:
    """
    One hard case.

    Attributes
    ----------
    name : str
    group : str
        Heading that it belongs to.
    text : str
        What is hard, and what counts: two lines at most.
    figure : str
        What its number is, with its unit.
    accurate, stable : float
        Up to which figure a result counts as accurate, and as degraded but stable.
    run : callable
        Takes (method, quick); returns the worst figure. May raise SimulationError: refused.
    lengths : str
        How much is run, in full and with ``quick``, parted by a slash; empty where it is the same.

    """

    name: str
    group: str
    text: str
    figure: str
    accurate: float
    stable: float
    run: Callable
    lengths: str = ''


@dataclass(frozen=True)
class Outcome:
    """
    What became of one case with one method.

    Attributes
    ----------
    status : str
        ``ACCURATE``, ``DEGRADED``, ``REFUSED``, ``UNSTABLE`` or ``SKIPPED``.
    figure : float
        The worst one; NaN where refused or not run.
    note : str
        The reason where refused.

    """

    status: str
    figure: float
    note: str = ''


def judge(case, method, quick):
    """
    Run one case with one method.

    Parameters
    ----------
    case : Case
        What to run.
    method : scene_records.Method
        What to run it with.
    quick : bool
        Fewer trials, shorter runs.

    Returns
    -------
    Outcome

    """
    try:
        figure = float(case.run(method, quick))
    except SimulationError as error:
        return Outcome(REFUSED, math.nan, f'{type(error).__name__}: {error}')
    # A NaN is no smaller than anything.
    if figure <= case.accurate:
        return Outcome(ACCURATE, figure)
    if figure <= case.stable:
        return Outcome(DEGRADED, figure)
    return Outcome(UNSTABLE, figure, 'the figure is out of bounds, and nothing was said')
