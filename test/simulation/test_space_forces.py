# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Forces in joints, energies and inverse dynamics in space."""

from dataclasses import replace

from closedloop_dynamics import codegen, load_scene, Point, Simulation, SimulationError
from closedloop_dynamics.codegen.equations import Equations
from closedloop_dynamics.effects.registry import (
    ExternalForce, JointFriction, JointSpring, PointSpring, Rotor)
from closedloop_dynamics.engine.types import DOF
from closedloop_dynamics.mechanism.mechanism import GROUND, JOINT_FREEDOMS, PRISMATIC, REVOLUTE
from closedloop_dynamics.recording.run import columns, row
from closedloop_dynamics.simulation import system
from closedloop_dynamics.simulation.recorded_run import joint_forces
import numpy as np
import pytest

from .test_space import machine, TIGHT
from ..codegen.spatial_engine import SpatialEngine
from ..reference import cases, spatial_linkages, spatial_maximal as twin
from ..reference.compare import assert_agree
from ..reference.numbers import Numbers
from ..reference.scenes import scene_in_space as scene


def at(model, q, qd):
    """Return the equations of a model, as the loops over bodies have them, in a state."""
    return Equations(model).move(q, qd)


def wrenches_of(model, q, qd, qdd, lam):
    """Return what joints hand over in a state under given multipliers, shape (nv, 6)."""
    made = system.build_system(model, unrolled=False)
    state = np.zeros(system.number_of_states(made))
    state[:len(q) + len(qd)] = *q, *qd
    return joint_forces(made, np.zeros((1, len(qd))), 1, 1, state[np.newaxis], qdd[np.newaxis],
                        lam[np.newaxis])[0]


def reactions(mechanism, q, qd, expected):
    """Return the wrench in each joint from the motion of the bodies, tips first."""
    motions = twin.forward(mechanism, q, qd, np.zeros(len(qd)))[0]
    needed = {GROUND: np.zeros(6)}
    for body in mechanism.bodies:
        motion, acceleration = motions[body.name], expected.accelerations[body.name]
        arm, spin = motion.axes @ body.center_of_mass, motion.spin
        about = motion.axes @ twin.inertia(body) @ motion.axes.T
        center = acceleration[3:] + np.cross(acceleration[:3], arm) + np.cross(
            spin, np.cross(spin, arm))
        force = body.mass * (center - (0.0, 0.0, -9.81))
        turning = about @ acceleration[:3] + np.cross(spin, about @ spin)
        needed[body.name] = np.concatenate([turning + np.cross(arm, force), force])
    for cut in mechanism.cut_joints:
        a, b = motions[cut.body_a], motions[cut.body_b]
        place = a.origin + a.axes @ cut.point_a
        moment, force = np.split(expected.wrenches[cut.name], 2)
        for name, motion, sign in ((cut.body_a, a, 1.0), (cut.body_b, b, -1.0)):
            needed[name] = needed[name] - sign * np.concatenate(
                [moment + np.cross(place - motion.origin, force), force])
    left = {joint.child: joint for joint in mechanism.joints}
    found = {}
    while left:
        parents = {joint.parent for joint in left.values()}
        name = next(name for name in left if name not in parents)
        joint = left.pop(name)
        found[joint.name] = wrench = needed[name]
        offset = motions[name].origin - motions[joint.parent].origin
        needed[joint.parent] = needed[joint.parent] + np.concatenate(
            [wrench[:3] + np.cross(offset, wrench[3:]), wrench[3:]])
    return found


