# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Pinocchio (Carpentier et al.), for the comparison in peers.py.

A library of rigid-body algorithms, without integrators of its own: constraintDynamics is called
from Python (in the plane, by SciPy's DOP853) and from loops in C++ (pinocchio_motion.hpp) with
Boost's integrators, which need a C++ compiler and the headers of Eigen. In space lcaba, its
algorithm over the bodies, too.
"""

from model_pinocchio import ACCURACY, Pinocchio, SETTINGS
import numpy as np
from peer_cases import gravity, Run
import pinocchio as pin
from scipy.integrate import solve_ivp

NAME = 'Pinocchio'
TOLERANCES = 1.0, 0.3, *(10.0 ** -k for k in range(1, 14))
QUICK_TOLERANCES = tuple(10.0 ** -k for k in range(3, 13, 3))
STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)
QUICK_STEPS = (1e-2, 1e-3)


class Engine:
    """
    One scene in Pinocchio.

    Parameters
    ----------
    scene : scene.Scene
        With gravity alone, joints and cut joints of the kinds that ``model_pinocchio`` builds.

    """

    name, version = NAME, pin.__version__
    softness = None

    def __init__(self, scene):
        """Build the model, and the loops in C++."""
        self._planar = scene.mechanism.planar
        arguments = scene.mechanism, gravity(scene)
        self._built = Pinocchio.built(*arguments)
        self._loops = Loops(self._built)
        # In the plane lcaba is slower and less exact.
        self._by_bodies = {} if self._planar else {
            name: Loops(Pinocchio.built(*arguments, algorithm=name))
            for name in SETTINGS if name.startswith('lcaba')}
        self.others = {name: loops.acceleration for name, loops in self._by_bodies.items()}
        self._model, self._data = self._built.model, self._built.data
        self._constraints, self._constraint_data = self._built.constraints()
        mu, iterations = SETTINGS['constraintDynamics']
        self._proximal = pin.ProximalSettings(ACCURACY, mu, iterations)
        pin.initConstraintDynamics(
            self._model, self._data, self._constraints, self._constraint_data)

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,)."""
        return self._built.ours(self._accelerate(
            *self._built.state(q, qd), self._built.efforts(tau)))

    def _accelerate(self, q, v, tau):
        return pin.constraintDynamics(
            self._model, self._data, q, v, tau, self._constraints, self._constraint_data,
            self._proximal).copy()

    def timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations}."""
        arguments = (self._model, self._data, *self._built.state(q, qd), self._built.efforts(tau),
                     self._constraints, self._constraint_data, self._proximal)

        def call(count):
            for _ in range(count):
                pin.constraintDynamics(*arguments)

        self._loops.set_state(q, qd, tau)
        result = {'evaluation, from Python': call,
                  'evaluation, C++ loop': self._loops.machine.evaluate,
                  'RK4 step, C++ loop': lambda count: self._loops.machine.runge_kutta(
                      1e-12, count)}
        for name, loops in self._by_bodies.items():
            loops.set_state(q, qd, tau)
            result[f'evaluation by {name}, C++ loop'] = loops.machine.evaluate
        return result

    def derivative_timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations with all derivatives}."""
        self._loops.set_state(q, qd, tau)
        return {'constraintDynamics and computeConstraintDynamicsDerivatives, C++ loop':
                self._loops.machine.differentiate}

    def runs(self, case, quick):
        """Return the runs of a case."""
        runs = []
        for value in QUICK_TOLERANCES if quick else TOLERANCES:
            setting = f'tolerance {value:.0e}'
            if self._planar:
                runs.append(Run(NAME, 'DOP853 of SciPy', setting, self._scipy(case, value)))
            runs.append(Run(NAME, 'Fehlberg 7(8) in C++', setting,
                            self._loops.motion(case, 'fehlberg', value)))
            runs += [Run(NAME, f'Fehlberg 7(8) in C++, {name}', setting,
                         loops.motion(case, 'fehlberg', value))
                     for name, loops in self._by_bodies.items()]
        for value in QUICK_STEPS if quick else STEPS:
            setting = f'step {value:g} s'
            runs.append(Run(NAME, 'RK4 in C++', setting,
                            self._loops.motion(case, 'runge_kutta', value)))
        return runs

    def _scipy(self, case, tolerance):
        n, tau = len(case.q), self._built.efforts(case.tau)
        start = np.concatenate(self._built.state(case.q, case.qd))

        def derivative(_, state):
            # An array of its own each time: SciPy keeps the last one.
            return np.concatenate([state[n:], self._accelerate(state[:n], state[n:], tau)])

        def execute():
            return self._built.coordinates_of(solve_ivp(
                derivative, (0.0, case.duration), start, method='DOP853',
                rtol=max(tolerance, 3e-14), atol=tolerance).y[:n, -1])
        return execute


class Loops:
    """
    A machine of ``model_pinocchio`` that is told states as ours are.

    Parameters
    ----------
    built : model_pinocchio.Pinocchio

    Attributes
    ----------
    machine : pinocchio_code.Machine

    """

    def __init__(self, built):
        self._built, self.machine = built, built.machine

    def set_state(self, q, qd, tau):
        """Go to a state under joint torques."""
        self.machine.set_state(*self._built.state(q, qd), self._built.efforts(tau))

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,)."""
        return self._built.evaluate(q, qd, tau)

    def motion(self, case, method, value):
        """Return a function that computes a motion: by a step size [s], or by a tolerance."""
        def execute():
            self.set_state(case.q, case.qd, case.tau)
            if method == 'runge_kutta':
                self.machine.runge_kutta(value, round(case.duration / value))
            else:
                self.machine.fehlberg(case.duration, value, 1e-2)
            return self._built.coordinates_of(self.machine.position())
        return execute
