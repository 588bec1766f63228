# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Drag of fluids: forces by hand, closed forms, energy."""

import math

from closedloop_dynamics.effects.registry import FluidDrag, Gravity
import numpy as np
import pytest

from .machines import assert_balanced, block, flyer, simulated
from .test_space import assert_moves, drawn
from ..reference import cases, spatial_linkages, spatial_maximal as twin
from ..reference.compare import assert_agree


def test_a_fall_approaches_its_final_speed_as_the_closed_form():
    mass, drag = 2.0, 0.8
    simulation = simulated(
        block(mass), {'gravity': Gravity((9.81, 0.0)),
                      'air': FluidDrag('center', quadratic=(drag, 0.0))}, [0.0], step_size=1e-3)
    final = math.sqrt(mass * 9.81 / drag)
    for _ in range(3):
        simulation.step(duration=0.5)
        assert simulation.velocity[0] == pytest.approx(
            final * math.tanh(9.81 * simulation.time / final), rel=1e-10)
    assert_balanced(simulation, 1e-9)


def test_a_flow_carries_a_body_along_by_its_work():
    simulation = simulated(block(2.0), {
        'stream': FluidDrag('center', linear=(3.0, 0.0), flow=(0.5, 0.0))}, [0.0], step_size=1e-3)
    simulation.step(duration=1.0)
    speed = 0.5 * (1.0 - math.exp(-1.5))
    assert simulation.velocity[0] == pytest.approx(speed, rel=1e-10)
    # The flow's work is the momentum gained times its speed.
    assert simulation.energy_balance.work == pytest.approx(2.0 * speed * 0.5, rel=1e-9)
    assert_balanced(simulation, 1e-10)


def test_force_and_torque_in_the_plane_follow_the_axes_of_the_body():
    law = FluidDrag('rim', (1.0, 2.0), (0.5, 3.0), 0.7, 0.2, (0.3, -0.1), angle=0.4)
    simulation = simulated(flyer(), {'water': law}, [0.0, 0.0, 0.2], [0.6, -0.4, 2.0])
    cosine, sine = math.cos(0.6), math.sin(0.6)
    axes = np.array([[cosine, sine], [-sine, cosine]])
    arm = np.array([math.sin(0.2), -math.cos(0.2)]) * 0.2
    velocity = axes @ (np.array([0.6 - 2.0 * arm[1], -0.4 + 2.0 * arm[0]]) - (0.3, -0.1))
    force = axes.T @ (-(np.array([1.0, 2.0]) + [0.5, 3.0] * np.abs(velocity)) * velocity)
    torque = arm[0] * force[1] - arm[1] * force[0] - (0.7 + 0.2 * 2.0) * 2.0
    assert np.allclose(simulation.acceleration, [
        force[0] / 1.5, force[1] / 1.25, torque / 0.5], rtol=1e-12)
    simulation.step(duration=0.5)
    assert_balanced(simulation, 1e-8)


@pytest.mark.parametrize('seed', cases.first(2, range(4)))
def test_bodies_in_space_are_moved_as_in_maximal_coordinates(seed):
    rng, mechanism, q, qd, bodies, points, motions = drawn(60 + seed)
    effects, pushes, lost, work = {}, [], 0.0, 0.0
    for k, (body, (arm, _, velocity)) in enumerate(zip(bodies, points)):
        linear, quadratic, turning, faster = rng.uniform(0.1, 2.0, (4, 3))
        flow, quaternion = rng.normal(size=3), spatial_linkages.quaternion(rng)
        axes = motions[body].axes @ twin.matrix(quaternion)
        seen, spin = axes.T @ (velocity - flow), axes.T @ motions[body].spin
        force = axes @ (-(linear + quadratic * np.abs(seen)) * seen)
        torque = axes @ (-(turning + faster * np.abs(spin)) * spin)
        pushes.append((body, arm, force, torque))
        lost -= force @ (velocity - flow) + torque @ motions[body].spin
        work += force @ flow
        effects[f'drag_{k}'] = FluidDrag(
            f'p{k}', *map(tuple, (linear, quadratic, turning, faster, flow)),
            orientation=tuple(quaternion))
    table = assert_moves(mechanism, q, qd, effects, pushes)
    assert_agree(table.rates[0::2].sum(), lost, 1e-11, smallest=1.0)
    assert_agree(table.rates[1::2].sum(), work, 1e-11, smallest=1.0)
