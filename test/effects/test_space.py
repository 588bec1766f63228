# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Effects in space: against maximal coordinates, closed forms, and by their energy."""

from dataclasses import replace
from types import SimpleNamespace

from closedloop_dynamics import Body, Joint, Mechanism, Point
from closedloop_dynamics.codegen.space import WORK_COLUMNS
from closedloop_dynamics.effects.effect import NameResolver
from closedloop_dynamics.effects.effect_set import EffectSet
from closedloop_dynamics.effects.effect_table import EffectTable
from closedloop_dynamics.effects.registry import (
    Actuator, Bushing, Cable, Contact, EndStop, ExternalForce, ForceTable, Gravity, JointDamping,
    JointSpring, Payload, PointSpring, PrescribedForce, Rotor)
from closedloop_dynamics.kinematics.modeling import build_model, mechanism_arrays
from closedloop_dynamics.mechanism.fields import FieldError
from closedloop_dynamics.mechanism.mechanism import GROUND
import numpy as np
import pytest

from .machines import assert_balanced, simulated
from ..reference import cases, spatial_linkages, spatial_machines, spatial_maximal as twin
from ..reference.compare import assert_agree
from ..reference.numbers import Numbers

TIGHT = {'integrator': 'dop853', 'tolerance': 1e-12}
MASSLESS = ((0.0, 0.0, 0.0), 0.0, True)


def accelerations(mechanism, q, qd, tau, effects):
    """Return joint accelerations under effects by dense matrices, and the effects' table."""
    built = mechanism_arrays(mechanism, (0.0, 0.0, -9.81))
    for record in effects.values():
        record.fit(mechanism)
    chosen = EffectSet(effects, built.model, NameResolver(mechanism, built.placements))
    numbers = Numbers(built.model)
    table = EffectTable.of(built.model, built.model, chosen.elements)
    numbers.move(q, qd)
    body = np.zeros((len(built.model.tree), WORK_COLUMNS))
    numbers.write(body)
    table.apply_effects(body, q, qd, tau)
    numbers.read(body)
    return numbers.accelerations(table.applied, 0.0)[0], table


def at_point(motion, place):
    """Return arm, place and velocity of a point of a body."""
    arm = motion.axes @ place
    return arm, motion.origin + arm, motion.velocity + np.cross(motion.spin, arm)


def drawn(seed):
    """Return a random mechanism with three points, its state and where the points are."""
    rng = np.random.default_rng(seed)
    mechanism, q, qd = spatial_linkages.random_mechanism(rng)
    bodies = rng.choice([body.name for body in mechanism.bodies], 3)
    places = rng.normal(size=(3, 3))
    mechanism = replace(mechanism, points=tuple(
        Point(f'p{k}', str(body), tuple(place))
        for k, (body, place) in enumerate(zip(bodies, places))))
    motions = twin.forward(mechanism, q, qd, np.zeros(len(qd)))[0]
    return rng, mechanism, q, qd, bodies, [
        at_point(motions[body], place) for body, place in zip(bodies, places)], motions


def collected(pushes):
    """Return wrenches by body of (body, arm, force, torque)."""
    wrenches = {}
    for body, arm, force, torque in pushes:
        wrench = wrenches.setdefault(body, np.zeros(6))
        wrench += [*(np.cross(arm, force) + torque), *force]
    return wrenches


def assert_moves(mechanism, q, qd, effects, pushes):
    """Assert that effects move a mechanism as forces and torques do; return their table."""
    tau = np.random.default_rng(1).normal(size=len(qd))
    expected = twin.forward_dynamics(mechanism, q, qd, tau, wrenches=collected(pushes))
    qdd, table = accelerations(mechanism, q, qd, tau, effects)
    found = twin.forward(mechanism, q, qd, qdd)[1]
    names = [body.name for body in mechanism.bodies]
    assert_agree([found[name] for name in names],
                 [expected.accelerations[name] for name in names], 1e-9)
    return table


