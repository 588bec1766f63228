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
Pinocchio (Carpentier et al.), for the comparison in peers.py.

A library of rigid-body algorithms, without integrators of its own: constraintDynamics is called
from Python (a time loop of our own, SciPy's DOP853) and, where a C++ compiler and the headers of
Eigen are found, from loops in C++ (pinocchio_loop.cpp) with Boost's integrators.

"""

import ctypes
import hashlib
import os
from pathlib import Path
import subprocess
import tempfile

import numpy as np
from peer_cases import gravity, Run
import pinocchio as pin
from scipy.integrate import solve_ivp

NAME = 'Pinocchio'
SOURCE = Path(__file__).with_name('pinocchio_loop.cpp')
# A closed loop in the plane has a third, empty row: mu must be positive. The accelerations are
# off by about mu, relative; one iteration is then enough, and more cost more.
MU, ACCURACY, ITERATIONS = 1e-14, 1e-12, 1
TOLERANCES = tuple(10.0 ** -k for k in range(2, 14))
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
        With gravity alone, all joints and cut joints revolute.

    """

    name, version = NAME, pin.__version__
    softness = None

    def __init__(self, scene):
        """Build the model, and the loops in C++ where possible."""
        mechanism = scene.mechanism
        self._number = {'ground': 0}
        for k, joint in enumerate(mechanism.joints, start=1):
            self._number[joint.child] = k
        self._build(mechanism, gravity(scene))
        library = compiled_loops()
        self._loops = None if library is None else Loops(
            library, mechanism, gravity(scene), self._number)

    def _build(self, mechanism, acceleration):
        model, bodies = pin.Model(), {body.name: body for body in mechanism.bodies}
        for joint in mechanism.joints:
            body = bodies[joint.child]
            number = model.addJoint(self._number[joint.parent], pin.JointModelRZ(),
                                    _placement(joint.position, joint.angle), joint.name)
            model.appendBodyToJoint(number, pin.Inertia(
                body.mass, np.array([*body.center_of_mass, 0.0]), body.inertia * np.eye(3)),
                pin.SE3.Identity())
        model.gravity.linear = np.array([*acceleration, 0.0])
        self._constraints = pin.StdVec_RigidConstraintModel()
        self._constraint_data = pin.StdVec_RigidConstraintData()
        for cut in mechanism.cut_joints:
            constraint = pin.RigidConstraintModel(
                pin.ContactType.CONTACT_3D, model,
                self._number[cut.body_a], _placement(cut.point_a),
                self._number[cut.body_b], _placement(cut.point_b), pin.ReferenceFrame.LOCAL)
            self._constraints.append(constraint)
            self._constraint_data.append(constraint.createData())
        self._model, self._data = model, model.createData()
        self._settings = pin.ProximalSettings(ACCURACY, MU, ITERATIONS)
        pin.initConstraintDynamics(
            model, self._data, self._constraints, self._constraint_data)

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,)."""
        return pin.constraintDynamics(
            self._model, self._data, q, qd, tau, self._constraints, self._constraint_data,
            self._settings).copy()

    def timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations}."""
        arguments = (self._model, self._data, q, qd, tau, self._constraints,
                     self._constraint_data, self._settings)

        def call(count):
            for _ in range(count):
                pin.constraintDynamics(*arguments)

        result = {'evaluation, from Python': call}
        if self._loops:
            self._loops.set_state(q, qd, tau)
            result['evaluation, C++ loop'] = self._loops.evaluate
        return result

    def runs(self, case, quick):
        """Return the runs of a case."""
        runs = []
        for value in QUICK_TOLERANCES if quick else TOLERANCES:
            runs.append(Run(NAME, 'DOP853 of SciPy', f'tolerance {value:.0e}',
                            self._scipy(case, value)))
            if self._loops:
                runs.append(Run(NAME, 'Fehlberg 7(8) in C++', f'tolerance {value:.0e}',
                                self._loops.fehlberg(case, value)))
        for value in QUICK_STEPS if quick else STEPS:
            if self._loops:
                runs.append(Run(NAME, 'RK4 in C++', f'step {value:g} s',
                                self._loops.runge_kutta(case, value)))
            elif value in PYTHON_STEPS:
                runs.append(Run(NAME, 'RK4 in Python', f'step {value:g} s',
                                self._runge_kutta(case, value)))
        return runs

    def _scipy(self, case, tolerance):
        n = len(case.q)
        start = np.concatenate([case.q, case.qd])

        def derivative(_, state):
            # An array of its own each time: SciPy keeps the last one.
            return np.concatenate([state[n:], pin.constraintDynamics(
                self._model, self._data, state[:n], state[n:], case.tau, self._constraints,
                self._constraint_data, self._settings)])

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


