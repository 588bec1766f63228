# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Sub-commands, and the options that they share."""

from argparse import ArgumentParser, ArgumentTypeError, RawDescriptionHelpFormatter
from dataclasses import dataclass
import math
import os
from pathlib import Path
import re
import sys
import textwrap
from typing import Callable

from ..effects.user_code import run_code
from ..formats.registry import is_model
from ..kinematics.motions import moving, require_actuated, with_motions
from ..mechanism.errors import AssemblyError
from ..mechanism.extras import require
from ..mechanism.fields import FieldError
from ..mechanism.mechanism import MechanismError
from ..scene.key_paths import changed, resolve
from ..scene.loading import load_scene, scene_names
from ..simulation.simulation import Simulation
from ..visual.progress import announced

# Exit code of a simulation that failed.
FAILED = 1
# Endings of the files that commands write.
PICTURES, TABLE, YAML = ('.png', '.pdf', '.svg'), ('.csv',), ('.yaml', '.yml')
# While a file is read.
READING = 'Reading the machine and closing its loops (Ctrl-C stops it) ...'


# Longest line of an example in a help text.
LONGEST_LINE = 96


def exit_codes(failure):
    """Return the exit codes in a paragraph, of which 1 is a failure in words."""
    return textwrap.fill(
        f'Exit codes: 0 done; 1 {failure}, or a file could not be written completely; 2 a wrong '
        'option, scene, mechanism or recording; 130 interrupted, 143 terminated.', 84)


class UsageError(ValueError):
    """A wrong command line; the message says what was expected."""


class Argument:
    """An argument or option, as ``ArgumentParser.add_argument`` takes it."""

    def __init__(self, *names, **settings):
        self.names, self.settings = names, settings

    def add_to(self, parser):
        """Add it to a parser."""
        parser.add_argument(*self.names, **self.settings)


class Output(Argument):
    """
    The option of a file that a command writes.

    ``endings``: of names that it may have, all if none are given. Commands with outputs have the
    option ``--overwrite``, and refuse a file that cannot be written before they begin.
    """

    def __init__(self, name, metavar, explanation, endings=(), **settings):
        super().__init__(name, metavar=metavar, type=Path, help=explanation, **settings)
        self.endings = endings

    def check(self, arguments):
        """Refuse the file of a command line where it cannot be written, with UsageError."""
        name, = self.names
        path = getattr(arguments, name.removeprefix('--').replace('-', '_'))
        if path is not None:
            require_free(arguments, path, name, self.endings)
            if self.endings == PICTURES:
                require('matplotlib')


class Group:
    """Arguments under a title."""

    def __init__(self, title, *arguments):
        self.title, self.arguments = title, arguments

    def add_to(self, parser):
        """Add them to a parser."""
        group = parser.add_argument_group(self.title)
        for one in self.arguments:
            one.add_to(group)


class OneOf:
    """Options of which at most one is given."""

    def __init__(self, *arguments):
        self.arguments = arguments

    def add_to(self, parser):
        """Add them to a parser or group."""
        group = parser.add_mutually_exclusive_group()
        for one in self.arguments:
            one.add_to(group)


@dataclass(frozen=True)
class Command:
    """One sub-command."""

    name: str
    summary: str  # For the list of commands, in a few words
    description: str  # For its own help, before the options
    #: Takes the parsed arguments, returns the exit code; prints its result. It may raise
    #: UsageError, SceneError, MechanismError (exit code 2), SimulationError and OSError (1).
    run: Callable
    arguments: tuple = ()  # Of Argument, Group and OneOf
    examples: tuple = ()  # Lines without ``closedloop``
    failure: str = 'the simulation failed'  # What exit code 1 means, beside files not written
    reads_scenes: bool = True  # Whether it reads any, and so has the option ``--allow-code``

    @property
    def epilog(self):
        """Return the end of its own help: examples, broken before options, and exit codes."""
        lines = ['examples:']
        for example in self.examples:
            words, *options = re.split(r' (?=--)', f'  closedloop {example}')
            lines.append(words)
            for option in options:
                if len(lines[-1]) + len(option) > LONGEST_LINE:
                    lines[-1] += ' \\'
                    lines.append(f'      {option}')
                else:
                    lines[-1] += f' {option}'
        return '\n'.join((*lines, '', exit_codes(self.failure)))

    @property
    def outputs(self):
        """Return the files that it writes, which are checked before it runs."""
        return [one for one in self.arguments if isinstance(one, Output)]

    def add_to(self, parser):
        """Add what it takes to its parser."""
        for one in self.arguments:
            one.add_to(parser)
        if self.outputs and OVERWRITE not in self.arguments:
            OVERWRITE.add_to(parser)
        if self.reads_scenes:
            ALLOW_CODE.add_to(parser)

    def __call__(self, arguments):
        """Run it; return the exit code."""
        for one in self.outputs:
            one.check(arguments)
        return self.run(arguments)


