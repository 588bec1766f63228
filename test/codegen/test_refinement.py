# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Regular mechanisms stay regular whatever their masses; singular and redundant ones do not."""

from copy import deepcopy
from dataclasses import replace

from closedloop_dynamics import (
    Body, codegen, Coupling, CutJoint, Joint, load_scene, Mechanism, Simulation)
from closedloop_dynamics.engine.types import (
    PROJECTION_ITERATIONS, RANK, RANK_REVEALING_COUNT, SMALLEST_PIVOT)
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.scene.integrators import PROJECTION
from closedloop_dynamics.simulation.system import build_system
import numpy as np
import pytest

from .test_elimination import every_loop_twice
from ..reference import cases, dense, maximal, special
from ..reference.dense import EARTH


def lighter(mechanism, factor, names):
    """Return a mechanism with the mass and inertia of some bodies multiplied."""
    return replace(mechanism, bodies=tuple(
        replace(body, mass=body.mass * factor, inertia=body.inertia * factor)
        if body.name in names else body for body in mechanism.bodies))


def machine(name):
    """Return a mechanism, its state, and names of bodies to make lighter."""
    if name == 'three_rrr':
        _, mechanism, q, qd = cases.drawn(name)
        return mechanism, q, qd, ('distal_1', 'distal_2', 'distal_3')
    if name == 'ladder':
        return *special.ladder(3, 0.4), ('coupler_0', 'coupler_1', 'coupler_2')
    if name == 'four_bar':
        return *special.parallelogram(), ('coupler_0',)
    return *special.scissor_lift(3), ('block',)


MACHINES = ('three_rrr', 'four_bar', 'ladder', 'scissor_lift')


@pytest.mark.parametrize('unrolled', [None, False], ids=['unrolled', 'loops'])
@pytest.mark.parametrize('factor', [1e-3, 1e-5, 1e-8, 1e-12, 0.0])
@pytest.mark.parametrize('name', MACHINES)
def test_light_links_are_regular(name, factor, unrolled):
    mechanism, q, qd, names = machine(name)
    mechanism = lighter(mechanism, factor, names)
    system = build_system(build_model(mechanism, EARTH), unrolled=unrolled)
    system.tau[:] = np.random.default_rng(5).normal(size=len(q))
    system.native.evaluate(q, qd)
    expected = maximal.forward_dynamics(
        mechanism, q, qd, system.tau, EARTH, maximal.extended)
    for found, wanted in ((system.qdd, expected.qdd), (system.lam, expected.lam)):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())
    health = system.work.health
    assert health[RANK_REVEALING_COUNT] == 0
    assert health[RANK] == mechanism.number_of_equations
    assert health[SMALLEST_PIVOT] > 1e-3


@pytest.mark.parametrize('unrolled', [None, False], ids=['unrolled', 'loops'])
@pytest.mark.parametrize('name', MACHINES)
def test_loops_of_massless_links_are_closed(name, unrolled):
    mechanism, q, qd, names = machine(name)
    system = build_system(build_model(lighter(mechanism, 0.0, names), EARTH), unrolled=unrolled)
    state = np.concatenate([q + 1e-3 * np.random.default_rng(5).normal(size=len(q)), qd])
    assert system.native.stabilise(PROJECTION, state)
    np.testing.assert_allclose(dense.closure(mechanism, state[:len(q)]), 0.0, atol=1e-12)
    assert 1 <= system.work.health[PROJECTION_ITERATIONS] <= 4
    assert system.work.health[RANK_REVEALING_COUNT] == 0


def test_light_links_hide_neither_singular_nor_redundant_loops():
    for mechanism, q, qd, rank in (
            (*special.ladder(2, 0.5 * np.pi), 2),
            (every_loop_twice(special.ladder(2, 0.4)[0]), *special.ladder(2, 0.4)[1:], 4)):
        mechanism = lighter(mechanism, 1e-6, ('coupler_0', 'coupler_1'))
        system = build_system(build_model(mechanism, EARTH))
        system.native.evaluate(q, qd)
        assert system.work.health[RANK_REVEALING_COUNT] == 1
        assert system.work.health[RANK] == rank
        assert np.isfinite(system.qdd).all()


def test_what_nothing_holds_needs_mass():
    # A massless rod that hangs on the last leg of a ladder, in no loop.
    mechanism, q, qd = special.ladder(1, 0.4)
    bodies = (*mechanism.bodies, special.bar('rod', 0.0, 1.0, 0.5))
    joints = (*mechanism.joints, special.revolute('hook', 'leg_1', 'rod', (1.0, 0.0)))
    system = build_system(build_model(
        replace(mechanism, bodies=bodies, joints=joints), EARTH))
    system.tau[-1] = 1.0
    system.native.evaluate(np.append(q, 0.0), np.append(qd, 0.0))
    assert np.isnan(system.qdd).all()


