# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Load a scene for a node, with its errors in one line."""

import time

from closedloop_dynamics.effects.prescribed_motion import COMMANDED, PrescribedMotion
from closedloop_dynamics.ros.process import leaving_at_once, StartError
from closedloop_dynamics.simulation.errors import SimulationError
from closedloop_dynamics.simulation.scene import load_scene
from closedloop_dynamics.simulation.simulation import Simulation


def load_simulation(scene, logger, moved='', **method):
    """
    Return the simulation of a scene, and the scene's own method; say so.

    ``moved`` names joints, with commas between them, whose motion is commanded beside those of
    the scene; ``method`` is what differs from the scene's own; None: nothing. Raises StartError
    if the scene cannot be read or simulated.

    """
    logger.info(f"loading scene '{scene}' ...")
    begin = time.monotonic()
    try:
        with leaving_at_once():
            read = load_scene(scene)
            joints = [name.strip() for name in moved.split(',') if name.strip()]
            simulation = Simulation.from_scene(read, {
                joint: PrescribedMotion(COMMANDED, joint=joint) for joint in joints}, **method)
    except (ValueError, OSError, SimulationError) as error:
        raise StartError(f"scene '{scene}': {error}") from None
    logger.info(f'loaded in {time.monotonic() - begin:.1f} s')
    return simulation, read.method
