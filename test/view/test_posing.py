# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Moving a mechanism by hand along its loops."""

from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.view.posing import joint_to
import numpy as np
import pytest


@pytest.mark.parametrize('scene', ['three_rrr_vertical', 'delta_robot', 'four_bar'])
def test_a_joint_gets_the_value_and_the_other_drives_keep_theirs(scene):
    simulation, rng = Simulation.from_scene(scene), np.random.default_rng(1)
    places = simulation.data.actuated_in_tree
    for _ in range(20):
        simulation.reset()
        simulation.step({}, rng.uniform(0.01, 0.2))
        place = rng.choice(places)
        wanted = simulation.coordinates.by_freedom(simulation.position)[places]
        wanted[places == place] -= rng.uniform(-0.1, 0.1)
        joint_to(simulation, simulation.joint_names[place], wanted[places == place][0])
        found = simulation.coordinates.by_freedom(simulation.position)[places]
        assert np.abs(found - wanted).max() < 1e-8 and simulation.closure < 1e-12
        assert not simulation.velocity.any()
