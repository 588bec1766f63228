# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Motions known to nearly all digits, from equations with one coordinate each.

Benchmarks of the Library of Computational Benchmark Problems (lim.ii.udc.es):
A02, N four-bar loops; A01, simple pendulum; and the slider-crank with spring of
SUNDIALS' idasSlCrank_dns.c, whose published figures hold five digits only.
"""

import numpy as np
from scipy.integrate import solve_ivp
from scipy.special import ellipj, ellipk

GRAVITY = 9.81
# Tolerances near the rounding of DOP853.
TIGHT = {'method': 'DOP853', 'rtol': 1e-13, 'atol': 1e-13}

# A02: {(N, time [s]): (x, y, xd, yd) of B0}, the tip of the first leg.
FOUR_BAR_REFERENCE = {
    (1, 10.0): (0.4783850578, 0.8781501788, 1.727264076, -0.940952179),
    (2, 10.0): (0.3284581115, 0.9445185382, 1.423051470, -0.494868845),
    (2, 20.0): (0.8397465743, 0.5429785364, 1.838222644, -2.842913789),
    (40, 20.0): (0.4109011537, 0.9116799010, 1.566785372, -0.706162236)}

# A01: {(x at rest, time [s]): (x, y)}.
PENDULUM_REFERENCE = {
    (-1.0, 9.99): (-0.316436469913, -0.948613704576),
    (-1.0, 10.0): (-0.275087462576, -0.961419205099),
    (1.0, 2000.0): (-0.8146030686, -0.5800188278)}
PENDULUM_PERIOD = 2.367841947576

# Slider-crank at 10 s.
SLIDER_CRANK_REFERENCE = {
    'crank': 1.275675848650, 'slider': 1.023578558980, 'rod': -0.498813049182,
    'crank_rate': -0.239914997196, 'slider_rate': 0.133778283216, 'rod_rate': 0.039731495991,
    'energy_integral': 3.336606799483}


def four_bar_ladder(loops, times):
    """
    Return B0 of benchmark A02 on its parallel branch, where all legs stay parallel.

    Parameters
    ----------
    loops : int
        N; 2 N + 1 uniform links, 1 m, 1 kg.
    times : array_like
        Increasing, [s]; at 0 the legs are upright and B0 moves at 1 m/s in x.

    Returns
    -------
    ndarray, shape (len(times), 4)
        x, y, xd, yd.

    """
    inertia = (loops + 1) / 3.0 + loops
    weight = GRAVITY * ((loops + 1) / 2.0 + loops)
    times = np.asarray(times, dtype=float)
    solution = solve_ivp(lambda t, state: (state[1], weight / inertia * np.sin(state[0])),
                         (0.0, times[-1]), (0.0, 1.0), t_eval=times, **TIGHT)
    angle, rate = solution.y
    return np.stack([np.sin(angle), np.cos(angle), rate * np.cos(angle), -rate * np.sin(angle)],
                    axis=1)


def pendulum(start, times):
    """
    Return the place of benchmark A01's pendulum, let go horizontally.

    Parameters
    ----------
    start : float
        +1 or -1, x of the point mass at rest [m].
    times : array_like
        [s].

    Returns
    -------
    ndarray, shape (len(times), 2)

    Notes
    -----
    sin(angle / 2) = k sn(K - omega t, k) with k = sin(amplitude / 2), amplitude
    pi / 2 from the lowest place.

    """
    modulus = 0.5
    phase = ellipk(modulus) - np.sqrt(GRAVITY) * np.asarray(times, dtype=float)
    sine = np.sqrt(modulus) * ellipj(phase, modulus)[0]
    angle = start * 2.0 * np.arcsin(sine)
    return np.stack([np.sin(angle), -np.cos(angle)], axis=1)


def pendulum_period():
    """Return the period of benchmark A01's pendulum [s]."""
    return 4.0 * ellipk(0.5) / np.sqrt(GRAVITY)


def slider_crank_geometry(crank):
    """Return (slider, rod, their derivatives by the crank angle, and second derivatives)."""
    rod = -np.arcsin(0.5 * np.sin(crank))
    rod_1 = -0.5 * np.cos(crank) / np.cos(rod)
    rod_2 = (0.5 * np.sin(crank) + np.sin(rod) * rod_1 ** 2) / np.cos(rod)
    slider = 0.5 * np.cos(crank) + np.cos(rod)
    slider_1 = -0.5 * np.sin(crank) - np.sin(rod) * rod_1
    slider_2 = -0.5 * np.cos(crank) - np.cos(rod) * rod_1 ** 2 - np.sin(rod) * rod_2
    return slider, rod, slider_1, rod_1, slider_2, rod_2


def slider_crank_rates(time, state):
    """Return the rates of (crank, crank_rate, integral of the kinetic energy)."""
    crank, rate, _ = state
    slider, rod, slider_1, rod_1, slider_2, rod_2 = slider_crank_geometry(crank)
    # Crank: 1 kg m^2 about its pivot; rod: 1 kg at the slider's pin, 2 kg m^2.
    inertia = 1.0 + slider_1 ** 2 + 2.0 * rod_1 ** 2
    inertia_1 = 2.0 * slider_1 * slider_2 + 4.0 * rod_1 * rod_2
    # Spring and damper between the middle of the crank and the middle of the rod.
    span = np.array([slider - 0.5 * np.cos(rod) - 0.25 * np.cos(crank),
                     -0.5 * np.sin(rod) - 0.25 * np.sin(crank)])
    span_1 = np.array([slider_1 + 0.5 * np.sin(rod) * rod_1 + 0.25 * np.sin(crank),
                       -0.5 * np.cos(rod) * rod_1 - 0.25 * np.cos(crank)])
    length = np.hypot(*span)
    length_1 = span @ span_1 / length
    tension = (length - 1.0) + length_1 * rate
    # 1 N along x on the rod, 1 m beyond the slider's pin.
    work = slider_1 - np.sin(rod) * rod_1 - tension * length_1
    return rate, (work - 0.5 * inertia_1 * rate ** 2) / inertia, 0.5 * inertia * rate ** 2


def slider_crank(times):
    """
    Return the motion of the slider-crank from the upright crank at rest.

    Parameters
    ----------
    times : array_like
        Increasing, [s].

    Returns
    -------
    dict
        Arrays by the names of SLIDER_CRANK_REFERENCE.

    """
    times = np.asarray(times, dtype=float)
    solution = solve_ivp(slider_crank_rates, (0.0, times[-1]), (np.pi / 2.0, 0.0, 0.0),
                         t_eval=times, **TIGHT)
    crank, rate, integral = solution.y
    slider, rod, slider_1, rod_1, _, _ = slider_crank_geometry(crank)
    return {'crank': crank, 'slider': slider, 'rod': rod, 'crank_rate': rate,
            'slider_rate': slider_1 * rate, 'rod_rate': rod_1 * rate,
            'energy_integral': integral}
