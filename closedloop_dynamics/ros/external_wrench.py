# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Wrenches from outside that act on bodies, checked on arrival."""

import math

from closedloop_dynamics.effects.actuator import Actuator
from closedloop_dynamics.mechanism.errors import SimulationError
from closedloop_dynamics.mechanism.kinematics import wrench_in_joints
from closedloop_dynamics.ros.commands import CommandError
import numpy as np

# How long a wrench acts when none follows [s of simulated time].
TIMEOUT = 0.5
TAKEN, WRENCHES_REFUSED = 'wrenches taken', 'wrenches refused'


class ExternalWrench:
    """
    Applies wrenches on bodies of a simulation as equivalent joint torques.

    These are found again whenever the simulation advances, and constant in between. As long as
    there are none, nothing is computed. ``torques``, shape (nv,): what the wrenches were in the
    latest steps [N m or N]; ``counts`` of those taken and refused.
    """

    def __init__(self, simulation):
        self._simulation, mechanism = simulation, simulation.mechanism
        self.torques = np.zeros(mechanism.coordinates.nv)
        self.counts = dict.fromkeys((TAKEN, WRENCHES_REFUSED), 0)
        self._places = {point.name: (point.body, np.array([*point.position, 0.0][:3]))
                        for point in mechanism.points}
        self._places.update({body.name: (body.name, np.zeros(3)) for body in mechanism.bodies})
        self._acting = {}
        # A motion's force comes from its own equation.
        self._moved = [mechanism.coordinates.index[motion.freedom]
                       for motion in mechanism.motions
                       if motion.freedom in mechanism.coordinates.index]

    def accept(self, message):
        """Apply a WrenchStamped from now on; raise CommandError if it is refused."""
        try:
            self._accept(message.header.frame_id, message.wrench)
        except CommandError:
            self.counts[WRENCHES_REFUSED] += 1
            raise
        self.counts[TAKEN] += 1

    def _accept(self, name, wrench):
        limited = [name for name, record in self._simulation.effects.items()
                   if isinstance(record, Actuator)]
        if limited:
            raise CommandError(
                'expected a scene without actuator effects, whose limits would act on it, too, '
                f'got {", ".join(limited)}; an external_force of the scene has no such limits')
        if name not in self._places:
            raise CommandError('expected a frame_id that is a body or a named point '
                               f'({", ".join(self._places)}), got {name!r}')
        parts = [getattr(part, axis) for part in (wrench.force, wrench.torque) for axis in 'xyz']
        if not all(map(math.isfinite, parts)):
            raise CommandError(f'expected finite numbers, got {parts}')
        if self._simulation.mechanism.planar and any(parts[2:5]):
            raise CommandError('expected force x and y and torque z, in the plane, got others')
        if any(parts):
            self._require_admissible(name, np.array(parts))
            self._acting[name] = np.array(parts), self._simulation.time + TIMEOUT
        else:
            self._acting.pop(name, None)

    def _require_admissible(self, name, wrench):
        """Refuse a wrench that no step can follow."""
        simulation, tau = self._simulation, self._simulation.joint_torques(None)
        tau[:len(self.torques)] = wrench_in_joints(
            simulation.mechanism, simulation.position, *self._places[name], wrench)
        try:
            simulation.stepping.require_admissible(tau)
        except SimulationError as error:
            raise CommandError(error) from None

    def forget(self):
        """Remove all wrenches."""
        self._acting.clear()

    def act(self, torque):
        """Add the acting wrenches to joint torques, shape (number of ``torque_names``,)."""
        if not self._acting:
            self.torques[:] = 0.0
            return
        simulation, torques = self._simulation, self.torques
        torques[:] = 0.0
        for name, (wrench, end) in list(self._acting.items()):
            # Half a step: a wrench that ends now does not act any more.
            if simulation.time > end - 0.5 * simulation.step_size:
                del self._acting[name]
                continue
            torques += wrench_in_joints(
                simulation.mechanism, simulation.position, *self._places[name], wrench)
        torque[:len(torques)] += torques

    def without(self, effort):
        """Return efforts of the joints, shape (nv,), without the share of the wrenches."""
        if not self.torques.any():
            return effort
        share = self.torques.copy()
        share[self._moved] = 0.0
        return effort - share
