# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop modes``: frequencies, damping and shapes of small motions about a position."""

import math

import numpy as np

from .command import (
    add_scene, add_set, add_torque, checked_torques, Command, mapping, UsageError, with_numbers)
from ..simulation.linearisation import Linearisation
from ..simulation.scene import load_scene
from ..visual.progress import announced
from ..visual.tables import text_table

# How many joints a shape is told by.
MOST_JOINTS = 4
STABILITY = {True: 'stable', False: 'unstable', None: 'not decided to first order'}


def _add_arguments(parser):
    add_scene(parser)
    add_torque(parser)
    parser.add_argument('--hold-start', action='store_true',
                        help="stay in the scene's start, under the torques that hold it (default: "
                             'go to the position near it that the torques given hold)')
    add_set(parser)


def _run(arguments):
    torque = mapping(arguments.torque, '--torque')
    if arguments.hold_start and torque:
        raise UsageError('--torque: expected none with --hold-start, which finds the torques')
    scene = with_numbers(load_scene(arguments.scene), arguments)
    with announced('Compiling derivatives and looking for a position at rest ...'):
        simulation = checked_torques(arguments.scene, scene, torque)
        linearisation = Linearisation(simulation)
        if arguments.hold_start:
            position, torque = simulation.position, linearisation.static_torque()
            stability = None
        else:
            found = linearisation.equilibrium(torque)
            position, stability = found.position, f'equilibrium: {STABILITY[found.stable]}'
        modes = linearisation.modes(position, torque)
    print('position: ' + _listed(simulation.coordinates.columns('position'), position))
    print('torques: ' + _listed(torque, torque.values()))
    if stability:
        print(stability)
    rows = [[str(number), f'{mode.frequency:.6g}',
             '-' if math.isnan(mode.damping) else f'{mode.damping:.4g}',
             f'{mode.eigenvalue.real:.4g}', _shape(simulation.joint_names, mode.shape)]
            for number, mode in enumerate(modes, 1)]
    print(text_table(('mode', 'frequency [Hz]', 'damping', 'growth [1/s]', 'shape'), rows))
    return 0


def _listed(names, values):
    """Return names and numbers in one line."""
    return ', '.join(f'{name} {value:.6g}' for name, value in zip(names, values)) or 'none'


def _shape(names, shape):
    """Return the joints that move most, with the sign of those that move in step."""
    order = np.argsort(-np.abs(shape), kind='stable')[:MOST_JOINTS]
    return ', '.join(
        f'{names[place]} {shape[place]:.3g}' if np.isrealobj(shape) else
        f'{names[place]} {abs(shape[place]):.3g} at {math.degrees(np.angle(shape[place])):.0f} deg'
        for place in order if abs(shape[place]) > 1e-6)


COMMAND = Command(
    name='modes',
    summary='frequencies, damping and shapes of small motions about a position at rest',
    description="""\
Find the position near the start of a scene that constant torques hold, and the modes
of small motions about it: frequency, damping (a share of critical damping; less than 0
where the motion grows), how fast it grows, and the joints that move most, the largest
motion 1. Where a scene lists what has no derivative (dry friction, contacts, ...),
that is refused by its name.
""",
    epilog="""\
examples:
  closedloop modes three_rrr_vertical
  closedloop modes four_bar --torque crank_joint=0.5
  closedloop modes carpet_scraper --hold-start
""",
    add_arguments=_add_arguments,
    run=_run)
