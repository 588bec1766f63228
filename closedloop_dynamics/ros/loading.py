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
