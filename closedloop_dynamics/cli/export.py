# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop export``: a mechanism in MJCF, URDF or SDF; a scene in C, or as an FMU."""

from dataclasses import asdict
from pathlib import Path

import numpy as np

from .command import (
    Argument, Command, OVERWRITE, READING, reading, READING_OPTIONS, require_free, UsageError)
from ..effects.registry import effect_type
from ..formats.building import Imported
from ..formats.in_space import in_space
from ..formats.model import free_name
from ..formats.registry import is_model, read_model, writer, WRITERS
from ..formats.sdf_writing import sdf
from ..formats.urdf_loops import FORMS, GAZEBO
from ..formats.urdf_writing import urdf_with_loops
from ..kinematics.global_assembly import find_closed
from ..kinematics.modeling import extent
from ..mechanism.errors import AssemblyError, SimulationError
from ..mechanism.mechanism import Mechanism, MechanismError
from ..scene.loading import load_scene, load_scene_or_mechanism
from ..scene.model_scene import assembled
from ..visual.progress import announced

# How the names of files end that code is written to.
C, FMU = '.c', '.fmu'
CODE = C, FMU


def _run(arguments):
    suffix = arguments.output.suffix.lower()
    if suffix not in (*WRITERS, *CODE):
        raise UsageError(f'--output: expected a name that ends with one of '
                         f'{", ".join((*WRITERS, *CODE))}, got {str(arguments.output)!r}')
    write = None if suffix in CODE else writer(suffix)
    if arguments.drake and write is not sdf:
        raise UsageError('--drake: expected it with an output that ends with .sdf')
    if arguments.loops and write is not urdf_with_loops:
        raise UsageError('--loops: expected it with an output that ends with .urdf')
    if arguments.derivatives and suffix not in CODE:
        raise UsageError('--derivatives: expected it with an output that ends with one of '
                         f'{", ".join(CODE)}')
    if arguments.float32 and suffix != C:
        raise UsageError(f'--float32: expected it with an output that ends with {C}')
    if arguments.fmi and suffix != FMU:
        raise UsageError(f'--fmi: expected it with an output that ends with {FMU}')
    require_free(arguments, arguments.output)
    if suffix in CODE:
        return (_write_c if suffix == C else _write_fmu)(arguments)
    with announced(READING):
        mechanism, effects, position, hold, limits = _read(
            arguments.scene, **reading(arguments, arguments.scene))
        mechanism = in_space(mechanism)
        mechanism, start = _closed(mechanism, position, hold, limits)
    drawn = mechanism.coordinates.start()
    moved = start is not None and bool(mechanism.coordinates.apart(start, drawn).any())
    drawn_closed = write is sdf or arguments.loops == GAZEBO
    if start is None and drawn_closed:
        raise MechanismError(f'{mechanism.name}: expected loops that are closed to write SDF, got '
                             'no such position (give a scene with a start near one)')
    left_out = {}
    options = {'drake': True} if arguments.drake else {}
    if arguments.loops:
        options['loops'] = arguments.loops
    text = write(mechanism, effects, start if moved else None, left_out, limits, **options)
    arguments.output.write_text(text, encoding='utf-8')
    print(f'{arguments.output}: {len(mechanism.bodies)} bodies, {len(mechanism.joints)} joints, '
          f'{len(mechanism.cut_joints)} that close loops')
    if moved and drawn_closed:
        print('drawn where the loops are closed; coordinates count from there: ' + ', '.join(
            f'{name} {value:.6g}' for name, value in zip(
                mechanism.coordinates.names, mechanism.coordinates.apart(start, drawn))))
    if left_out:
        print('left out: the effects ' + ', '.join(
            f'{name} ({what})' if what else name for name, what in left_out.items()))
    return 0


def _write_c(arguments):
    """Write a scene as C and its header."""
    # Only here: no other format needs the code generation.
    from ..export.c_run import error_of_float32, STEPS
    from ..export.c_source import c_cost, c_source
    header = arguments.output.with_suffix('.h')
    require_free(arguments, header)
    simulation, (text, declared) = _coded(arguments, lambda simulation: c_source(
        simulation, arguments.output.stem, arguments.derivatives, arguments.float32))
    arguments.output.write_text(text, encoding='utf-8')
    header.write_text(declared, encoding='utf-8')
    print(f'{arguments.output}, {header}: {len(simulation.position)} coordinates, '
          f'{len(simulation.joint_names)} rates, {len(simulation.data.system.lam)} multipliers')
    # What is stated in the header.
    print(*c_cost(simulation, arguments.derivatives, arguments.float32).lines(), sep='\n')
    _print_step_cost(simulation)
    if arguments.float32:
        try:
            error = error_of_float32(simulation)
            print(f'single precision: a joint coordinate differs from double by {error:.2g} rad '
                  f'or m at most in {STEPS} steps without torques')
        except SimulationError as error:
            print(f'single precision: its error was not measured: {error}')
    _print_left_out(simulation)
    return 0


def _write_fmu(arguments):
    """Write a scene as a functional mock-up unit."""
    from ..export.fmu import fmu
    with announced('Writing and compiling the unit ...'):
        simulation, unit = _coded(arguments, lambda simulation: fmu(
            simulation, arguments.output.stem, arguments.fmi or '3.0', arguments.derivatives))
    arguments.output.write_bytes(unit.archive)
    kinds = 'co-simulation' + ('' if unit.no_exchange else ' and model exchange')
    print(f'{arguments.output}: FMI {arguments.fmi or "3.0"}, {kinds}, '
          f'{len(unit.variables)} variables')
    if unit.no_exchange:
        print(f'no model exchange: {unit.no_exchange}')
    _print_step_cost(simulation)
    _print_left_out(simulation)
    return 0


