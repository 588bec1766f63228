# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
MuJoCo beside us.

Built for control and learning with contact: loops are soft equalities, springs that pull a loop
together. The settings here are the ones that gave the smallest errors among those tried: impedance
at its upper bound, critically damped springs as stiff as the step allows, Newton's method with the
one iteration that a quadratic cost needs, everything else switched off, islands and warm starts,
too, which cost more than they save here. A file in MJCF is read by MuJoCo itself, with its meshes;
other machines are written for it.
"""

import copy
from dataclasses import asdict, replace
from xml.etree import ElementTree

import mujoco
import numpy as np
from peer_cases import CannotExpress, Machine, NotAdapted, with_balls_at_loops

from closedloop_dynamics.effects.registry import effect_type  # noqa: I100
from closedloop_dynamics.formats.building import word
from closedloop_dynamics.formats.mjcf_writing import mjcf
from closedloop_dynamics.mechanism.mechanism import MechanismError

NAME = 'MuJoCo'
HARDEST = 0.9999
# How soft loops are where accelerations are extrapolated to hard ones, over the hardest.
SOFTER = 1.0, 1.4, 2.0, 2.8, 4.0
INTEGRATORS = 'RK4', 'implicitfast'
OFF = 'CONTACT', 'ACTUATION', 'REFSAFE', 'ISLAND', 'WARMSTART'
# What a file may have beside gravity.
OFF_UNDER_GRAVITY = 'LIMIT', 'FRICTIONLOSS', 'SPRING', 'DAMPER', 'EULERDAMP'
# No spring for a time: rates are what they are, positions as well.
SPRINGS_AT_REST = 1e3
# Sections that only pictures, contacts and measuring need.
ASIDE = ('asset', 'contact', 'sensor', 'visual', 'keyframe')

# What goes wrong shows in the result; no file MUJOCO_LOG.TXT is wanted.
mujoco.set_mju_user_warning(lambda message: None)


class Engine:
    """
    One machine in MuJoCo.

    Parameters
    ----------
    machine : peer_cases.Machine or scene.Scene

    Attributes
    ----------
    order : ndarray of int, shape (nq,)
        Where in its coordinates ours are: its quaternions are w, x, y, z.

    Raises
    ------
    CannotExpress, NotAdapted

    """

    name, version = NAME, mujoco.__version__
    # Accelerations are off in proportion to the softness, by any factor.
    agreed, limit_agreed, limit_name = np.inf, 1e-3, 'hard limit'
    others = {}

    def __init__(self, machine):
        if not isinstance(machine, Machine):
            machine = Machine(machine.name, machine)
        scene, path = machine.scene, machine.path
        effects = {name: {'type': effect_type(effect), **asdict(effect)}
                   for name, effect in scene.effects.items()}
        left = {}
        try:
            written = mjcf(with_balls_at_loops(scene.mechanism), effects, left_out=left)
        except MechanismError as error:
            raise NotAdapted(error) from error
        left = [name for name in left if effects[name]['type'] != 'gravity']
        if left:
            raise CannotExpress(f'effects ({", ".join(left)})')
        if path is not None and path.suffix.lower() in ('.xml', '.mjcf'):
            self._model = compiled(path)
            self._model.dof_armature[:] = 0.0
        else:
            self._model = mujoco.MjModel.from_xml_string(written)
        model = self._model
        only_gravity = all(values['type'] == 'gravity' for values in effects.values())
        for off in (*OFF, *(OFF_UNDER_GRAVITY if only_gravity else ())):
            model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f'mjDSBL_{off}')
        model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
        model.opt.solver, model.opt.iterations = mujoco.mjtSolver.mjSOL_NEWTON, 1
        model.opt.tolerance = 1e-14
        self._match(scene.mechanism)
        self._resting = self.build(1e-3, SPRINGS_AT_REST)
        self._data = mujoco.MjData(model)

    def _match(self, mechanism):
        """Find our coordinates and rates among its own."""
        model, numbers, order, rates = self._model, {}, [], []
        for number in range(model.njnt):
            name = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, number)
            if name is None:
                body = int(model.jnt_bodyid[number])
                name = (f'{mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, body)}_joint_'
                        f'{number - int(model.body_jntadr[body]) + 1}')
            numbers[word(name)] = number
        # Coordinates of what floats are counted from where it is drawn.
        self._drawn = np.zeros(model.nq)
        for joint in mechanism.joints:
            parts = [joint.name] if joint.name in numbers else [
                f'{joint.name}_{k}' for k in range(1, 7) if f'{joint.name}_{k}' in numbers]
            for number in map(numbers.get, parts):
                place, rate = int(model.jnt_qposadr[number]), int(model.jnt_dofadr[number])
                # By type: free, ball, slide, hinge.
                some, width = (((0, 1, 2, 4, 5, 6, 3), 6), ((1, 2, 3, 0), 3), ((0,), 1), ((0,), 1)
                               )[model.jnt_type[number]]
                order += [place + one for one in some]
                rates += range(rate, rate + width)
                if width == 6:
                    self._drawn[place:place + 3] = model.qpos0[place:place + 3]
                    if model.qpos0[place + 3] != 1.0:
                        raise NotAdapted(f'{joint.name}: drawn turned')
        self.order, self._rates = np.array(order), np.array(rates)
        if sorted(rates) != list(range(model.nv)) or len(order) != mechanism.coordinates.nq:
            raise NotAdapted('joints are written otherwise than ours')

    def build(self, step, frequency, integrator='Euler', hardness=HARDEST):
        """Return a model with a step size [s] and a natural frequency of its loops [rad/s]."""
        model = copy.copy(self._model)
        model.opt.timestep = step
        model.opt.integrator = getattr(mujoco.mjtIntegrator, 'mjINT_' + integrator.upper())
        model.eq_solref[:] = -frequency ** 2, -2.0 * frequency
        model.eq_solimp[:] = hardness, hardness, 1e-3, 0.5, 2.0
        return model

    def _start(self, model, data, q, qd, tau):
        mujoco.mj_resetData(model, data)
        data.qpos[self.order] = q
        data.qpos += self._drawn
        data.qvel[self._rates], data.qfrc_applied[self._rates] = qd, tau[:model.nv]

    def _ours(self, data):
        """Return our coordinates."""
        return (data.qpos - self._drawn)[self.order]

    def acceleration(self, q, qd, tau, softness=1.0):
        """Return joint accelerations, shape (nv,)."""
        hardness = 1.0 - softness * (1.0 - HARDEST)
        self._resting.eq_solimp[:, :2] = hardness
        self._start(self._resting, self._data, q, qd, tau)
        mujoco.mj_forward(self._resting, self._data)
        return self._data.qacc[self._rates]

    def limit(self, q, qd, tau):
        """Return the accelerations where loops are hard: a polynomial through softer ones."""
        found = [self.acceleration(q, qd, tau, softness) for softness in SOFTER]
        return np.polynomial.polynomial.polyfit(SOFTER, found, len(SOFTER) - 1)[0]

    def timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations or steps}."""
        model, fourth_order = (self.build(1e-3, 100.0, name) for name in ('Euler', 'RK4'))
        data, other = mujoco.MjData(model), mujoco.MjData(model)

        def forward(count):
            for _ in range(count):
                mujoco.mj_forward(model, data)

        def stepping(model, at_once=True):
            def steps(count):
                # Not further from the state than a thousandth of a second.
                model.opt.timestep = 1e-3 / count
                self._start(model, other, q, qd, tau)
                for _ in range(1 if at_once else count):
                    mujoco.mj_step(model, other, count if at_once else 1)
            return steps

        self._start(model, data, q, qd, tau)
        return {'mj_forward, from Python': forward, 'mj_step (Euler), C loop': stepping(model),
                'mj_step (Euler), from Python': stepping(model, at_once=False),
                'mj_step (RK4), C loop': stepping(fourth_order)}

    def derivative_timings(self, q, qd, tau):
        """Return {what: function of a number of differentiated steps}."""
        model = self.build(1e-3, 100.0)
        data, by_state = mujoco.MjData(model), np.zeros((2 * model.nv, 2 * model.nv))

        def derivatives(count):
            for _ in range(count):
                mujoco.mjd_transitionFD(model, data, 1e-6, 0, by_state, None, None, None)

        self._start(model, data, q, qd, tau)
        return {'mjd_transitionFD by the state, one-sided, from Python': derivatives}

    def lines(self, case, plan):
        """Return the ways to compute a case."""
        lines = []
        for integrator in INTEGRATORS:
            for springs in plan.springs:
                line = case.stepped(
                    NAME, integrator, plan.steps,
                    lambda *steps, integrator=integrator, springs=springs: self._motion(
                        case, *steps, springs, integrator))
                lines.append(replace(line, settings=[
                    f'{step}, springs {springs:g} / step' for step in line.settings]))
        return lines

    def _motion(self, case, count, step, springs, integrator):
        # One data serves all settings: there may be hundreds.
        model, data = self.build(step, springs / step, integrator), self._data
        held = np.zeros((len(case.torques), model.nv))
        held[:, self._rates] = case.torques[:, :model.nv]

        def execute():
            self._start(model, data, case.q, case.qd, case.torques[0])
            for torque in held:
                data.qfrc_applied[:] = torque
                mujoco.mj_step(model, data, count)
            # On bad values MuJoCo restarts by itself.
            if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                return np.full(len(case.q), np.nan)
            return self._ours(data)
        return execute


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
