# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms of the hard cases, each with a closed state, and modifications that make one hard."""

from dataclasses import replace
import math

from closedloop_dynamics.effects.gravity import Gravity
from closedloop_dynamics.effects.registry import EFFECTS
from closedloop_dynamics.engine.status import SHARE
from closedloop_dynamics.formats.in_space import in_space as lifted
from closedloop_dynamics.mechanism.mechanism import (
    Body, CutJoint, FIXED, GROUND, Joint, Mechanism, REVOLUTE)
from closedloop_dynamics.mechanism.rotations import composed, of_quaternion
from closedloop_dynamics.scene.integrators import FIXED as FIXED_STEP, INTEGRATORS
from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.scene.records import Initial, Scene
from closedloop_dynamics.simulation.simulation import Simulation
import numpy as np

G = 9.81
# Direction of the ground: the world's axes must play no part.
DIRECTION = 0.7
# Of a plane in space, a unit quaternion; along no axis of the world.
TURN = tuple((np.array([1.0, 2.0, 3.0, 9.0]) / math.sqrt(95.0)).tolist())
# Of error-controlled methods: rounding, almost.
TIGHT = 1e-11


def started(name, method, **keys):
    """Return a simulation of a shipped scene by a method, with other values of its keys."""
    return Simulation(replace(load_scene(name), method=replace(method, **keys)))


def fixed(method):
    """Return whether a method makes steps of a fixed size."""
    return INTEGRATORS[method.integrator].kind == FIXED_STEP


def own_step(method, step_size):
    """Return a step size, a tenth of it for a method of order 1, whose error would hide others."""
    return 0.1 * step_size if method.integrator == 'semi_implicit_euler' else step_size


def tight(method, step_size, tolerance=TIGHT):
    """Return a method with its ``own_step`` and a tolerance."""
    return replace(method, step_size=own_step(method, step_size), tolerance=tolerance,
                   accuracy=tolerance / SHARE)


def stepped(count):
    """Return an advance, for ``worst_of``: so many steps, one by one."""
    def advance(simulation):
        for _ in range(count):
            simulation.step()
    return advance


def worst_of(simulation, looks, advance, *figures, bound=math.inf):
    """
    Return the worst figure along a motion, infinity where it reaches a bound or is NaN.

    Parameters
    ----------
    simulation : simulation.simulation.Simulation
        Advanced without torques.
    looks : int
        How often figures are looked at.
    advance : float, int or callable
        How it comes from one look to the next: a duration [s], a number of steps that are made
        at once, or a function of the simulation.
    figures : callable
        Of the simulation.
    bound : float, optional
        Where it reaches this, the rest of the motion says nothing more.

    """
    worst, tau = 0.0, np.zeros(len(simulation.torque_names))
    for _ in range(looks):
        if callable(advance):
            advance(simulation)
        elif isinstance(advance, int):
            simulation.advance(tau, advance)
        else:
            simulation.step(duration=advance)
        found = [figure(simulation) for figure in figures]
        # NaN is less than nothing.
        if not all(one < bound for one in found):
            return math.inf
        worst = max(worst, *found)
    return worst


def energy_error(simulation, scale=None, gained=False):
    """
    Return a figure: how far the energy is from that at present, relative.

    In ``scale`` [J], or over the present one; or how far it is above that, where only energy that
    is ``gained`` counts.
    """
    start = simulation.energy
    if scale is None:
        return lambda one: abs(one.energy / start - 1.0)
    return lambda one: (one.energy - start if gained else abs(one.energy - start)) / scale


def effect_of(keys):
    """Return the effect that keys of a scene describe."""
    return EFFECTS[keys['type']](**{
        key: tuple(value) if isinstance(value, list) else value
        for key, value in keys.items() if key != 'type'})


def bar(name, mass, length):
    """Return a uniform bar along its x axis."""
    return Body(name, mass, (0.5 * length, 0.0), mass * length ** 2 / 12.0)


def hinge(name, parent, child, x=0.0, y=0.0, angle=0.0, actuated=False):
    """Return a revolute tree joint."""
    return Joint(name, REVOLUTE, parent, child, (x, y), angle, actuated)


def ladder(loops, tilt=0.0, rate=1.0, direction=DIRECTION, size=1.0):
    """
    Return N parallelogram loops in a row (benchmark A02) on their parallel branch.

    Legs stand at a tilt [rad], clockwise from upright, and turn at a rate [rad/s]; all is turned
    by the direction of the ground [rad]. Links are ``size`` long [m], of 1 kg.
    """
    cos, sin = math.cos(direction), math.sin(direction)
    bodies, joints, cuts, q, qd = [], [], [], [], []
    for k in range(loops + 1):
        bodies.append(bar(f'leg_{k}', 1.0, size))
        joints.append(hinge(f'hip_{k}', 'ground', f'leg_{k}', k * size * cos, k * size * sin,
                            direction + 0.5 * math.pi, k == 0))
        q.append(-tilt)
        qd.append(-rate)
        if k == loops:
            break
        bodies.append(bar(f'coupler_{k}', 1.0, size))
        joints.append(hinge(f'knee_{k}', f'leg_{k}', f'coupler_{k}', size, 0.0, -0.5 * math.pi))
        q.append(tilt)
        qd.append(rate)
        cuts.append(CutJoint(f'cut_{k}', REVOLUTE, f'coupler_{k}', f'leg_{k + 1}',
                             (size, 0.0), (size, 0.0)))
    return (Mechanism('ladder', tuple(bodies), tuple(joints), tuple(cuts)),
            np.array(q), np.array(qd))