class HelpfulParser(ArgumentParser):
    """A parser that keeps the line breaks of its texts, with errors in two lines."""

    def __init__(self, **options):
        """Build a parser; long options are never cut short, so that new ones break nothing."""
        super().__init__(
            formatter_class=RawDescriptionHelpFormatter, allow_abbrev=False, **options)

    def add_argument(self, *names, **options):
        """Add an argument; shells complete scenes by names and files."""
        action = super().add_argument(*names, **options)
        if str(action.metavar).endswith('SCENE'):
            action.completer = _complete_scene
        return action

    def error(self, message):
        """Print the error and where help is; exit with 2."""
        print(f'{self.prog}: {message}\nTry: {self.prog} --help', file=sys.stderr)
        self.exit(2)


def _complete_scene(prefix, **_):
    """Return the shipped scenes and files that a shell may complete a word to."""
    from argcomplete.completers import FilesCompleter
    return [*scene_names(), *FilesCompleter()(prefix)]


def _run_code(path):
    """Run a Python file that the user has named, and return its path."""
    try:
        run_code(path)
    except ValueError as error:
        raise ArgumentTypeError(str(error)) from None
    return path


def reading(arguments, path):
    """
    Return the options for the reader of a model or a scene, by its parameters' names.

    UsageError where some of a model are given, and the path is not one in another format.
    """
    found = {'mend_inertias': arguments.mend_inertias, 'model': arguments.model,
             'arguments': mapping(arguments.argument, '--argument'),
             'anywhere': arguments.anywhere, 'ignore': tuple(arguments.ignore)}
    found = {key: value for key, value in found.items() if value}
    if found and not is_model(path):
        key = next(iter(found))
        option = '--argument' if key == 'arguments' else f'--{key.replace("_", "-")}'
        raise UsageError(f'{option}: expected a model in another format, got {str(path)!r}; in a '
                         f'scene of such a model write the key {key}')
    if arguments.geometry_tolerance is not None:
        found['tolerance'] = arguments.geometry_tolerance
    return found


def with_numbers(scene, arguments):
    """Return a scene with the numbers that the command line sets; raise UsageError."""
    try:
        return changed(scene, {resolve(scene, key): value for key, value in mapping(
            arguments.set, '--set').items()})
    except (FieldError, MechanismError) as error:
        raise UsageError(f'--set: {error}') from None


def read_scene(name, arguments):
    """Return a scene by its name, with the options of a command line; print a long read."""
    with announced(READING):
        return load_scene(name, **reading(arguments, name))


def scene_to_change(arguments):
    """Return the scene of a command line, read, with the numbers set."""
    return with_numbers(read_scene(arguments.scene, arguments), arguments)


def scene_of(arguments):
    """Return the scene of a command line with the numbers set and the motions it prescribes."""
    return with_motion(scene_to_change(arguments), arguments)


def with_motion(scene, arguments):
    """Return a scene with the motions that the command line prescribes; raise UsageError."""
    try:
        return moving(scene, mapping(arguments.motion, '--motion'))
    except FieldError as error:
        raise UsageError(f'--{error}') from None


def recording_of(arguments, path, other_machine=False):
    """
    Return the recording in a bag or a CSV file, by the arguments of ``recording``.

    Numbers that are set are those of ``--scene``, which may have another mechanism than the bag if
    ``other_machine``. UsageError where it cannot be read, lacks something, or is of another
    mechanism.
    """
    # Only here, as other commands need none of its libraries.
    from ..recording.errors import RecordingError
    from ..recording.recording import read_recording
    from ..recording.rows import require_same_mechanism
    if arguments.set and not arguments.scene:
        raise UsageError('--set: expected it with --scene, whose numbers it changes; a recording '
                         'knows those that it was made with')
    scene = with_numbers(load_scene(arguments.scene), arguments) if arguments.scene else None
    try:
        recording = read_recording(path, scene, arguments.namespace)
        if scene is not None and recording.changes and not other_machine:
            require_same_mechanism(path, recording.changes[0][0], scene)
    except (RecordingError, OSError) as error:
        raise UsageError(str(error)) from None
    return recording


