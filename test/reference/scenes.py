# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Scenes of mechanisms in the plane and in space, with orientations or without."""

from functools import partial

from closedloop_dynamics import Initial, Method, Scene, Simulation
from closedloop_dynamics.effects.registry import Gravity
import numpy as np

from .spatial_machines import GRAVITY


def scene(mechanism, position=None, velocity=None, effects=None, gravity=None, *, hold=(),
          turned=None, method=None, **keys):
    """
    Return a scene of a mechanism: as drawn, at rest and without effects unless given.

    Positions and velocities are all of them, or some by name; ``keys`` are of the method.
    """
    names = mechanism.coordinates
    start = [values if values is not None and not hasattr(values, 'items')
             else names.filled(quantity, values or {}, present)
             for quantity, values, present in (
                 ('position', position, names.start()),
                 ('velocity', velocity, np.zeros(names.nv)))]
    pull = {} if gravity is None else {'gravity': Gravity(tuple(gravity))}
    return Scene(mechanism.name, None, '', mechanism,
                 Initial(*map(tuple, start), tuple(hold), turned or {}),
                 {**pull, **(effects or {})}, method or Method(**keys))


def simulated(*arguments, **keywords):
    """Return a simulation of such a scene."""
    return Simulation(scene(*arguments, **keywords))


scene_in_space = partial(scene, gravity=GRAVITY)
