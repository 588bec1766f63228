# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Pinocchio (Carpentier et al.), for the comparison in peers.py.

A library of rigid-body algorithms, without integrators of its own: constraintDynamics is called
from Python (a time loop of our own, SciPy's DOP853; in the plane) and, where a C++ compiler and
the headers of Eigen are found, from loops in C++ (pinocchio_loop.cpp) with Boost's integrators. In
space lcaba, its algorithm over the bodies, too.
"""

import ctypes
from pathlib import Path

import numpy as np
from peer_cases import elements, gravity, point_pairs, Run
import pinocchio as pin
from pinocchio_code import compiled, Machine, pointer
from scipy.integrate import solve_ivp

NAME = 'Pinocchio'
SOURCE = Path(__file__).with_name('pinocchio_loop.cpp')
ACCURACY = 1e-12
# Regularisation mu and number of iterations. A closed loop in the plane has a third, empty row, a
# hinge in space two that repeat others: mu must be positive. The accelerations are off by about
# mu, relative; one iteration is then enough, and more cost more.
SETTINGS = 1e-14, 1
# The same for lcaba: the least error that one iteration leaves, and two.
BY_BODIES = {'lcaba': (1e-8, 1), 'lcaba, 2 iterations': (1e-5, 2)}
TOLERANCES = 1.0, 0.3, *(10.0 ** -k for k in range(1, 14))
QUICK_TOLERANCES = tuple(10.0 ** -k for k in range(3, 13, 3))
STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5)
QUICK_STEPS = (1e-2, 1e-3)
# From Python a step costs the more: fewer of them.
PYTHON_STEPS = (1e-2, 5e-3, 2e-3, 1e-3, 5e-4)


class Engine:
    """
    One scene in Pinocchio.

    Parameters
    ----------
    scene : scene.Scene
        With gravity alone, joints and cut joints of the kinds that ``peer_cases`` knows.

    """

    name, version = NAME, pin.__version__
    softness = None

    def __init__(self, scene):
        """Build the model, and the loops in C++ where possible."""
        mechanism = scene.mechanism
        self._planar = mechanism.planar
        parts = elements(mechanism), point_pairs(mechanism), (*gravity(scene), 0.0)[:3]
        self._build(*parts)
        library = compiled(SOURCE)
        self._loops = library and Loops(library, *parts, SETTINGS)
        # In the plane lcaba is slower and less exact.
        self._by_bodies = {} if mechanism.planar or library is None else {
            name: Loops(library, *parts, settings, by_bodies=True)
            for name, settings in BY_BODIES.items()}
        self.others = {name: loops.acceleration for name, loops in self._by_bodies.items()}

    def _build(self, parts, pairs, acceleration):
        model = pin.Model()
        for part in parts:
            number = model.addJoint(part.parent, _joint(part), pin.SE3(
                pin.Quaternion(np.array(part.orientation)), np.array(part.position)), part.name)
            model.appendBodyToJoint(number, pin.Inertia(
                part.mass, np.array(part.center_of_mass), np.diag(part.inertia)),
                pin.SE3.Identity())
        model.gravity.linear = np.array(acceleration)
        self._constraints = pin.StdVec_RigidConstraintModel()
        self._constraint_data = pin.StdVec_RigidConstraintData()
        for number_a, point_a, number_b, point_b in pairs:
            constraint = pin.RigidConstraintModel(
                pin.ContactType.CONTACT_3D, model, number_a, _at(point_a), number_b,
                _at(point_b), pin.ReferenceFrame.LOCAL)
            self._constraints.append(constraint)
            self._constraint_data.append(constraint.createData())
        self._model, self._data = model, model.createData()
        mu, iterations = SETTINGS
        self._proximal = pin.ProximalSettings(ACCURACY, mu, iterations)
        pin.initConstraintDynamics(
            model, self._data, self._constraints, self._constraint_data)

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,)."""
        return pin.constraintDynamics(
            self._model, self._data, q, qd, tau, self._constraints, self._constraint_data,
            self._proximal).copy()

    def timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations}."""
        arguments = (self._model, self._data, q, qd, tau, self._constraints,
                     self._constraint_data, self._proximal)

        def call(count):
            for _ in range(count):
                pin.constraintDynamics(*arguments)

        result = {'evaluation, from Python': call}
        if self._loops:
            self._loops.set_state(q, qd, tau)
            result['evaluation, C++ loop'] = self._loops.evaluate
            result['RK4 step, C++ loop'] = lambda count: self._loops.runge_kutta(1e-12, count)
        for name, loops in self._by_bodies.items():
            loops.set_state(q, qd, tau)
            result[f'evaluation by {name}, C++ loop'] = loops.evaluate
        return result

    def derivative_timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations with all derivatives}."""
        if not self._loops:
            return {}
        self._loops.set_state(q, qd, tau)
        return {'constraintDynamics and computeConstraintDynamicsDerivatives, C++ loop':
                self._loops.differentiate}

    def runs(self, case, quick):
        """Return the runs of a case."""
        runs = []
        for value in QUICK_TOLERANCES if quick else TOLERANCES:
            setting = f'tolerance {value:.0e}'
            if self._planar:
                runs.append(Run(NAME, 'DOP853 of SciPy', setting, self._scipy(case, value)))
            if self._loops:
                runs.append(Run(NAME, 'Fehlberg 7(8) in C++', setting,
                                self._loops.motion(case, 'fehlberg', value)))
            runs += [Run(NAME, f'Fehlberg 7(8) in C++, {name}', setting,
                         loops.motion(case, 'fehlberg', value))
                     for name, loops in self._by_bodies.items()]
        for value in QUICK_STEPS if quick else STEPS:
            setting = f'step {value:g} s'
            if self._loops:
                runs.append(Run(NAME, 'RK4 in C++', setting,
                                self._loops.motion(case, 'runge_kutta', value)))
            elif self._planar and value in PYTHON_STEPS:
                runs.append(Run(NAME, 'RK4 in Python', setting, self._runge_kutta(case, value)))
        return runs

    def _scipy(self, case, tolerance):
        n = len(case.q)
        start = np.concatenate([case.q, case.qd])

        def derivative(_, state):
            # An array of its own each time: SciPy keeps the last one.
            return np.concatenate([state[n:], pin.constraintDynamics(
                self._model, self._data, state[:n], state[n:], case.tau, self._constraints,
                self._constraint_data, self._proximal)])

        def execute():
            return solve_ivp(derivative, (0.0, case.duration), start, method='DOP853',
                             rtol=max(tolerance, 3e-14), atol=tolerance).y[:n, -1]
        return execute

    def _runge_kutta(self, case, step):
        def execute():
            q, qd = case.q, case.qd
            for _ in range(round(case.duration / step)):
                a1 = self.acceleration(q, qd, case.tau)
                v2 = qd + 0.5 * step * a1
                a2 = self.acceleration(q + 0.5 * step * qd, v2, case.tau)
                v3 = qd + 0.5 * step * a2
                a3 = self.acceleration(q + 0.5 * step * v2, v3, case.tau)
                v4 = qd + step * a3
                a4 = self.acceleration(q + step * v3, v4, case.tau)
                q = q + step / 6.0 * (qd + 2.0 * v2 + 2.0 * v3 + v4)
                qd = qd + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            return q
        return execute


