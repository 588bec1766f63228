# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Models of robots in MuJoCo, for the comparison in models.py.

A file in MJCF is read by MuJoCo itself, with its meshes; other models are written as MJCF first.
Equalities are soft in MuJoCo: what accelerations they lead to when hard follows from its inertia,
bias force and Jacobian.
"""

from pathlib import Path
import sys
from xml.etree import ElementTree

from machine import ROOT
import mujoco
import numpy as np

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.formats.building import word  # noqa: E402,I100
from closedloop_dynamics.formats.mjcf_writing import mjcf  # noqa: E402
from closedloop_dynamics.mechanism.mechanism import FREE, HELICAL, SPHERICAL  # noqa: E402
from closedloop_dynamics.mechanism.rotations import of_quaternion, quaternion_of  # noqa: E402

NAME, VERSION = 'MuJoCo', mujoco.__version__
# Differences of Jacobians along the motion: of fourth order [s].
STEP = 1e-3
# Sections that only pictures, contacts and measuring need.
ASIDE = ('asset', 'contact', 'sensor', 'visual', 'keyframe')
OFF = ('CONTACT', 'LIMIT', 'FRICTIONLOSS', 'ACTUATION', 'SPRING', 'DAMPER')


class MuJoCo:
    """
    A model in MuJoCo.

    Parameters
    ----------
    path : pathlib.Path
        Of its file.
    mechanism : Mechanism
        What our reader made of it.
    gravity : sequence of 3 floats
        [m/s^2].

    Attributes
    ----------
    own : bool
        Whether MuJoCo has read the file itself.

    Raises
    ------
    ValueError
        Where it cannot be the same machine.

    """

    def __init__(self, path, mechanism, gravity):
        """Read or write the file, and leave out what acts beside gravity."""
        self.mechanism, self.own = mechanism, Path(path).suffix.lower() in ('.xml', '.mjcf')
        self._effects = {'gravity': {'type': 'gravity', 'acceleration': tuple(gravity)}}
        self.model = compiled(path) if self.own else (
            mujoco.MjModel.from_xml_string(mjcf(mechanism, self._effects)))
        model = self.model
        for off in OFF:
            model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f'mjDSBL_{off}')
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        model.opt.solver, model.opt.iterations = mujoco.mjtSolver.mjSOL_NEWTON, 1
        model.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_EULERDAMP
        model.dof_armature[:] = 0.0
        model.opt.gravity[:] = gravity
        self.data = mujoco.MjData(model)
        if self.own:
            self._match()

    def _match(self):
        """Find our joints among MuJoCo's."""
        names = {}
        for number in range(self.model.njnt):
            name = mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_JOINT, number)
            if name is None:
                body = int(self.model.jnt_bodyid[number])
                name = (f'{mujoco.mj_id2name(self.model, mujoco.mjtObj.mjOBJ_BODY, body)}_joint_'
                        f'{number - int(self.model.body_jntadr[body]) + 1}')
            names[word(name)] = number
        if set(names) != set(self.mechanism.joint_names):
            raise ValueError('joints are called otherwise than ours')
        self._numbers = names
        places = self.mechanism.coordinates
        self._order = np.concatenate([
            self.model.jnt_dofadr[names[joint.name]]
            + np.arange(places.rates[joint.name].stop - places.rates[joint.name].start)
            for joint in self.mechanism.joints])

    def _position(self, q):
        found = self.model.qpos0.copy()
        places = self.mechanism.coordinates
        for joint in self.mechanism.joints:
            at = int(self.model.jnt_qposadr[self._numbers[joint.name]])
            some = q[places.coordinates[joint.name]]
            if joint.type == FREE:
                # Counted from where it is drawn.
                body = int(self.model.jnt_bodyid[self._numbers[joint.name]])
                drawn = of_quaternion(np.roll(self.model.body_quat[body], -1))
                turned = drawn @ of_quaternion(some[3:])
                found[at:at + 3] = self.model.body_pos[body] + drawn @ some[:3]
                found[at + 3:at + 7] = np.roll(quaternion_of(turned), 1)
            elif joint.type == SPHERICAL:
                found[at:at + 4] = np.roll(some, 1)
            else:
                found[at] = some[0]
        return found

    def equations(self, q, qd, tau):
        """
        Return the equations of motion in our order of coordinates; of a file that is MuJoCo's.

        Returns
        -------
        inertia, force, jac, bias : ndarrays
            inertia qdd + jac^T lam = force, jac qdd = -bias.

        """
        model, data, places = self.model, self.data, self.mechanism.coordinates
        order = self._order
        # Rates of a free joint: its velocity is in the world here, in the drawn frame there.
        turn = np.eye(model.nv)
        for joint in self.mechanism.joints:
            if joint.type == FREE:
                at = places.rates[joint.name].start
                body = int(model.jnt_bodyid[self._numbers[joint.name]])
                turn[at:at + 3, at:at + 3] = of_quaternion(np.roll(model.body_quat[body], -1))
        rates = np.zeros(model.nv)
        rates[order] = turn @ qd
        position = self._position(q)
        rows = self._jacobian(position)[:, order] @ turn
        inertia = np.zeros((model.nv, model.nv))
        data.qvel[:] = rates
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
        force = turn.T @ -data.qfrc_bias[order] + tau
        inertia = turn.T @ inertia[np.ix_(order, order)] @ turn
        bias = np.zeros(len(rows))
        for share, weight in ((1.0, 8.0), (2.0, -1.0)):
            for sign in (1.0, -1.0):
                there = position.copy()
                mujoco.mj_integratePos(model, there, rates, sign * share * STEP)
                bias += sign * weight * self._jacobian(there) @ rates / (12.0 * STEP)
        return inertia, force, rows, bias

    def _jacobian(self, position):
        """Return the Jacobian of the equalities in MuJoCo's order."""
        data = self.data
        data.qpos[:], data.qvel[:] = position, 0.0
        mujoco.mj_forward(self.model, data)
        return data.efc_J.reshape(-1, self.model.nv)[:data.ne].copy()

    def stepper(self, q, qd):
        """Return a function of a number of steps, which stay near a state."""
        model = self.model
        if self.own:
            position, rates = self._position(q), np.zeros(model.nv)
            rates[self._order] = qd
        else:
            if any(joint.type == HELICAL for joint in self.mechanism.joints):
                raise ValueError('screws are two joints')
            keyed = mujoco.MjModel.from_xml_string(mjcf(self.mechanism, self._effects, q))
            position, rates = keyed.key_qpos[0], qd

        def steps(count):
            # Not further from the state than a thousandth of a second.
            model.opt.timestep = 1e-3 / count
            mujoco.mj_resetData(model, self.data)
            self.data.qpos[:], self.data.qvel[:] = position, rates
            mujoco.mj_step(model, self.data, count)
        return steps


def compiled(path):
    """Return a file compiled, without what is for pictures and contacts where meshes miss."""
    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except ValueError:
        root = ElementTree.parse(path).getroot()
    for tag in ASIDE:
        for element in root.findall(tag):
            root.remove(element)
    for parent in list(root.iter()):
        if parent.tag in ('worldbody', 'default') or parent.find('inertial') is not None:
            for element in parent.findall('geom'):
                parent.remove(element)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding='unicode'))