@pytest.mark.parametrize('tables', [False, True])
@pytest.mark.parametrize('seed', cases.first(1, range(8)))
def test_springs_between_points_pull_as_in_maximal_coordinates(seed, tables):
    _, mechanism, q, qd, bodies, points, _ = drawn(seed)
    (arm_a, a, va), (arm_b, b, vb), (arm_c, c, vc) = points
    stiffness, damping, free, anchor = 30.0, 2.0, 0.4, np.array([0.3, -0.5, 0.8])
    pushes, stored, lost = [], 0.0, 0.0
    for first, second in (((bodies[0], arm_a, a, va), (bodies[1], arm_b, b, vb)),
                          ((bodies[2], arm_c, c, vc), (GROUND, 0.0, anchor, np.zeros(3)))):
        apart = second[2] - first[2]
        length = np.linalg.norm(apart)
        along = apart / length
        rate = along @ (second[3] - first[3])
        tension = stiffness * (length - free) + damping * rate
        stored += 0.5 * stiffness * (length - free) ** 2
        lost += damping * rate ** 2
        for body, arm, sign in ((*first[:2], 1.0), (*second[:2], -1.0)):
            if body != GROUND:
                pushes.append((body, arm, sign * tension * along, 0.0))
    law = {'stiffness': stiffness, 'damping': damping, 'free_length': free}
    springs = PointSpring('p0', 'p1', **law), PointSpring('p2', anchor=tuple(anchor), **law)
    if tables:
        law = (free, free + 1.0, free + 2.0), (0.0, stiffness, 2.0 * stiffness)
        springs = (ForceTable(*law, point_a='p0', point_b='p1', damping=damping),
                   ForceTable(*law, point_a='p2', anchor=tuple(anchor), damping=damping))
    table = assert_moves(mechanism, q, qd, dict(zip(('between', 'anchored'), springs)), pushes)
    assert_agree(table.output[:, 0].sum(), stored, 1e-12)
    assert_agree(table.rates.sum(), lost, 1e-11, smallest=1.0)


@pytest.mark.parametrize('seed', cases.first(1, range(4)))
@pytest.mark.parametrize('slack', [False, True])
def test_cables_pull_along_their_way(seed, slack):
    _, mechanism, q, qd, bodies, points, _ = drawn(20 + seed)
    ways = [points[k + 1][1] - points[k][1] for k in range(2)]
    length = sum(map(np.linalg.norm, ways))
    along = [way / np.linalg.norm(way) for way in ways]
    rate = sum(along[k] @ (points[k + 1][2] - points[k][2]) for k in range(2))
    free = length + (0.1 if slack else -0.1)
    elastic = 0.0 if slack else 50.0 * 0.1
    tension = elastic * max(0.0, 1.0 + 0.3 * rate)
    # The guide in the middle takes both.
    pulls = (along[0], along[1] - along[0], -along[1])
    table = assert_moves(mechanism, q, qd, {
        'rope': Cable(('p0', 'p1', 'p2'), 50.0, free, 0.3)}, [
            (body, arm, tension * pull, 0.0)
            for body, (arm, _, _), pull in zip(bodies, points, pulls)])
    assert_agree(table.output[0, 1:3], [tension, length], 1e-11)
    assert_agree(table.rates, [(tension - elastic) * rate], 1e-10, smallest=1.0)


