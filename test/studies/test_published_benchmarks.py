# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The benchmark problems of the IFToMM library, beside what is known of them independently."""

import csv

from closedloop_dynamics.cli import main
from closedloop_dynamics.studies.published_benchmarks import four_bars_angle, PROBLEMS, solve
import numpy as np
import pytest
from scipy.integrate import solve_ivp

NAMED = {problem.name: problem for problem in PROBLEMS}


@pytest.mark.parametrize('name, position_error, energy_error', [
    ('A01', 1e-6, 1e-6), ('A02', 1e-6, 1e-5),
    # The known digits themselves are off by 1.4e-9 rad; the energies are some 0.1 J.
    ('A03', 3e-9, 1e-7), ('A04', None, 1e-6), ('A05', None, 1e-6)])
def test_solutions_agree_with_what_is_known(name, position_error, energy_error):
    solution = solve(NAMED[name], 1e-6, repeats=1)
    assert solution.energy_error < energy_error
    assert np.isnan(solution.position_error) if position_error is None else (
        solution.position_error < position_error)
    assert solution.table.shape[1] == len(solution.header) and np.isfinite(solution.table).all()


def test_a_finer_accuracy_comes_nearer():
    coarse, fine = (solve(NAMED['A02'], accuracy, repeats=1) for accuracy in (1e-4, 1e-8))
    assert fine.position_error < 1e-2 * coarse.position_error


def test_four_bars_are_the_pendulum_of_their_closed_form():
    """The closed form obeys its own differential equation, from an integration of it."""
    times = np.linspace(0.0, 3.0, 31)
    square = 9.81 * (1.5 + 2.0) / (1.0 + 2.0)
    motion = solve_ivp(lambda _, y: (y[1], -square * np.cos(y[0])), (0.0, 3.0), (np.pi / 2, -1.0),
                       rtol=1e-12, atol=1e-12, t_eval=times)
    assert np.abs(four_bars_angle(times)['pin_0'] - motion.y[0]).max() < 1e-9


def test_the_governor_moves_as_lagranges_equations_of_three_coordinates_say():
    """Turn of the shaft, height of the slider and, by symmetry, one angle of both rods."""
    rod, slider, ball, thick, offset = 0.3, 3.0, 5.0, 0.01, 0.05
    swinging = rod * (1.0 / 3.0 + thick ** 2 / 12.0) + ball
    first = rod / 2.0 + ball  # First moment of a rod about its pin [kg m]
    shaft = rod * thick ** 2 / 6.0 + slider * 0.1 ** 2 / 6.0

    def about_the_axis(angle):
        """Return the moment of inertia of all about the axis, and its derivative."""
        cosine, sine = np.cos(angle), np.sin(angle)
        along, across = rod / 3.0 + ball, rod * thick ** 2 / 12.0
        both = 2.0 * ((rod + ball) * offset ** 2 + 2.0 * offset * first * cosine
                      + (along + across) * cosine ** 2 + 2.0 * across * sine ** 2)
        slope = 2.0 * (-2.0 * offset * first * sine
                       - 2.0 * (along - across) * sine * cosine)
        return shaft + both, slope

    momentum = about_the_axis(np.pi / 6.0)[0] * 2.0 * np.pi

    def rates(_, state):
        height, angle, rise, swing = state
        inertia, slope = about_the_axis(angle)
        # From the side of the slider to the middle of the rod.
        across, up = 0.5 * np.cos(angle), 1.0 - 0.5 * np.sin(angle) - height
        length = np.hypot(across, up)
        by_angle = (-0.5 * across * np.sin(angle) - 0.5 * up * np.cos(angle)) / length
        by_height = -up / length
        pull = 8e5 * (length - 0.5) + 4e4 * (by_angle * swing + by_height * rise)
        return (rise, swing, -9.81 - 2.0 * pull * by_height / slider,
                (0.5 * slope * (momentum / inertia) ** 2 + 2.0 * 9.81 * first * np.cos(angle)
                 - 2.0 * pull * by_angle) / (2.0 * swinging))

    solution = solve(NAMED['A05'], 1e-8, repeats=1)
    motion = solve_ivp(rates, (0.0, 10.0), (0.5, np.pi / 6.0, 0.0, 0.0), method='Radau',
                       rtol=1e-8, atol=1e-10, t_eval=solution.table[:, 0])
    assert np.abs(solution.table[:, 1] - motion.y[0]).max() < 1e-6


def test_the_command_writes_results_and_refuses_unknown_problems(tmp_path, capsys):
    assert main(['benchmark', 'A03', '--accuracy', '1e-5', '--accuracy', '1e-7',
                 '--repeats', '1', '--output', str(tmp_path)]) == 0
    assert capsys.readouterr().out.count('andrews') == 2
    with open(tmp_path / 'benchmark.csv', encoding='utf-8') as file:
        rows = list(csv.DictReader(file))
    assert [float(row['accuracy']) for row in rows] == [1e-5, 1e-7]
    table = np.loadtxt(tmp_path / 'A03_results.txt')
    assert table.shape == (51, 3) and table[-1, 0] == pytest.approx(0.05)
    # F is at the end of the crank of 7 mm.
    assert np.hypot(*table[:, 1:].T) == pytest.approx(0.007, abs=1e-12)
    assert main(['benchmark', 'A06']) == 2
    assert "expected problems of A01, A02, A03, A04, A05, got 'A06'" in capsys.readouterr().err
