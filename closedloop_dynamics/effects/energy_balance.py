# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Stored, dissipated and supplied energy of a simulation."""

from dataclasses import dataclass
import math
from typing import NamedTuple

import numpy as np

# Columns of ``EnergyAccount.numbers``, all [J]; a test compares them with the engine's.
HELD_WORK, REFERENCE, START_KINETIC, START_STORED, COLUMNS = range(5)


class EnergyAccount(NamedTuple):
    """The engine's data for the energy balance of a run."""

    roles: np.ndarray  # Shape (nz,): roles of the effects' states, as of ``table``
    since: np.ndarray  # Shape (nv + nk,): coordinates when work was added last
    numbers: np.ndarray  # Shape (COLUMNS,)


@dataclass(frozen=True)
class Energies:
    """
    The energy balance since the start or the last reset.

    Attributes
    ----------
    kinetic : float
        Of bodies and rotors [J].
    stored : float
        In gravity, springs, stops and contacts [J].
    dissipated : float
        By effects, so far [J].
    work : float
        Of torques, drives and external forces, so far [J].
    residual : float
        kinetic + stored + dissipated - work less the energy at the start: the error of the
        integration [J].

    """

    kinetic: float
    stored: float
    dissipated: float
    work: float
    residual: float


class EnergyBalance:
    """
    Account of the energy of a simulation; the engine draws the balance.

    Parameters
    ----------
    roles : ndarray of int, shape (nz,)
        Roles of the effects' states.
    freedoms : int
        Of the joints, and of cut joints that anything acts in.

    Attributes
    ----------
    account : EnergyAccount

    """

    def __init__(self, roles, freedoms):
        self.account = EnergyAccount(
            roles.astype(np.int64), np.zeros(freedoms), np.zeros(COLUMNS))

    def restart(self, q):
        """Begin at a state, coordinates by freedom; its energy is evaluated when first needed."""
        _, since, numbers = self.account
        since[:], numbers[:] = q, 0.0
        numbers[REFERENCE] = math.nan

    def start(self, kinetic, stored):
        """Set the energy at the start [J]."""
        self.account.numbers[REFERENCE:] = kinetic + stored, kinetic, stored

    @property
    def at_start(self):
        """Return the balance at the start, None before it is evaluated."""
        _, reference, kinetic, stored = self.account.numbers.tolist()
        return None if math.isnan(reference) else Energies(kinetic, stored, 0.0, 0.0, 0.0)

    def jump(self, q, energy):
        """
        Exclude the energy of a change from outside from the balance.

        ``q``: coordinate of each freedom after it; ``energy``: kinetic and stored energy after it
        less before [J].
        """
        self.account.since[:] = q
        self.account.numbers[REFERENCE] += energy
