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

A new law is one line of ``LAWS``. Only the laws of listed effects are compiled, and visited.

"""

from . import (
    actuator, body_contact, bushing, cable, contact, cut_coordinates, end_stop, external_force,
    force_table, joint_damping, joint_friction, joint_spring, point_spring, prescribed_force,
    prescribed_motion, rotor)
from .law import Acting
from .table import (
    ACTUATOR, BUSHING, CABLE, CIRCLE_CONTACT, CONTACT, CURVE_CONTACT, CUT_ROTOR, END_STOP, EXERT,
    EXTERNAL_FORCE, FIRST_LAW, FOLLOWED, JOINT_DAMPING, JOINT_FORCE_TABLE, JOINT_FRICTION,
    JOINT_SPRING, LINE_CONTACT, MEASURE, POINT_FORCE_TABLE, POINT_SPRING, PRESCRIBED_FORCE,
    PRESCRIBED_MOTION, PRESCRIBED_TORQUE, SPATIAL_BODY_CONTACT, SPATIAL_BUSHING, SPATIAL_CABLE,
    SPATIAL_CONTACT, SPATIAL_FORCE, SPATIAL_FORCE_TABLE, SPATIAL_POINT_SPRING,
    SPATIAL_PRESCRIBED_FORCE)
from ..core.codegen.records import addressed, call_at, link
from ..core.compiled import inlined

LAWS = {
    ACTUATOR: actuator.apply,
    BUSHING: bushing.apply,
    CABLE: cable.apply,
    CIRCLE_CONTACT: body_contact.apply_on_circle,
    CONTACT: contact.apply,
    CURVE_CONTACT: body_contact.apply_on_curve,
    CUT_ROTOR: rotor.apply,
    END_STOP: end_stop.apply,
    EXTERNAL_FORCE: external_force.apply,
    JOINT_DAMPING: joint_damping.apply,
    JOINT_FORCE_TABLE: force_table.apply,
    JOINT_FRICTION: joint_friction.apply,
    JOINT_SPRING: joint_spring.apply,
    LINE_CONTACT: body_contact.apply_on_line,
    POINT_FORCE_TABLE: force_table.apply_between_points,
    POINT_SPRING: point_spring.apply,
    PRESCRIBED_FORCE: prescribed_force.apply_at_point,
    PRESCRIBED_MOTION: prescribed_motion.apply,
    PRESCRIBED_TORQUE: prescribed_force.apply,
    SPATIAL_BODY_CONTACT: body_contact.apply_in_space,
    SPATIAL_BUSHING: bushing.apply_in_space,
    SPATIAL_CABLE: cable.apply_in_space,
    SPATIAL_CONTACT: contact.apply_in_space,
    SPATIAL_FORCE: external_force.apply_in_space,
    SPATIAL_FORCE_TABLE: force_table.apply_in_space,
    SPATIAL_POINT_SPRING: point_spring.apply_in_space,
    SPATIAL_PRESCRIBED_FORCE: prescribed_force.apply_in_space,
}


def linked(table, body, tau):
    """
    Return a table that knows the addresses of its laws, and what keeps these.

    Parameters
    ----------
    table : EffectTable
        All its other arrays are shared.
    body : ndarray, shape (nb + 1, WORK_COLUMNS)
        That the laws read and write.
    tau : ndarray, shape (nv + nk,)
        The commanded torques.

    Returns
    -------
    table : EffectTable
    record : ndarray of int
        To be kept as long as the table.

    """
    cuts = (_measure, _exert) if len(table.cuts.index) else (None, None)
    laws, record = link(
        Acting(table, body, tau), (*cuts, *(LAWS[kind] for kind in table.kind.tolist())))
    return table._replace(laws=laws), record


@addressed
def _measure(acting, number, q, qd):
    """Find the coordinates and rates of cut joints, to stand behind those of the tree."""
    cuts, nv = acting.table.cuts, q.shape[0]
    for i in range(nv):
        cuts.q[i] = q[i]
        cuts.qd[i] = qd[i]
    cut_coordinates.measure(
        cuts.index, cuts.values, acting.body, acting.table.states, nv, cuts.q, cuts.qd)
    return 1


@addressed
def _exert(acting, number, q, qd):
    """Let efforts along the coordinates of cut joints act, and follow their angles."""
    table, cuts = acting.table, acting.table.cuts
    nv = q.shape[0] - cuts.index.shape[0]
    for k in range(cuts.index.shape[0]):
        if cuts.index[k, FOLLOWED] >= 0:
            table.rates[cuts.index[k, FOLLOWED]] = cuts.qd[nv + k]
    cut_coordinates.exert(cuts.index, cuts.values, acting.body, table.applied, nv)
    return 1


@inlined
def apply(table, q, qd, tau):
    """
    Apply all effects that are switched on.

    Parameters
    ----------
    table : EffectTable
        As ``linked`` returns it, to bodies after ``kinematics.outward``: forces at points reduce
        their bias forces, columns FZ to FY, in space the six from FORCE on. ``states`` is read;
        ``applied`` (commands and joint torques), ``rates``, ``output`` and which joints stick are
        written.
    q, qd : ndarray, shape (nv,)
        Joint coordinates and rates.
    tau : ndarray, shape (nv + nk,)
        Commanded joint torques [N m] and forces [N], those of cut joints behind.

    """
    for i in range(tau.shape[0]):
        table.applied[i] = tau[i]
    for k in range(table.rates.shape[0]):
        table.rates[k] = 0.0
    table.sticking.rows[0] = 0
    if table.laws[MEASURE] == 0:
        _apply_laws(table, q, qd)
    else:
        call_at(table.laws, MEASURE, 0, q, qd)
        _apply_laws(table, table.cuts.q, table.cuts.qd)
        call_at(table.laws, EXERT, 0, table.cuts.q, table.cuts.qd)


@inlined
def _apply_laws(table, q, qd):
    """Apply the laws to the joints that the arrays have."""
    for row in range(table.kind.shape[0]):
        if table.enabled[row] == 1:
            call_at(table.laws, FIRST_LAW + row, row, q, qd)
