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

"""Several runs in lockstep, side by side in the vector units of a core."""

from dataclasses import dataclass

import numpy as np

from .rollout_run import (
    all_torques, ENERGY_ERROR, is_plain, Record, STATE, tape_for, values_of, verdict)
from ..integration import lockstep
from ..integration.advance import DONE
from ..integration.march import annotate

# From so many runs on it pays to make them together.
FEWEST = 3
MOST = lockstep.LANES


@dataclass(frozen=True)
class Start:
    """
    What a run begins with.

    Attributes
    ----------
    simulation : Simulation
        Whose mechanism moves; several runs may share it.
    state : ndarray, shape (ns,)
        Where it begins.
    torques : ndarray, shape (rows, number of actuated joints)
        [N m or N].

    """

    simulation: object
    state: np.ndarray
    torques: np.ndarray


def may_go_together(simulation, schedule):
    """Tell whether runs of a simulation can be made in lockstep at all."""
    return bool(is_plain(simulation) and schedule.steps(simulation.step_size) and lockstep.fits(
        simulation.system, simulation.monitor.driver.stabilisation))


class Together:
    """Makes several runs at a time, and keeps what they do."""

    def __init__(self, schedule, quantities):
        """Begin without a pack."""
        self._schedule, self._quantities = schedule, quantities
        self._systems, self._pack = [], None

    def record(self, starts, room=None):
        """
        Make some runs.

        Parameters
        ----------
        starts : sequence of Start
            Of simulations that may go together, up to MOST of them.
        room : tuple of 2 ndarrays, shape (MOST, instants, nv), optional
            Where positions and velocities go, so that they need not be copied.

        Returns
        -------
        list of Record, or None
            None where they must be made one by one: they differ in their methods, or one of
            them fails or comes to a singular configuration.

        """
        first, schedule = starts[0].simulation, self._schedule
        if len(starts) < FEWEST or any(
                start.simulation.scene.method != first.scene.method for start in starts[1:]):
            return None
        pack = self._pack_of([start.simulation.system for start in starts])
        if pack is None:
            return None
        driver, steps = first.monitor.driver, schedule.steps(first.step_size)
        torques = [all_torques(start.simulation, start.torques) for start in starts]
        spread = np.stack(lockstep.filled(torques), axis=-1).reshape(len(torques[0]), -1)
        state = lockstep.lanes.spread(lockstep.filled([start.state for start in starts]))
        if room is None:
            shape = lockstep.LANES, schedule.instants, torques[0].shape[1]
            room = np.empty(shape), np.empty(shape)
        work = np.zeros(lockstep.LANES)
        status = lockstep.march(
            pack, driver.tableau, driver.stabilisation, state, first.step_size, spread,
            schedule.hold * steps, schedule.every * steps, schedule.intervals * steps,
            np.zeros((len(driver.scratch), len(state))), *room, work)
        if status != DONE:
            return None
        ends = state.reshape(-1, lockstep.LANES).T
        judged = [verdict(start.simulation, np.hstack(motion), end, done, schedule)
                  for start, end, done, *motion in zip(starts, ends, work, *room)]
        if not all(share <= ENERGY_ERROR for share, _ in judged):
            return None
        return [Record(_values(start.simulation, tau, schedule, steps, self._quantities, *motion),
                       finding)
                for start, tau, (_, finding), *motion in zip(starts, torques, judged, *room)]

    def _pack_of(self, systems):
        """Return a pack of systems, the last one where they are still the same."""
        if len(systems) != len(self._systems) or any(
                one is not other for one, other in zip(systems, self._systems)):
            self._systems, self._pack = systems, lockstep.build_pack(systems)
        return self._pack


def _values(simulation, tau, schedule, steps, quantities, position, velocity):
    """Return what is kept of one of the runs."""
    if all(name in STATE for name in quantities):
        both = {'position': position, 'velocity': velocity}
        return {name: both[name] for name in quantities}
    tape = tape_for(simulation, schedule, quantities)
    tape.state[:] = np.hstack((position, velocity))
    annotate(simulation.system, tau, schedule.hold * steps, schedule.every * steps, tape)
    simulation._fresh = False
    return values_of(simulation, tape, tau, schedule, quantities)
