# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Stored, dissipated and supplied energy of a simulation."""

from dataclasses import dataclass


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
