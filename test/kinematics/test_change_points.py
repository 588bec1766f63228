# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A four-bar that goes through flat, or nearly: the right branch, or reported as undecided."""

from collections import Counter
from dataclasses import replace
from typing import NamedTuple

from closedloop_dynamics import (
    AssemblyError, codegen, Mechanism, Method, Simulation, SimulationError)
from closedloop_dynamics.kinematics.change_points import branches_apart
import hard_machines
import numpy as np
import pytest

from ..reference.machines import bar, revolute, revolute_cut
from ..reference.scenes import simulated
from ..reference.special import ladder


class Bars(NamedTuple):
    """Lengths of a four-bar that is flat where its crank lies along the base [m]."""

    crank: float = 1.0
    rocker: float = 2.0
    base: float = 1.5
    #: What the coupler is longer than that.
    longer: float = 0.0

    @property
    def coupler(self):
        """Return the length of the coupler."""
        return self.base + self.rocker - self.crank + self.longer

    def mechanism(self):
        """Return the linkage."""
        return Mechanism('four_bar', (
            bar('crank', 1.0, self.crank, 0.5 * self.crank), bar('coupler', 2.5, 2.5, 1.25),
            bar('rocker', 2.0, self.rocker, 0.5 * self.rocker)), (
            revolute('A', 'ground', 'crank', (0.0, 0.0), actuated=True),
            revolute('B', 'crank', 'coupler', (self.crank, 0.0)),
            revolute('D', 'ground', 'rocker', (self.base, 0.0))), (
            revolute_cut('C', 'coupler', (self.coupler, 0.0), 'rocker', (self.rocker, 0.0)),))

    def closed(self, crank, side):
        """Return the angles with a crank angle, the coupler's end on one side."""
        tip = self.crank * np.array([np.cos(crank), np.sin(crank)])
        span = np.array([self.base, 0.0]) - tip
        reach = np.hypot(*span)
        along = (self.coupler ** 2 - self.rocker ** 2 + reach ** 2) / (2.0 * reach)
        across = side * np.sqrt(max(self.coupler ** 2 - along ** 2, 0.0))
        end = tip + (along * span + across * np.array([-span[1], span[0]])) / reach
        return np.array([crank, np.arctan2(*(end - tip)[::-1]) - crank,
                         np.arctan2(end[1], end[0] - self.base)])

    def error(self, angles):
        """
        Return how far angles are from the branch of a motion through or back from flat [rad].

        Begun at positive crank angles, the coupler's end on the positive side: with a longer
        coupler the crank turns back before the base, the end crosses; with a shorter one the
        crank goes through, and the end stays on its side.
        """
        turned_back = self.longer > 0.0
        if turned_back != (angles[0] > 0.0):
            return np.inf
        return apart(angles, self.closed(angles[0], -1.0 if turned_back else 1.0))

    def started(self, crank=0.4, rate=-1.0, hold=('A',), method=None):
        """Return a simulation, the coupler's end on the positive side."""
        return simulated(self.mechanism(), self.closed(crank, 1.0), (rate, 0.0, 0.0), hold=hold,
                         method=method)


def apart(angles, others):
    """Return how far angles are from others, by the shorter turns [rad]."""
    return np.abs((angles - others + np.pi) % (2.0 * np.pi) - np.pi).max()


def is_reported(report):
    """Return whether a run says that its branch is undecided, and of no bound."""
    reported = any('undecided' in finding for finding in report.findings)
    assert reported == report.branch_undecided
    assert not reported or np.isnan(report.error_bound)
    return reported


METHODS = [Method(), Method(integrator='dop853', tolerance=1e-12),
           Method(integrator='rk4', step_size=1e-3), Method(integrator='rodas4')]


@pytest.mark.parametrize('method', METHODS, ids=lambda method: method.integrator)
@pytest.mark.parametrize('sign', [1.0, -1.0])
def test_near_flat_the_branch_is_right_or_reported_to_be_undecided(sign, method):
    reported = []
    for power in range(3, 13):
        bars = Bars(longer=sign * 10.0 ** -power)
        simulation = bars.started(method=method)
        try:
            simulation.step(None, 0.8)
        except SimulationError:
            # Fixed steps cannot turn round in a step, and say so.
            assert method.integrator == 'rk4' and power < 8
            continue
        if is_reported(simulation.report()):
            reported.append(power)
        else:
            # Integrators err along the branch; off it only as loops are open.
            assert bars.error(simulation.position) < 1e-9, (power, simulation.position)
    # To 1e-6 it is followed; from 1e-8 on it is not believed.
    assert all(power > 6 for power in reported)
    assert {8, 9, 10, 11, 12} <= set(reported)


@pytest.mark.parametrize('count', [10, pytest.param(300, marks=[
    pytest.mark.slow, pytest.mark.timeout(3600)])])