def ladder_energy(loops):
    """Return kinetic and potential energy at the upright start, seen from the ground [J]."""
    return 0.5 * ((loops + 1) / 3.0 + loops) + G * ((loops + 1) / 2.0 + loops)


def off_the_branch(simulation):
    """Return how far a ladder's legs are from parallel [rad]."""
    position = simulation.position
    legs, knees = position[::2], position[1::2]
    return max(np.abs(legs - legs[0]).max(), np.abs(knees + legs[0]).max())


def in_space(mechanism):
    """Return a planar mechanism of pins in a plane along no axis; of each 3 equations repeat."""
    axes = of_quaternion(TURN)
    flat = lifted(mechanism)
    return replace(flat, joints=tuple(
        joint if joint.parent != GROUND else replace(
            joint, position=tuple((axes @ joint.position).tolist()), orientation=tuple(
                composed(np.array(TURN), np.array(joint.orientation)).tolist()))
        for joint in flat.joints))


def gravity_in_space():
    """Return gravity in space as ``gravity`` acts on a mechanism in its plane."""
    one = gravity()['gravity']
    return {'gravity': Gravity(tuple(of_quaternion(TURN) @ (*one.acceleration, 0.0)))}


def gravity(direction=DIRECTION, strength=G):
    """Return gravity towards the ground of a mechanism turned by ``direction``."""
    return {'gravity': Gravity(acceleration=(strength * math.sin(direction),
                                             -strength * math.cos(direction)))}


def change_point_linkage():
    """Return a four-bar of 4, 1, 3 and 2 m (1 + 4 = 3 + 2), turned, crank upright at 1 rad/s."""
    ground, crank, coupler, rocker = 4.0, 1.0, 3.0, 2.0
    cos, sin = math.cos(DIRECTION), math.sin(DIRECTION)
    bodies = (bar('crank', 1.0, crank), bar('coupler', 3.0, coupler), bar('rocker', 2.0, rocker))
    joints = (hinge('crank_joint', 'ground', 'crank', angle=DIRECTION, actuated=True),
              hinge('coupler_joint', 'crank', 'coupler', crank),
              hinge('rocker_joint', 'ground', 'rocker', ground * cos, ground * sin, DIRECTION))
    cuts = (CutJoint('cut', REVOLUTE, 'coupler', 'rocker', (coupler, 0.0), (rocker, 0.0)),)
    # Crank upright: place of the coupler's end on the circles of coupler and rocker.
    tip = np.array([0.0, crank])
    pivot = np.array([ground, 0.0])
    span = pivot - tip
    distance = np.linalg.norm(span)
    along = (coupler ** 2 - rocker ** 2 + distance ** 2) / (2.0 * distance)
    up = math.sqrt(coupler ** 2 - along ** 2)
    end = tip + along * span / distance + up * np.array([-span[1], span[0]]) / distance
    coupler_angle = math.atan2(*(end - tip)[::-1])
    rocker_angle = math.atan2(*(end - pivot)[::-1])
    q = np.array([0.5 * math.pi, coupler_angle - 0.5 * math.pi, rocker_angle])
    return Mechanism('change_point', bodies, joints, cuts), q, np.array([1.0, 0.0, 0.0])


# Lengths [m] and masses [kg] of the pantograph of the carpet scraping mechanism.
PANTOGRAPH = {'link_4': (0.39, 3.0), 'link_5': (0.13, 1.0), 'link_6': (0.39, 3.0),
              'link_7': (0.26, 2.0)}
FROM_4_TO_5, FROM_6_TO_7 = 0.13, 0.13


def pantograph(arm, forearm, arm_rate, forearm_rate):
    """
    Return the pantograph of the carpet scraping mechanism alone, two freedoms, one loop.

    ``arm``, ``forearm``: angles of links 4 and 6 against the ground [rad], folded flat where they
    agree; their rates in rad/s.
    """
    bodies = tuple(bar(name, mass, length) for name, (length, mass) in PANTOGRAPH.items())
    joints = (hinge('theta_4', 'ground', 'link_4', angle=DIRECTION, actuated=True),
              hinge('theta_5', 'link_4', 'link_5', FROM_4_TO_5),
              hinge('theta_6', 'link_4', 'link_6', PANTOGRAPH['link_4'][0]),
              hinge('theta_7', 'link_6', 'link_7', FROM_6_TO_7))
    cuts = (CutJoint('cut_3', REVOLUTE, 'link_7', 'link_5', (PANTOGRAPH['link_7'][0], 0.0),
                     (PANTOGRAPH['link_5'][0], 0.0)),)
    fold, fold_rate = forearm - arm, forearm_rate - arm_rate
    return (Mechanism('pantograph', bodies, joints, cuts),
            np.array([arm, fold, fold, math.pi - fold]),
            np.array([arm_rate, fold_rate, fold_rate, -fold_rate]))