def require_free(arguments, path, option='--output', endings=()):
    """
    Refuse, before anything is computed, a file that cannot be written.

    UsageError where its name does not end with one of ``endings``, if any are given; where it
    exists and ``--overwrite`` is not given, is a directory, or its directory does not exist.
    """
    if path.is_dir():
        raise UsageError(f'{option}: expected a file, got the directory {path}')
    if endings and path.suffix not in endings:
        raise UsageError(f'{option}: expected a name that ends with {", ".join(endings)}, got '
                         f'{path}')
    if path.is_file() and not arguments.overwrite:
        raise UsageError(f'{option}: {path} exists; name another file, or add --overwrite')
    require_writable(path if path.exists() else path.parent, option)


def free_paths(arguments, *names):
    """
    Return the paths of files in the directory ``--output``; none where it is not given.

    UsageError where one of them exists and ``--overwrite`` is not given, or they cannot be
    written; MissingLibraryError where one is a picture, and matplotlib is not installed.
    """
    if arguments.output is None:
        return []
    paths = [arguments.output / name for name in names]
    for path in paths:
        if path.suffix in PICTURES:
            require('matplotlib')
        if path.exists() and not arguments.overwrite:
            raise UsageError(f'--output: {path} exists; name another directory, or add '
                             '--overwrite')
    # Missing directories are made.
    there = next(place for place in (arguments.output, *arguments.output.absolute().parents)
                 if place.exists())
    if not there.is_dir():
        raise UsageError(f'--output: expected a directory, got {arguments.output}: {there} is a '
                         'file')
    require_writable(there, '--output')
    return paths


def require_writable(path, option):
    """Refuse a directory or file that does not exist or must not be changed, with UsageError."""
    if not path.exists():
        raise UsageError(f'{option}: expected an existing directory, got {path}')
    if not os.access(path, os.W_OK):
        raise UsageError(f'{option}: expected a place that may be written to, got {path}')


def write_drawing(arguments, motion, title):
    """Write the line drawing of a motion that was requested."""
    from ..visual.line_drawing import line_drawing, write
    write(line_drawing(motion, title), arguments.drawing)


def checked_torques(name, scene, torque, build=Simulation):
    """
    Build a simulation of a scene, after a check of the torques' names.

    ``name`` of the scene is for messages; ``build`` takes the scene. UsageError where a joint
    takes no torque, or the scene cannot be assembled.
    """
    try:
        require_actuated(with_motions(scene), torque)
    except ValueError as error:
        raise UsageError(f'--{error}') from None
    try:
        return build(scene)
    except AssemblyError as error:
        raise UsageError(f'{name}: {error}') from None
    except MechanismError as error:
        raise UsageError(f'{name}: mechanism.{error}') from None


def positive(text):
    """Convert an option's value to a finite number > 0."""
    value = _number(text)
    if not 0.0 < value < math.inf:
        raise ArgumentTypeError(f'expected a finite number > 0, got {text!r}')
    return value


def not_negative(text):
    """Convert an option's value to a finite number >= 0."""
    value = _number(text)
    if not 0.0 <= value < math.inf:
        raise ArgumentTypeError(f'expected a finite number >= 0, got {text!r}')
    return value


def whole(least=0, most=math.inf):
    """Return the conversion of an option's value to a whole number of a range."""
    def convert(text):
        if not (text.isdecimal() and least <= int(text) <= most):
            end = 'on' if most == math.inf else f'to {most}'
            raise ArgumentTypeError(f'expected a whole number from {least} {end}, got {text!r}')
        return int(text)
    return convert


def comma_separated(text):
    """Convert names with commas between them to a list."""
    return [name.strip() for name in text.split(',')]


def pair(form, sign='=', empty=False):
    """Return the conversion of an option's value to a name and a text, of a form for messages."""
    def convert(text):
        name, found, value = text.partition(sign)
        if not (name and (value or empty and found)):
            raise ArgumentTypeError(f'expected {form}, got {text!r}')
        return name, value
    return convert


def assignment(text):
    """Convert ``NAME=NUMBER`` to a pair."""
    form = 'NAME=NUMBER'
    name, value = pair(form)(text)
    if not math.isfinite(_number(value)):
        raise ArgumentTypeError(f'expected {form}, got {text!r}')
    return name, float(value)


def mapping(pairs, option):
    """Return pairs of an option that may be repeated, each name once, as a dict."""
    result = dict(pairs)
    if len(result) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise UsageError(f'{option} {twice}: expected once, got it {names.count(twice)} times')
    return result


def complain(arguments, message, code=FAILED):
    """Print a message on the standard error; return the exit code."""
    print(f'{arguments.prog}: {message}', file=sys.stderr)
    return code


def interrupted(arguments, signal, resumable):
    """Report that a computation was interrupted; return the exit code."""
    more = '; what is written is kept, and the same command with --resume goes on'
    return complain(arguments, f'interrupted{more if resumable else ""}', 128 + signal)


def _number(text):
    try:
        return float(text)
    except ValueError:
        return math.nan


