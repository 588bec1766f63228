# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The exact solutions give the reference values, to the digits these were written with."""

import numpy as np
import pytest

from . import exact


@pytest.mark.parametrize('loops, time', exact.FOUR_BAR_REFERENCE)
def test_four_bar_ladder_gives_the_reference(loops, time):
    # Ten digits of the places, nine of the velocities are written down.
    np.testing.assert_allclose(exact.four_bar_ladder(loops, [time])[0],
                               exact.FOUR_BAR_REFERENCE[loops, time], rtol=0.0, atol=1e-9)


@pytest.mark.parametrize('start, time', exact.PENDULUM_REFERENCE)
def test_pendulum_gives_the_reference(start, time):
    # Ten to twelve digits are written down.
    np.testing.assert_allclose(exact.pendulum(start, [time])[0],
                               exact.PENDULUM_REFERENCE[start, time], rtol=0.0, atol=1e-10)


def test_pendulum_comes_back_after_a_period():
    assert exact.pendulum_period() == pytest.approx(exact.PENDULUM_PERIOD, abs=1e-12)
    place = exact.pendulum(1.0, [exact.pendulum_period()])[0]
    np.testing.assert_allclose(place, [1.0, 0.0], rtol=0.0, atol=1e-12)


def test_slider_crank_gives_the_reference():
    motion = exact.slider_crank([10.0])
    for name, value in exact.SLIDER_CRANK_REFERENCE.items():
        # Twelve digits are written down.
        assert motion[name][0] == pytest.approx(value, abs=1e-11)
