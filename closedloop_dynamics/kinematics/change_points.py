# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Change points that a mechanism nearly has: branches that pass each other closely, and do not meet.

At a change point two branches of positions cross, and a motion goes straight on. Where lengths
differ a little from those with which it is one, the loops do not close there: each branch turns
off before, within a distance of about the root of the difference, into the direction of the
other. Nearer than the places from which an evaluation there is interpolated that cannot be
followed, and which branch a run is on behind it is not determined.
"""

import numpy as np

from .assembly import Assembler

# Singular values below this share of the largest vanish at the change point nearby, which is
# looked for within so far [rad, and shares of the size], in so many corrections up to so little.
VANISHING, NEAR, MOST_CORRECTIONS, FOUND = 0.1, 0.3, 12, 1e-9
# Distance for differences; derivatives of vanishing equations below this share are zero.
DIFFERENCE, NO_BEND = 1e-4, 1e-6
# Branches that are farther apart, in sizes, are followed: they turn within the root of it, 5e-4
# rad, and evaluations are interpolated from places 0.015 rad away.
UNDECIDED = 3e-7
# Error of the loops there, of the size, that is rounding: of some ten operations on lengths.
ROUNDING = 2e-14


def branches_apart(mechanism, equations, position):
    """
    Return by how much lengths miss a change point near a position, in sizes of the mechanism.

    Parameters
    ----------
    mechanism : Mechanism
        With its closure equations.
    equations : codegen.equations.Equations
        Of the mechanism.
    position : ndarray, shape (nq,)
        Next to the change point, nearly closing the loops.

    Returns
    -------
    float
        0.0 where they do not miss it by more than rounding; NaN where none is found.

    """
    assembler, coordinates = Assembler(mechanism, equations), mechanism.coordinates
    unit = np.where(coordinates.lengths, assembler.extent, 1.0)
    vanishing = None
    q = np.array(position)
    for _ in range(MOST_CORRECTIONS):
        jac = assembler.jacobian(q) * unit
        left, singular, right = np.linalg.svd(jac)
        if vanishing is None:
            vanishing = len(jac) - int((singular > VANISHING * singular.max(initial=0.0)).sum())
        rank = len(jac) - vanishing
        if not vanishing:
            return np.nan
        psi, null = left.T @ assembler.closure(q), right[rank:].T
        # Regular equations are met, and the gradients of the others vanish along the rest.
        change = -right[:rank].T @ (psi[:rank] / singular[:rank])
        slopes = left[:, rank:].T @ jac @ null
        bends = np.stack([left[:, rank:].T @ (
            assembler.jacobian(coordinates.moved(q, step))
            - assembler.jacobian(coordinates.moved(q, -step))) * unit @ null
            for step in DIFFERENCE * unit * null.T], axis=-1) / (2.0 * DIFFERENCE)
        change += null @ np.linalg.lstsq(
            bends.reshape(-1, null.shape[1]), -slopes.ravel(), rcond=NO_BEND)[0]
        q = coordinates.moved(q, unit * change)
        if not np.abs(coordinates.apart(q, position) / unit).max() < NEAR:
            return np.nan
        if np.abs(change).max() < FOUND:
            apart = float(np.abs(left[:, rank:].T @ assembler.closure(q)).max())
            return 0.0 if apart <= ROUNDING * assembler.extent else apart / assembler.extent
    return np.nan


def finding(mechanism, equations, passage):
    """
    Yield what to say of a run that came next to a singular position.

    ``passage`` is as ``simulation.system.System`` has it.
    """
    if not passage[0] > 0.0:
        return
    apart = branches_apart(mechanism, equations, passage[1:])
    if 0.0 < apart < UNDECIDED:
        size = Assembler(mechanism, equations).extent
        yield (
            f'it is undecided on which branch {mechanism.name} is: it came to a change point (a '
            f'singular position) that its lengths miss by {apart * size:.2g} m only, so that two '
            'branches turn away from one another within about '
            f'{np.sqrt(apart):.1g} rad, nearer than a run can follow them. Make the lengths agree '
            f'to all digits, or differ by more than {UNDECIDED * size:.1g} m, or keep away from '
            'there by stops.')
