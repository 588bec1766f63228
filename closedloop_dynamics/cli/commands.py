# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The sub-commands of ``closedloop``, and its command line made of them."""

from importlib import import_module
import os
import sys
import warnings

from .command import complain, exit_codes, HelpfulParser, UsageError
from .. import __version__
from ..codegen import announced_by
from ..mechanism.errors import SimulationError
from ..mechanism.extras import MissingLibraryError
from ..mechanism.mechanism import MechanismError
from ..scene.loading import SceneError
from ..simulation.signals import Interrupted, program_watch

# Command -> its module, imported when it is needed: each one needs libraries of its own.
COMMANDS = {name: {'import': 'import_model'}.get(name, name) for name in (
    'accuracy', 'animate', 'assemblies', 'benchmark', 'check', 'compare', 'effects', 'estimate',
    'export', 'forces', 'identify', 'import', 'kinematics', 'list', 'modes',
    'optimise', 'plot', 'replay', 'report', 'simulate', 'sweep', 'synthesise',
    'urdf', 'view', 'workspace')}

# Commands of earlier versions, and what serves in their place.
GONE = {
    **{name: 'doc/examples/derived_machines of the sources writes such scenes: `python '
             f'doc/examples/derived_machines {name} --help`'
       for name in ('cognates', 'invert', 'mirror')},
    'formulations': 'the dense formulations are oracles of the tests (test/reference)',
    'stability': 'benchmark/stability.py of the sources makes this study: `python '
                 'benchmark/stability.py --help`',
    'recover': 'killed recordings are read as they are; an MCAP file gets its index back, and '
               'loses what is damaged, by `mcap recover FILE -o NEW`, a bag its metadata.yaml by '
               '`ros2 bag reindex BAG`'}

USAGE, BROKEN_PIPE = 2, 141
DESCRIPTION = """\
Simulate mechanisms with closed kinematic loops.

A mechanism and a scene (a mechanism, its start, what acts on it) are YAML files.
The shipped ones go by their names; anything else is the path of a file:

  closedloop check three_rrr
  closedloop simulate three_rrr --duration 2 --torque theta_1=5 --output run.csv
"""


def parser(names=tuple(COMMANDS)):
    """Return the parser of the whole command line, with some commands only."""
    whole = HelpfulParser(prog='closedloop', description=DESCRIPTION, epilog=exit_codes(
        'the simulation failed, or a comparison found a difference'))
    whole.add_argument('--version', action='version', version=f'%(prog)s {__version__}')
    commands = whole.add_subparsers(
        title='commands', metavar='COMMAND', required=True, parser_class=HelpfulParser)
    for name in names:
        command = import_module(f'.{COMMANDS[name]}', __package__).COMMAND
        one = commands.add_parser(
            command.name, help=command.summary, description=command.description,
            epilog=command.epilog)
        command.add_to(one)
        one.set_defaults(run=command, prog=one.prog, refuse=one.error)
    return whole


def run(argv):
    """Run ``closedloop`` with arguments without the program's name, None: of this process."""
    for stream in (sys.stdout, sys.stderr):
        # The terminal need not be able to show names of files and texts of scenes.
        stream.reconfigure(errors='backslashreplace')
    argv = sys.argv[1:] if argv is None else argv
    completing = '_ARGCOMPLETE' in os.environ
    words = os.environ['COMP_LINE'].split()[1:] if completing else argv
    whole = parser([name for name in words[:1] if name in COMMANDS] or COMMANDS)
    if completing:
        # A shell requests words that may follow; doc/install.md explains the set-up.
        import argcomplete
        argcomplete.autocomplete(whole)
    if words and words[0] in GONE:
        whole.error(f'{words[0]} is no longer a command: {GONE[words[0]]}')
    arguments, unknown = whole.parse_known_args(argv)
    if unknown:
        arguments.refuse(f'unrecognized arguments: {" ".join(unknown)}')
    with warnings.catch_warnings():
        warnings.showwarning = lambda message, *where: complain(arguments, message)
        with program_watch.interrupting(), announced_by(
                lambda text: complain(arguments, text)):
            return _run(arguments)


def _run(arguments):
    """Run a command; return the exit code."""
    try:
        code = arguments.run(arguments)
        sys.stdout.flush()
        return code
    except (SceneError, MechanismError, MissingLibraryError, UsageError) as error:
        return complain(arguments, error, USAGE)
    except BrokenPipeError:
        # The reader of the output has enough; the rest is dropped when Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except (SimulationError, OSError) as error:
        return complain(arguments, error)
    except MemoryError as error:
        return complain(arguments, f'out of memory: {error}')
    except Interrupted as interrupt:
        return complain(arguments, 'interrupted', 128 + interrupt.args[0])