@pytest.mark.parametrize('seed', cases.first(2, range(12)))
def test_forces_in_joints_are_those_of_maximal_coordinates(seed):
    rng = np.random.default_rng(seed)
    mechanism, q, qd = spatial_linkages.random_mechanism(rng)
    engine = SpatialEngine(mechanism)
    tau = rng.normal(size=engine.nv)
    expected = twin.forward_dynamics(mechanism, q, qd, tau)
    qdd, lam, _ = engine.forward_dynamics(q, qd, tau)
    equations = at(engine.model, q, qd)
    by_freedom = wrenches_of(engine.model, q, qd, qdd, lam)
    motions = twin.forward(mechanism, q, qd, qdd)[0]
    known, found = reactions(mechanism, q, qd, expected), {}
    numbers = Numbers(engine.model)
    numbers.move(q, qd)
    for joint in mechanism.joints:
        if JOINT_FREEDOMS[joint.type]:
            row = engine.rows[joint.name][-1]
            found[joint.name] = by_freedom[engine.model.tree[row, DOF]].copy()
            arm = motions[joint.child].origin - numbers.recursion.motion[row].origin
            found[joint.name][:3] -= np.cross(arm, found[joint.name][3:])
    assert_agree(list(found.values()), [known[name] for name in found], 1e-8)
    # Along the joints' freedoms they are the forces that drive them, loops closed.
    forces = np.zeros(engine.nv)
    equations.model.tree_torque(equations.work, qdd, forces)
    assert_agree(forces, tau + equations.jacobian().T @ lam, 1e-9)
    # Wrenches at the cut joints, of all equations.
    assert_agree(equations.cut_wrenches(lam, equations.work.body)[:len(mechanism.cut_joints)],
                 [expected.wrenches[cut.name] for cut in mechanism.cut_joints], 1e-8)


@pytest.fixture(scope='module')
def linkage():
    """Return an RSSR four-bar in motion under effects, and its torque."""
    mechanism, torque = machine('rssr_four_bar', ('rocker', (0.0, 0.0, 0.15)))
    return replace(mechanism, joints=tuple(
        replace(joint, actuated=joint.name in ('crank', 'tip_3')) for joint in mechanism.joints))


def moving(mechanism, effects=None):
    """Return a simulation after some motion."""
    one = Simulation(scene(mechanism, effects=effects, integrator='rk4'))
    one.step({'crank': 0.03, 'tip_3': 1e-3}, 0.3)
    return one


@pytest.mark.parametrize('effects', [{}, {
    'spring': JointSpring('rocker', 0.3, 0.1), 'motor': Rotor('crank', 1e-4, 3.0),
    'idler': Rotor('tip', 1e-5, 4.0), 'cord': PointSpring(
        'point_0', anchor=(0.0, 0.0, 1.0), stiffness=3.0, damping=0.1),
    'push': ExternalForce('point_0', (0.1, 0.2, 0.3), (0.01, 0.0, 0.0), 'body')}])
def test_inverse_dynamics_finds_the_torques_of_a_motion(linkage, effects):
    one = moving(linkage, effects)
    state = one.position, one.velocity
    for crank, spin in ((0.05, 0.002), (-0.4, 0.0)):
        torques = {'crank': crank, 'tip_3': spin}
        acceleration, multipliers = one.forward_dynamics(*state, torques)
        torque, lam = one.inverse_dynamics(*state, acceleration)
        assert_agree(torque, [crank, spin], 1e-9)
        assert_agree(lam, multipliers, 1e-8)
    acceleration[1] += 1.0
    with pytest.raises(SimulationError, match='opens the loops'):
        one.inverse_dynamics(*state, acceleration)


def test_forces_in_joints_do_the_work_of_what_moves(linkage):
    one = moving(linkage)
    forces, names = one.joint_forces, list(one.joint_names)
    assert forces.shape == (len(names), 6)
    # The hinge hands the crank the torque of its drive, and nothing about its axis otherwise.
    assert_agree(forces[names.index('crank'), 2], 0.03, 1e-10)
    assert_agree(forces[names.index('rocker'), 0], 0.0, 1e-10, smallest=1.0)
    # All that holds the machine carries its weight and changes its momentum.
    held = forces[names.index('crank'), 3:] + forces[names.index('rocker'), 3:]
    total = np.zeros(3)
    motions, rates = twin.forward(linkage, one.position, one.velocity, one.acceleration)[:2]
    for body in linkage.bodies:
        motion, rate = motions[body.name], rates[body.name]
        arm = motion.axes @ body.center_of_mass
        total += body.mass * (rate[3:] + np.cross(rate[:3], arm) + np.cross(
            motion.spin, np.cross(motion.spin, arm)) - (0.0, 0.0, -9.81))
    assert_agree(held, total, 1e-9)
    assert_agree(one.force('rocker'), forces[names.index('rocker')], 0.0)