@pytest.mark.parametrize('seed', cases.first(1, range(6)))
def test_bushings_push_along_and_turn_about_their_axes(seed):
    rng, mechanism, q, qd, bodies, points, motions = drawn(40 + seed)
    stiffness, damping, turning, loss = rng.uniform(1.0, 3.0, (4, 3))
    own, rest = (spatial_linkages.quaternion(rng) for _ in range(2))
    pushes, stored, lost = [], 0.0, 0.0
    anchor = np.array([0.2, 0.4, -0.3])
    for first, second in ((0, 1), (2, None)):
        one = motions[bodies[first]]
        axes = one.axes @ twin.matrix(own)
        arm, place, speed = points[first]
        if second is None:
            other_arm, there, moving = anchor, anchor, np.zeros(3)
            spin, turned = -one.spin, np.eye(3)
        else:
            other = motions[bodies[second]]
            other_arm, there, moving = points[second]
            spin, turned = other.spin - one.spin, other.axes
        triad = turned @ twin.matrix(rest).T @ twin.matrix(own)
        apart = axes.T @ (there - place)
        rate = axes.T @ (moving - speed - np.cross(one.spin, there - place))
        force = axes @ (-stiffness * apart - damping * rate)
        # Shares of 1 - a . b, of which those of the other two axes make a turn's stiffness.
        shares = 0.5 * turning.sum() - turning
        moment = sum(share * np.cross(b, a) for share, a, b in zip(shares, axes.T, triad.T))
        moment = moment - axes @ (loss * (axes.T @ spin))
        # On body a at the same place.
        pushes.append((bodies[first], arm + there - place, -force, -moment))
        if second is not None:
            pushes.append((bodies[second], other_arm, force, moment))
        stored += 0.5 * stiffness @ apart ** 2 + shares @ (1.0 - np.sum(axes * triad, axis=0))
        lost += damping @ rate ** 2 + loss @ (axes.T @ spin) ** 2
    law = {'stiffness': tuple(stiffness), 'damping': tuple(damping),
           'turning_stiffness': tuple(turning), 'turning_damping': tuple(loss),
           'orientation': own, 'rest_orientation': rest}
    table = assert_moves(mechanism, q, qd, {
        'between': Bushing('p0', 'p1', **law),
        'anchored': Bushing('p2', anchor=tuple(anchor), **law)}, pushes)
    assert_agree(table.output[:, 0].sum(), stored, 1e-11)
    assert_agree(table.rates.sum(), lost, 1e-10, smallest=1.0)


def test_a_body_swings_on_a_bushing_about_each_axis():
    mechanism = Mechanism(
        'mounted', (Body('block', 2.0, (0.0, 0.0, 0.0), (0.02, 0.03, 0.04)),),
        (Joint('free', 'free', GROUND, 'block', (0.0, 0.0, 0.0)),), (),
        (Point('center', 'block', (0.0, 0.0, 0.0)),))
    stiffness, turning = np.array([50.0, 80.0, 30.0]), np.array([0.5, 0.2, 0.9])
    start = 1e-7 * np.array([1.0, -2.0, 3.0])
    one = simulated(mechanism, {'mount': Bushing(
        'center', anchor=(0.0, 0.0, 0.0), stiffness=tuple(stiffness),
        turning_stiffness=tuple(turning))}, (*start, *(0.5 * start), 1.0), np.zeros(6), **TIGHT)
    one.step(duration=0.7)
    rates = np.sqrt(stiffness / 2.0)
    # The axes turn with the block, and the forces have levers, of the motion's own size.
    assert_agree(one.position[:3], start * np.cos(0.7 * rates), 1e-3)
    rates = np.sqrt(turning / [0.02, 0.03, 0.04])
    assert_agree(one.position[3:6], 0.5 * start * np.cos(0.7 * rates), 1e-3)
    assert set(one.effect_readings('mount')) >= {'force_1', 'force_2', 'force_3', 'moment'}


@pytest.mark.parametrize('seed', cases.first(1, range(8)))
def test_forces_and_torques_push_as_in_maximal_coordinates(seed):
    rng, mechanism, q, qd, bodies, points, motions = drawn(100 + seed)
    force, torque = rng.normal(size=(2, 2, 3)) * 5.0
    axes = motions[bodies[1]].axes
    pushes = [(bodies[0], points[0][0], force[0], torque[0]),
              (bodies[1], points[1][0], axes @ force[1], axes @ torque[1])]
    table = assert_moves(mechanism, q, qd, {
        'push': ExternalForce('p0', tuple(force[0]), tuple(torque[0])),
        'thruster': ExternalForce('p1', tuple(force[1]), tuple(torque[1]), 'body')}, pushes)
    assert_agree(table.rates, [
        f @ point[2] + t @ motions[body].spin
        for (body, _, f, t), point in zip(pushes, points)], 1e-11, smallest=1.0)