class _Drawing(Output):
    """The option of a line drawing."""

    def check(self, arguments):
        """Refuse it where it cannot be written, or a library is missing, with UsageError."""
        if arguments.drawing is not None:
            # Only here, as in the commands: it takes long to load.
            from ..visual.line_drawing import DrawingError, require_kind
            try:
                require_kind(arguments.drawing)
            except DrawingError as error:
                raise UsageError(f'--drawing: {error}') from None
        super().check(arguments)


def reading_options(short=True):
    """
    Return the options of how a model is read, to be read by ``reading``.

    ``short``: whether the command has no other ``--tolerance``.
    """
    return (
        Group(
            'how a model in another format is read',
            Argument('--mend-inertias', action='store_true',
                     help='change moments of inertia that no body has, one being larger than the '
                          'sum of the other two, by as little as makes them possible, and give '
                          'links with inertia but no mass a negligible one'),
            Argument('--model', metavar='NAME', help='which one of several models of a world'),
            Argument('--argument', type=pair('NAME:=VALUE', ':=', empty=True), action='append',
                     default=[], metavar='NAME:=VALUE',
                     help='argument of a xacro file; may be repeated'),
            Argument('--anywhere', action='store_true',
                     help='read meshes and parts of a model from outside of its folder, too'),
            Argument('--ignore', metavar='ELEMENT', action='append', default=[],
                     help='leave out elements of URDF or SDF of this name, which nobody knows '
                          'and which may change the motion; may be repeated')),
        Argument('--geometry-tolerance', *['--tolerance'] * short, type=not_negative, metavar='T',
                 help='take axes and places that agree to so much, sines of angles and shares of '
                      'the longest distance on a body, as parallel, at right angles or meeting '
                      '(default: that of the mechanism, 1e-8)'))


def picture_option(what):
    """Return the option of a picture."""
    return Output('--picture', 'FILE.png', f'where to draw {what} (or .pdf, .svg)', PICTURES)


def directory_options(files, default=' (default: only print)'):
    """Return the options of a directory where files are written, for ``free_paths``."""
    return (
        Argument('--output', metavar='DIR', type=Path, required=not default,
                 help=f'where to write {files}{default}'),
        OVERWRITE)


def recording_arguments(name='recording', metavar='BAG_OR_CSV', nargs=None, what=(
        'a bag, or what `closedloop simulate --output` wrote')):
    """Return the arguments of ``recording_of``, the first one called and explained so."""
    return (
        Argument(name, metavar=metavar, nargs=nargs, help=what),
        Argument('--scene', metavar='SCENE',
                 help='the scene that was simulated (default: the one in the bag, or beside the '
                      'CSV file)'),
        SET,
        Argument('--namespace', metavar='NAME',
                 help='of the simulator, where several are in the bag'))


def measured_options(joints, smoothed):
    """Return the options of measured joints, given their default, and of their smoothing."""
    return (
        Argument('--joints', metavar='NAMES', type=comma_separated,
                 help=f'measured joints, with commas between them (default: {joints}); the '
                      'others follow from the loops'),
        Argument('--deviation', metavar='ERROR', type=not_negative, default=0.0,
                 help=f'standard deviation of a position [rad or m]: {smoothed}'))


SCENE = Argument('scene', metavar='SCENE', help='a shipped scene by its name, or a YAML file')
SET = Argument('--set', type=assignment, action='append', default=[], metavar='KEY=VALUE',
               help='override a number of the scene or its mechanism, by its key path: '
                    'parameters.l=0.3, mechanism.bodies.crank.mass=2; may be repeated')
TORQUE = Argument('--torque', type=assignment, action='append', default=[], metavar='JOINT=VALUE',
                  help='constant torque of an actuated joint [N m], or force of a prismatic one '
                       '[N]; may be repeated (default: none)')
MOTION = Argument('--motion', type=pair('JOINT=EXPRESSION'), action='append', default=[],
                  metavar='JOINT=EXPRESSION',
                  help='motion of a joint as an expression in the time t [rad or m], such as '
                       'theta_1=4.7124*t; the effort is reported; may be repeated (default: as '
                       'the scene says)')
DRAWING = _Drawing(
    '--drawing', 'FILE', 'where to draw the first position and the paths of all points, to scale '
    'in millimetres with a layer for each: a .dxf, or a .svg')
OVERWRITE = Argument('--overwrite', action='store_true', help='replace files that exist')
ALLOW_CODE = Argument('--allow-code', type=_run_code, action='append', metavar='FILE',
                      help='run a Python file of your own first, which registers the effects that '
                           'the scene names; may be repeated (no scene runs code by itself)')
READING_OPTIONS = reading_options()
