# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Modes of small motions about a position, as motions that can be drawn and shown."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .run import columns, row
from ..kinematics.modeling import extent
from ..simulation.model import Model

# How often a mode is repeated, rows of each time, and how long one lasts that does not
# oscillate [s].
PERIODS, ROWS, USUAL_PERIOD = 10, 40, 1.0
# Amplitude of the joint that moves most [rad], or of a slide as a share of the mechanism's size.
USUAL_AMPLITUDE = 0.2


class ModeMotion(NamedTuple):
    """An undamped mode as a periodic motion, loops closed."""

    time: np.ndarray  # Shape (n,): [s]
    #: ``position``, ``velocity``: Shape (n, nq), (n, nv): The first and the last are those of the
    #: largest deflection.
    position: np.ndarray
    velocity: np.ndarray


def usual_amplitude(mechanism, mode):
    """Return an amplitude of a mode [rad or m] at which its shape can be seen."""
    length = mechanism.coordinates.lengths[int(np.argmax(np.abs(mode.shape)))]
    return USUAL_AMPLITUDE * (extent(mechanism) if length else 1.0)


def mode_motion(linearisation, mode, position, amplitude, periods=PERIODS, rows=ROWS):
    """
    Return the motion of a mode about a position.

    ``amplitude`` is that of the joint that moves most [rad or m]; there are so many ``periods`` of
    so many ``rows``. SimulationError where the loops cannot be closed at this amplitude.
    """
    period = 1.0 / mode.frequency if mode.frequency else USUAL_PERIOD
    turn = 2.0j * np.pi * np.arange(rows) / rows
    deflected = amplitude * mode.shape * np.exp(turn)[:, np.newaxis]
    rates = 2.0j * np.pi / period * deflected
    once = [linearisation.deflected(position, *each) for each in zip(deflected.real, rates.real)]
    position, velocity = (np.concatenate((np.tile(each, (periods, 1)), each[:1]))
                          for each in map(np.array, zip(*once)))
    return ModeMotion(period / rows * np.arange(len(position)), position, velocity)


def mode_table(scene, motion, torque):
    """
    Return a motion of a mode as ``simulate`` writes one, under the torques that hold the middle.

    That is a scene that begins with the motion, and names and rows of a table.
    """
    begun = replace(scene.initial, position=tuple(motion.position[0].tolist()),
                    velocity=tuple(motion.velocity[0].tolist()), hold=())
    scene = replace(scene, initial=begun)
    model = Model(scene)
    rows = []
    for time, q, qd in zip(*motion):
        readings = model.readings(model.state(q, qd, time=time), torque)
        rows.append(row(readings, float(time)))
    return scene, columns(readings), np.array(rows)