@pytest.mark.parametrize('seed', cases.first(1, range(4)))
def test_forces_over_time_push_as_in_maximal_coordinates(seed):
    rng, mechanism, q, qd, bodies, points, motions = drawn(150 + seed)
    one, other = rng.normal(size=(2, 3))
    axes = motions[bodies[1]].axes
    # At time 0: the first is an expression, the second a sine.
    pushes = [(bodies[0], points[0][0], 3.0 * one / np.linalg.norm(one), 0.0),
              (bodies[1], points[1][0], axes @ (2.0 * other / np.linalg.norm(other)), 0.0)]
    table = assert_moves(mechanism, q, qd, {
        'push': PrescribedForce('expression', point='p0', direction=tuple(one),
                                expression='2 + cos(5*t)'),
        'thruster': PrescribedForce('sine', point='p1', direction=tuple(other), axes='body',
                                    amplitude=2.0, frequency=3.0, phase=0.5 * np.pi)}, pushes)
    assert_agree(table.output[:, 2], [force @ point[2] for (_, _, force, _), point in zip(
        pushes, points)], 1e-11, smallest=1.0)


@pytest.mark.parametrize('seed', cases.first(1, range(8)))
def test_planes_push_as_in_maximal_coordinates(seed):
    rng, mechanism, q, qd, bodies, points, _ = drawn(200 + seed)
    normal = rng.normal(size=3)
    unit = normal / np.linalg.norm(normal)
    pushes, effects, powers = [], {}, []
    for k, depth in enumerate((0.1, -0.1)):
        arm, place, velocity = points[k]
        origin = place + depth * unit + np.cross(unit, rng.normal(size=3))
        effects[f'floor_{k}'] = Contact(
            f'p{k}', tuple(origin), 200.0, exponent=1.5, damping=0.1, friction=0.3,
            slip_velocity=0.02, scraping=1.0, normal=tuple(normal))
        if depth < 0.0:
            continue
        rate = -unit @ velocity
        sliding = velocity + rate * unit
        elastic = 200.0 * depth ** 1.5
        press = elastic * max(0.0, 1.0 + 0.1 * rate)
        drag = (0.3 * press + 1.0 * depth) * sliding / np.hypot(np.linalg.norm(sliding), 0.02)
        pushes.append((bodies[k], arm, press * unit - drag, 0.0))
        powers.append((press - elastic) * rate + drag @ sliding)
        stored = elastic * depth / 2.5
    table = assert_moves(mechanism, q, qd, effects, pushes)
    assert_agree(table.rates, [powers[0], 0.0], 1e-9)
    assert_agree(table.output[:, 0], [stored, 0.0], 1e-9)


@pytest.mark.parametrize('seed', cases.first(1, range(8)))
def test_a_payload_is_a_part_of_its_body(seed):
    rng, mechanism, q, qd, bodies, _, _ = drawn(300 + seed)
    position, mass = rng.normal(size=3), 0.7
    added = spatial_linkages.random_body(rng, 'part')
    inertia = tuple(0.1 * np.array(added.inertia))
    expected, _ = accelerations(mechanism, q, qd, np.zeros(len(qd)), {
        'part': Payload(str(bodies[0]), mass, tuple(position), inertia)})
    whole = []
    for body in mechanism.bodies:
        if body.name == bodies[0]:
            total = body.mass + mass
            center = (body.mass * np.array(body.center_of_mass) + mass * position) / total
            about = twin.inertia(body) + twin.inertia(replace(added, inertia=inertia))
            for part, place in ((body.mass, body.center_of_mass), (mass, position)):
                arm = place - center
                about = about + part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
            body = replace(body, mass=total, center_of_mass=tuple(center), inertia=tuple(
                about[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]))
        whole.append(body)
    found, _ = accelerations(replace(mechanism, bodies=tuple(whole)), q, qd, np.zeros(len(qd)), {})
    assert_agree(found, expected, 1e-10)


