# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Inputs of a shown simulation: the drives of its joints, and a controller of some."""

import math

import numpy as np

from .drives import Drive
from .messages import (
    drive_of, EXPRESSION, FREE, HELD, OWN, POSITION, require_one_number, SPEED, TORQUE)
from .own_motion import MODES, OwnMotion
from .posing import felt_inertia
from ..effects.actuator import Actuator
from ..mechanism.checks import one_of
from ..mechanism.fields import at, FieldError
from ..simulation.pacer import ROUNDING

# Simulated time after which drives that track something, and controllers, find their torques again
# [s].
DRIVE_PERIOD, OWN_PERIOD = 0.002, 0.005
# Motion of a joint after which drives that track something find the inertia that they feel again
# [rad, m].
FELT_AFTER = 0.02
# Accelerations that the sliders of torques reach [rad/s^2, m/s^2].
REACH = {False: 60.0, True: 20.0}
# Speed of a drive that was added by hand, so that it shows what it moves [rad/s, m/s].
NEW_SPEED = {False: 1.0, True: 0.1}


class Driving:
    """
    The drives of a simulation, by the name of a driven freedom.

    ``own``: how the machine moves by itself.
    """

    def __init__(self, own):
        self.own, self.drives = own, {}
        # Where each driven freedom is among those of the simulation.
        self._places = {}
        # Time of the controller's last call, and its torques.
        self._held = math.inf, {}

    def begin(self, simulation):
        """Drive another simulation, without torques."""
        self._simulation = simulation
        # Cut joints are not driven by hand: the page shows the joints of the tree.
        self._places = {simulation.joint_names[place]: place
                        for place in simulation.data.actuated_in_tree.tolist()}
        lengths = simulation.coordinates.lengths
        self._felt_at = self._positions()
        self.drives = {name: Drive(name, inertia, bool(lengths[self._places[name]]))
                       for name, inertia in self._inertias().items()}

    @property
    def chosen(self):
        """Return mode and value of each drive, by joint."""
        return {name: (drive.mode, drive.value) for name, drive in self.drives.items()}

    def restore(self, chosen):
        """Give drives modes and values as ``chosen`` has them; those that are new a speed."""
        names = self._simulation.coordinates
        for name, drive in self.drives.items():
            place = self._places[name]
            # An orientation has no single speed.
            new = (SPEED, NEW_SPEED[bool(names.lengths[place])]) if names.place[place] >= 0 else (
                TORQUE, 0.0)
            drive.set(*chosen.get(name, new), *self._now_at(name))

    # Torques.

    def torques(self):
        """Return the joint torques that the drives give now, shape (nv,)."""
        simulation = self._simulation
        tau, position = simulation.joint_torques(None), self._positions()
        if np.abs(position - self._felt_at).max() > FELT_AFTER and any(
                drive.mode not in (TORQUE, OWN) for drive in self.drives.values()):
            self._felt_at = position
            for name, inertia in self._inertias().items():
                self.drives[name].inertia = inertia
        for name, place in self._places.items():
            drive = self.drives[name]
            tau[place] = self._controlled()[name] if drive.mode == OWN else drive.torque(
                simulation.time, position[place], simulation.velocity[place])
        return tau

    @property
    def period(self):
        """Return the simulated time after which torques are to be renewed [s]."""
        modes = {drive.mode for drive in self.drives.values()} - {TORQUE}
        if not modes:
            return math.inf
        return OWN_PERIOD if modes == {OWN} else DRIVE_PERIOD

    def _controlled(self):
        """Return the torques of the controller, which are held for its period, by joint."""
        simulation, (since, torques) = self._simulation, self._held
        if not 0.0 <= simulation.time - since < (1.0 - ROUNDING) * OWN_PERIOD:
            torques = self.own.controller.torques(
                simulation.time, simulation.position, simulation.velocity)
            self._held = simulation.time, torques
        return torques

    def _positions(self):
        """Return the number of each freedom, shape (nv,)."""
        return self._simulation.coordinates.by_freedom(self._simulation.position)

    def _now_at(self, joint):
        """Return the time [s] and the number of a driven freedom."""
        return self._simulation.time, float(self._positions()[self._places[joint]])

    def _inertias(self):
        """Return, by actuated joint, the inertia that its drive feels now."""
        felt = felt_inertia(self._simulation)[list(self._places.values())]
        return {name: float(inertia) if math.isfinite(inertia) else 1.0
                for name, inertia in zip(self._places, felt)}

    # The machine's own motion.

    def start(self):
        """Start each drive with the machine's own motion."""
        self.restart_controller()
        for name, drive in self.drives.items():
            (mode, value), (time, position) = self.own.start(name), self._now_at(name)
            with at(name):
                drive.set(mode, position if value is None else value, time, position)

    def restart_controller(self):
        self._held = math.inf, {}
        if self.own.controller is not None:
            self.own.controller.restart()

    def follow(self, controller):
        """Go on with a controller of another machine, in place of the one before."""
        self.own = OwnMotion(controller, {
            joint: start for joint, start in self.own.starts.items() if start[0] != OWN})
        self.restart_controller()

    def hold(self):
        """Go on without a controller: the joints that it has driven are held where they are."""
        self.own = OwnMotion()
        for name, drive in self.drives.items():
            if drive.mode == OWN:
                time, position = self._now_at(name)
                drive.set(POSITION, position, time, position)

    # What pages ask for, and see.

    def modes(self, name):
        controller = self.own.controller
        known = controller is not None and name in controller.joints
        return (*MODES, OWN) if known else MODES

    def reach(self, name):
        """Return the largest torque of a slider: that of the drive, or one for a brisk motion."""
        for record in self._simulation.effects.values():
            if isinstance(record, Actuator) and record.joint == name and record.max_torque:
                return record.max_torque
        slides = bool(self._simulation.coordinates.lengths[self._places[name]])
        return round_up(REACH[slides] * self.drives[name].inertia)

    def change_mode(self, joint, mode):
        """Give a drive another mode, with its value then; FieldError where it has none."""
        drive = drive_of(self.drives, joint)
        if drive.mode == mode:
            return
        with at('mode'):
            one_of(self.modes(joint))(mode)
        if mode != OWN:
            require_one_number(self._simulation.coordinates, joint, mode)
        elif not any(other.mode == OWN for other in self.drives.values()):
            self.restart_controller()
        time, position = self._now_at(joint)
        drive.set(mode, {
            TORQUE: 0.0, SPEED: 0.0, POSITION: position, EXPRESSION: f'{position:.9g}'}.get(
                mode, self.own.start(joint)[1]), time, position)

    def command(self, joint, value):
        """Give a drive another value; raise FieldError where it can have none."""
        drive = drive_of(self.drives, joint)
        if drive.mode == OWN:
            raise FieldError('another mode of the drive', f'a value for {drive.value}', path=(
                'joint',))
        drive.set(drive.mode, value, *self._now_at(joint))

    def move(self, which):
        """Drive all joints as the machine does by itself, hold them, or leave them free."""
        if which == OWN:
            self.start()
            return
        turning = self._simulation.coordinates
        for name, drive in self.drives.items():
            time, position = self._now_at(name)
            one_number = turning.place[turning.index[name]] >= 0
            if which == HELD and one_number:
                drive.set(POSITION, position, time, position)
            else:
                drive.set(TORQUE, 0.0, time, position)

    @property
    def motion(self):
        """Return how the machine is driven, as ``move`` takes it; None: otherwise."""
        drives = self.drives.values()
        if drives and all(drive.mode == POSITION for drive in drives):
            return HELD
        if all((drive.mode, drive.value) == (TORQUE, 0.0) for drive in drives):
            return FREE
        return OWN if all(
            self.own.start(drive.joint) in ((drive.mode, drive.value), (drive.mode, None))
            for drive in drives) else None


def round_up(value):
    """Round a positive number up to 1, 2 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= value)