def _placement(position, angle=0.0):
    return pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, angle), np.array([*position, 0.0]))


class Loops:
    """
    The loops of pinocchio_loop.cpp on one mechanism.

    Parameters
    ----------
    library : ctypes.CDLL
        Compiled.
    mechanism : Mechanism
        All joints and cut joints revolute.
    acceleration : sequence of 2 floats
        Of gravity [m/s^2].
    number : mapping
        Of the joint that carries each body, 0 for the ground.

    """

    def __init__(self, library, mechanism, acceleration, number):
        """Hand the mechanism over."""
        joints, cuts = mechanism.joints, mechanism.cut_joints
        bodies = {body.name: body for body in mechanism.bodies}
        carried = [bodies[joint.child] for joint in joints]
        library.create.restype, library.evaluations.restype = ctypes.c_void_p, ctypes.c_long
        self._library, self._n = library, len(joints)
        self._handle = ctypes.c_void_p(library.create(
            len(joints), _pointer([number[joint.parent] for joint in joints], np.int32),
            _pointer([[*joint.position, joint.angle] for joint in joints]),
            _pointer([[b.mass, *b.center_of_mass, b.inertia] for b in carried]),
            len(cuts), _pointer([[number[c.body_a], number[c.body_b]] for c in cuts], np.int32),
            _pointer([[*c.point_a, *c.point_b] for c in cuts]), _pointer(acceleration),
            ctypes.c_double(MU), ctypes.c_double(ACCURACY), ITERATIONS))

    def set_state(self, q, qd, tau):
        """Go to a state under joint torques."""
        self._library.set_state(self._handle, _pointer(q), _pointer(qd), _pointer(tau))

    def evaluate(self, count):
        """Evaluate the present state again and again; return its accelerations."""
        result = np.zeros(self._n)
        self._library.evaluate(self._handle, ctypes.c_long(count), _pointer(result))
        return result

    def position(self):
        """Return the present joint coordinates."""
        q, qd = np.zeros(self._n), np.zeros(self._n)
        self._library.get_state(self._handle, _pointer(q), _pointer(qd))
        return q

    def runge_kutta(self, case, step):
        """Return a function that computes the motion of a case by RK4."""
        def execute():
            self.set_state(case.q, case.qd, case.tau)
            self._library.runge_kutta_4(self._handle, ctypes.c_double(step),
                                        ctypes.c_long(round(case.duration / step)))
            return self.position()
        return execute

    def fehlberg(self, case, tolerance):
        """Return a function that computes the motion of a case by Fehlberg's pair."""
        def execute():
            self.set_state(case.q, case.qd, case.tau)
            self._library.fehlberg_78(self._handle, ctypes.c_double(case.duration),
                                      ctypes.c_double(tolerance), ctypes.c_double(1e-2))
            return self.position()
        return execute


def _pointer(values, kind=float):
    return np.ascontiguousarray(values, dtype=kind).ctypes.data_as(ctypes.c_void_p)


def compiled_loops():
    """
    Compile pinocchio_loop.cpp against the installed wheel, once for each version of both.

    Returns
    -------
    ctypes.CDLL or None
        None where there is no compiler, or the headers do not suffice.

    """
    prefix = Path(pin.__file__).resolve().parents[4]
    options = ['-O3', '-DNDEBUG', '-std=c++17', '-shared', '-fPIC', '-w',
               '-DBOOST_MPL_LIMIT_LIST_SIZE=30', '-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS',
               f'-I{prefix}/include', f'-I{prefix}/include/eigen3']
    links = [f'-L{prefix}/lib', '-lpinocchio_default', f'-Wl,-rpath,{prefix}/lib']
    text = SOURCE.read_text() + ' '.join(options) + pin.__version__
    cache = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    library = cache / 'closedloop_dynamics' / (
        f'pinocchio_loop_{hashlib.sha256(text.encode()).hexdigest()[:16]}.so')
    if not library.exists():
        print('compiling the loops in C++ around Pinocchio (a minute, this time alone) ...')
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as scratch:
            made = Path(scratch) / 'loop.so'
            try:
                subprocess.run([os.environ.get('CXX', 'g++'), *options, str(SOURCE), '-o',
                                str(made), *links], check=True, capture_output=True, text=True)
            except (OSError, subprocess.CalledProcessError) as error:
                lines = (getattr(error, 'stderr', '') or str(error)).strip().splitlines()
                print(f'no loops in C++: {lines[0] if lines else error}')
                return None
            made.replace(library)
    return ctypes.CDLL(str(library))
