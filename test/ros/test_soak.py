# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The soak: two minutes of it among the slow tests, some seconds otherwise."""

from test.ros.soak import growth, soak

import pytest


def test_growth_is_seen_and_settling_is_not():
    steady = [(t, 100e6 if t > 20 else 80e6) for t in range(200)]
    assert growth(steady, 25.0) == 0.0
    leaking = [(t, 80e6 + 1e5 * t) for t in range(200)]
    assert growth(leaking, 20.0) == pytest.approx(1e5 * 162.0, rel=0.05)


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_two_minutes_lose_nothing_and_leak_nothing(domain, tmp_path):
    report, good = soak(120.0, 'carpet_scraper', 200.0, tmp_path)
    assert good, report
