# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Where the energy of a simulation is, where it went, and where it came from."""

from dataclasses import dataclass

import numpy as np

from ..engine import native


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
    Keeps account of the energy of a simulation.

    ``at_start``: Energies, or None where nobody has wanted to know yet.

    The work of a torque that is held and passes unchanged is tau . (q - q at the hold's start),
    exactly; nothing is computed for it in between. Drives and other effects integrate theirs, and
    so do torques on rotations in three dimensions, of which no coordinate tells the work.

    """

    def __init__(self, effects):
        """Start with nothing."""
        self._effects = effects
        self._since, self._work, self._reference, self.at_start = np.zeros(0), 0.0, None, None

    def restart(self, q):
        """
        Begin at a state; its energy may follow when somebody wants to know.

        Parameters
        ----------
        q : ndarray, shape (nv,)
            Coordinate of each freedom.

        """
        self._since, self._work, self._reference, self.at_start = q.copy(), 0.0, None, None

    def start(self, kinetic, stored):
        """Take the energy at the start [J]."""
        self._reference = kinetic + stored
        self.at_start = Energies(kinetic, stored, 0.0, 0.0, 0.0)

    def add_work(self, q, tau):
        """
        Add the work of the torques held up to here.

        Parameters
        ----------
        q : ndarray, shape (nv,)
            Coordinate of each freedom now.
        tau : ndarray, shape (nv,)
            The torques held so far.

        """
        self._work += native.work_of_hold(tau, self._effects.driven, self._since, q)

    def jump(self, q, energy):
        """
        Leave the energy of a change from outside out of the balance.

        Parameters
        ----------
        q : ndarray, shape (nv,)
            Coordinate of each freedom after it.
        energy : float
            Kinetic and stored energy after it less before [J].

        """
        self._since = q.copy()
        self._reference += energy

    def balance(self, states, kinetic, stored, turned=0.0):
        """
        Draw the balance, the work of all held torques being added.

        Parameters
        ----------
        states : ndarray, shape (nz,)
            The effects' own.
        kinetic, stored : float
            [J].
        turned : float
            Work of torques on rotations in three dimensions, which is integrated [J].

        """
        dissipated = self._effects.dissipated(states)
        work = self._work + self._effects.work(states) + turned
        return Energies(kinetic, stored, dissipated, work,
                        kinetic + stored + dissipated - work - self._reference)