# The numbers of joints in pinocchio_loop.cpp; universal ones come last.
KINDS = {('revolute', 'x'): 0, ('revolute', 'y'): 1, ('revolute', 'z'): 2, ('prismatic', 'x'): 3,
         ('prismatic', 'y'): 4, ('prismatic', 'z'): 5, ('spherical',): 6}
FIRST_UNIVERSAL = 10


def _kind(part):
    if part.type == 'universal':
        first, second = ('xyz'.index(axis) for axis in part.axes)
        return FIRST_UNIVERSAL + 3 * first + second
    return KINDS[part.type, *part.axes]


def _joint(part):
    if part.type == 'universal':
        return pin.JointModelUniversal(*(np.eye(3)['xyz'.index(axis)] for axis in part.axes))
    name = {'revolute': 'R', 'prismatic': 'P', 'spherical': 'Spherical'}[part.type]
    return getattr(pin, 'JointModel' + name + ''.join(part.axes).upper())()


def _at(point):
    return pin.SE3(np.eye(3), np.array(point))


class Loops(Machine):
    """
    The loops of pinocchio_loop.cpp on one mechanism.

    Parameters
    ----------
    library : ctypes.CDLL
        Compiled.
    parts : sequence of Element
        The tree.
    pairs : sequence of tuples
        Points that are held together, of ``peer_cases.point_pairs``.
    acceleration : sequence of 3 floats
        Of gravity [m/s^2].
    settings : tuple
        Regularisation and number of iterations.
    by_bodies : bool
        Evaluate by lcaba.

    """

    def __init__(self, library, parts, pairs, acceleration, settings, by_bodies=False):
        """Hand the mechanism over."""
        mu, iterations = settings
        super().__init__(library, library.create(
            len(parts), pointer([part.parent for part in parts], np.int32),
            pointer([_kind(part) for part in parts], np.int32),
            pointer([[*part.position, *part.orientation] for part in parts]),
            pointer([[part.mass, *part.center_of_mass, *part.inertia] for part in parts]),
            len(pairs), pointer([[pair[0], pair[2]] for pair in pairs], np.int32),
            pointer([[*pair[1], *pair[3]] for pair in pairs]), pointer(acceleration),
            ctypes.c_double(mu), ctypes.c_double(ACCURACY), iterations, int(by_bodies)))

    def motion(self, case, method, value):
        """Return a function that computes a motion: by a step size [s], or by a tolerance."""
        def execute():
            self.set_state(case.q, case.qd, case.tau)
            if method == 'runge_kutta':
                self.runge_kutta(value, round(case.duration / value))
            else:
                self.fehlberg(case.duration, value, 1e-2)
            return self.position()
        return execute
