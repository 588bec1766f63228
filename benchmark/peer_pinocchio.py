# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Pinocchio (Carpentier et al.) beside us.

A library of rigid-body algorithms, without integrators of its own: constraintDynamics and lcaba,
its algorithm over the bodies, are called from Python (in the plane, by SciPy's DOP853) and from
loops in C++ (peer_pinocchio.cpp) with Boost's integrators, which need a C++ compiler and the
headers of Eigen.

A mechanism is built joint by joint, with places, axes and masses that Pinocchio reads itself from
a URDF file. Loops are closed by rigid constraints between the frames that our reader found.
"""

import ctypes
from dataclasses import replace
import hashlib
import os
from pathlib import Path
import sys
import tempfile
from xml.etree import ElementTree

import numpy as np
from peer_cases import (
    CannotExpress, depth_first, Line, NotAdapted, run_compiler, with_balls_at_loops)
import pinocchio as pin
from scipy.integrate import solve_ivp

from closedloop_dynamics.formats.building import word  # noqa: I100
from closedloop_dynamics.mechanism.inertia import inertia_matrix
from closedloop_dynamics.mechanism.mechanism import (
    FIXED, GROUND, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
from closedloop_dynamics.mechanism.rotations import of_quaternion

NAME = 'Pinocchio'
SOURCE = Path(__file__).with_suffix('.cpp')
ACCURACY = 1e-12
# Loops may repeat each other's equations: mu must be positive. Of each algorithm mu and the number
# of iterations that are enough, as more cost more: accelerations are off by about mu, relative.
# For lcaba the smallest mu that rounding leaves, and two iterations.
PLAIN = 'constraintDynamics'
SETTINGS = {PLAIN: (1e-12, 1), 'lcaba': (1e-8, 1), 'lcaba, 2 iterations': (1e-5, 2)}
# What constraintDynamics tends to, however nearly equations repeat others.
CONVERGED = (1e-8, 100)
# Places on the axis of a hinge that closes a loop [m].
HINGE = 0.0, 0.1
KNOWN = ('link', 'joint', 'material', 'transmission')


class Engine:
    """
    One machine in Pinocchio.

    Parameters
    ----------
    machine : peer_cases.Machine

    Raises
    ------
    CannotExpress
        Where it cannot be the same machine.
    NotAdapted
        Where there is no C++ compiler.

    """

    name, version = NAME, pin.__version__
    agreed, limit_agreed, limit_name = 1e-5, 1e-5, 'converged'

    def __init__(self, machine):
        self.mechanism = mechanism = machine.mechanism
        machine.require_gravity_alone()
        if mechanism.couplings:
            raise CannotExpress('couplings of joints')
        tree = None
        if machine.path is not None and machine.path.suffix.lower() == '.urdf':
            tree = _tree(machine.path, mechanism)
        self._model = pin.Model()
        self._model.gravity.linear = np.array(machine.gravity)
        whole = with_balls_at_loops(mechanism, HINGE)
        carrying = self._build(whole, tree)
        loops = [_constraint(cut, carrying) for cut in whole.cut_joints]
        self._loops = {name: Loops(self, self._model, loops, *settings, name != PLAIN)
                       for name, settings in SETTINGS.items()}
        self._plain = self._loops[PLAIN]
        self.acceleration = self._plain.acceleration
        self.limit = Loops(self, self._model, loops, *CONVERGED, False).acceleration
        self.others = {name: of.acceleration for name, of in self._loops.items() if name != PLAIN}
        self._data = self._model.createData()
        self._constraints = pin.StdVec_RigidConstraintModel()
        self._constraint_data = pin.StdVec_RigidConstraintData()
        for *ends, rigid in loops:
            self._constraints.append(pin.RigidConstraintModel(
                pin.ContactType.CONTACT_6D if rigid else pin.ContactType.CONTACT_3D, self._model,
                *ends, pin.ReferenceFrame.LOCAL))
            self._constraint_data.append(self._constraints[-1].createData())
        self._proximal = pin.ProximalSettings(ACCURACY, *SETTINGS[PLAIN])
        pin.initConstraintDynamics(
            self._model, self._data, self._constraints, self._constraint_data)

    def _build(self, mechanism, tree):
        """Add the joints and bodies; return what carries each body, and its frame there."""
        model, names = self._model, mechanism.coordinates
        bodies = {body.name: body for body in mechanism.bodies}
        numbers = {word(name): number for number, name in enumerate(tree.names)} if tree else {}
        carrying = {GROUND: (0, pin.SE3.Identity())}
        # Where our coordinates and rates are in its own, and which count the other way.
        self._q, self._v = np.zeros(names.nq, dtype=int), np.zeros(names.nv, dtype=int)
        self._sign_q, self._sign_v = np.ones(names.nq), np.ones(names.nv)
        for joint in depth_first(mechanism):
            parent, placement = carrying[joint.parent]
            if tree is None:
                body = bodies[joint.child]
                own = pin.SE3(of_quaternion(joint.orientation), np.array(joint.position))
                inertia = pin.Inertia(body.mass, np.array(body.center_of_mass),
                                      inertia_matrix(body.inertia))
            else:
                number = numbers[joint.name]
                own, inertia = tree.jointPlacements[number], tree.inertias[number]
                if joint.type in (REVOLUTE, PRISMATIC):
                    axis = np.ravel(tree.joints[number].createData().S)
                    joint = replace(
                        joint, axis=tuple(axis[3:] if joint.type == REVOLUTE else axis[:3]))
            placement = placement * own
            coordinates, rates = names.coordinates[joint.name], names.rates[joint.name]
            if joint.type in (REVOLUTE, PRISMATIC) and np.isin(joint.axis, (0.0, -1.0)).all():
                # Its joints about axes of the frame, which are faster, are about positive ones.
                joint = replace(joint, axis=tuple(-number for number in joint.axis))
                self._sign_q[coordinates.start] = self._sign_v[rates.start] = -1.0
            self._q[coordinates] = model.nq + np.arange(coordinates.stop - coordinates.start)
            self._v[rates] = model.nv + np.arange(rates.stop - rates.start)
            if joint.type != FIXED:
                parent = model.addJoint(parent, _kind(joint), placement, joint.name)
                placement = pin.SE3.Identity()
            model.appendBodyToJoint(parent, inertia, placement)
            carrying[joint.child] = parent, placement
        return carrying

    def state(self, q, qd):
        """Return its coordinates and rates, one after the other, for ours."""
        found = np.zeros(self._model.nq + self._model.nv)
        found[self._q], found[self._model.nq + self._v] = self._sign_q * q, self._sign_v * qd
        return found

    def efforts(self, tau):
        """Return joint torques in its order, as an array for C."""
        found = np.zeros(self._model.nv)
        found[self._v] = self._sign_v * tau[:len(found)]
        return found

    def ours(self, rates):
        """Return our rates, or accelerations, for its own."""
        return self._sign_v * rates[self._v]

    def coordinates(self, q):
        """Return our coordinates for its own."""
        return self._sign_q * q[self._q]

    def _accelerate(self, q, v, tau):
        return pin.constraintDynamics(
            self._model, self._data, q, v, tau, self._constraints, self._constraint_data,
            self._proximal)

    def timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations}."""
        arguments = *np.split(self.state(q, qd), [self._model.nq]), self.efforts(tau)

        def call(count):
            for _ in range(count):
                self._accelerate(*arguments)

        for loops in self._loops.values():
            loops.set_state(q, qd, tau)
        return {'evaluation, from Python': call, 'evaluation, C++ loop': self._plain.evaluate,
                'RK4 step, C++ loop': lambda count: self._plain.advance(
                    'runge_kutta_4', 1e-12, count),
                **{f'evaluation by {name}, C++ loop': self._loops[name].evaluate
                   for name in self.others}}

    def derivative_timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations with all derivatives}."""
        self._plain.set_state(q, qd, tau)
        return {'constraintDynamics and computeConstraintDynamicsDerivatives, C++ loop':
                lambda count: self._plain.advance('differentiate', count)}

    def lines(self, case, plan):
        """Return the ways to compute a case."""
        tolerances = [f'tolerance {value:.1e}' for value in plan.tolerances]
        lines = []
        if self.mechanism.planar and len(case.torques) == 1:
            lines.append(Line(NAME, 'DOP853 of SciPy', tolerances, lambda number: (
                self._scipy(case, plan.tolerances[number]))))
        for name, loops in self._loops.items():
            end = '' if name == PLAIN else f', {name}'
            lines += [
                Line(NAME, f'Fehlberg 7(8) in C++{end}', tolerances,
                     lambda number, loops=loops: loops.motion(
                         case, 'fehlberg_78', case.span, plan.tolerances[number], case.step)),
                case.stepped(NAME, f'RK4 in C++{end}', plan.steps,
                             lambda count, step, loops=loops: loops.motion(
                                 case, 'runge_kutta_4', step, count))]
        return lines

    def _scipy(self, case, tolerance):
        tau, start, n = self.efforts(case.torques[0]), self.state(case.q, case.qd), len(case.q)

        def derivative(_, state):
            # In the plane rates are derivatives of coordinates; copied: SciPy keeps the last one.
            return np.concatenate([state[n:], self._accelerate(state[:n], state[n:], tau)])

        return lambda: self.coordinates(solve_ivp(
            derivative, (0.0, case.duration), start, method='DOP853',
            rtol=max(tolerance, 3e-14), atol=tolerance).y[:n, -1])


class Loops:
    """
    A machine in the loops of peer_pinocchio.cpp.

    Parameters
    ----------
    engine : Engine
        Whose states it is told.
    model : pinocchio.Model
    loops : list of tuple
        What holds loops together: joint, frame, joint, frame, whether orientations are held, too.
    mu, iterations : float, int
        Of the proximal iteration.
    by_bodies : bool
        Whether lcaba computes accelerations.

    """

    def __init__(self, engine, model, loops, mu, iterations, by_bodies):
        self._engine, self._library = engine, _compiled()
        with tempfile.NamedTemporaryFile(suffix='.bin') as file:
            model.saveToBinary(file.name)
            self._handle = ctypes.c_void_p(self._library.create(
                file.name.encode(), len(loops),
                _pointer([[a, b] for a, _, b, _, _ in loops], np.int32),
                _pointer([whole for *_, whole in loops], np.int32),
                _pointer([[np.column_stack([frame.rotation, frame.translation])
                           for frame in (one, other)] for _, one, _, other, _ in loops]),
                ctypes.c_double(mu), ctypes.c_double(ACCURACY), iterations, int(by_bodies)))

    def set_state(self, q, qd, tau):
        """Go to a state of ours under joint torques."""
        self._library.set_state(self._handle, _pointer(self._engine.state(q, qd)))
        self._library.set_torque(self._handle, _pointer(self._engine.efforts(tau)))

    def evaluate(self, count):
        """Evaluate the present state again and again; return our accelerations."""
        result = np.zeros(self._engine.mechanism.coordinates.nv)
        self._library.evaluate(self._handle, ctypes.c_long(count), _pointer(result))
        return self._engine.ours(result)

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,)."""
        self.set_state(q, qd, tau)
        return self.evaluate(1)

    def advance(self, name, *values):
        """Call a function of C++ by its name."""
        getattr(self._library, name)(self._handle, *map(_number, values))

    def motion(self, case, name, *values):
        """Return a function that computes a motion, by a call of C++ for each torque."""
        held = [_pointer(self._engine.efforts(torque)) for torque in case.torques]
        arguments, advance = [*map(_number, values)], getattr(self._library, name)
        q, set_torque, handle = np.zeros(len(case.q)), self._library.set_torque, self._handle

        def execute():
            self.set_state(case.q, case.qd, case.torques[0])
            for torque in held:
                set_torque(handle, torque)
                advance(handle, *arguments)
            self._library.get_position(handle, _pointer(q))
            return self._engine.coordinates(q)
        return execute


