# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A simulation under torque commands that publishes its states."""

import time

from closedloop_dynamics.mechanism.errors import NumericalError
from closedloop_dynamics.ros.external_wrench import ExternalWrench
import numpy as np

# A state that does not change is published so often in simulated time [s of the steady clock].
REPEAT_PERIOD = 1.0


class LiveSimulation:
    """
    The simulation that a mode advances under a ``TorqueCommand``, and its publishing.

    ``stamps`` are the time that messages carry, ``states`` publishes them; a command grows old by
    the simulated time of ``pacer``, where it is not None, which is reported to ``logger``.
    ``torque``, by ``torque_names``: command, and what external wrenches (``wrench``) are in
    joints, in the latest steps [N m or N].

    Functions in ``on_published`` are called with the stamp, a Time message, after a state was
    published, those in ``on_advance`` with ``torque`` before steps are made under it, those in
    ``on_jump`` when the next state does not follow from the last by simulating.
    """

    def __init__(self, simulation, command, stamps, states, pacer, logger):
        self.simulation, self.command, self.stamps, self.states = (
            simulation, command, stamps, states)
        self._pacer, self._logger = pacer, logger
        self._others = bool(simulation.data.equation_forces())
        self.torque, self.wrench = simulation.joint_torques(None), ExternalWrench(simulation)
        self.on_published, self.on_advance, self.on_jump = [], [], []
        self._published_at = self._published_stamp = None

    def expire(self):
        """Set the torques to zero if no command came for too long, and log it."""
        if self.command.expire(time.monotonic()):
            self._logger.warning(f'no command for {self.command.timeout:g} s: all torques are '
                                 'zero until the next one')

    def advance(self, steps):
        """Make steps under the torques in force."""
        if self._pacer is not None:
            # A tick that makes up for others must not hold a command longer than they had.
            self.expire()
            self.command.held += (
                steps * self.simulation.step_size / self._pacer.real_time_factor)
        # Before the notes, which report the accuracy of the steps that follow.
        self.simulation.stepping.keep_budget()
        self.torque[:] = 0.0
        self.torque[self.simulation.data.actuated] = self.command.torque
        self.wrench.act(self.torque)
        for note in self.on_advance:
            note(self.torque)
        self.simulation.advance(self.torque, steps)

    def publish(self, late=0.0):
        """
        Publish the present state and constraint forces.

        It was due ``late`` s ago, of the steady clock. Raises NumericalError instead of publishing
        a state that the energy guard refuses, or forces that are not finite.
        """
        self.simulation.stepping.energy_guard.pass_on()
        simulation, stamp = self.simulation, self.stamps.earlier(late, self._published_stamp)
        forces = simulation.constraint_forces
        others = [np.array(list(each.values()))
                  for each in (simulation.data.equation_forces() if self._others else {}).values()]
        if not all(np.isfinite(each).all() for each in (forces, *others)):
            raise NumericalError('the constraint forces are not finite numbers')
        cuts = (*simulation.data.measured_cut_joints(), simulation.cut_effort) if (
            simulation.cut_joint_names) else ()
        self.states.publish(stamp, *simulation.measured(),
                            self.wrench.without(simulation.effort), forces, cuts, *others)
        self._published_at, self._published_stamp = time.monotonic(), stamp
        for publish in self.on_published:
            publish(self.states.stamp)
        # Last: a reader that begins a period by the clock finds the state there.
        self.stamps.publish()

    def refresh(self, late=0.0):
        """Publish the state if it has a new stamp, or again, for latecomers, after a while."""
        if (not self.stamps.simulated or self.stamps.now() != self._published_stamp
                or self.is_stale):
            self.publish(late)

    @property
    def is_stale(self):
        """Return whether the latest state was published so long ago that it is repeated."""
        return self._published_at is None or (
            time.monotonic() - self._published_at >= REPEAT_PERIOD)

    def is_received(self):
        """Return whether reliable subscribers have received all states."""
        return self.states.is_received()

    def jump(self):
        """Publish a state that does not follow from the last by simulating."""
        for note in self.on_jump:
            note()
        self.publish()