def carried(seed, joint, axis):
    """
    Return a chain of three bodies, and the same with the rotor of a joint as one more body.

    The rotor stands on the parent of a joint, its centre of mass on the joint.
    """
    rng = np.random.default_rng(seed)
    kinds = ('revolute', 'helical', 'prismatic')
    bodies = tuple(spatial_linkages.random_body(rng, f'body_{k}') for k in range(3))
    joints = tuple(spatial_linkages.random_joint(
        rng, f'joint_{k}', kind, GROUND if k == 0 else f'body_{k - 1}', f'body_{k}')
        for k, kind in enumerate(kinds))
    axis = axis or tuple(twin.matrix(joints[joint].orientation) @ joints[joint].axis)
    wheel = Body('wheel', 0.2, (0.0, 0.0, 0.0), tuple(
        (0.05 * np.eye(3) + 0.02 * np.outer(axis, axis))[(0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)]))
    bearing = Joint('spin', 'revolute', f'body_{joint - 1}', 'wheel', joints[joint].position,
                    axis=axis)
    explicit = Mechanism('explicit', (*bodies, wheel), (*joints, bearing))
    # As if it were fixed, the rotor is its carrier's.
    fixed = Payload(f'body_{joint - 1}', 0.2, joints[joint].position, wheel.inertia)
    q, qd = rng.normal(size=(2, 3))
    return Mechanism('chain', bodies, joints), fixed, explicit, q, qd


@pytest.mark.parametrize('joint, axis, ratio', [
    (1, None, 1.0), (1, None, -7.0), (2, None, 4.0), (1, (0.6, 0.0, 0.8), 3.0)])
@pytest.mark.parametrize('seed', cases.first(1, range(3)))
def test_a_rotor_moves_as_a_body_of_its_own(seed, joint, axis, ratio):
    chain, fixed, explicit, q, qd = carried(seed, joint, axis)
    built = mechanism_arrays(chain, (0.0, 0.0, -9.81))
    machine = NameResolver(chain, built.placements)
    effects = {'motor': Rotor(f'joint_{joint}', 0.07, ratio, axis), 'fixed': fixed}
    EffectSet(effects, built.model, machine)
    one, other = Numbers(built.model), Numbers(build_model(explicit, (0.0, 0.0, -9.81)))
    # The wheel turns by the gear.
    geared = np.vstack([np.eye(3), ratio * np.eye(3)[joint]])
    one.move(q, qd)
    other.move(geared @ q, geared @ qd)
    assert_agree(one.inertia(), geared.T @ other.inertia() @ geared, 1e-12)
    assert_agree(one.bias_force(), geared.T @ other.bias_force(), 1e-11)
    assert_agree(one.energies(), other.energies(), 1e-12)
    # The recursions move it like the matrices.
    tau = np.array([0.3, -0.2, 0.5])
    expected = np.linalg.solve(one.inertia(), tau - one.bias_force())
    work, qdd = SimpleNamespace(body=np.zeros((4, WORK_COLUMNS))), np.zeros(3)
    one.recursion.inward(built.model, tau, work)
    one.recursion.outward_acceleration(built.model, work, qdd)
    assert_agree(qdd, expected, 1e-11)


def point_mass():
    """Return a mass that slides along three axes, of the ground and of massless bodies."""
    return Mechanism(
        'point', (Body('along', 0.0, *MASSLESS), Body('across', 0.0, *MASSLESS),
                  Body('ball', 2.0, (0.0, 0.0, 0.0), (0.1, 0.1, 0.1))),
        tuple(Joint(name, 'prismatic', parent, child, (0.0, 0.0, 0.0), axis=tuple(axis))
              for name, parent, child, axis in zip(
                  'xyz', (GROUND, 'along', 'across'), ('along', 'across', 'ball'), np.eye(3))),
        (), (Point('center', 'ball', (0.0, 0.0, 0.0)),))


def test_a_mass_on_a_spring_of_no_length_runs_in_an_ellipse():
    place, velocity = np.array([0.4, -0.2, 0.1]), np.array([0.3, 0.5, -0.6])
    one = simulated(point_mass(), {'cord': PointSpring(
        'center', anchor=(0.1, 0.0, 0.2), stiffness=50.0)}, place, velocity, **TIGHT)
    one.step(duration=1.7)
    anchor, rate = np.array([0.1, 0.0, 0.2]), 5.0
    expected = anchor + (place - anchor) * np.cos(rate * 1.7) + velocity * np.sin(
        rate * 1.7) / rate
    assert_agree(one.point('center'), expected, 1e-9)
    assert_balanced(one, 1e-9)