def test_no_random_linkage_changes_its_branch_in_silence(count, monkeypatch):
    # Loops over bodies are compiled once.
    monkeypatch.setattr(codegen, 'MOST_UNROLLED_OPERATIONS', 0)
    found = Counter()
    for number in range(count):
        rng = np.random.default_rng([15, number])
        crank = rng.uniform(0.3, 1.5)
        bars = Bars(crank, rng.uniform(0.8, 3.0), crank + rng.uniform(0.3, 1.0),
                    rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-12.5, -2.5))
        method = METHODS[rng.integers(len(METHODS))]
        start, rate = rng.uniform(0.25, 0.6), -rng.uniform(0.5, 2.0)
        try:
            simulation = bars.started(start, rate, method=method)
            # A turn of the crank at twice its angle, or back where it was: past flat once.
            simulation.step(None, 1.6 * start / abs(rate))
        except SimulationError:
            found['refused'] += 1
            continue
        if is_reported(simulation.report()):
            found['reported'] += 1
        else:
            right = bars.error(simulation.position) < 1e-8
            found['right' if right else 'silent'] += 1
            if not right:
                print(number, bars, method.integrator, simulation.position)
    print(f'tried {count}:', dict(found))
    assert found['silent'] == 0


@pytest.mark.parametrize('method', METHODS, ids=lambda method: method.integrator)
def test_a_change_point_is_passed_straight_without_a_word(method):
    bars = Bars()
    simulation = bars.started(method=method)
    simulation.step(None, 0.8)
    position = simulation.position
    assert position[0] < -0.2
    # The coupler's end crosses with the crank: on the other side below the base.
    assert apart(position, bars.closed(position[0], -1.0)) < 1e-9
    assert not simulation.report().findings


def test_by_how_much_lengths_miss_a_change_point():
    """At the flat position the coupler's end is as far from the rocker's as the coupler longer."""
    for longer in (1e-5, -1e-8, 1e-11):
        bars = Bars(longer=longer)
        found = branches_apart(bars.mechanism(), bars.started().data.loop_model.equations,
                               Bars().closed(0.02, 1.0))
        assert abs(found * bars.coupler - abs(longer)) < 1e-3 * abs(longer) + 1e-15
    for mechanism, position, _ in (ladder(1, 0.5 * np.pi - 0.01), ladder(3, 0.5 * np.pi - 0.01),
                                   hard_machines.pantograph(-1.9, -1.89, 1.0, 1.0)):
        simulation = simulated(mechanism, position)
        assert branches_apart(mechanism, simulation.data.loop_model.equations, position) == 0.0


def falling(longer=0.0):
    """Yield machines that fall, or swing, through positions where several loops are flat."""
    method = Method()
    for loops in (1, 2, 3):
        for tilt in (0.4, 0.5 * np.pi, 0.5 * np.pi - 1e-6):
            mechanism, q, qd = hard_machines.ladder(loops, tilt)
            cut, *others = mechanism.cut_joints
            cut = replace(cut, point_a=(cut.point_a[0] + longer, *cut.point_a[1:]))
            yield hard_machines.scene(
                replace(mechanism, cut_joints=(cut, *others)), q, qd, method), 3.0
    if not longer:
        light = hard_machines.gravity(strength=1.0)
        yield hard_machines.scene(*hard_machines.change_point_linkage(), method, light), 10.0
        for fold in (0.6, 0.0, -1e-5):
            yield hard_machines.scene(
                *hard_machines.pantograph(-1.9, -1.9 + fold, 1.0, -3.0), method), 1.0


def test_real_change_points_are_passed_without_a_word():
    passed = 0
    for scene, duration in falling():
        simulation = Simulation(scene)
        simulation.step(None, duration)
        assert not is_reported(simulation.report()), scene.mechanism.name
        passed += simulation.health.singular_count > 0
    assert passed > 10


def test_one_of_several_flat_loops_that_misses_is_reported():
    reported = 0
    for scene, duration in falling(1e-9):
        try:
            simulation = Simulation(scene)
            simulation.step(None, duration)
        except AssemblyError:
            # Started at flat, where it does not close.
            continue
        except SimulationError as error:
            assert 'undecided' in str(error)
            reported += 1
            continue
        assert is_reported(simulation.report()), scene.initial
        reported += 1
    assert reported > 2


@pytest.mark.parametrize('hold', [('A',), ()])
@pytest.mark.parametrize('side', [1.0, -1.0])
@pytest.mark.parametrize('beside', [1e-2, 1e-4, 1e-5, 1e-6, 1e-7, -1e-6, -1e-7])
def test_starts_beside_a_change_point_go_on_their_branch(beside, side, hold):
    # Rates of the branch, at the change point: that of the crank -1, the others' by differences.
    step = 1e-2
    places = {1: 0.8, -1: -0.8, 2: -0.2, -2: 0.2, 3: 4 / 105, -3: -4 / 105, 4: -1 / 280,
              -4: 1 / 280}
    bars = Bars()
    rates = -sum(weight / step * bars.closed(beside + k * step, side * np.sign(
        (beside + k * step) * beside)) for k, weight in places.items())
    simulation = simulated(bars.mechanism(), bars.closed(beside, side), rates, hold=hold)
    # Differences of the eighth order, over 0.01 rad; beside the position is rounded to 1e-16 over
    # the distance, which the interpolation does not feel.
    assert np.abs(simulation.velocity - rates).max() < 1e-7
    simulation.step(None, 0.4)
    position = simulation.position
    assert apart(position, bars.closed(position[0], side * np.sign(
        position[0] * beside))) < 1e-9


def test_a_start_at_a_change_point_is_refused_as_one():
    for beside in (1e-9, 1e-12, 0.0):
        with pytest.raises(AssemblyError, match='change point') as caught:
            Bars().started(beside)
        assert 'contradict' not in str(caught.value)
