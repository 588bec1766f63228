# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Machines in space of which the motion is known from elsewhere."""

from dataclasses import replace

from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.mechanism.config import shipped_path
from closedloop_dynamics.mechanism.mechanism import Body, CutJoint, Joint, Mechanism
from closedloop_dynamics.mechanism.reader import read_mechanism, with_cuts
import numpy as np

from .numbers import Numbers

GRAVITY = (0.0, 0.0, -9.81)


def rod(direction, mass, length, radius):
    """Return the inertia of a solid cylinder along a unit direction, six numbers."""
    along, across = mass * radius ** 2 / 2.0, mass * (3.0 * radius ** 2 + length ** 2) / 12.0
    matrix = across * np.eye(3) + (along - across) * np.outer(direction, direction)
    return tuple(matrix[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)])


def ring(radius, degrees, height):
    """Return points on a horizontal circle about the z axis."""
    angles = np.radians(degrees)
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles),
                            np.full(len(angles), height)])


def tangent(point):
    """Return the horizontal direction across a point's radius, counter-clockwise."""
    return np.array([-point[1], point[0], 0.0]) / np.hypot(point[0], point[1])


def unit(vector):
    """Return a vector of length one."""
    return vector / np.linalg.norm(vector)


def stewart_platform():
    """
    Return a 6-UPS platform and its leg forces, by joint.

    All frames are parallel to the world's at the start; the platform hangs on the first leg.
    """
    base = ring(0.5, [-10.0, 10.0, 110.0, 130.0, 230.0, 250.0], 0.0)
    top = ring(0.3, [-50.0, 50.0, 70.0, 170.0, 190.0, 290.0], 0.6)
    bodies, joints, cuts, forces = [], [], [], {}
    for k, (foot, head) in enumerate(zip(base, top), start=1):
        along = unit(head - foot)
        bodies += [
            Body(f'cylinder_{k}', 1.5, tuple(0.2 * along), rod(along, 1.5, 0.4, 0.02)),
            Body(f'piston_{k}', 0.8, tuple(-0.2 * along), rod(along, 0.8, 0.4, 0.01))]
        joints += [
            Joint(f'foot_{k}', 'universal', 'ground', f'cylinder_{k}', tuple(foot),
                  axis=tuple(tangent(foot)),
                  second_axis=tuple(unit(np.cross(along, tangent(foot))))),
            Joint(f'leg_{k}', 'prismatic', f'cylinder_{k}', f'piston_{k}', tuple(head - foot),
                  axis=tuple(along), actuated=True)]
        forces[f'leg_{k}'] = 28.5 * (1.0, 1.1, 0.95, 1.05, 0.9, 1.0)[k - 1]
        if k > 1:
            cuts.append(CutJoint(f'head_{k}', 'spherical', 'platform', f'piston_{k}',
                                 tuple(head - top[0]), (0.0, 0.0, 0.0)))
    center = tuple(np.array([0.0, 0.0, 0.6]) - top[0])
    bodies.append(Body('platform', 10.0, center, (0.25, 0.25, 0.5)))
    joints.append(Joint('head_1', 'spherical', 'piston_1', 'platform', (0.0, 0.0, 0.0)))
    return Mechanism('stewart_platform', tuple(bodies), tuple(joints), tuple(cuts)), forces


