# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Linkages by precision positions are those of the literature, and move through the positions."""

from closedloop_dynamics.kinematics.assembly import Assembler
from closedloop_dynamics.kinematics.geometry import Geometry
from closedloop_dynamics.mechanism.kinematics import body_poses, named_point, pose_of
from closedloop_dynamics.studies import synthesis
from closedloop_dynamics.studies.synthesis import (
    function_generation, Linkage, motion_generation, path_generation, SLIDER_CRANK, SynthesisError)
import numpy as np
import pytest


def chebyshev(first, last, count):
    """Return the places of the least largest error of polynomials."""
    k = np.arange(count, 0, -1)
    return 0.5 * (first + last) + 0.5 * (last - first) * np.cos((2 * k - 1) * np.pi / (2 * count))


def driven(linkage):
    """Return places, angles of coupler and output in each position, of the scene that is made."""
    scene = linkage.scene('found')
    mechanism, q = scene.mechanism, np.array(scene.initial.position)
    assembler, found, last = Assembler(mechanism, Geometry(mechanism).equations), [], 0.0
    for turn in linkage.turns:
        # In steps, so that the nearest position is that of the branch.
        for part in np.linspace(last, turn, 30)[1:] if turn != last else [turn]:
            q[0] = scene.initial.position[0] + part
            q = assembler.positions(q, ['input_joint'])
        last = turn
        poses = body_poses(mechanism, q)
        found.append((*named_point(mechanism, poses, 'traced')[:2],
                      pose_of(mechanism, poses, 'coupler')[2], q[2]))
    return np.array(found)


def curve(linkage, turns):
    """Return pins, ends and traced places of a linkage at angles of its crank."""
    pin, end, traced, missing = linkage.at(turns)
    assert not missing.any()
    return pin, end, traced


def four_bar():
    """Return a crank-rocker of base 0.4, crank 0.1, coupler 0.35 and rocker 0.25 m."""
    pin = 0.1 * np.exp(1j)
    away = 0.4 - pin
    along = (0.35 ** 2 - 0.25 ** 2 + abs(away) ** 2) / (2.0 * abs(away))
    end = pin + away / abs(away) * (along + 1j * np.sqrt(0.35 ** 2 - along ** 2))
    return Linkage(0j, pin, end, 0.4 + 0j, 1.0 + 0j, pin + (end - pin) * (0.5 + 0.3j))


TURNS = np.array([0.0, 0.7, 1.5, 2.3, 3.1])


def test_freudenstein_meets_a_logarithm_at_chebyshevs_places():
    # Log10 from 1 to 2 over 60 deg of the crank and 90 deg of the rocker, from 45 deg and 0 deg.
    x = chebyshev(1.0, 2.0, 3)
    np.testing.assert_allclose(x, [1.0669873, 1.5, 1.9330127], atol=1e-7)
    inputs = np.radians(45.0) + np.radians(60.0) * (x - 1.0)
    outputs = np.radians(90.0) * np.log10(x) / np.log10(2.0)
    linkage, = function_generation(inputs, outputs).linkages
    out = driven(linkage)[:, 3]
    np.testing.assert_allclose(out - out[0], outputs - outputs[0], atol=1e-9)
    # Between these the error changes sign at each of the places, and nowhere else.
    fine = np.linspace(1.0, 2.0, 400)
    _, end, _ = curve(linkage, np.radians(60.0) * (fine - x[0]))
    wanted = np.radians(90.0) * np.log10(fine) / np.log10(2.0)
    error = np.angle((end - linkage.pivot) / (linkage.end - linkage.pivot) * np.exp(
        1j * (outputs[0] - wanted)))
    signs = fine[1:][np.diff(np.sign(error)) != 0.0]
    np.testing.assert_allclose(signs, x, atol=0.01)


@pytest.mark.parametrize('count', [3, 5])
def test_function_generation_finds_the_linkage_that_made_the_function(count):
    made, turns = four_bar(), TURNS[:count]
    _, end, _ = curve(made, turns)
    found = function_generation(1.0 + turns, np.angle(end - 0.4), base=0.4).linkages
    assert any(one.lengths == pytest.approx([0.4, 0.1, 0.35, 0.25], abs=1e-6) for one in found)


def test_three_poses_have_their_pivots_at_the_centres_of_circles():
    made = four_bar()
    pin, end, traced = curve(made, TURNS[:3])
    angles = np.angle((end - pin) / (end[0] - pin[0]))
    linkage = motion_generation(
        np.column_stack([traced.real, traced.imag]), angles,
        pins=[(pin[0].real, pin[0].imag), (end[0].real, end[0].imag)]).linkages[0]
    assert sorted(linkage.lengths) == pytest.approx([0.1, 0.25, 0.35, 0.4], abs=1e-12)
    assert sorted([abs(linkage.crank), abs(linkage.pivot)]) == pytest.approx(
        [0.0, 0.4], abs=1e-12)