def test_a_mass_slides_down_a_plane_with_friction():
    tilt, mu, gravity = 0.6, 0.2, 9.81
    normal = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    down = np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    # At rest across the plane, sliding along it so fast that friction is Coulomb's.
    depth = 2.0 * gravity * np.cos(tilt) / 1e4
    place, velocity = np.array([1.0, 2.0, 3.0]) - depth * normal, 2.0 * down
    one = simulated(point_mass(), {
        'gravity': Gravity((0.0, 0.0, -gravity)),
        'slope': Contact('center', (1.0, 2.0, 3.0), 1e4, friction=mu, slip_velocity=1e-6,
                         normal=tuple(normal))}, place, velocity, **TIGHT)
    one.step(duration=0.5)
    pull = gravity * (np.sin(tilt) - mu * np.cos(tilt))
    assert_agree(one.point('center'), place + (2.0 * 0.5 + 0.5 * pull * 0.25) * down, 1e-9)
    assert one.effect_readings('slope')['normal_force'] == pytest.approx(
        2.0 * gravity * np.cos(tilt), rel=1e-9)
    assert_balanced(one, 1e-9)


def gyroscope():
    """Return a housing on two axes, the vertical one first, with a wheel of no weight."""
    x, y, z = np.eye(3)
    return Mechanism(
        'gyroscope', (Body('fork', 0.0, *MASSLESS),
                      Body('housing', 1.5, (0.2, 0.0, 0.0), (0.001, 0.004, 0.004)),
                      Body('wheel', 1e-3, (0.0, 0.0, 0.0), (1e-6, 1e-6, 1e-6))),
        (Joint('turn', 'revolute', GROUND, 'fork', (0.0, 0.0, 0.0), axis=tuple(z)),
         Joint('tilt', 'revolute', 'fork', 'housing', (0.0, 0.0, 0.0), axis=tuple(y)),
         Joint('spin', 'revolute', 'housing', 'wheel', (0.2, 0.0, 0.0), axis=tuple(x))),
        (), (Point('center', 'housing', (0.2, 0.0, 0.0)),))


@pytest.mark.parametrize('tilt', [0.0, -0.5])
def test_a_gyroscope_precesses_steadily(tilt):
    # A rotor of 0.003 kg m^2 turns ten times as fast as the wheel.
    momentum, rate, gravity = 10.0 * 0.003 + 1e-6, 40.0, 9.81
    weight = (1.5 * 0.2 + 1e-3 * 0.2) * gravity
    # Steady: weight * cos = turn cos (momentum rate + (A - C) turn sin), as for every top, with
    # moments across the axis at the pivot and along it, sin of the axis above the horizon.
    across = 0.004 + 1.5 * 0.04 + 1e-6 + 1e-3 * 0.04
    along = 0.001 + 1e-6
    up = np.sin(-tilt)
    turn = weight / (momentum * rate)
    for _ in range(100):
        turn = weight / (momentum * rate + (along - across) * turn * up)
    one = simulated(
        gyroscope(), {'gravity': Gravity((0.0, 0.0, -gravity)),
                      'rotor': Rotor('spin', 0.003, 10.0)},
        (0.0, tilt, 0.0), (turn, 0.0, rate), **TIGHT)
    one.step(duration=1.0)
    assert_agree(one.position, (turn, tilt, rate), 1e-9)
    assert_agree(one.velocity, (turn, 0.0, rate), 1e-9, smallest=1.0)
    assert_balanced(one, 1e-9)


