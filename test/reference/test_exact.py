# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

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
