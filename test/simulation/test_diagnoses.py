# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What messages say of a cause is true, and the cure they name works."""

import re

from closedloop_dynamics import SimulationError
from closedloop_dynamics.effects.registry import Contact, JointSpring
import numpy as np
import pytest

from ..effects.machines import block, simulated

STEP = 1e-3


def bouncing(**method):
    """
    Return a block of 1 kg that bounces to and fro between two walls at 10 m/s.

    A wall is touched for pi ms, three steps of RK4, which are stable for its 1000 1/s but meet
    where it begins and ends by chance: more than a tenth of the energy goes astray within 0.1 s.
    """
    walls = {'stiffness': 1e6}
    return simulated(block(), {
        'spring': JointSpring('slide', 100.0, -0.2),
        'right': Contact('center', (0.0, 0.0), angle=0.5 * np.pi, **walls),
        'left': Contact('center', (-0.4, 0.0), angle=-0.5 * np.pi, **walls)},
        [-0.2], [10.0], step_size=STEP, **method)


def test_contacts_that_press_are_named_where_the_work_is_too_much():
    # A million oscillations a second between two walls that are closer than the block is wide.
    walls = {'stiffness': 1e13}
    jammed = simulated(block(), {
        'right': Contact('center', (-0.01, 0.0), angle=0.5 * np.pi, **walls),
        'left': Contact('center', (0.02, 0.0), angle=-0.5 * np.pi, **walls),
        'far': Contact('center', (-9.0, 0.0), angle=-0.5 * np.pi, **walls)},
        [0.0], [0.0], step_size=0.5, integrator='rodas4', tolerance=1e-9)
    with pytest.raises(SimulationError, match='In contact: ') as error:
        jammed.step(duration=0.5)
    named = re.findall(r'(\w+) \((\S+) m deep, normal force (\S+) N\)',
                       str(error.value).partition('In contact: ')[2])
    assert {name for name, *_ in named} == {'left', 'right'}
    for name, depth, force in named:
        readings = jammed.effect_readings(name)
        assert float(depth) == pytest.approx(readings['depth'], rel=1e-2)
        assert float(force) == pytest.approx(1e13 * readings['depth'], rel=1e-2)
    forces = [float(force) for *_, force in named]
    assert forces == sorted(forces, reverse=True)


# A kernel of its own, RODAS4 with effects.
@pytest.mark.slow
def test_the_walls_are_no_stiff_scene():
    evaluations = {}
    for integrator in ('dop853', 'rodas4'):
        simulation = bouncing(integrator=integrator, tolerance=1e-8)
        simulation.step(duration=0.5)
        balance = simulation.energy_balance
        assert abs(balance.residual) < 1e-3 * (balance.kinetic + balance.stored)
        evaluations[integrator] = simulation.report().evaluations
    assert 2 * evaluations['dop853'] < evaluations['rodas4']


def test_energy_lost_at_contacts_is_not_called_stiffness():
    with pytest.raises(SimulationError) as caught:
        bouncing(integrator='rk4').step(duration=2.0)
    message = str(caught.value)
    allowed = re.search(r'stable with steps up to ([\d.e+-]+) s', message)
    assert allowed is None or float(allowed[1]) < STEP, message
    assert 'integrator: auto' in message and 'rodas4' not in message
