# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop modes``: frequencies, damping and shapes of small motions about a position."""

import math

import numpy as np

from .command import (
    Argument, checked_torques, Command, mapping, Output, picture_option, positive, SCENE, SET,
    TABLE, TORQUE, UsageError, whole, with_numbers)
from ..recording.modes import mode_motion, mode_table, usual_amplitude
from ..recording.rows import write_scene
from ..scene.loading import load_scene
from ..simulation.linearisation import Linearisation
from ..visual.progress import announced
from ..visual.tables import short, text_table, write_csv

# How many joints describe a shape, and how many shapes are drawn.
MOST_JOINTS, MOST_SHAPES = 4, 12
STABILITY = {True: 'stable', False: 'unstable', None: 'not decided to first order'}


def _run(arguments):
    torque = mapping(arguments.torque, '--torque')
    if arguments.hold_start and torque:
        raise UsageError('--torque: expected none with --hold-start, which finds the torques')
    if arguments.mode is not None and arguments.output is None:
        raise UsageError('--mode: expected it with --output')
    if arguments.amplitude is not None and arguments.output is arguments.picture:
        raise UsageError('--amplitude: expected it with --output or --picture')
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
             short(mode.damping, '.4g'),
             f'{mode.eigenvalue.real:.4g}', _shape(simulation.joint_names, mode.shape)]
            for number, mode in enumerate(modes, 1)]
    print(text_table(('mode', 'frequency [Hz]', 'damping', 'growth [1/s]', 'shape'), rows))
    if arguments.output is not None:
        number = 1 if arguments.mode is None else arguments.mode
        if number > len(modes):
            raise UsageError(f'--mode: expected a number from 1 to {len(modes)}, got {number}')
        motion = mode_motion(linearisation, modes[number - 1], position,
                             _amplitude(arguments, scene, modes[number - 1]))
        begun, *table = mode_table(scene, motion, torque)
        write_scene(arguments.output, begun)
        write_csv(arguments.output, *table)
        print(f'mode {number}: {arguments.output}')
    if arguments.picture is not None:
        _draw(arguments, scene, linearisation, modes[:MOST_SHAPES], position)
        print(f'modes 1 to {min(len(modes), MOST_SHAPES)}: {arguments.picture}')
    return 0


def _amplitude(arguments, scene, mode):
    """Return the amplitude of a mode [rad or m]."""
    return arguments.amplitude or usual_amplitude(scene.mechanism, mode)


def _draw(arguments, scene, linearisation, modes, position):
    """Draw shapes: the position, and both ends of the motion."""
    if not modes:
        raise UsageError('--picture: expected a mechanism with modes, got none')
    # Only here, as it takes long to load.
    from ..visual.pictures import shapes
    deflections = {
        f'mode {number}: {mode.frequency:.4g} Hz': np.array([position, *mode_motion(
            linearisation, mode, position, _amplitude(arguments, scene, mode), 1, 4).position[
                [0, 2]]]) for number, mode in enumerate(modes, 1)}
    shapes(scene.mechanism, deflections, f'{scene.name}: modes').savefig(arguments.picture)


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
    examples=(
        'modes three_rrr_vertical',
        'modes four_bar --torque crank_joint=0.5',
        'modes carpet_scraper --hold-start',
        'modes three_rrr_vertical --picture modes.png',
        'modes three_rrr_vertical --mode 2 --output mode_2.csv',
        'view mode_2.csv'),
    arguments=(
        SCENE, TORQUE,
        Argument('--hold-start', action='store_true',
                 help="stay in the scene's start, under the torques that hold it (default: go to "
                      'the position near it that the torques given hold)'),
        SET,
        picture_option(f'the shapes of the first {MOST_SHAPES} modes'),
        Output('--output', 'FILE.csv', 'where to write the motion of one mode, without growth or '
               'decay, for animate and view', TABLE),
        Argument('--mode', metavar='NUMBER', type=whole(1),
                 help='with --output, which one (default: 1)'),
        Argument('--amplitude', metavar='SIZE', type=positive,
                 help='with --output or --picture, of the joint that moves most [rad or m] '
                      '(default: one that can be seen)')),
    run=_run)