def _number(value):
    return ctypes.c_long(value) if isinstance(value, int) else ctypes.c_double(value)


def _pointer(values, kind=float):
    """Return what C takes of an array, which lives as long."""
    return np.ascontiguousarray(values, dtype=kind).ctypes.data_as(ctypes.c_void_p)


def _compiled():
    """
    Return the loops in C++, compiled against the installed wheel once for each version of both.

    NotAdapted where there is no compiler, or the headers do not suffice.
    """
    prefix = Path(pin.__file__).resolve().parents[4]
    options = ['-O3', '-DNDEBUG', '-std=c++17', '-shared', '-fPIC', '-w',
               '-DBOOST_MPL_LIMIT_LIST_SIZE=30', '-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS',
               f'-I{prefix}/include', f'-I{prefix}/include/eigen3', f'-L{prefix}/lib',
               '-lpinocchio_default', '-lboost_serialization', f'-Wl,-rpath,{prefix}/lib']
    text = ''.join([SOURCE.read_text(), *options, pin.__version__])
    cache = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    library = cache / 'closedloop_dynamics' / (
        f'{SOURCE.stem}_{hashlib.sha256(text.encode()).hexdigest()[:16]}.so')
    if not library.exists():
        print(f'compiling {SOURCE.name} around Pinocchio (a minute, this time alone) ...',
              file=sys.stderr)
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as scratch:
            made = Path(scratch) / 'made.so'
            run_compiler('CXX', 'g++', [SOURCE, '-o', made, *options])
            made.replace(library)
    loaded = ctypes.CDLL(str(library))
    loaded.create.restype = ctypes.c_void_p
    return loaded


