# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Every shipped scene runs for a minute, or stops for a known reason, in real time."""

from dataclasses import replace

from closedloop_dynamics import load_scene, NumericalError, scene_names, Simulation
from closedloop_dynamics.engine.types import RANK_REVEALING_COUNT
import pytest

DURATION = 60.0
# Evaluations per second of motion: 10 microseconds each are half of real time. One that reveals
# the rank of the equations takes as long as so many others.
MOST_EVALUATIONS, REVEALING = 50_000, 500
# Contacts too stiff for steps of 1 ms.
STOPS = {('geneva_drive', 'rk4'): 'does not follow this motion.*integrator: auto'}


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize('method', ['auto', 'rk4'])
@pytest.mark.parametrize('name', scene_names())
def test_every_shipped_scene_runs_for_a_minute(name, method):
    scene = load_scene(name)
    simulation = Simulation(replace(scene, method=replace(scene.method, integrator=method)))
    if (name, method) in STOPS:
        with pytest.raises(NumericalError, match=STOPS[name, method]):
            simulation.step(duration=DURATION)
        return
    for _ in range(int(DURATION)):
        simulation.step(duration=1.0)
    assert simulation.time == pytest.approx(DURATION)
    evaluations = simulation.report().evaluations + (
        REVEALING * simulation.data.system.work.health[RANK_REVEALING_COUNT])
    assert evaluations <= MOST_EVALUATIONS * DURATION
