# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The articulated-body algorithm with embedded constraints (C-ABA) by CasADi, beside us.

M. Chignoli, N. Adrian, S. Kim and P. Wensing, Recursive Rigid-Body Dynamics Algorithms for Systems
with Kinematic Loops, arXiv 2311.13732 (2023); embedding: A. Jain. Bodies whose joints are in loops
with one another form a cluster, which moves by its independent rates alone. Articulated inertias
pass from cluster to cluster to the root, accelerations back. From the links of peer_generated.py,
compiled as its code is. Independent rates are chosen once, at the start.
"""

import casadi as ca
import peer_generated
from peer_generated import eliminated, hat, substituted, symmetric, thin, times


class Clusters(peer_generated.System):
    """The same equations, solved cluster by cluster."""

    def accelerated(self, tau, rows, biases):
        """Return the accelerations of all rates."""
        moves, constant = embedded(rows, biases, self.pivots)
        accelerations, ground = ca.SX(tau.numel(), 1), ca.SX(6, 1)
        inward = [(links, *self._inward(links, tau, moves, constant))
                  for links in reversed(self.clusters())]
        for links, rates, by, fixed, inverse, below, right in reversed(inward):
            carrier = links[0].parent
            pulled = ground if carrier is None else ca.vertcat(*carrier.extra)
            independent = ca.vertcat(*substituted(
                inverse, below, [row[0] - times(row[1:], pulled) for row in right]))
            accelerations[rates] = thin(times(by, independent) + fixed)
            for link in links:
                _accelerate(link, accelerations)
        return accelerations

    def _inward(self, links, tau, moves, constant):
        """
        Eliminate the independent rates of a cluster; its carrier gets what is left.

        Returns its rates, their accelerations by the independent ones and where these are 0, and
        the eliminated equations, whose right sides are what drives the independent rates and, with
        the other sign, their momenta by the acceleration of the carrier.
        """
        for link in links:
            _as_one(link)
        matrix, driven, momenta = self.composed(links, tau)
        rates = [rate for link in links for rate in link.rates]
        by, fixed, matrix, momenta = (
            moves[rates, :], constant[rates], matrix[rates, rates], momenta[:, rates])
        by = by[:, [k for k in range(by.shape[1]) if by[:, k].nnz()]]
        inverse, below, right = eliminated(symmetric(times(by.T, matrix, by)), ca.horzcat(
            times(by.T, thin(driven[rates] - times(matrix, fixed))), times(momenta, by).T))
        carrier = links[0].parent
        if carrier is not None:
            force = times(momenta, fixed)
            for one, row in zip(inverse, right):
                own = row[1:].T * one
                force = force + own * row[0]
                carrier.carried = symmetric(carrier.carried - times(own, row[1:]))
            carrier.torque = thin(carrier.torque + force[:3])
            carrier.force = thin(carrier.force + force[3:])
        return rates, by, fixed, inverse, below, right


def embedded(rows, biases, pivots):
    """
    Solve the equations of loops for the dependent rates.

    Returns accelerations of all by the independent ones, shape (nv, nv), and where these are 0.
    """
    left = {row: {k: rows[row, k] for k in range(rows.shape[1]) if rows[row, k].nnz()}
            for row, _ in pivots}
    right = {row: biases[row] for row, _ in pivots}
    for number, (row, column) in enumerate(pivots):
        inverse = 1.0 / left[row].pop(column)
        left[row] = {k: value * inverse for k, value in left[row].items()}
        right[row] *= inverse
        for other, _ in pivots[number + 1:]:
            factor = left[other].pop(column, None)
            if factor is not None:
                right[other] -= factor * right[row]
                for k, value in left[row].items():
                    left[other][k] = left[other].get(k, 0.0) - factor * value
    moves, constant = ca.SX.eye(rows.shape[1]), ca.SX(rows.shape[1], 1)
    for row, column in pivots:
        moves[column, column] = 0.0
    moves = thin(moves)
    for row, column in reversed(pivots):
        constant[column] = -right[row]
        for k, value in left[row].items():
            moves[column, :] -= value * moves[k, :]
            constant[column] -= value * constant[k]
    return thin(moves), thin(constant)


def _as_one(link):
    """Add a link's own inertia to what it carries, where that is no rigid body."""
    if link.carried.nnz():
        moment = hat(link.moment)
        link.carried = symmetric(link.carried + ca.blockcat(
            [[link.inertia, moment], [-moment, link.mass * ca.SX.eye(3)]]))
        link.mass, link.moment, link.inertia = ca.SX(1, 1), ca.SX(3, 1), ca.SX(3, 3)


def _accelerate(link, accelerations):
    """Find how much more a link is accelerated than at ``qdd`` = 0."""
    own = accelerations[link.rates]
    turning, pulled = times(link.about, own), times(link.along, own)
    if link.parent is not None:
        before, origin = link.parent.extra
        turning = thin(turning + times(link.turn.T, before))
        pulled = thin(pulled + times(link.turn.T, thin(
            origin + times(hat(before), link.position))))
    link.extra = turning, pulled


class Engine(peer_generated.Engine):
    """Generated code of one machine; see ``peer_generated.Engine``."""

    name, system = 'C-ABA by CasADi', Clusters
