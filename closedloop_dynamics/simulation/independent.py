# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Changes of coordinates that keep the loops closed, by those of independent ones.

Of the closure equations C(q, p) = 0 and J qd = 0 with parameters p, the dependent coordinates r
follow the independent ones: J_r dr = -(J_own d own + C_p dp), and their rates likewise.
"""

import numpy as np

# Singular values below this share of the largest of all closure equations, which are independent,
# are rounding.
RANK_TOLERANCE = 1e-8


def places_of(names, independent):
    """
    Return the places of the requested independent coordinates; None where none are.

    ValueError for unknown names.
    """
    for name in independent or ():
        if name not in names:
            raise ValueError(f'independent: expected names of {", ".join(names)}, got {name!r}')
        if list(independent).count(name) > 1:
            raise ValueError(f'independent: expected each name once, got {name!r} twice')
    return None if independent is None else [names.index(name) for name in independent]


def choose_independent(jac, first):
    """
    Choose coordinates by which the others are best determined, places in rising order.

    ``jac``, shape (nc, nv), has full rank; ``first`` are taken before others: the actuated ones.
    """
    # The row of the null space that is longest beside those that are chosen.
    _, _, rows = np.linalg.svd(jac)
    left = rows[len(jac):].T.copy()
    before = np.isin(np.arange(len(left)), first)
    own = []
    for _ in range(left.shape[1]):
        lengths = np.linalg.norm(left, axis=1)
        lengths[own] = 0.0
        # An actuated joint that moves with the rest at all is taken before any other.
        some = before & (lengths > 0.1 * lengths.max())
        place = int(np.argmax(np.where(some, lengths, 0.0) if some.any() else lengths))
        own.append(place)
        unit = left[place] / np.linalg.norm(left[place])
        left -= np.outer(left @ unit, unit)
    return sorted(own)


def dependent_on(jac, own, names):
    """
    Return the places of the other coordinates, shape (nc,), than the independent ones.

    ``names`` of all coordinates are for the message of the ValueError, where those do not
    determine all others.
    """
    nc, nv = jac.shape
    if len(own) != nv - nc:
        raise ValueError(
            f'independent: expected {nv - nc} names, as many as there are degrees of freedom, '
            f'got {len(own)}')
    rest = np.setdiff1d(np.arange(nv), own)
    if nc:
        values = np.linalg.svd(jac[:, rest], compute_uv=False)
        if values[-1] <= RANK_TOLERANCE * np.linalg.norm(jac, 2):
            raise ValueError(
                'independent: expected coordinates that determine all others, got '
                f'{", ".join(names[place] for place in own)}')
    return rest


def changes_along(jac, own, rest, rate_by_position):
    """
    Return the changes of all coordinates and rates with the independent ones, shape (nv, n).

    ``jac`` and ``rate_by_position``, shape (nc, nv): J, and the derivatives of J qd by the
    coordinates; ``own``, ``rest``: the independent coordinates, and the others. Changes are for a
    unit change of each independent coordinate, of the rates with the independent ones held.
    """
    along = following(jac, rest, jac[:, own])
    along[own] = np.eye(len(own))
    return along, following(jac, rest, rate_by_position @ along)


def following(jac, rest, right):
    """
    Return the changes of dependent coordinates with closure equations, the others held, (nv, n).

    ``rest`` are the dependent ones, ``right``, shape (nc, n), changes of the equations.
    """
    found = np.zeros((jac.shape[1], right.shape[1]))
    if len(rest):
        found[rest] = -np.linalg.solve(jac[:, rest], right)
    return found