def _tree(path, mechanism):
    """Return what Pinocchio reads of a URDF file: the tree, of our joints alone."""
    root = ElementTree.parse(path).getroot()
    for element in list(root):
        if element.tag not in KNOWN:
            root.remove(element)
    tree = pin.buildModelFromXML(ElementTree.tostring(root, encoding='unicode'))
    # What a YAML file beside the model makes rigid is none of our joints.
    rigid = [number for number in range(1, tree.njoints)
             if word(tree.names[number]) not in mechanism.joint_names]
    return pin.buildReducedModel(tree, rigid, pin.neutral(tree))


def _aligned(axis, letter):
    """Return Pinocchio's faster joint about or along an axis of the frame, else any."""
    for unit, name in zip(np.eye(3), 'XYZ'):
        if np.array_equal(axis, unit):
            return getattr(pin, f'JointModel{letter}{name}')()
    return {'R': pin.JointModelRevoluteUnaligned, 'P': pin.JointModelPrismaticUnaligned}[letter](
        np.array(axis))


def _kind(joint):
    """Return Pinocchio's joint for one of ours in space."""
    kinds = {
        REVOLUTE: lambda: _aligned(joint.axis, 'R'), PRISMATIC: lambda: _aligned(joint.axis, 'P'),
        UNIVERSAL: lambda: pin.JointModelUniversal(
            np.array(joint.axis), np.array(joint.second_axis)),
        SPHERICAL: pin.JointModelSpherical}
    if joint.type not in kinds:
        raise NotAdapted(f'{joint.type} joints')
    return kinds[joint.type]()


def _constraint(cut, carrying):
    """Return what holds a loop together: joint, frame, joint, frame, whether it is rigid."""
    if cut.type not in (FIXED, SPHERICAL):
        raise CannotExpress(f'{cut.type} joints where loops close')
    (a, of_a), (b, of_b) = carrying[cut.body_a], carrying[cut.body_b]
    turned = of_quaternion(cut.orientation).T if cut.type == FIXED else np.eye(3)
    return (a, of_a * pin.SE3(turned, np.array(cut.point_a)),
            b, of_b * pin.SE3(np.eye(3), np.array(cut.point_b)), cut.type == FIXED)
