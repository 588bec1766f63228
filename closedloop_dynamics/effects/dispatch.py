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
From a row of the table to its law: the one place where the compiled laws come together.

A new law is one branch of ``apply``. Only listed effects are visited.

"""

from . import (
    actuator, contact, end_stop, external_force, joint_damping, joint_friction, joint_spring,
    point_spring)
from .table import FIRST, STATE
from ..core.compiled import compiled


@compiled
def apply(body, table, q, qd, tau):
    """
    Apply all effects that are switched on.

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``kinematics.outward``. Forces at points reduce the bias force, columns FZ to FY.
    table : EffectTable
        ``states`` is read; ``applied`` (commands and joint torques), ``rates`` and ``output``
        are written.
    q, qd : ndarray, shape (nv,)
        Joint coordinates and rates.
    tau : ndarray, shape (nv,)
        Commanded joint torques [N m] and forces [N].

    """
    for i in range(tau.shape[0]):
        table.applied[i] = tau[i]
    for k in range(table.rates.shape[0]):
        table.rates[k] = 0.0
    for row in range(table.kind.shape[0]):
        if table.enabled[row] == 0:
            continue
        kind = table.kind[row]
        if kind == joint_damping.KIND:
            joint_damping.apply(table, row, qd)
        elif kind == joint_spring.KIND:
            joint_spring.apply(table, row, q)
        elif kind == end_stop.KIND:
            end_stop.apply(table, row, q, qd)
        elif kind == joint_friction.KIND:
            joint_friction.apply(table, row, qd)
        elif kind == point_spring.KIND:
            point_spring.apply(table, row, body)
        elif kind == external_force.KIND:
            external_force.apply(table, row, body)
        elif kind == contact.KIND:
            contact.apply(table, row, body)
        elif kind == actuator.KIND:
            actuator.apply(table, row, qd, tau)


@compiled
def settle(table, state, nv):
    """
    Bring the effects' own states back to where they may be, after a step.

    Parameters
    ----------
    table : EffectTable
        ``states`` is used.
    state : ndarray, shape (ns,)
        Corrected in place.
    nv : int
        Number of joint coordinates.

    """
    for k in range(table.states.shape[0]):
        table.states[k] = state[2 * nv + k]
    for row in range(table.kind.shape[0]):
        if table.kind[row] == joint_friction.KIND and table.enabled[row] == 1:
            place = table.index[row, STATE]
            state[2 * nv + place] = joint_friction.settle(
                table, row, state[nv + table.index[row, FIRST]])
