# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Changes of coordinates that keep the loops closed, by those of independent ones.

Of the closure equations C(q, p) = 0 and J qd = 0 with parameters p, the dependent coordinates r
follow the independent ones: J_r dr = -(J_own d own + C_p dp), and their rates likewise.
"""

import numpy as np

# Singular values of the closure equations below this share of the largest are rounding.
RANK_TOLERANCE = 1e-8


def places_of(names, independent):
    """
    Return the places of the requested independent coordinates; None where none are.

    Raises
    ------
    ValueError
        For unknown names.

    """
    for name in independent or ():
        if name not in names:
            raise ValueError(f'independent: expected names of {", ".join(names)}, got {name!r}')
    return None if independent is None else [names.index(name) for name in independent]


def choose_independent(jac, first):
    """
    Choose coordinates by which the others are best decided.

    Parameters
    ----------
    jac : ndarray, shape (nc, nv)
        Jacobian of the closure equations, of full rank.
    first : list of int
        To be taken before others: the actuated ones.

    Returns
    -------
    list of int
        As many as there are degrees of freedom, in rising order.

    """
    # Of the null space, the row that is longest beside those that are chosen.
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
    Return the other coordinates.

    Parameters
    ----------
    jac : ndarray, shape (nc, nv)
        Jacobian of the closure equations.
    own : list of int
        The independent ones.
    names : sequence of str
        Of all coordinates, for messages.

    Returns
    -------
    ndarray of int, shape (nc,)

    Raises
    ------
    ValueError
        Where those do not decide all others.

    """
    nc, nv = jac.shape
    if len(own) != nv - nc:
        raise ValueError(
            f'independent: expected {nv - nc} names, as many as there are degrees of freedom, '
            f'got {len(own)}')
    rest = np.setdiff1d(np.arange(nv), own)
    if nc:
        values = np.linalg.svd(jac[:, rest], compute_uv=False)
        if values[-1] <= RANK_TOLERANCE * values[0]:
            raise ValueError(
                'independent: expected coordinates that decide all others, got '
                f'{", ".join(names[place] for place in own)}')
    return rest


def changes_along(jac, own, rest, rate_by_position):
    """
    Return the changes of all coordinates and rates with the independent ones.

    Parameters
    ----------
    jac, rate_by_position : ndarray, shape (nc, nv)
        J, and the derivatives of J qd by the coordinates.
    own : sequence of int
        The independent coordinates.
    rest : ndarray of int, shape (nc,)
        The others.

    Returns
    -------
    along, bent : ndarray, shape (nv, n)
        Changes of all coordinates, and of all rates with the independent ones held, for a unit
        change of each independent coordinate.

    """
    along = following(jac, rest, jac[:, own])
    along[own] = np.eye(len(own))
    return along, following(jac, rest, rate_by_position @ along)


def following(jac, rest, right):
    """
    Return the changes of dependent coordinates with closure equations, the others held.

    Parameters
    ----------
    jac : ndarray, shape (nc, nv)
        Jacobian of the closure equations.
    rest : ndarray of int, shape (nc,)
        The dependent coordinates.
    right : ndarray, shape (nc, n)
        Changes of the equations.

    Returns
    -------
    ndarray, shape (nv, n)

    """
    found = np.zeros((jac.shape[1], right.shape[1]))
    if len(rest):
        found[rest] = -np.linalg.solve(jac[:, rest], right)
    return found