def delta_robot():
    """
    Return a Delta robot with rods between universal and spherical joints, and its arm torques.

    All frames are parallel to the world's at the start; the platform hangs on the first rod.
    """
    down, half = np.radians(20.0), 0.05
    bodies, joints, cuts, torques = [], [], [], {}
    for k, angle in enumerate((0.0, 120.0, 240.0), start=1):
        hip, = ring(0.2, [angle], 0.0)
        out, across = unit(hip), tangent(hip)
        along = np.cos(down) * out - np.sin(down) * np.array([0.0, 0.0, 1.0])
        elbow, end = hip + 0.3 * along, 0.05 * out
        # The platform's center is below the base where the rods are 0.8 m long.
        inward = np.linalg.norm((elbow - end)[:2])
        end = end + np.array([0.0, 0.0, elbow[2] - np.sqrt(0.8 ** 2 - inward ** 2)])
        bodies.append(Body(f'arm_{k}', 0.5, tuple(0.15 * along), rod(along, 0.5, 0.3, 0.015)))
        joints.append(Joint(f'hip_{k}', 'revolute', 'ground', f'arm_{k}', tuple(hip),
                            axis=tuple(across), actuated=True))
        torques[f'hip_{k}'] = (0.5, 0.0, -0.5)[k - 1]
        direction = unit(end - elbow)
        for n, side in enumerate((-half, half), start=1):
            name = f'{k}{n}'
            bodies.append(Body(
                f'rod_{name}', 0.1, tuple(0.4 * direction), rod(direction, 0.1, 0.8, 0.005)))
            joints.append(Joint(
                f'elbow_{name}', 'universal', f'arm_{k}', f'rod_{name}',
                tuple(0.3 * along + side * across), axis=tuple(across),
                second_axis=tuple(unit(np.cross(direction, across)))))
            if name == '11':
                center = np.array([0.0, 0.0, end[2]]) - (end + side * across)
                first = end + side * across
                joints.append(Joint('wrist_11', 'spherical', 'rod_11', 'platform',
                                    tuple(0.8 * direction)))
                continue
            cuts.append(CutJoint(
                f'wrist_{name}', 'spherical', 'platform', f'rod_{name}',
                tuple(end + side * across - first), tuple(0.8 * direction)))
    bodies.append(Body('platform', 0.4, tuple(center), (2e-4, 2e-4, 4e-4)))
    return Mechanism('delta_robot', tuple(bodies), tuple(joints), tuple(cuts)), torques


def rssr_four_bar():
    """
    Return a crank, a rocker across it and a rod between spherical joints; the crank's torque.

    All frames are parallel to the world's at the start.
    """
    return read_mechanism(shipped_path('mechanisms', 'rssr_four_bar')), {'crank': 0.02}


def bricard():
    """
    Return six revolute joints in a ring of rods (IFToMM A04), the last one cut; no forces.

    All frames are parallel to the world's at the start. One of the equations repeats the others.
    """
    shipped = read_mechanism(shipped_path('mechanisms', 'bricard'))
    return with_cuts(shipped, ('joint_6',)), {}


def with_single_freedoms(mechanism):
    """
    Return a mechanism with joints of one freedom and massless bodies for those of several.

    A spherical joint becomes revolute ones about z, y and x; all frames must be parallel at the
    start. The name of the first of the joints is that of the joint they stand for.
    """
    bodies, joints = list(mechanism.bodies), []
    for joint in mechanism.joints:
        axes = {'universal': (joint.axis, joint.second_axis),
                'spherical': tuple(map(tuple, np.eye(3)[::-1]))}.get(joint.type)
        if axes is None:
            joints.append(joint)
            continue
        parent, place = joint.parent, joint.position
        for k, axis in enumerate(axes):
            child = joint.child
            if k < len(axes) - 1:
                child = f'{joint.name}_link_{k + 1}'
                bodies.append(Body(child, 0.0, (0.0, 0.0, 0.0), 0.0, massless=True))
            joints.append(Joint(joint.name if k == 0 else f'{joint.name}_{k + 1}', 'revolute',
                                parent, child, place, axis=axis))
            parent, place = child, (0.0, 0.0, 0.0)
    return replace(mechanism, bodies=tuple(bodies), joints=tuple(joints))


def in_motion(mechanism, rng):
    """Return a mechanism in a state near its start that closes the loops, (mechanism, q, qd)."""
    numbers, coordinates = Numbers(build_model(mechanism)), mechanism.coordinates
    q = coordinates.moved(coordinates.start(), 0.2 * rng.normal(size=coordinates.nv))
    for _ in range(20):
        numbers.move(q)
        q = coordinates.moved(q, -np.linalg.pinv(numbers.jacobian()) @ numbers.closures()[0])
    numbers.move(q)
    qd, jac = rng.normal(size=coordinates.nv), numbers.jacobian()
    for _ in range(2):
        qd = qd - np.linalg.pinv(jac) @ (jac @ qd)
    return mechanism, q, qd
