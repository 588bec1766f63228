# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop check``: the contents of a file as they were read, or its faults."""

import numpy as np

from .command import (
    Argument, Command, complain, READING, reading, READING_OPTIONS, SET, UsageError, with_numbers)
from ..formats.registry import is_model, read_model
from ..mechanism.errors import NumericalError, SimulationError
from ..mechanism.mechanism import Mechanism, MechanismError
from ..scene.loading import load_scene_or_mechanism
from ..simulation.simulation import Simulation
from ..studies.check import describe, describe_model
from ..visual.progress import announced


def _run(arguments):
    options = reading(arguments, arguments.scene)
    if is_model(arguments.scene) and arguments.c:
        raise UsageError('--c: expected it with a scene, got a model in another format')
    if is_model(arguments.scene):
        with announced(READING):
            text, closed = describe_model(read_model(arguments.scene, **options))
        print(text)
        if not closed:
            raise UsageError(f'{arguments.scene}: no position was found that closes the loops; '
                             'the notes say which stay open')
        return 0
    read = load_scene_or_mechanism(arguments.scene, **options)
    if isinstance(read, Mechanism) and arguments.c:
        raise UsageError('--c: expected it with a scene, got a mechanism')
    if isinstance(read, Mechanism):
        if arguments.set:
            raise UsageError('--set: expected it with a scene, got a mechanism')
        try:
            print(describe(read))
        except MechanismError as error:
            raise UsageError(f'{arguments.scene}: {error}') from None
        return 0
    read = with_numbers(read, arguments)
    try:
        with announced('Assembling ...'):
            simulation = Simulation(read)
            _require_finite(simulation)
    except MechanismError as error:
        raise UsageError(f'{arguments.scene}: mechanism.{error}') from None
    except SimulationError as error:
        print(describe(read))
        raise UsageError(f'{arguments.scene}: {error}') from None
    print(describe(read, simulation))
    if arguments.c:
        # Only here: nothing else needs the code generation of C.
        from ..export.c_source import c_cost
        print('', 'C, as closedloop export writes it', sep='\n')
        print(*(f'  {line}' for line in c_cost(simulation).lines()), sep='\n')
    for note in simulation.data.start_notes():
        complain(arguments, note)
    return 0


def _require_finite(simulation):
    """Refuse a start whose numbers, each possible, overflow together."""
    if not np.isfinite([simulation.energy, *simulation.acceleration]).all():
        raise NumericalError(
            'The energy or the accelerations at the start are not finite numbers: look for '
            'masses, lengths or parameters of effects that are far too large, or next to nothing.')


COMMAND = Command(
    name='check',
    summary='read a mechanism or scene, check it and show its contents',
    description="""\
Read a mechanism or a scene, check it and show its contents: bodies, joints,
subsystems, cut joints, degrees of freedom, the elimination order, and what a
scene starts from, as given and with the loops closed. If something is wrong,
say where and what was expected; if the start may not be what was meant, say so.
""",
    examples=(
        'check four_bar',
        'check my/mechanism.yaml'),
    arguments=(
        Argument('scene', metavar='FILE_OR_SCENE',
                 help='a shipped scene or mechanism by its name, a YAML file, or a model in '
                      'another format'),
        Argument('--c', action='store_true',
                 help='what the scene costs in C at most: operations, corrections, stack'),
        SET, *READING_OPTIONS),
    run=_run)
