# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Accelerations of models by MuJoCo and Pinocchio, in the order of our coordinates."""

from closedloop_dynamics.formats.building import word
from closedloop_dynamics.mechanism.mechanism import FREE
from closedloop_dynamics.mechanism.rotations import of_quaternion
import numpy as np
import pytest

# Change of the position by which the Jacobian is differentiated [s].
STEP = 1e-5


def of_mujoco(path, simulation, q, qd):
    """
    Return MuJoCo's accelerations, its equalities solved as hard ones.

    Returns
    -------
    ndarray, shape (nv,), or None
        None where MuJoCo does not read the file, or has other joints.

    """
    mujoco = pytest.importorskip('mujoco')
    mujoco.set_mju_user_warning(lambda text: None)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError:
        return None
    finally:
        mujoco.set_mju_user_warning(None)
    coordinates, joints = simulation.mechanism.coordinates, simulation.mechanism.joints
    joints = [joint for joint in joints if coordinates.rates[joint.name].stop
              > coordinates.rates[joint.name].start]
    known = {joint.name: joint for joint in joints}
    names = [word(model.joint(number).name or '?') for number in range(model.njnt)]
    if len(joints) != model.njnt:
        return None
    if set(names) == set(known):
        joints = [known[name] for name in names]
    data, order, turned = mujoco.MjData(model), np.zeros(model.nv, dtype=int), np.eye(model.nv)
    for number, joint in enumerate(joints):
        values = q[coordinates.coordinates[joint.name]].copy()
        rates = coordinates.rates[joint.name]
        address, dof = model.jnt_qposadr[number], model.jnt_dofadr[number]
        if len(values) >= 4:
            values[-4:] = np.roll(values[-4:], 1)
        if joint.type == FREE:
            # Counted from where it is drawn, in the axes that it has there.
            drawn = model.qpos0[address:address + 7]
            axes = of_quaternion(np.roll(drawn[3:], -1))
            values[:3] = drawn[:3] + axes @ values[:3]
            mujoco.mju_mulQuat(values[3:], drawn[3:], values[3:].copy())
            turned[dof:dof + 3, dof:dof + 3] = axes
        data.qpos[address:address + len(values)] = values
        order[dof:dof + rates.stop - rates.start] = range(rates.start, rates.stop)
    data.qvel[:] = turned @ qd[order]
    mujoco.mj_forward(model, data)
    # No contacts, limits, friction and drives. Drives may have the compensation of weights.
    force, inertia = data.qfrc_passive - data.qfrc_bias, np.zeros((model.nv, model.nv))
    at_drives = np.asarray(model.jnt_actgravcomp, dtype=bool)[model.dof_jntid]
    force[at_drives] += data.qfrc_gravcomp[at_drives]
    for column, unit in zip(inertia, np.eye(model.nv)):
        mujoco.mj_mulM(model, data, column, unit)
    # The Jacobian changes along the motion: by differences of the position.
    there, jacs = mujoco.MjData(model), []
    for step in (0.0, STEP, -STEP):
        there.qpos[:], there.qvel[:] = data.qpos, data.qvel
        mujoco.mj_integratePos(model, there.qpos, data.qvel, step)
        mujoco.mj_forward(model, there)
        jacs.append(_of_equalities(mujoco, model, there))
    theirs = _hard(inertia, force, jacs[0], (jacs[1] - jacs[2]) @ data.qvel / (2.0 * STEP))
    found = np.empty(model.nv)
    found[order] = turned.T @ theirs
    return found


def _of_equalities(mujoco, model, data):
    """Return the Jacobian of the equalities that hold, shape (rows, nv)."""
    jac = np.zeros((data.nefc, model.nv))
    if mujoco.mj_isSparse(model):
        mujoco.mju_sparse2dense(jac, data.efc_J, data.efc_J_rownnz, data.efc_J_rowadr,
                                data.efc_J_colind)
    else:
        jac = data.efc_J.reshape(jac.shape)
    return jac[data.efc_type == int(mujoco.mjtConstraint.mjCNSTR_EQUALITY)].copy()


def _hard(inertia, force, jac, bias):
    """Return the accelerations of what moves with ``jac @ a = -bias``."""
    free = np.linalg.solve(inertia, force)
    if not len(jac):
        return free
    through = np.linalg.solve(inertia, jac.T)
    return free - through @ np.linalg.lstsq(jac @ through, jac @ free + bias, rcond=1e-10)[0]


def of_pinocchio(path, simulation, q, qd):
    """
    Return Pinocchio's accelerations, with damping and couplings of ours, which it does not read.

    Returns
    -------
    ndarray, shape (nv,), or None
        None where Pinocchio has other joints.

    """
    pinocchio = pytest.importorskip('pinocchio')
    model = pinocchio.buildModelFromUrdf(str(path))
    data, coordinates = model.createData(), simulation.mechanism.coordinates
    there = {word(name): joint for name, joint in zip(model.names, model.joints)}
    if not set(coordinates.names) <= set(there):
        return None
    joints = [there[name] for name in coordinates.names]
    position, velocity = pinocchio.neutral(model), np.zeros(model.nv)
    for joint, place, rate in zip(joints, coordinates.place, qd):
        velocity[joint.idx_v], value = rate, q[place]
        position[joint.idx_q:joint.idx_q + joint.nq] = (
            (np.cos(value), np.sin(value)) if joint.nq == 2 else value)
    moved = [joint.idx_v for joint in joints]
    inertia = np.triu(pinocchio.crba(model, data, position))
    inertia = (inertia + np.triu(inertia, 1).T)[np.ix_(moved, moved)]
    force = -pinocchio.nonLinearEffects(model, data, position, velocity)[moved]
    for effect in simulation.effects.values():
        if hasattr(effect, 'coefficient'):
            place = coordinates.index[effect.joint]
            force[place] -= effect.coefficient * qd[place]
    couplings = simulation.mechanism.couplings
    jac = np.zeros((len(couplings), len(qd)))
    for row, coupling in zip(jac, couplings):
        for name, factor in coupling.joints.items():
            row[coordinates.index[name]] = factor
    return _hard(inertia, force, jac, np.zeros(len(jac)))
