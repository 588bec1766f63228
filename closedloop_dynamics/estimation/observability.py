# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What sensors will show of a motion and of unknown numbers, before anything is measured.

Along a motion, changes e of the state and of the numbers at its start change the readings by
H_k Phi_k e, with Phi the product of the Jacobians of the steps. In units of the noise, columns of
all these rows that depend on one another determine which sums the readings show: by a QR
factorisation with pivoting, as ``studies.identification`` names sums of parameters.
"""

from typing import Dict, List, Sequence

import numpy as np
from scipy.linalg import qr, solve_triangular

from .filtering import Filter, Now
from .results import Observability
from ..studies.identification import Combination

# Columns, scaled to length one, are dependent below DEPENDENT; shares of others below NOTHING are
# rounding; what changes all readings by less than UNSEEN of their noise, where it is changed by a
# deviation of the start, has no influence.
DEPENDENT, NOTHING, UNSEEN = 1e-8, 1e-6, 1e-6


def observability(filtering: Filter, now: Now, names: Sequence[str], torques: np.ndarray,
                  duration: float, period: float) -> Observability:
    """
    Return what the sensors show along a motion from a belief on.

    Parameters
    ----------
    filtering : Filter
        Of the plant and its sensors.
    now : Now
        Where the motion begins.
    names : sequence of str
        Of the states, then of the numbers that are estimated.
    torques : ndarray, shape (rows, number of commanded joints)
        Each acts for an equal share of the duration [N m or N].
    duration, period : float
        Of the motion, and between readings of all sensors [s].

    """
    sensors = filtering.measuring.sensors
    typical = np.sqrt(now.covariance.diagonal())
    factor, transition = np.zeros((0, len(names))), np.eye(len(names))
    count = max(1, round(duration / period))
    begin = now.time
    for k in range(count + 1):
        now = now._replace(command=torques[min(k * len(torques) // count, len(torques) - 1)])
        filtering.plant.take(now.independent)
        slope, noise = filtering.slopes(now, list(sensors))
        rows = slope @ transition / np.sqrt(noise)[:, np.newaxis]
        factor = np.linalg.qr(np.vstack((factor, rows)), mode='r')
        if k < count:
            for step in filtering.steps(now, begin + (k + 1) * duration / count):
                transition = step.transition @ transition
                now = step.now
    return _observability(factor, typical, names)


def _observability(factor: np.ndarray, typical: np.ndarray, names: Sequence[str]) -> Observability:
    """Return what rows in units of their noise show, of which that is the triangular factor."""
    lengths = np.linalg.norm(factor, axis=0)
    seen = lengths * typical > UNSEEN
    places = np.flatnonzero(seen)
    unseen = tuple(names[place] for place in np.flatnonzero(~seen))
    deviations = dict.fromkeys(names, np.inf)
    combinations: List[Combination] = []
    if len(places):
        _, upper, order = qr(factor[:, places] / lengths[places], mode='economic', pivoting=True)
        diagonal = np.abs(np.diag(upper))
        rank = int(np.sum(diagonal > DEPENDENT * diagonal[0]))
        base, rest = places[order[:rank]], places[order[rank:]]
        shares = solve_triangular(upper[:rank, :rank], upper[:rank, rank:])
        shares[np.abs(shares) < NOTHING] = 0.0
        factors = shares * lengths[rest] / lengths[base][:, np.newaxis]
        inverse = solve_triangular(upper[:rank, :rank], np.eye(rank)) / (
            lengths[base][:, np.newaxis])
        own = dict(zip(base.tolist(), np.sqrt(np.sum(inverse ** 2, axis=1)).tolist()))
        for place, row in sorted(zip(base.tolist(), factors), key=lambda pair: pair[0]):
            terms: Dict[str, float] = {names[place]: 1.0, **{
                names[other]: float(one) for other, one in zip(rest.tolist(), row) if one}}
            if len(terms) == 1:
                deviations[names[place]] = own[place]
            else:
                combinations.append(Combination(terms, None))
    return Observability(deviations, tuple(combinations), unseen)