def gripper(mass, planar=True):
    """Return two fingers that slide apart alike on a hinged arm."""
    def vector(*xy):
        return xy if planar else (*xy, 0.0)

    def inertia(value):
        return value if planar else 3 * (value,)

    axes = [{} if planar else {'axis': axis} for axis in (
        (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (0.0, -1.0, 0.0))]
    bodies = (Body('arm', 1.0, vector(0.2, 0.0), inertia(0.02)), *(
        Body(name, mass, vector(0.0, 0.0), inertia(1e-4 * mass)) for name in ('left', 'right')))
    joints = (Joint('hinge', 'revolute', 'ground', 'arm', vector(0.0, 0.0), **axes[0]), *(
        Joint(name, 'prismatic', 'arm', name, vector(0.4, 0.0), **(
            {'angle': angle} if planar else axis))
        for name, angle, axis in (
            ('left', 0.5 * np.pi, axes[1]), ('right', -0.5 * np.pi, axes[2]))))
    return Mechanism('gripper', bodies, joints, (), couplings=(
        Coupling('fingers', {'left': 1.0, 'right': -1.0}),))


@pytest.mark.parametrize('mass', [0.1, 1e-9])
@pytest.mark.parametrize('by', ['loops', 'routines', 'refined routines'])
@pytest.mark.parametrize('planar', [True, False])
def test_a_hinge_may_lie_on_the_path_of_a_coupling_of_lengths(planar, by, mass):
    mechanism = gripper(mass, planar)
    system = build_system(
        build_model(mechanism),
        unrolled=by != 'loops')
    if by == 'refined routines':
        codegen.link(system.model, system.table, codegen.REFINED)
    system.tau[:] = 0.3, 0.0, 0.0
    place, speed = 0.05, 3.0
    q, qd = np.array([0.4, place, place]), np.array([speed, 0.0, 0.0])
    system.native.evaluate(q, qd)
    # The arm's angular acceleration pushes one finger out and the other one in.
    np.testing.assert_allclose(system.qdd[1:], place * speed ** 2, rtol=1e-9)
    both = 0.02 + 0.2 ** 2 + 2.0 * mass * (1e-4 + 0.4 ** 2 + place ** 2)
    np.testing.assert_allclose(system.qdd[0], 0.3 / both, rtol=1e-9)


@pytest.mark.parametrize('unrolled', [None, False], ids=['unrolled', 'loops'])
def test_a_massless_link_that_no_force_turns_is_regular(unrolled):
    # A block in the slot of a lever: what it presses passes through its pin.
    mechanism = Mechanism('whitworth', (
        Body('crank', 0.5, (0.04, 0.0), 2.7e-4), Body('block', 0.0, (0.0, 0.0), 0.0, True),
        Body('lever', 1.2, (0.2, 0.0), 0.016)), (
            Joint('crank_joint', 'revolute', 'ground', 'crank', (0.0, 0.0)),
            Joint('pin', 'revolute', 'crank', 'block', (0.08, 0.0)),
            Joint('lever_joint', 'revolute', 'ground', 'lever', (0.0, -0.2))), (
                CutJoint('slot', 'prismatic', 'block', 'lever', (0.0, 0.0), (0.0, 0.0)),))
    lever = np.arctan2(0.2 + 0.08 * np.sin(0.3), 0.08 * np.cos(0.3))
    q, qd = np.array([0.3, lever - 0.3, lever]), np.zeros(3)
    system = build_system(build_model(mechanism, EARTH), unrolled=unrolled)
    system.tau[0] = 0.7
    system.native.evaluate(q, qd)
    expected = maximal.forward_dynamics(
        mechanism, q, qd, system.tau, EARTH, maximal.extended)
    for found, wanted in ((system.qdd, expected.qdd), (system.lam, expected.lam)):
        np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-11 * np.abs(wanted).max())
    assert system.work.health[RANK_REVEALING_COUNT] == 0


# Of shipped scenes: bodies without mass whose forces, or the masses around them, let refinement
# converge slowly, and ones whose loops are eliminated with their joints, which asks for no masses:
# one of them only a coupling holds.
SLOW = [('rssr_four_bar', 'rocker', False), ('humanoid_knee', 'crank', True), *(
    pytest.param(*case, marks=pytest.mark.slow) for case in (
        ('slider_crank', 'rod', False), ('carpet_scraper', 'coupler', False),
        ('rack_press', 'lever', False)))]


@pytest.mark.parametrize(('name', 'body', 'refined'), SLOW)
def test_a_scene_with_a_massless_link_is_refined_by_routines(name, body, refined):
    scene = load_scene(name)
    light = [replace(scene, mechanism=replace(scene.mechanism, bodies=tuple(
        replace(one, mass=mass, inertia=inertia, massless=mass == 0.0)
        if one.name == body else one for one in scene.mechanism.bodies)))
        for mass, inertia in ((0.0, 0.0), (1e-9, 1e-12 * np.array(
            1.0 if scene.mechanism.planar else (1.0, 1.0, 1.0))))]
    massless, lightest = map(Simulation, light)
    for system in massless.data.system, deepcopy(massless.data.system):
        assert (set(codegen.REFINED) < set(system.routines)) == refined
    assert not set(codegen.REFINED) & set(Simulation(scene).data.system.routines)
    for _ in range(3):
        q, qd = massless.position, massless.velocity
        expected, _ = lightest.forward_dynamics(q, qd)
        found, _ = massless.forward_dynamics(q, qd)
        allowed = 1e-6 * (1e-3 + np.abs(expected).max())
        np.testing.assert_allclose(found, expected, rtol=0, atol=allowed)
        for simulation in (massless, lightest):
            simulation.step(duration=0.02)
        np.testing.assert_allclose(massless.position, lightest.position, rtol=0, atol=1e-7)
    assert massless.data.system.work.health[RANK_REVEALING_COUNT] == 0
