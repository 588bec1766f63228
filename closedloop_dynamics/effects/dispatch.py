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
    actuator, body_contact, bushing, cable, contact, cut_coordinates, end_stop, external_force,
    force_table, joint_damping, joint_friction, joint_spring, point_spring, prescribed_force,
    prescribed_motion, rotor)
from .table import (
    ACTUATOR, BUSHING, CABLE, CIRCLE_CONTACT, CONTACT, CURVE_CONTACT, CUT_ROTOR, END_STOP,
    EXTERNAL_FORCE, FOLLOWED, JOINT_DAMPING, JOINT_FORCE_TABLE, JOINT_FRICTION, JOINT_SPRING,
    LINE_CONTACT, POINT_FORCE_TABLE, POINT_SPRING, PRESCRIBED_FORCE, PRESCRIBED_MOTION,
    PRESCRIBED_TORQUE, SPATIAL_BODY_CONTACT, SPATIAL_BUSHING, SPATIAL_CABLE, SPATIAL_CONTACT,
    SPATIAL_FORCE, SPATIAL_FORCE_TABLE, SPATIAL_POINT_SPRING, SPATIAL_PRESCRIBED_FORCE)
from ..core.compiled import compiled


@compiled
def apply(body, table, q, qd, tau):
    """
    Apply all effects that are switched on.

    Parameters
    ----------
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        After ``kinematics.outward``. Forces at points reduce the bias force: columns FZ to FY, in
        space the six from FORCE on.
    table : EffectTable
        ``states`` is read; ``applied`` (commands and joint torques), ``rates``, ``output`` and
        which joints stick are written.
    q, qd : ndarray, shape (nv,)
        Joint coordinates and rates.
    tau : ndarray, shape (nv + nk,)
        Commanded joint torques [N m] and forces [N], those of cut joints behind.

    """
    _apply(table.cuts, body, table, q, qd, tau)


@compiled
def _apply(cuts, body, table, q, qd, tau):
    """Let laws see the cut joints that they act in, where there are any."""
    if cuts is None:
        _apply_laws(body, table, q, qd, tau)
    if cuts is not None:
        _apply_with_cuts(cuts, body, table, q, qd, tau)


@compiled
def _apply_with_cuts(cuts, body, table, q, qd, tau):
    """Apply the laws to the joints of the tree and to cut joints behind them."""
    nv = q.shape[0]
    for i in range(nv):
        cuts.q[i] = q[i]
        cuts.qd[i] = qd[i]
    cut_coordinates.measure(
        cuts.index, cuts.values, body, table.states, nv, cuts.q, cuts.qd)
    _apply_laws(body, table, cuts.q, cuts.qd, tau)
    for k in range(cuts.index.shape[0]):
        if cuts.index[k, FOLLOWED] >= 0:
            table.rates[cuts.index[k, FOLLOWED]] = cuts.qd[nv + k]
    cut_coordinates.exert(cuts.index, cuts.values, body, table.applied, nv)


@compiled
def _apply_laws(body, table, q, qd, tau):
    """Apply the laws to the joints that the arrays have."""
    for i in range(tau.shape[0]):
        table.applied[i] = tau[i]
    for k in range(table.rates.shape[0]):
        table.rates[k] = 0.0
    table.sticking.rows[0] = 0
    for row in range(table.kind.shape[0]):
        if table.enabled[row] == 0:
            continue
        kind = table.kind[row]
        if kind == JOINT_DAMPING:
            joint_damping.apply(table, row, qd)
        elif kind == JOINT_SPRING:
            joint_spring.apply(table, row, q)
        elif kind == END_STOP:
            end_stop.apply(table, row, q, qd)
        elif kind == JOINT_FRICTION:
            joint_friction.apply(table, row, qd)
        elif kind == POINT_SPRING:
            point_spring.apply(table, row, body)
        elif kind == EXTERNAL_FORCE:
            external_force.apply(table, row, body)
        elif kind == CONTACT:
            contact.apply(table, row, body)
        elif kind == ACTUATOR:
            actuator.apply(table, row, qd, tau)
        elif kind == SPATIAL_POINT_SPRING:
            point_spring.apply_in_space(table, row, body)
        elif kind == SPATIAL_FORCE:
            external_force.apply_in_space(table, row, body)
        elif kind == SPATIAL_CONTACT:
            contact.apply_in_space(table, row, body)
        elif kind == CUT_ROTOR:
            rotor.apply(table, row, qd)
        else:
            _apply_element(table.data, table, row, body, q, qd)


@compiled
def _apply_element(data, table, row, body, q, qd):
    """Apply a machine element, where a scene lists any: ``data`` is None where not."""
    if data is not None:
        kind = table.kind[row]
        if kind == PRESCRIBED_TORQUE:
            prescribed_force.apply(table, row, qd)
        elif kind == PRESCRIBED_FORCE:
            prescribed_force.apply_at_point(table, row, body)
        elif kind == JOINT_FORCE_TABLE:
            force_table.apply(table, row, q, qd)
        elif kind == POINT_FORCE_TABLE:
            force_table.apply_between_points(table, row, body)
        elif kind == BUSHING:
            bushing.apply(table, row, body)
        elif kind == CABLE:
            cable.apply(table, row, body)
        elif kind == LINE_CONTACT:
            body_contact.apply_on_line(table, row, body)
        elif kind == CIRCLE_CONTACT:
            body_contact.apply_on_circle(table, row, body)
        elif kind == CURVE_CONTACT:
            body_contact.apply_on_curve(table, row, body)
        elif kind == SPATIAL_PRESCRIBED_FORCE:
            prescribed_force.apply_in_space(table, row, body)
        elif kind == SPATIAL_BUSHING:
            bushing.apply_in_space(table, row, body)
        elif kind == SPATIAL_CABLE:
            cable.apply_in_space(table, row, body)
        elif kind == SPATIAL_BODY_CONTACT:
            body_contact.apply_in_space(table, row, body)
        elif kind == PRESCRIBED_MOTION:
            prescribed_motion.apply(table, row)
        elif kind == SPATIAL_FORCE_TABLE:
            force_table.apply_in_space(table, row, body)
