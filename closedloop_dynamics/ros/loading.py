# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Load a scene for a node, with its errors in one line."""

import time
import warnings

from closedloop_dynamics.effects.prescribed_motion import COMMANDED, PrescribedMotion
from closedloop_dynamics.effects.user_code import run_code
from closedloop_dynamics.mechanism.errors import InaccuracyWarning, SimulationError
from closedloop_dynamics.recording.cost import allowance, probe
from closedloop_dynamics.ros.parameters import ALLOW_CODE
from closedloop_dynamics.ros.process import leaving_at_once, StartError
from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.simulation.simulation import Simulation

# Simulated time whose cost the start reports [s], calls in a second of it [Hz], and CPU time of
# each of the two probes [s].
COST_DURATION, COST_RATE, LONGEST_PROBE = 10.0, 10.0, 0.1


def allow_code(paths):
    """Run the Python files of the parameter ``allow_code``; StartError where one fails."""
    try:
        for path in paths:
            run_code(path)
    except ValueError as error:
        raise StartError(f"parameter 'allow_code': {error}") from None


def load_simulation(values, logger, moved=(), **method):
    """
    Return the simulation of a scene, and the scene's own method; log both.

    ``values`` are parameters of the node, ``scene`` and ``allow_code`` among them. ``moved`` names
    joints whose motion is commanded beside those of the scene;
    ``method`` is what differs from the scene's own; None: nothing. Raises StartError if the scene
    cannot be read or simulated.
    """
    scene = values['scene']
    allow_code(values[ALLOW_CODE.name])
    logger.info(f"loading scene '{scene}' ...")
    begin = time.monotonic()
    try:
        with leaving_at_once():
            read = load_scene(scene)
            simulation = Simulation.from_scene(read, {
                joint: PrescribedMotion(COMMANDED, joint=joint) for joint in moved}, **method)
            simulation.data.prepare_exchanges()
    except (ValueError, OSError, SimulationError) as error:
        raise StartError(f"scene '{scene}': {error}") from None
    logger.info(f'loaded in {time.monotonic() - begin:.1f} s')
    return simulation, read.method


def log_cost(simulation, pace, logger):
    """
    Log the predicted cost of a simulation, from a short probe without torques.

    ``pace`` is in simulated seconds per second of the clock. Messages are not counted.
    """
    with leaving_at_once(), warnings.catch_warnings():
        warnings.simplefilter('ignore', InaccuracyWarning)
        costs = probe(simulation, COST_DURATION, COST_RATE, longest=LONGEST_PROBE)
    logger.info('without torques, computing is expected to take ' + ', '.join(
        f'{pace * cost.share:.2%} of a core with {cost.setting}' if not cost.failure else
        f'what is not known with {cost.setting}, as the motion ends at t = {cost.probed:.3g} s'
        for cost in costs))
    budget = simulation.scene.method.budget
    if budget is not None:
        logger.info(allowance(budget, costs, pace))
