# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
MuJoCo, for the comparison in peers.py.

Built for control and learning with contact: loops are soft "connect" equalities, springs that pull
the cut point together. The settings here are the ones that gave the smallest errors among
those tried: impedance at its upper bound, critically damped springs as stiff as the step allows,
Newton's method with the one iteration that a quadratic cost needs, everything else switched off,
islands and warm starts, too, which cost more than they save here.
"""

from xml.sax.saxutils import quoteattr

import mujoco
import numpy as np
from peer_cases import elements, gravity, point_pairs, Run

NAME = 'MuJoCo'
HARDEST = 0.9999
# Natural frequency of the loops' springs times the step size, the best of those tried.
FREQUENCIES = {'RK4': (0.1, 0.3), 'implicitfast': (0.1, 0.3)}
STEPS = {'RK4': (5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5),
         'implicitfast': (2e-3, 1e-3, 2e-4, 1e-4, 2e-5)}
QUICK_STEPS = (1e-3, 5e-4)
# No spring for a time: rates are what they are, positions as well.
SPRINGS_AT_REST = 1e3

# What goes wrong shows in the result; no file MUJOCO_LOG.TXT is wanted.
mujoco.set_mju_user_warning(lambda message: None)


class Engine:
    """
    One scene in MuJoCo.

    Parameters
    ----------
    scene : scene.Scene
        With gravity alone, joints and cut joints of the kinds that ``peer_cases`` knows.

    Attributes
    ----------
    order : ndarray of int, shape (nq,)
        Where in its coordinates ours are: its quaternions are w, x, y, z.

    """

    name, version = NAME, mujoco.__version__
    # Accelerations are off in proportion to this.
    softness, others = 1.0 - HARDEST, {}

    def __init__(self, scene):
        """Build the model."""
        self._elements, self._pairs = elements(scene.mechanism), point_pairs(scene.mechanism)
        self._gravity = (*gravity(scene), 0.0)[:3]
        self.order = np.arange(scene.mechanism.coordinates.nq)
        for first, _ in scene.mechanism.coordinates.balls:
            self.order[first:first + 4] = first + np.array([1, 2, 3, 0])
        self._model = self.build(1e-3, SPRINGS_AT_REST)
        self._data = mujoco.MjData(self._model)

    def build(self, step, frequency, integrator='Euler', hardness=HARDEST):
        """Return a model with a step size [s] and a natural frequency of its loops [rad/s]."""
        model = mujoco.MjModel.from_xml_string(self._description(frequency, hardness))
        model.opt.timestep = step
        model.opt.integrator = getattr(
            mujoco.mjtIntegrator, 'mjINT_' + integrator.upper())
        # Given one anchor, MuJoCo finds the other at q = 0, where these loops are open.
        for row, (_, point_a, _, point_b) in zip(model.eq_data, self._pairs):
            row[:6] = *point_a, *point_b
        return model

    def _description(self, frequency, hardness):
        """Return the mechanism in MuJoCo's XML, with every digit."""
        children = {}
        for number, element in enumerate(self._elements, start=1):
            children.setdefault(element.parent, []).append((number, element))

        def branch(parent):
            return ''.join(
                f'<body name={quoteattr(element.body)} pos="{_numbers(*element.position)}" '
                f'quat="{_numbers(element.orientation[3], *element.orientation[:3])}">'
                f'{_inertial(element)}{_joints(element)}{branch(number)}</body>'
                for number, element in children.get(parent, []))

        names = ['world', *(element.body for element in self._elements)]
        springs = (f'solref="{-frequency ** 2!r} {-2.0 * frequency!r}" '
                   f'solimp="{hardness!r} {hardness!r} 0.001 0.5 2"')
        loops = ''.join(
            f'<connect body1={quoteattr(names[a])} body2={quoteattr(names[b])} '
            f'anchor="{_numbers(*point)}" {springs}/>' for a, point, b, _ in self._pairs)
        return (
            '<mujoco><compiler angle="radian"/>'
            f'<option gravity="{_numbers(*self._gravity)}" solver="Newton" iterations="1" '
            'tolerance="1e-14" jacobian="dense"><flag contact="disable" refsafe="disable" '
            'island="disable" warmstart="disable" '
            'limit="disable" frictionloss="disable" actuation="disable" spring="disable" '
            'damper="disable"/></option>'
            f'<worldbody>{branch(0)}</worldbody><equality>{loops}</equality></mujoco>')

    def _start(self, model, data, q, qd, tau):
        mujoco.mj_resetData(model, data)
        data.qpos[self.order], data.qvel[:], data.qfrc_applied[:] = q, qd, tau

    def acceleration(self, q, qd, tau, softness=None):
        """Return joint accelerations, shape (nv,)."""
        model = self._model if softness is None else self.build(
            1e-3, SPRINGS_AT_REST, hardness=1.0 - softness)
        self._start(model, self._data, q, qd, tau)
        mujoco.mj_forward(model, self._data)
        return self._data.qacc.copy()

    def timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations or steps}."""
        model, data = self.build(1e-3, 100.0), mujoco.MjData(self._model)
        fourth_order = self.build(1e-3, 100.0, 'RK4')

        def forward(count):
            for _ in range(count):
                mujoco.mj_forward(model, data)

        def several(model):
            def steps(count):
                # Not further from the state than a thousandth of a second.
                model.opt.timestep = 1e-3 / count
                self._start(model, data, q, qd, tau)
                mujoco.mj_step(model, data, count)
            return steps

        def single_steps(count):
            model.opt.timestep = 1e-3 / count
            self._start(model, data, q, qd, tau)
            for _ in range(count):
                mujoco.mj_step(model, data)

        self._start(model, data, q, qd, tau)
        return {'mj_forward, from Python': forward, 'mj_step (Euler), C loop': several(model),
                'mj_step (Euler), from Python': single_steps,
                'mj_step (RK4), C loop': several(fourth_order)}

    def derivative_timings(self, q, qd, tau):
        """Return {what: function of a number of differentiated steps}."""
        model, data = self.build(1e-3, 100.0), mujoco.MjData(self._model)
        by_state = np.zeros((2 * model.nv, 2 * model.nv))

        def derivatives(count):
            for _ in range(count):
                mujoco.mjd_transitionFD(model, data, 1e-6, 0, by_state, None, None, None)

        self._start(model, data, q, qd, tau)
        return {'mjd_transitionFD by the state, one-sided, from Python': derivatives}

    def runs(self, case, quick):
        """Return the runs of a case."""
        runs = []
        for integrator, frequencies in FREQUENCIES.items():
            for step in QUICK_STEPS if quick else STEPS[integrator]:
                for frequency in frequencies[:1] if quick else frequencies:
                    runs.append(Run(
                        NAME, integrator, f'step {step:g} s, springs {frequency:g} / step',
                        self._motion(case, step, frequency / step, integrator)))
        return runs

    def _motion(self, case, step, frequency, integrator):
        model = self.build(step, frequency, integrator)
        data = mujoco.MjData(model)

        def execute():
            self._start(model, data, case.q, case.qd, case.tau)
            mujoco.mj_step(model, data, round(case.duration / step))
            # On bad values MuJoCo restarts by itself.
            if data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                return np.full(len(case.q), np.nan)
            return data.qpos[self.order]
        return execute


def _inertial(element):
    return (f'<inertial mass="{element.mass!r}" pos="{_numbers(*element.center_of_mass)}" '
            f'diaginertia="{_numbers(*element.inertia)}"/>')


def _joints(element):
    """Return one joint, or the two hinges of a universal joint."""
    if element.type == 'spherical':
        return f'<joint name={quoteattr(element.name)} type="ball"/>'
    kind = 'slide' if element.type == 'prismatic' else 'hinge'
    return ''.join(
        f'<joint name={quoteattr(f"{element.name}.{axis}")} type="{kind}" '
        f'axis="{_numbers(*(axis == letter for letter in "xyz"))}"/>' for axis in element.axes)


def _numbers(*values):
    return ' '.join(repr(float(value)) for value in values)
