# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The twins agree with one another, and with physics."""

from closedloop_dynamics.scene.loading import load_scene
import numpy as np
import pytest

from . import cases, dense, exact, linkages, machines, maximal, special, states
from .compare import assert_agree, IDENTITY, SOLVE
from .trees import derivative


@pytest.fixture(params=cases.PARAMETERS, ids=str)
def case(request):
    """Return (rng, mechanism, q, qd), the state closed."""
    return cases.drawn(request.param, seed=2)


def test_accelerations_and_multipliers_of_both_twins_agree(case):
    rng, mechanism, q, qd = case
    tau = rng.normal(size=len(q))
    qdd, lam = dense.forward_dynamics(mechanism, q, qd, tau)
    result = maximal.forward_dynamics(mechanism, q, qd, tau)
    assert_agree(result.qdd, qdd, SOLVE)
    assert_agree(result.lam, lam, SOLVE)


def test_states_close_and_leave_a_freedom(case):
    _, mechanism, q, qd = case
    assert_agree(dense.closure(mechanism, q), np.zeros(mechanism.number_of_equations),
                 IDENTITY, smallest=1.0)
    jac = dense.closure_jacobian(mechanism, q)
    assert_agree(jac @ qd, np.zeros(len(jac)), IDENTITY, smallest=1.0)
    assert len(q) - len(jac) >= 1
    assert states.smallest_singular_value(mechanism, q) > 1e-2


def test_closure_jacobian_by_two_ways_agrees(case):
    _, mechanism, q, _ = case
    assert_agree(dense.closure_jacobian_by_paths(mechanism, q),
                 dense.closure_jacobian(mechanism, q), IDENTITY)


def test_kinetic_energy_is_the_sum_over_the_single_bodies(case):
    _, mechanism, q, qd = case
    motions = maximal.body_motions(mechanism, q, qd)
    energy = sum(0.5 * body.mass * motions[body.name].velocity @ motions[body.name].velocity
                 + 0.5 * body.inertia * motions[body.name].rate ** 2
                 for body in mechanism.bodies)
    assert energy == pytest.approx(dense.kinetic_energy(mechanism, q, qd), rel=IDENTITY)


def test_power_of_the_torques_is_the_rate_of_energy(case):
    rng, mechanism, q, qd = case
    tau = rng.normal(size=len(q))
    qdd, _ = dense.forward_dynamics(mechanism, q, qd, tau)
    nv = len(q)

    def energy(state):
        return (dense.kinetic_energy(mechanism, state[:nv], state[nv:])
                + dense.potential_energy(mechanism, state[:nv]))

    rate = derivative(energy, np.concatenate([q, qd]), np.concatenate([qd, qdd]))
    # Against the power of the single joints, which may cancel in the sum.
    assert rate == pytest.approx(tau @ qd, abs=SOLVE * np.abs(tau * qd).sum())


def test_inverse_dynamics_returns_the_torques():
    rng = np.random.default_rng(3)
    for build, start in machines.MACHINES.values():
        mechanism = build()
        q, qd = states.random_state(rng, mechanism, start)
        tau = rng.normal(size=7) * [joint.actuated for joint in mechanism.joints]
        qdd, lam = dense.forward_dynamics(mechanism, q, qd, tau)
        torque, forces = dense.inverse_dynamics(mechanism, q, qd, qdd)
        assert_agree(torque, tau, SOLVE)
        assert_agree(forces, lam, SOLVE)


def test_multiplier_carries_half_a_coupler_upward():
    # Upright four-bar at rest: body A of the cut, the coupler, rests on leg 1.
    mechanism, q, qd = special.ladder(1, tilt=0.0, rate=0.0)
    for lam in (dense.forward_dynamics(mechanism, q, qd, np.zeros(3))[1],
                maximal.forward_dynamics(mechanism, q, qd, np.zeros(3)).lam):
        assert_agree(lam, [0.0, 9.81 / 2.0], IDENTITY)


@pytest.mark.parametrize('loops', [1, 2, 6])
def test_ladder_follows_the_exact_parallel_branch(loops):
    mechanism, q, qd = special.ladder(loops, tilt=0.4, rate=1.3)
    qdd, _ = dense.forward_dynamics(mechanism, q, qd, np.zeros(len(q)))
    weight = exact.GRAVITY * ((loops + 1) / 2.0 + loops)
    expected = weight / ((loops + 1) / 3.0 + loops) * np.sin(0.4)
    legs = [index for index, joint in enumerate(mechanism.joints) if joint.parent == 'ground']
    assert_agree(qdd[legs], np.full(loops + 1, -expected), SOLVE)


def test_random_linkages_cover_every_joint_and_come_back_with_their_seed():
    def joint_types(count):
        return [[joint.type for joint in linkage[0].joints]
                + [f'cut {cut.type}' for cut in linkage[0].cut_joints]
                for linkage in (linkages.random_linkage(np.random.default_rng(seed))
                                for seed in range(count))]

    first = joint_types(20)
    assert set(sum(first, [])) == {
        'revolute', 'prismatic', 'cut revolute', 'cut prismatic', 'cut fixed'}
    assert first[:4] == joint_types(4)


@pytest.mark.parametrize('name', machines.MACHINES)
def test_shipped_file_is_the_published_machine(name):
    rng = np.random.default_rng(4)
    shipped, published = load_scene(name).mechanism, machines.MACHINES[name][0]()
    assert shipped.actuated_joints == published.actuated_joints
    for _ in range(3):
        q = rng.uniform(-np.pi, np.pi, 7)
        for quantity in (dense.generalized_inertia_matrix, dense.closure,
                         dense.potential_energy):
            assert_agree(quantity(shipped, q), quantity(published, q), IDENTITY)
