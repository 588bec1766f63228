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

"""How a law of force is compiled: as what is called by its address, for one row of the table."""

from typing import NamedTuple

import numpy as np

from .table import EffectTable
from ..core.codegen.records import array_at, record_at
from ..core.compiled import merged, replaced


class Acting(NamedTuple):
    """The record that laws work on; see ``law``."""

    table: EffectTable
    body: np.ndarray
    tau: np.ndarray


def law(function):
    """
    Compile a law.

    It is compiled for scenes that list such an effect, once for all of them, and called by its
    address.

    Parameters
    ----------
    function : function
        Of the ``EffectTable``, the row of the effect; ``body``, shape (nb + 1, WORK_COLUMNS),
        after ``kinematics.outward``, whose bias forces it may reduce; joint coordinates and
        rates, shape (nv + nk,), those of cut joints that anything acts in behind; commanded
        torques, shape (nv + nk,).

    """
    kernel = merged(function)

    def called(address, row, count, first, second):
        acting = record_at(address)
        kernel(acting.table, row, acting.body, array_at(first, count), array_at(second, count),
               acting.tau)
        return 1

    return replaced(function, called)
