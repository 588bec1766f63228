# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Models of robots in Pinocchio, for the comparison in models.py.

A URDF file is read by Pinocchio itself; joints that a YAML file beside it makes spherical or
universal are replaced, and loops are closed by rigid constraints between the frames that our
reader found. Evaluations run in C++ (pinocchio_model.cpp) where there is a compiler.
"""

import ctypes
from pathlib import Path
import sys
import tempfile
from xml.etree import ElementTree

from machine import ROOT
import numpy as np
import pinocchio as pin
from pinocchio_code import compiled, Machine, pointer

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.formats.building import word  # noqa: E402,I100
from closedloop_dynamics.mechanism.mechanism import (  # noqa: E402
    FIXED, GROUND, REVOLUTE, SPHERICAL, UNIVERSAL)
from closedloop_dynamics.mechanism.rotations import of_quaternion  # noqa: E402

NAME = 'Pinocchio'
VERSION = pin.__version__
SOURCE = Path(__file__).with_name('pinocchio_model.cpp')
ACCURACY = 1e-12
# Loops may repeat each other's equations: mu must be positive. Of each algorithm mu and the number
# of iterations that are enough; for lcaba the smallest mu that rounding leaves.
SETTINGS = {'constraintDynamics': (1e-12, 1), 'lcaba': (1e-8, 1)}
# A second place on the axis of a hinge that closes a loop [m].
ALONG = 0.1
KNOWN = ('link', 'joint', 'material', 'transmission')


class Pinocchio:
    """
    A model in Pinocchio.

    Parameters
    ----------
    path : pathlib.Path
        Of a URDF file.
    mechanism : Mechanism
        What our reader made of it.
    gravity : sequence of 3 floats
        [m/s^2].
    balls : bool
        Whether three hinges through one place without mass in between are one ball, as the
        authors of some models load them.
    algorithm : str
        Of ``SETTINGS``.

    Raises
    ------
    ValueError
        Where it cannot be the same machine.

    """

    def __init__(self, path, mechanism, gravity, balls=False, algorithm='constraintDynamics'):
        """Read the file, replace joints, and hold the loops together."""
        self._algorithm = algorithm
        if mechanism.couplings:
            raise ValueError('Pinocchio has no couplings')
        self.mechanism = mechanism
        ours = {joint.name: joint for joint in mechanism.joints}
        tree = _tree(path)
        # What a YAML file beside the model makes rigid is none of our joints.
        rigid = [number for number in range(1, tree.njoints)
                 if word(tree.names[number]) not in ours]
        tree = pin.buildReducedModel(tree, rigid, pin.neutral(tree))
        model, carrying = pin.Model(), {GROUND: 0}
        # By joint of ours: places of its coordinates and rates in Pinocchio's.
        self._places, self._balls = {}, []
        merged = _balls(mechanism) if balls else {}
        numbers = {0: 0}
        for number in range(1, tree.njoints):
            name = word(tree.names[number])
            joint = ours[name]
            parent, placement = numbers[tree.parents[number]], tree.jointPlacements[number]
            if name in merged:
                first, last = merged[name][0], merged[name][-1]
                if name != last:
                    # Its place is that of the first; what is between has no mass.
                    numbers[number] = parent
                    if name == first:
                        self._first = placement
                    continue
                placement, made = self._first, [pin.JointModelSpherical()]
                self._balls.append((merged[name], len(model.names)))
            elif joint.type == SPHERICAL:
                made = [pin.JointModelSpherical()]
            elif joint.type == UNIVERSAL:
                made = [_hinge(joint.axis), _hinge(joint.second_axis)]
            else:
                made = [tree.joints[number]]
            for part, kind in enumerate(made):
                parent = model.addJoint(parent, kind, placement, f'{name}_{part}')
                placement = pin.SE3.Identity()
                self._places.setdefault(name, []).append(parent)
            model.appendBodyToJoint(parent, tree.inertias[number], pin.SE3.Identity())
            numbers[number] = carrying[joint.child] = parent
        model.gravity.linear = np.array(gravity)
        self.model, self.data = model, model.createData()
        self._loops = [loop for cut in mechanism.cut_joints for loop in _loops(cut, carrying)]
        self.machine = self._compiled()

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
                if count == 2:
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
            found[places.rates[name]] = np.concatenate([
                rates[self.model.idx_vs[joint]:self.model.idx_vs[joint] + self.model.nvs[joint]]
                for joint in joints])
        return found

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
            raise ValueError('no C++ compiler')
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
                int(self._algorithm == 'lcaba')))


def _tree(path):
    """Return the tree of a URDF file, without the elements that Pinocchio does not know."""
    root = ElementTree.parse(path).getroot()
    for element in list(root):
        if element.tag not in KNOWN:
            root.remove(element)
    return pin.buildModelFromXML(ElementTree.tostring(root, encoding='unicode'))


def _hinge(axis):
    axis = np.array(axis)
    for unit, kind in zip(np.eye(3), (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)):
        if np.array_equal(axis, unit):
            return kind()
    return pin.JointModelRevoluteUnaligned(axis)


def _loops(cut, carrying):
    """Return what holds a loop together: joint, frame, joint, frame, whether it is rigid."""
    a, b = carrying[cut.body_a], carrying[cut.body_b]
    turned, places = np.eye(3), [0.0]
    if cut.type == FIXED:
        turned = of_quaternion(cut.orientation).T
    elif cut.type == REVOLUTE:
        places = [0.0, ALONG]
    elif cut.type != SPHERICAL:
        raise ValueError(f'Pinocchio has no cut joint {cut.type}')
    for along in places:
        ends = [np.array(point) + (along * np.array(axis) if along else 0.0)
                for point, axis in ((cut.point_a, cut.axis_a), (cut.point_b, cut.axis_b))]
        yield (a, pin.SE3(turned, ends[0]), b, pin.SE3(np.eye(3), ends[1]), cut.type == FIXED)


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
