# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Machines derived from others, written as scenes.

    python doc/examples/derived_machines cognates four_bar --output cognates
    python doc/examples/derived_machines invert slider_crank --ground rod --output cylinder.yaml
    python doc/examples/derived_machines mirror delta_robot --axis z --output from_below.yaml

``cognates``: the other two four-bar linkages with the same coupler curve; ``invert``: the same
machine with another link as the ground; ``mirror``: its mirror image. What a scene does not take
over is named.
"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from pathlib import Path
import sys

from closedloop_dynamics import load_scene, Model
from closedloop_dynamics.mechanism.errors import AssemblyError
from closedloop_dynamics.mechanism.mechanism import MechanismError
from closedloop_dynamics.scene.loading import SceneError
from closedloop_dynamics.scene.text import write_scene
from cognates import cognates
from inversion import inverted
from mirror import AXES, mirrored


def main(arguments=None):
    """Run a command line; return the exit code."""
    parser = _parser()
    given = parser.parse_args(arguments)
    names = ('cognate_1.yaml', 'cognate_2.yaml') if given.command == 'cognates' else ['']
    files = [given.output / name for name in names]
    for file in files:
        if file.suffix != '.yaml' or file.exists():
            parser.error(f'--output: expected the name of a new file *.yaml, got {file}')
    try:
        scene = load_scene(given.scene)
        if given.command == 'cognates':
            found = cognates(scene, given.point)
        else:
            found = [inverted(scene, given.ground) if given.command == 'invert'
                     else mirrored(scene, given.axis)]
        for one in found:
            # What cannot move is not written.
            Model(one.scene).assemble()
        for file, one in zip(files, found):
            file.parent.mkdir(parents=True, exist_ok=True)
            write_scene(one.scene, file)
            print(file)
            for note in one.left_out:
                print(f'{file.name}: left out: {note}', file=sys.stderr)
    except (ValueError, AssemblyError, MechanismError, SceneError, OSError) as error:
        parser.error(f'{error}')
    return 0


def _parser():
    parser = ArgumentParser('derived_machines', description=__doc__,
                            formatter_class=RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest='command', required=True)
    for name in ('cognates', 'invert', 'mirror'):
        one = commands.add_parser(name)
        one.add_argument('scene', help='a shipped scene by its name, or a YAML file')
        if name == 'cognates':
            one.add_argument('--point', help='the point of the coupler that traces the curve '
                                             '(default: its first one)')
        elif name == 'invert':
            one.add_argument('--ground', required=True, help='the body that is held')
        else:
            one.add_argument('--axis', choices=tuple(AXES), default='x',
                             help='the coordinate that changes its sign (default: x)')
        one.add_argument('--output', type=Path, required=True,
                         help='the new file *.yaml, of cognates the directory of two')
    return parser


if __name__ == '__main__':
    sys.exit(main())
