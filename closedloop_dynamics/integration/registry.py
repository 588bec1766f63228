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
The integrators and stabilisations that a scene can name.

A new explicit method is a tableau and one line here.

"""

from typing import NamedTuple

import numpy as np

from . import projection
from .tableau import DOP853, DOPRI5, HEUN, RK4, Tableau

FIXED, ADAPTIVE = 'fixed step', 'adaptive'


class Integrator(NamedTuple):
    """
    An integrator by name.

    Attributes
    ----------
    kind : str
        ``FIXED``: takes steps of ``step_size``; ``ADAPTIVE``: chooses its steps to keep the
        local error below ``tolerance``.
    tableau : Tableau
    summary : str
        One line for people.

    """

    kind: str
    tableau: Tableau
    summary: str


_EULER = Tableau(np.zeros((1, 1)), np.zeros(0), np.zeros((2, 1)), np.zeros((1, 0)), 1, 0)

INTEGRATORS = {
    'semi_implicit_euler': Integrator(FIXED, _EULER, 'order 1, one evaluation a step'),
    'heun': Integrator(FIXED, HEUN, 'order 2, two evaluations a step'),
    'rk4': Integrator(FIXED, RK4, 'order 4, four evaluations a step'),
    'dopri5': Integrator(ADAPTIVE, DOPRI5, 'order 5(4), error control, dense output'),
    'dop853': Integrator(ADAPTIVE, DOP853, 'order 8(5,3), error control, dense output'),
}

STABILISATIONS = {
    'none': projection.NONE,
    'baumgarte': projection.BAUMGARTE,
    'velocity_projection': projection.VELOCITY,
    'projection': projection.PROJECTION,
}