def test_forces_of_all_equations_turn_into_the_same_motion():
    mechanism, _ = machine('bricard')
    one = Simulation(scene(mechanism, gravity=(0.0, -9.81, 0.0), integrator='rk4'))
    one.step(None, 0.2)
    numbers = Numbers(one.data.system.model)
    numbers.move(one.position, one.velocity)
    _, lam, rank = numbers.accelerations(np.zeros(5), 0.0)
    assert rank == 4
    # Both are least, the one in all joints together, the other at the cut joint.
    assert_agree(numbers.jacobian().T @ one.multipliers, numbers.jacobian().T @ lam, 1e-9)
    assert np.linalg.norm(lam) < 0.99 * np.linalg.norm(one.multipliers)


def test_friction_in_a_joint_follows_the_force_that_the_joint_carries():
    # A bar about a vertical hinge presses on it by its weight, and pulls by its turning.
    mechanism, _ = machine('rssr_four_bar')
    bar = replace(
        mechanism, bodies=mechanism.bodies[:1], joints=mechanism.joints[:1], cut_joints=(),
        points=(Point('end', 'crank', (0.1, 0.0, 0.0)),))
    effects = {'rub': JointFriction('crank', friction_coefficient=0.2, radius=0.01)}
    one = Simulation(scene(bar, effects=effects, **TIGHT))
    one.set_state({'crank': 0.0}, {'crank': 20.0})
    one.step(None, 0.05)
    rate = one.velocity[0]
    load = 0.5 * np.hypot(9.81, 0.05 * rate ** 2)
    assert one.effect_readings('rub')['reaction'] == pytest.approx(load, rel=1e-3)
    assert one.effect_readings('rub')['torque'] == pytest.approx(-0.2 * 0.01 * load, rel=1e-2)
    # It comes to rest, and stays.
    one.step(None, 3.0)
    assert one.velocity[0] == 0.0
    assert abs(one.energy_balance.residual) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize('name', [
    'excavator_arm', pytest.param('double_wishbone', marks=pytest.mark.slow)])
def test_generated_code_finds_the_forces_that_drive_effects_as_the_loops_do(name, monkeypatch):
    shipped = load_scene(name)
    sizes = {REVOLUTE: {'radius': 0.02}, PRISMATIC: {}}
    effects = {
        f'at_{joint.name}': JointFriction(
            joint.name, friction_coefficient=0.1, **sizes[joint.type])
        for joint in shipped.mechanism.joints if joint.type in sizes}
    readings = []
    for most in (codegen.MOST_UNROLLED_OPERATIONS, 0):
        monkeypatch.setattr(codegen, 'MOST_UNROLLED_OPERATIONS', most)
        one = Simulation(replace(shipped, effects={**shipped.effects, **effects}))
        assert one.data.system.is_unrolled == (most > 0)
        one.step(None, 0.02)
        readings.append([one.effect_readings(effect)['reaction'] for effect in effects])
    assert min(readings[0]) > 0.1
    assert_agree(*readings, 1e-9)


def test_rows_have_the_forces_in_all_joints(linkage):
    one = Simulation(scene(linkage, integrator='rk4'))
    names, values = columns(one, all_forces=True), row(one, 0.0, all_forces=True)
    assert len(names) == len(values)
    found = [values[names.index(f'force.rocker.{part}')] for part in (
        'torque_x', 'torque_y', 'torque_z', 'x', 'y', 'z')]
    assert_agree(found, one.force('rocker'), 0.0)