def test_five_poses_have_burmesters_dyads():
    made = four_bar()
    pin, end, traced = curve(made, TURNS)
    angles = np.angle((end - pin) / (end[0] - pin[0]))
    dyads = synthesis.dyads(traced, np.exp(1j * angles), np.ptp(traced.real))
    # Four at most, and those of the linkage that made the poses among them.
    assert 2 <= len(dyads) <= 4
    for wanted in ((made.pin, made.crank), (made.end, made.pivot)):
        assert min(abs(wanted[0] - one) + abs(wanted[1] - other) for one, other in dyads) < 1e-6
    found = motion_generation(np.column_stack([traced.real, traced.imag]), angles)
    for linkage in found.linkages:
        out = driven(linkage)
        np.testing.assert_allclose(out[:, 0] + 1j * out[:, 1], traced, atol=1e-7)
        np.testing.assert_allclose(np.exp(1j * (out[:, 2] - out[0, 2])), np.exp(1j * angles),
                                   atol=1e-6)
    assert any(one.lengths == pytest.approx([0.4, 0.1, 0.35, 0.25], abs=1e-6)
               for one in found.linkages)


def test_a_straight_path_is_as_straight_as_hoekens():
    # Crank 1, base 2, coupler and rocker 2.5, point at 5: straight over half a turn.
    base = 2.0 - 1j
    along = abs(base) / 2.0
    end = 1j + base / abs(base) * (along + 1j * np.sqrt(2.5 ** 2 - along ** 2))
    hoeken = Linkage(0j, 1j, end, 2.0 + 0j, 1.0 + 0j, 1j + 2.0 * (end - 1j))
    _, _, path = curve(hoeken, np.linspace(0.5, np.pi - 0.5, 100))
    straight = np.ptp(path.imag)
    # Stroke of 4 in half a turn, straight to a thousandth of it.
    _, _, half = curve(hoeken, np.linspace(0.0, np.pi, 200))
    assert np.ptp(half.real) == pytest.approx(4.0, rel=0.02)
    assert straight < 4e-3 * 4.0
    # Five places on a line, as far apart as those of Chebyshev: straighter between them.
    x = chebyshev(-1.0, 1.0, 5)
    found = path_generation(np.column_stack([x, 0.0 * x]), starts=40)
    flatness = []
    for linkage in found.linkages:
        out = driven(linkage)
        np.testing.assert_allclose(out[:, 0] + 1j * out[:, 1], x, atol=1e-7)
        _, _, between = curve(linkage, np.linspace(0.0, linkage.turns[-1], 200))
        flatness.append(np.ptp(between.imag))
    assert min(flatness) < 1e-2


@pytest.mark.parametrize('count', [5, 8])
def test_paths_of_slider_cranks_are_met_or_come_near(count):
    made = Linkage(0j, 0.1 + 0j, 0.1 + np.sqrt(0.3 ** 2 - 0.02 ** 2) + 0.02j, None, 1.0 + 0j,
                   0.25 + 0.1j)
    _, _, traced = curve(made, np.linspace(0.0, 3.0, count))
    found = path_generation(np.column_stack([traced.real, traced.imag]), SLIDER_CRANK, starts=30)
    best = found.linkages[0]
    out = driven(best)
    np.testing.assert_allclose(out[:, 0] + 1j * out[:, 1], traced, atol=1e-3 if count > 5
                               else 1e-7)


def test_strokes_follow_the_crank():
    made = Linkage(0j, 0.1j, np.sqrt(0.3 ** 2 - 0.1 ** 2) + 0j, None, 1.0 + 0j, 0j)
    _, end, _ = curve(made, TURNS)
    found = function_generation(TURNS, end.real, SLIDER_CRANK, starts=40)
    assert any(one.lengths == pytest.approx([0.1, 0.3], abs=1e-6) for one in found.linkages)
    np.testing.assert_allclose(np.diff(driven(found.linkages[0])[:, 3]), np.diff(end.real),
                               atol=1e-7)


def test_defects_are_left_out_and_reported():
    made = four_bar()
    _, end, _ = curve(made, TURNS)
    # The same positions in another order.
    order = [0, 2, 1, 3]
    with pytest.raises(SynthesisError, match='on several branches or in another order'):
        function_generation(1.0 + TURNS[order], np.angle(end[order] - 0.4), base=0.4,
                            starts=20)
    for wrong in (lambda: path_generation([(0.0, 0.0)]), lambda: path_generation([(1.0, 2.0)] * 4),
                  lambda: function_generation([0.0, 1.0], [0.0, 1.0]),
                  lambda: motion_generation([(0.0, 0.0)] * 3, [0.0, 1.0])):
        with pytest.raises(SynthesisError):
            wrong()
