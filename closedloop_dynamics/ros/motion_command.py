# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Profiles of prescribed motions from outside, checked on arrival."""

from closedloop_dynamics.control.references import TrajectoryError
from closedloop_dynamics.recording.message_numbers import NANOSECONDS, stamp_of
from closedloop_dynamics.ros.commands import CommandError
from closedloop_dynamics.ros.joint_trajectory import points_of

FOLLOWED, REFUSED, LOST = 'motions followed', 'motions refused', 'motions lost'


class MotionCommand:
    """
    Has commanded motions follow trajectories; a faulty trajectory is refused as a whole.

    A trajectory may name the ``commanded_motions`` of the simulation; its stamp is of ``stamps``,
    which simulated time follows as fast as ``pacer`` says. ``counts``: trajectories followed,
    refused, and lost on the way, counted by the receiver.
    """

    def __init__(self, simulation, stamps, pacer):
        self._simulation, self._stamps, self._pacer = simulation, stamps, pacer
        self.counts = dict.fromkeys((FOLLOWED, REFUSED, LOST), 0)

    def accept(self, message):
        """Follow a JointTrajectory from the present state on; raise CommandError if refused."""
        try:
            self._simulation.command_motion(self._commands(message))
        except (TrajectoryError, ValueError) as error:
            self.counts[REFUSED] += 1
            raise CommandError(str(error)) from None
        self.counts[FOLLOWED] += 1

    def _commands(self, message):
        """Return the arguments of ``Simulation.command_motion``."""
        names, known = list(message.joint_names), self._simulation.data.commanded_motions
        unknown = [name for name in names if name not in known]
        if unknown or not names:
            raise CommandError(
                (f"'{unknown[0]}' is not commanded" if unknown else 'it names no joint')
                + f'; what may be named: {", ".join(known)}')
        # Whether a profile may go on after its last point depends on what it moves.
        points = points_of(message, list(dict.fromkeys(names)), held=False)
        stamp = stamp_of(message)
        begin = self._simulated(stamp) if stamp else self._simulation.time
        return {name: (begin + points.times, *(values[:, k] for values in points.derivatives))
                for k, name in enumerate(names)}

    def _simulated(self, stamp):
        """Return the simulated time [s] of a stamp [ns]."""
        if self._stamps.simulated:
            return self._stamps.simulated_time(stamp)
        later = (stamp - self._stamps.now()) / NANOSECONDS
        return self._simulation.time + later * self._pacer.real_time_factor