def _coded(arguments, write):
    """Return the simulation of a scene, and its parts that are written as code."""
    from ..simulation.simulation import Simulation
    if reading(arguments, arguments.scene):
        raise UsageError('--output: expected a scene to write C of; a model in another format '
                         'becomes one by `closedloop import`')
    try:
        simulation = Simulation.from_scene(load_scene(arguments.scene))
        return simulation, write(simulation)
    except AssemblyError as error:
        raise UsageError(f'{arguments.scene}: {error}') from None
    except ValueError as error:
        raise UsageError(f'--output: {error}') from None


def _print_step_cost(simulation):
    """Report what the step size of the scene costs, in steps as the C makes them."""
    from ..export.c_run import step_cost
    step = f'steps of {simulation.step_size:g} s'
    try:
        cost = step_cost(simulation)
        print(f'{step}: in {cost.duration:g} s without torques the energy balance misses '
              f'{cost.energy:.2g} of the kinetic energy; half of it moves a joint coordinate by '
              f'{cost.apart:.2g} rad or m at most')
    except SimulationError as error:
        print(f'{step}: what they cost was not measured: {error}')


def _print_left_out(simulation):
    """Name the effects that have no part in the motion."""
    from ..export.c_source import left_out
    sensors = left_out(simulation)
    if sensors:
        print(f'left out: {", ".join(sensors)}, which only measure')


def _read(name, **asked):
    """Return a mechanism, its effects, its start with the joints held, and its limits."""
    if is_model(name):
        imported = read_model(name, **asked)
        effects = {**imported.effects, **{
            free_name(f'drive_{joint}', imported.effects): {
                'type': 'actuator', 'joint': joint, 'max_torque': torque, 'max_speed': speed}
            for joint, (torque, speed) in imported.drives.items()}}
        return imported.mechanism, effects, imported.position, (), imported.limits
    subject = load_scene_or_mechanism(name, **asked)
    effects = {key: {'type': effect_type(effect), **asdict(effect)}
               for key, effect in getattr(subject, 'effects', {}).items()}
    if isinstance(subject, Mechanism):
        return subject, effects, {}, (), {}
    return (subject.mechanism, effects, np.array(subject.initial.position),
            [one for one in subject.initial.hold if one in subject.mechanism.joint_names], {})


def _closed(mechanism, position, hold, limits):
    """Return the mechanism, and coordinates that close its loops near a position, or None."""
    size = extent(mechanism)
    if isinstance(position, dict):
        imported, found, _ = assembled(Imported(mechanism, position, limits=limits))
        mechanism = imported.mechanism
    else:
        found = find_closed(mechanism, size, position, hold, starts=0)
        if not found.closed:
            found = find_closed(mechanism, size, position)
    return mechanism, found.q if found.closed else None


COMMAND = Command(
    name='export',
    summary='write a mechanism with its loops as MJCF, URDF, SDF, C or an FMU',
    description="""\
Write a mechanism for other programs: MJCF, whose equalities close the loops in
MuJoCo, URDF with elements that close loops (--loops), or SDF, whose joints form loops.
SDF is drawn with its loops closed, and its coordinates count from there. Joints of
several freedoms that a format does not have become several joints. Of the effects of a
scene, gravity and what acts on joints is written. For a robot description to show, see
closedloop urdf.

A name that ends with .c gets C99, and a header beside it: evaluation, correction of
the loops, a step, energies and points, for programs without this package
(doc/export.md). One that ends with .fmu gets a functional mock-up unit, with its
sources and compiled for this machine. What cannot be written so is refused.
""",
    examples=(
        'export three_rrr --output three_rrr.xml',
        'export my_robot.yaml --output my_robot.urdf',
        'export my_robot.yaml --loops drake --output my_robot_for_drake.urdf',
        'export delta_robot --output delta_robot.sdf',
        'export stewart_platform --output stewart_platform.c',
        'export three_rrr --output three_rrr.fmu'),
    arguments=(
        Argument('scene', metavar='SCENE',
                 help='a shipped scene or mechanism by its name, a YAML file, or a model'),
        Argument('--output', metavar='FILE', type=Path, required=True,
                 help=f'where to write it; a name that ends with {", ".join(WRITERS)} {C} or '
                      f'{FMU} gives the format'),
        OVERWRITE,
        Argument('--drake', action='store_true',
                 help='SDF for Drake, which refuses loops of joints: pins and ball joints that '
                      'close loops become its ball constraints'),
        Argument('--loops', choices=tuple(FORMS), default=None,
                 help='with an output that ends with .urdf, how loops are written: constraint, '
                      'as proposed for URDF (the default); loop, as in URDF+; drake, ball '
                      'constraints; gazebo, joints of SDF in an element gazebo of a robot that '
                      'is drawn with its loops closed'),
        Argument('--derivatives', action='store_true',
                 help=f'with an output that ends with {C} or {FMU}: derivatives, too: of '
                      'accelerations and multipliers, and the Jacobian for CasADi; directional '
                      'ones of a unit'),
        Argument('--float32', action='store_true',
                 help=f'with an output that ends with {C}: numbers of single precision, for small '
                      'processors; its error beside double is measured and printed'),
        Argument('--fmi', metavar='VERSION', choices=('3.0', '2.0'), default=None,
                 help=f'with an output that ends with {FMU}: 3.0 (the default) or 2.0'),
        *READING_OPTIONS),
    run=_run)
