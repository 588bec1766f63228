# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Computations that take longer than a page can wait are stopped, and nothing is lost."""

import math
import threading

from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.view.watchdog import Watchdog
import numpy as np

# It would take minutes.
ENDLESS = 100_000_000


def test_what_takes_long_is_stopped_and_goes_on():
    simulation, alone = (Simulation.from_scene('four_bar') for _ in range(2))
    tau, heard = simulation.joint_torques(None), []
    with Watchdog(0.05, lambda: False, heard.append) as watchdog:
        assert watchdog.does(lambda: simulation.advance(tau, 100))
        assert not watchdog.does(lambda: simulation.advance(tau, ENDLESS))
        steps = round(simulation.time / simulation.step_size)
        assert 100 <= steps < ENDLESS
        # The next one is not stopped by what stopped this.
        assert watchdog.does(lambda: simulation.advance(tau, 100))
    alone.advance(tau, steps + 100)
    assert math.isclose(simulation.time, alone.time)
    # Of steps that are divided by error control, as many have been made.
    np.testing.assert_allclose(simulation.position, alone.position, rtol=0.0, atol=1e-5)
    assert heard and min(heard) > 0.05


def test_patience_ends_when_somebody_wants_something():
    simulation = Simulation.from_scene('four_bar')
    tau, wanted = simulation.joint_torques(None), threading.Event()

    def heard(elapsed):
        # After the second look that was too late, and not before.
        if elapsed > 0.1:
            wanted.set()

    with Watchdog(0.02, wanted.is_set, heard) as watchdog:
        assert not watchdog.does(lambda: simulation.advance(tau, ENDLESS), patient=True)
    assert wanted.is_set()