def pantograph_motion(arm, forearm, arm_rate, forearm_rate, times, strength=G):
    """
    Return the joint angles of the free pantograph, shape (len(times), 4), by another way.

    On its parallelogram branch it is a double pendulum of links 4 and 6: two equations without
    constraints, regular where it folds, solved here to rounding.
    """
    from scipy.integrate import solve_ivp
    inertia, weight = np.zeros((2, 2)), np.zeros(2)
    # Centres of mass at p e(arm) + r e(forearm), links turning with the arm (0) or forearm (1).
    end, knee, elbow = PANTOGRAPH['link_4'][0], FROM_4_TO_5, FROM_6_TO_7
    for name, p, r, turning in (
            ('link_4', 0.5 * end, 0.0, 0), ('link_5', knee, 0.5 * PANTOGRAPH['link_5'][0], 1),
            ('link_6', end, 0.5 * PANTOGRAPH['link_6'][0], 1),
            ('link_7', end - 0.5 * PANTOGRAPH['link_7'][0], elbow, 0)):
        length, mass = PANTOGRAPH[name]
        lever = np.array([p, r])
        inertia += mass * np.outer(lever, lever)
        inertia[turning, turning] += mass * length ** 2 / 12.0
        weight += mass * lever

    def slope(time, state):
        angles, rates = state[:2], state[2:]
        cos, sin = math.cos(angles[0] - angles[1]), math.sin(angles[0] - angles[1])
        coupling = inertia[0, 1]
        matrix = np.array([[inertia[0, 0], coupling * cos], [coupling * cos, inertia[1, 1]]])
        push = -strength * weight * np.cos(angles)
        push -= coupling * sin * np.array([rates[1] ** 2, -rates[0] ** 2])
        return np.concatenate([rates, np.linalg.solve(matrix, push)])

    solution = solve_ivp(slope, (0.0, times[-1]), (arm, forearm, arm_rate, forearm_rate),
                         'DOP853', times, rtol=1e-13, atol=1e-13)
    arms, folds = solution.y[0], solution.y[1] - solution.y[0]
    return np.stack([arms, folds, folds, math.pi - folds], axis=1)


def three_rockers():
    """Return an overconstrained parallelogram: a coupler on three equal rockers."""
    mechanism, q, qd = ladder(1, tilt=0.4)
    middle = bar('leg_middle', 1.0, 1.0)
    cos, sin = math.cos(DIRECTION), math.sin(DIRECTION)
    return replace(
        mechanism, name='three_rockers', bodies=mechanism.bodies + (middle,),
        joints=mechanism.joints + (hinge('hip_middle', 'ground', 'leg_middle', 0.5 * cos,
                                         0.5 * sin, DIRECTION + 0.5 * math.pi),),
        cut_joints=mechanism.cut_joints + (CutJoint(
            'cut_middle', REVOLUTE, 'coupler_0', 'leg_middle', (0.5, 0.0), (1.0, 0.0)),)
    ), np.append(q, -0.4), np.append(qd, -1.0)


def doubled(mechanism):
    """Return the mechanism with every cut joint twice."""
    return replace(mechanism, cut_joints=mechanism.cut_joints + tuple(
        replace(cut, name=f'{cut.name}_again') for cut in mechanism.cut_joints))


def welded_twice():
    """Return a pendulum of two bodies held together by a fixed cut joint, twice."""
    bodies = (bar('upper', 1.0, 1.0), bar('lower', 2.0, 0.5))
    joints = (hinge('pivot', 'ground', 'upper', actuated=True),
              hinge('weld', 'upper', 'lower', 1.0))
    cuts = tuple(CutJoint(name, FIXED, 'upper', 'lower', (1.0 + x, 0.0), (x, 0.0))
                 for name, x in (('weld_here', 0.0), ('weld_there', 0.3)))
    return (Mechanism('welded', bodies, joints, cuts), np.array([0.3, 0.0]), np.array([1.0, 0.0]))


def with_masses(mechanism, scale):
    """Return the mechanism with masses (and inertias) of the bodies in ``scale`` multiplied."""
    def scaled(body):
        factor = scale.get(body.name, 1.0)
        return replace(body, mass=factor * body.mass, inertia=factor * body.inertia,
                       massless=factor == 0.0)
    return replace(mechanism, bodies=tuple(scaled(body) for body in mechanism.bodies))


def scene(mechanism, q, qd, method, effects=None):
    """Return the scene of a mechanism under gravity towards its turned ground."""
    return Scene(mechanism.name, None, '', mechanism, Initial(tuple(q), tuple(qd)),
                 gravity() if effects is None else effects, method)