def linkage_with_all_of_it():
    """Return a linkage, torques that drive it, and effects of many types."""
    mechanism, torque = spatial_machines.rssr_four_bar()
    mechanism = replace(spatial_machines.with_single_freedoms(mechanism), points=(
        Point('tip', 'crank', (0.1, 0.0, 0.0)), Point('end', 'rocker', (0.0, 0.0, 0.3))))
    return mechanism, torque, {
        'gravity': Gravity((0.0, 0.0, -9.81)),
        'cord': PointSpring('tip', 'end', stiffness=20.0, damping=0.1, free_length=0.5),
        'part': Payload('rocker', 0.3, (0.0, 0.0, 0.2), (1e-3, 1e-3, 1e-4)),
        'motor': Rotor('crank', 1e-4, 5.0), 'idler': Rotor('tip', 1e-5, 3.0),
        'push': ExternalForce('end', (0.5, 0.2, 0.1), (0.02, 0.0, 0.0), 'body'),
        'grease': JointDamping('rocker', 0.01),
        'rope': Cable(('tip', 'end'), 30.0, 0.48, 0.5),
        'gas': ForceTable((0.2, 0.4, 0.6), (-2.0, -1.0, -0.5), point_a='tip', point_b='end',
                          interpolation='cubic', damping=0.1),
        'mount': Bushing('tip', 'end', stiffness=(3.0, 2.0, 1.0), damping=(0.1, 0.0, 0.2),
                         turning_stiffness=(0.03, 0.05, 0.01), turning_damping=1e-3),
        'floor': Contact('end', (0.0, 0.0, 0.27), 300.0, damping=0.5, friction=0.3,
                         normal=(0.0, 0.1, 1.0))}


def test_a_linkage_with_all_of_it_keeps_its_energy_in_balance():
    mechanism, torque, effects = linkage_with_all_of_it()
    one = simulated(mechanism, effects, np.zeros(len(mechanism.joints)), **TIGHT)
    one.step(torque, 0.8)
    balance = one.energy_balance
    assert balance.dissipated > 1e-3 and abs(balance.work) > 1e-3
    assert_balanced(one, 1e-8)


def two_wheels():
    """Return a sphere on a ball joint and a body on a universal joint, at their centres."""
    x, y = np.eye(3)[:2]
    return Mechanism(
        'wheels', (Body('sphere', 1.0, (0.0, 0.0, 0.0), (0.2, 0.2, 0.2)),
                   Body('cross', 1.0, (0.0, 0.0, 0.0), (0.3, 0.2, 0.4))),
        (Joint('ball', 'spherical', GROUND, 'sphere', (0.0, 0.0, 0.0)),
         Joint('hip', 'universal', GROUND, 'cross', (1.0, 0.0, 0.0), axis=tuple(x),
               second_axis=tuple(y), actuated=True)))


def test_effects_act_on_single_freedoms_of_joints():
    effects = {f'oil_{axis}': JointDamping(f'ball.r{axis}', 0.1) for axis in 'xyz'}
    effects['spring'] = JointSpring('hip.2', 5.0, 0.1)
    effects['drive'] = Actuator('hip.1', max_torque=0.0001)
    spin = np.array([1.0, -2.0, 3.0])
    one = simulated(two_wheels(), effects, (0.0, 0.0, 0.0, 1.0, 0.0, 0.3),
                    (*spin, 0.0, 0.0), step_size=1e-3)
    one.step(duration=1.3)
    # All axes of a sphere are alike.
    assert_agree(one.velocity[:3], spin * np.exp(-0.1 / 0.2 * 1.3), 1e-9)
    assert_agree(one.position[5], 0.1 + 0.2 * np.cos(5.0 * 1.3), 1e-9)
    assert_balanced(one, 1e-9)


@pytest.mark.parametrize('record', [
    JointSpring('ball.rx', 1.0), EndStop('ball.rz', 1.0, 0.0), Actuator('ball.rx'),
    JointDamping('hip', 1.0), JointDamping('hip.3', 1.0), Rotor('ball', 1.0)])
def test_freedoms_that_an_effect_cannot_act_on_are_refused(record):
    with pytest.raises(FieldError, match='effect.joint: expected one of the'):
        simulated(two_wheels(), {'effect': record}, (0.0, 0.0, 0.0, 1.0, 0.0, 0.0), 5 * [0.0])


def test_names_of_freedoms_are_names():
    for text in ('hip.', 'hip.1.2', '.x', 'a b', '1.x'):
        with pytest.raises(FieldError, match='a name of letters'):
            JointDamping(text, 1.0)
