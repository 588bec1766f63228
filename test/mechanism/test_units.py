# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Units of coordinates, in the tree and where it is cut: efforts times rates are powers."""

from closedloop_dynamics.mechanism.coordinates import EITHER, QUANTITIES, unit_of
from closedloop_dynamics.scene.loading import load_scene


def test_turns_and_slides_have_units_whose_products_are_powers():
    mechanism = load_scene('slider_crank').mechanism
    # Crank and cut pin turn, the block slides, and points move along axes.
    for name, length, power in (
            ('crank_joint', 'rad', 'N m rad/s'), ('cut_1', 'rad', 'N m rad/s'),
            ('slider_joint', 'm', 'N m/s'), ('slider.x', 'm', 'N m/s')):
        assert f'{unit_of(mechanism, "effort", name)} {unit_of(mechanism, "velocity", name)}' == (
            power)
        assert [unit_of(mechanism, quantity, name) for quantity in QUANTITIES][:3] == [
            length, f'{length}/s', f'{length}/s^2']
    assert EITHER['acceleration'] == 'rad/s^2 or m/s^2'
    assert mechanism.coordinates.units('effort') == ['N m', 'N m', 'N']
