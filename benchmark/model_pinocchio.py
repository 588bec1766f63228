# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Machines in Pinocchio, for the comparisons in peers.py, all_machines.py and models.py.

A mechanism of ours is built joint by joint. A URDF file is read by Pinocchio itself; joints that
a YAML file beside it makes spherical or universal are replaced. Loops are closed by rigid
constraints between the frames that our reader found. Evaluations run in C++ (pinocchio_model.cpp)
where there is a compiler.
"""

import ctypes
from pathlib import Path
import sys
import tempfile
from xml.etree import ElementTree

from machine import ROOT
import numpy as np
from peer_errors import CannotExpress, NotAdapted
import pinocchio as pin
from pinocchio_code import compiled, Machine, pointer

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.formats.building import word  # noqa: E402,I100
from closedloop_dynamics.formats.in_space import in_space  # noqa: E402
from closedloop_dynamics.mechanism.inertia import inertia_matrix  # noqa: E402
from closedloop_dynamics.mechanism.mechanism import (  # noqa: E402
    FIXED, GROUND, PRISMATIC, REVOLUTE, SPHERICAL, UNIVERSAL)
from closedloop_dynamics.mechanism.rotations import of_quaternion  # noqa: E402

NAME = 'Pinocchio'
VERSION = pin.__version__
SOURCE = Path(__file__).with_name('pinocchio_model.cpp')
ACCURACY = 1e-12
# Loops may repeat each other's equations: mu must be positive. Of each algorithm mu and the number
# of iterations that are enough, as more cost more: accelerations are off by about mu, relative.
# For lcaba the smallest mu that rounding leaves, and two iterations.
SETTINGS = {'constraintDynamics': (1e-12, 1), 'lcaba': (1e-8, 1),
            'lcaba, 2 iterations': (1e-5, 2)}
# A second place on the axis of a hinge that closes a loop [m].
ALONG = 0.1
KNOWN = ('link', 'joint', 'material', 'transmission')


class Pinocchio:
    """
    A machine in Pinocchio, of ``read`` or ``built``.

    Parameters
    ----------
    model : pinocchio.Model
    places : dict of str to list of int
        Its joints for each of ours.
    loops : list of tuple
        What holds loops together: joint, frame, joint, frame, whether orientations are held, too.
    mechanism : Mechanism
        Ours.
    gravity : sequence of 2 or 3 floats
        [m/s^2].
    algorithm : str
        Of ``SETTINGS``.
    balls : list of (list of str, int)
        Hinges of ours that are one ball, and that joint.

    Raises
    ------
    CannotExpress
        Where it cannot be the same machine.
    NotAdapted
        Where there is no C++ compiler.

    """

    def __init__(self, model, places, loops, mechanism, gravity, algorithm, balls=()):
        self._algorithm, self._places, self._loops, self._balls = algorithm, places, loops, balls
        self.mechanism = mechanism
        model.gravity.linear = np.array((*gravity, 0.0)[:3])
        self.model, self.data = model, model.createData()
        self.machine = self._compiled()

    @classmethod
    def built(cls, mechanism, gravity, algorithm='constraintDynamics'):
        """Return a mechanism, in the plane or in space, built joint by joint."""
        if mechanism.couplings:
            raise CannotExpress('couplings of joints')
        whole, model, places = in_space(mechanism), pin.Model(), {}
        bodies = {body.name: body for body in whole.bodies}
        carrying, carried = {GROUND: (0, pin.SE3.Identity())}, {}
        for joint in whole.joints:
            carried.setdefault(joint.parent, []).append(joint)
        # Depth first, as Pinocchio numbers its joints.
        waiting = carried.get(GROUND, [])[::-1]
        while waiting:
            joint = waiting.pop()
            waiting += carried.get(joint.child, [])[::-1]
            parent, offset = carrying[joint.parent]
            placement = offset * pin.SE3(
                of_quaternion(joint.orientation), np.array(joint.position))
            places[joint.name] = []
            for part, kind in enumerate(_kinds(joint)):
                parent = model.addJoint(parent, kind, placement, f'{joint.name}_{part}')
                placement = pin.SE3.Identity()
                places[joint.name].append(parent)
            body = bodies[joint.child]
            model.appendBodyToJoint(parent, pin.Inertia(
                body.mass, np.array(body.center_of_mass), inertia_matrix(body.inertia)), placement)
            carrying[joint.child] = parent, placement
        loops = [loop for cut in whole.cut_joints
                 for loop in _loops(cut, carrying, mechanism.planar)]
        return cls(model, places, loops, mechanism, gravity, algorithm)

    @classmethod
    def read(cls, path, mechanism, gravity, balls=False, algorithm='constraintDynamics'):
        """
        Return a model of a URDF file, its joints replaced and its loops held together.

        ``mechanism``: what our reader made of it. ``balls``: whether three hinges through one
        place without mass in between are one ball, as the authors of some models load them.
        """
        if mechanism.couplings:
            raise CannotExpress('couplings of joints')
        ours = {joint.name: joint for joint in mechanism.joints}
        tree = _tree(path)
        # What a YAML file beside the model makes rigid is none of our joints.
        rigid = [number for number in range(1, tree.njoints)
                 if word(tree.names[number]) not in ours]
        tree = pin.buildReducedModel(tree, rigid, pin.neutral(tree))
        model, carrying = pin.Model(), {GROUND: (0, pin.SE3.Identity())}
        places, replaced, numbers, first = {}, [], {0: 0}, None
        merged = _balls(mechanism) if balls else {}
        for number in range(1, tree.njoints):
            name = word(tree.names[number])
            joint = ours[name]
            parent, placement = numbers[tree.parents[number]], tree.jointPlacements[number]
            if name in merged:
                if name != merged[name][-1]:
                    # Its place is that of the first; what is between has no mass.
                    numbers[number] = parent
                    if name == merged[name][0]:
                        first = placement
                    continue
                placement, made = first, [pin.JointModelSpherical()]
                replaced.append((merged[name], len(model.names)))
            elif joint.type == SPHERICAL:
                made = [pin.JointModelSpherical()]
            elif joint.type == UNIVERSAL:
                made = [_hinge(joint.axis), _hinge(joint.second_axis)]
            else:
                made = [tree.joints[number]]
            for part, kind in enumerate(made):
                parent = model.addJoint(parent, kind, placement, f'{name}_{part}')
                placement = pin.SE3.Identity()
                places.setdefault(name, []).append(parent)
            model.appendBodyToJoint(parent, tree.inertias[number], pin.SE3.Identity())
            numbers[number] = parent
            carrying[joint.child] = parent, placement
        loops = [loop for cut in mechanism.cut_joints for loop in _loops(cut, carrying, False)]
        return cls(model, places, loops, mechanism, gravity, algorithm, replaced)

    @property
    def merged(self):
        """Return how many balls stand for three hinges."""
        return len(self._balls)

    def state(self, q, qd):
        """Return Pinocchio's coordinates and rates for ours."""
        found, rates = pin.neutral(self.model), np.zeros(self.model.nv)
        places = self.mechanism.coordinates
        spans = {name: (q[places.coordinates[name]], qd[places.rates[name]])
                 for name in self.mechanism.joint_names}
        merged = {name: joint for names, joint in self._balls for name in names}
        for name, joints in self._places.items():
            if name in merged:
                continue
            some, speeds = spans[name]
            for joint in joints:
                count, width = self.model.nqs[joint], self.model.nvs[joint]
                value = some[:width] if count == width else some
                if (count, width) == (2, 1):
                    value = [np.cos(some[0]), np.sin(some[0])]
                at, rate = self.model.idx_qs[joint], self.model.idx_vs[joint]
                found[at:at + count], rates[rate:rate + width] = value, speeds[:width]
                some, speeds = some[width:], speeds[width:]
        ours = {joint.name: joint for joint in self.mechanism.joints}
        for names, joint in self._balls:
            turned, speed = np.eye(3), np.zeros(3)
            for number, name in enumerate(names):
                one, (angle, rate) = ours[name], spans[name]
                before = of_quaternion(one.orientation) if number else np.eye(3)
                turn = before @ pin.AngleAxis(angle[0], np.array(one.axis)).matrix()
                turned = turned @ turn
                speed = turn.T @ speed + rate[0] * np.array(one.axis)
            at, rate = self.model.idx_qs[joint], self.model.idx_vs[joint]
            found[at:at + 4] = pin.Quaternion(turned).coeffs()
            rates[rate:rate + 3] = speed
        return found, rates

    def ours(self, rates):
        """Return the rates of our joints, in our order; of no merged balls."""
        found, places = np.zeros(self.mechanism.coordinates.nv), self.mechanism.coordinates
        for name, joints in self._places.items():
            if not joints:
                continue
            found[places.rates[name]] = np.concatenate([
                rates[self.model.idx_vs[joint]:self.model.idx_vs[joint] + self.model.nvs[joint]]
                for joint in joints])
        return found

    def coordinates_of(self, position):
        """Return the coordinates of our joints, in our order; of none about angles unlimited."""
        found, places = np.zeros(self.mechanism.coordinates.nq), self.mechanism.coordinates
        for name, joints in self._places.items():
            if joints:
                found[places.coordinates[name]] = np.concatenate([
                    position[self.model.idx_qs[joint]:self.model.idx_qs[joint]
                             + self.model.nqs[joint]] for joint in joints])
        return found

    def constraints(self):
        """Return what holds the loops together in Pinocchio, and the data of it."""
        models, data = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
        for a, of_a, b, of_b, whole in self._loops:
            models.append(pin.RigidConstraintModel(
                pin.ContactType.CONTACT_6D if whole else pin.ContactType.CONTACT_3D, self.model,
                a, of_a, b, of_b, pin.ReferenceFrame.LOCAL))
            data.append(models[-1].createData())
        return models, data

    def efforts(self, tau):
        """Return generalized forces in Pinocchio's order, of joints that are not merged."""
        found, places = np.zeros(self.model.nv), self.mechanism.coordinates
        for name, joints in self._places.items():
            some = tau[places.rates[name]]
            for joint in joints:
                at, width = self.model.idx_vs[joint], self.model.nvs[joint]
                if len(some) >= width:
                    found[at:at + width] = some[:width]
                some = some[width:]
        return found

    def equations(self, q, qd, tau):
        """
        Return the equations of motion in our order of coordinates.

        Returns
        -------
        inertia, force, jac, bias : ndarrays
            inertia qdd + jac^T lam = force, jac qdd = -bias.

        """
        model, data = self.model, self.data
        position, rates = self.state(q, qd)
        inertia = pin.crba(model, data, position).copy()
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        force = self.efforts(tau) - pin.nonLinearEffects(model, data, position, rates)
        pin.computeJointJacobians(model, data, position)
        pin.forwardKinematics(model, data, position, rates, np.zeros(model.nv))
        jac, bias = [], []
        for a, frame_a, b, frame_b, whole in self._loops:
            rows, drift = np.zeros((6, model.nv)), np.zeros(6)
            for joint, frame, sign in ((a, frame_a, 1.0), (b, frame_b, -1.0)):
                if joint:
                    one = pin.getFrameJacobian(
                        model, data, joint, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
                    accelerated = pin.getFrameClassicalAcceleration(
                        model, data, joint, frame, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
                    rows += sign * one
                    drift += sign * accelerated.vector
            count = 6 if whole else 3
            jac.append(rows[:count])
            bias.append(drift[:count])
        # Columns in our order.
        order = self.ours(np.arange(model.nv, dtype=float)).astype(int)
        return (inertia[np.ix_(order, order)], force[order], np.vstack(jac)[:, order],
                np.concatenate(bias))

    def evaluate(self, q, qd, tau, count=1):
        """Evaluate a state so many times in C++; return its accelerations in our order."""
        position, rates = self.state(q, qd)
        self.machine.set_state(position, rates, self.efforts(tau))
        result = self.machine.evaluate(count)
        return None if self.merged else self.ours(result)

    def _compiled(self):
        library = compiled(SOURCE, '-lboost_serialization')
        if library is None:
            raise NotAdapted('no C++ compiler')
        loops, (mu, iterations) = self._loops, SETTINGS[self._algorithm]
        with tempfile.NamedTemporaryFile(suffix='.bin') as file:
            self.model.saveToBinary(file.name)
            return Machine(library, library.create(
                file.name.encode(), len(loops),
                pointer([[a, b] for a, _, b, _, _ in loops], np.int32),
                pointer([whole for *_, whole in loops], np.int32),
                pointer([[np.column_stack([frame.rotation, frame.translation])
                          for frame in (one, other)] for _, one, _, other, _ in loops]),
                ctypes.c_double(mu), ctypes.c_double(ACCURACY), iterations,
                int(self._algorithm.startswith('lcaba'))))


def _tree(path):
    """Return the tree of a URDF file, without the elements that Pinocchio does not know."""
    root = ElementTree.parse(path).getroot()
    for element in list(root):
        if element.tag not in KNOWN:
            root.remove(element)
    return pin.buildModelFromXML(ElementTree.tostring(root, encoding='unicode'))


def _hinge(axis):
    return _aligned(axis, 'R') or pin.JointModelRevoluteUnaligned(np.array(axis))


def _aligned(axis, letter):
    """Return Pinocchio's faster joint about or along an axis of the frame, None of another."""
    for unit, name in zip(np.eye(3), 'XYZ'):
        if np.array_equal(axis, unit):
            return getattr(pin, f'JointModel{letter}{name}')()
    return None


def _kinds(joint):
    """Return Pinocchio's joints for one of ours in space; none for one that is fixed."""
    if joint.type == PRISMATIC:
        return [_aligned(joint.axis, 'P') or pin.JointModelPrismaticUnaligned(
            np.array(joint.axis))]
    kinds = {
        FIXED: lambda: [], REVOLUTE: lambda: [_hinge(joint.axis)],
        UNIVERSAL: lambda: [pin.JointModelUniversal(
            np.array(joint.axis), np.array(joint.second_axis))],
        SPHERICAL: lambda: [pin.JointModelSpherical()]}
    if joint.type not in kinds:
        raise NotAdapted(f'{joint.type} joints')
    return kinds[joint.type]()


def _loops(cut, carrying, planar):
    """Yield what holds a loop together: joint, frame, joint, frame, whether it is rigid."""
    (a, of_a), (b, of_b) = carrying[cut.body_a], carrying[cut.body_b]
    turned, places = np.eye(3), [0.0]
    if cut.type == FIXED:
        turned = of_quaternion(cut.orientation).T
    elif cut.type == REVOLUTE:
        # In the plane one point suffices.
        places = [0.0] if planar else [0.0, ALONG]
    elif cut.type != SPHERICAL:
        raise CannotExpress(f'{cut.type} joints where loops close')
    for along in places:
        ends = [np.array(point) + (along * np.array(axis) if along else 0.0)
                for point, axis in ((cut.point_a, cut.axis_a), (cut.point_b, cut.axis_b))]
        yield (a, of_a * pin.SE3(turned, ends[0]), b, of_b * pin.SE3(np.eye(3), ends[1]),
               cut.type == FIXED)


def _balls(mechanism):
    """Return by joint the three hinges through one place, without mass between, that it is of."""
    below, found = {}, {}
    massless = {body.name for body in mechanism.bodies if body.massless}
    for joint in mechanism.joints:
        below.setdefault(joint.parent, []).append(joint)
    closed = {body for cut in mechanism.cut_joints for body in (cut.body_a, cut.body_b)}
    for joint in mechanism.joints:
        chain = [joint]
        while len(chain) < 3 and chain[-1].child in massless - closed and len(
                below.get(chain[-1].child, ())) == 1:
            chain += below[chain[-1].child]
        if len(chain) == 3 and all(one.type == REVOLUTE for one in chain) and not any(
                any(one.position) for one in chain[1:]) and joint.name not in found:
            found.update((one.name, [one.name for one in chain]) for one in chain)
    return found
