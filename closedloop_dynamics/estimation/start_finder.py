# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Where a run begins: positions and rates from the first readings of joints, loops closed."""

from dataclasses import replace

from .sensors import JointSensor, POSITION, RATE
from ..kinematics.passive_joint_solver import PassiveJointSolver

# Readings further apart give no rate [s].
LONGEST = 0.2


class StartFinder:
    """
    Finds the start of a run in readings as they come.

    Where the measured joints determine all others, their positions do, and their rates, measured
    or from one reading to the next. Otherwise it is where the model starts.

    Parameters
    ----------
    setup : setup_file.Setup
    model : simulation.model.Model
        Its start is on the branch of the motion.

    """

    def __init__(self, setup, model):
        self._start, self._model = setup.start, model
        joints = [one for one in setup.sensors if isinstance(one, JointSensor)
                  and one.joint in model.coordinates.single_names]
        self._sensors = list({one.joint: one for one in joints
                              if one.quantity == POSITION}.values())
        self._rates = {one.joint: one.name for one in joints if one.quantity == RATE}
        self._latest, self._found, self._completion = {}, {}, None
        names = [one.joint for one in self._sensors]
        if names:
            try:
                self._completion = PassiveJointSolver(
                    model.mechanism, names, model.assemble().q)
            except ValueError:
                # These joints leave some freedom open.
                pass

    def take(self, time, readings):
        """
        Return the ``Start``, or None where more readings are needed.

        ``readings``, by sensor, are of a time [s]. PassiveJointError where the loops cannot be
        closed with them.
        """
        if self._completion is None:
            return replace(self._start, time=time)
        for one in self._sensors:
            if one.name in readings:
                (value,), before = readings[one.name], self._latest.get(one.name)
                true = time - one.latency
                self._latest[one.name] = true, value
                if self._rates.get(one.joint) in readings:
                    self._found[one.name], = readings[self._rates[one.joint]]
                elif before and 0.0 < true - before[0] <= LONGEST:
                    self._found[one.name] = (value - before[1]) / (true - before[0])
        if len(self._found) < len(self._sensors):
            return None
        completion, names = self._completion, [one.name for one in self._sensors]
        completion.complete([self._latest[name][1] for name in names],
                            [self._found[name] for name in names])
        begin = max(true for true, _ in self._latest.values())
        return replace(self._start, time=begin, state=self._model.state(
            completion.position, completion.velocity, time=begin))
