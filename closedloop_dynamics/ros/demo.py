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

"""
The demonstration: scenes simulated live, driven and recorded by real ROS 2 nodes.

For each scene a simulator, a torque source and a recorder run as processes of
their own for some seconds. Then the bag is read back, and what happened is
said and drawn.

"""

from argparse import ArgumentParser, RawDescriptionHelpFormatter
from datetime import datetime
import math
import os
from pathlib import Path
import re
import signal
import sys

from closedloop_dynamics.mechanism.mechanism import MechanismError
from closedloop_dynamics.ros.demo_drive import aim_of, drive_for, shipped_drives
from closedloop_dynamics.ros.demo_processes import DemoError
from closedloop_dynamics.ros.demo_recording import read_recording
from closedloop_dynamics.ros.demo_report import draw, summary
from closedloop_dynamics.ros.demo_session import run_nodes
from closedloop_dynamics.scene import load_scene, SceneError

DEFAULT_OUTPUT = 'demo_output'
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class Interrupted(KeyboardInterrupt):
    """A signal asked for the end; its number is the argument."""


def arguments_of(argv):
    """Return the parsed command line."""
    parser = ArgumentParser(
        prog='demo', formatter_class=RawDescriptionHelpFormatter, allow_abbrev=False,
        description=f"""\
Simulate scenes live with real ROS 2 nodes, drive them by torques from another
process, record joint states and constraint forces in a rosbag2 bag, and show
what happened. Ends by itself.

Without SCENE: {' and '.join(shipped_drives())}, one after the other.
""", epilog='Exit codes: 0 done; 1 a node failed; 2 a wrong option or scene; 130 interrupted.')
    parser.add_argument('scene', metavar='SCENE', nargs='?',
                        help='a shipped scene by its name, or a YAML file')
    parser.add_argument('--duration', type=_seconds, default=8.0, metavar='SECONDS',
                        help='of the motion of each scene (default: 8)')
    parser.add_argument('--output', type=Path, metavar='DIRECTORY',
                        help='for bags, logs and pictures; must be new or empty (default: a new '
                             f'one in {DEFAULT_OUTPUT}/)')
    return parser, parser.parse_args(argv)


def _seconds(text):
    value = float(text)
    if not 0.0 < value < math.inf:
        raise ValueError
    return value


def main(argv=None):
    """
    Run the demonstration.

    Parameters
    ----------
    argv : list of str, optional
        Arguments without the program's name; ``sys.argv[1:]`` when not given.

    Returns
    -------
    int
        Exit code.

    """
    # Unless asked for, nothing leaves this machine.
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    parser, arguments = arguments_of(argv)
    try:
        scenes = [load_scene(name)
                  for name in ([arguments.scene] if arguments.scene else shipped_drives())]
        output = _output(arguments.output)
    except (SceneError, MechanismError, OSError) as error:
        parser.error(str(error))
    _raise_on_signals()
    try:
        for number, scene in enumerate(scenes, 1):
            print(f'[{number}/{len(scenes)}] {scene.name}', flush=True)
            demonstrate(scene, arguments.duration, output / scene.name)
        print(f'Done. Bags, logs and pictures are in {output}/')
        return 0
    except Interrupted as interrupt:
        print(f'\nInterrupted; all nodes were stopped. What there is so far: {output}/',
              file=sys.stderr)
        return 128 + interrupt.args[0]
    except DemoError as error:
        print(f'demo: {error}', file=sys.stderr)
        return 1


def demonstrate(scene, duration, directory):
    """
    Run one scene, then tell and draw what happened.

    Parameters
    ----------
    scene : scene.Scene
        What is simulated.
    duration : float
        Of the motion [s].
    directory : pathlib.Path
        For bag, logs and pictures; made here.

    Raises
    ------
    DemoError
        Where a node failed or nothing was recorded.

    """
    directory.mkdir(parents=True)
    # A name in ROS is letters, digits and underscores, and begins with a letter.
    namespace = '/demo_' + re.sub(r'\W', '_', scene.name, flags=re.ASCII)
    drive = drive_for(scene)
    _say('driven by', drive.description)
    _say('starting', 'the nodes (compiling takes half a minute the very first time) ...')
    last_words = run_nodes(scene, drive, namespace, duration, directory)
    try:
        recording = read_recording(directory / 'bag', namespace, scene.mechanism)
    except ValueError as error:
        raise DemoError(f'{error}; the logs are in {directory}') from None
    aim = aim_of(drive, scene.mechanism.actuated_joints)
    _say('simulator', last_words)
    for key, text in summary(recording, aim):
        _say(key, text)
    for path in draw(recording, aim, scene.name, directory):
        _say('picture', path)


def _output(directory):
    """Return the directory for everything: new, or empty."""
    if directory is None:
        parent = Path(DEFAULT_OUTPUT)
        parent.mkdir(exist_ok=True)
        # Whoever runs this in a checkout does not want to commit it.
        (parent / '.gitignore').write_text('*\n')
        directory = parent / datetime.now().strftime('%Y_%m_%d-%H_%M_%S')
    directory.mkdir(parents=True, exist_ok=True)
    if any(directory.iterdir()):
        raise FileExistsError(f'--output: {directory} is not empty; name a new directory')
    return directory


def _raise_on_signals():
    """Let the first signal unwind what runs, and the others not disturb that."""
    def on_signal(number, frame):
        for other in SIGNALS:
            signal.signal(other, signal.SIG_IGN)
        raise Interrupted(number)

    for number in SIGNALS:
        signal.signal(number, on_signal)


def _say(key, text):
    print(f'  {key:10} {text}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
