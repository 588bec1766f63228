# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

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
import time

from closedloop_dynamics.mechanism.mechanism import MechanismError
from closedloop_dynamics.recording.errors import BagReadError, RecordingError
from closedloop_dynamics.scene.loading import load_scene, SceneError
from closedloop_dynamics.simulation.signals import Interrupted, SignalWatch
from closedloop_dynamics.visual.progress import progress_to
from demo_drive import (
    aim_of, drive_for, RECORDER, SIMULATOR, TORQUE_SOURCE)
from demo_report import (
    compared, draw, not_representative, open_loops, read_run, summary)
from programs import POLL, ProgramError, Programs, READY

DEFAULT_OUTPUT = 'demo_output'
# The machines of the package's name, where no other is requested.
SHOWN = ('carpet_scraper', 'three_rrr')
EXIT_CODES = ('Exit codes: 0 done; 1 a node failed, or a machine did not do what was wanted '
              '(where the computer is too busy to judge that, the output says so); 2 a wrong '
              'option or scene; 130 interrupted.')
# For loading, for nodes to find each other, and to end [s].
LOADING, FINDING, ENDING = 120.0, 60.0, 20.0
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


def arguments_of(argv):
    """Return the parsed command line."""
    parser = ArgumentParser(
        prog='demo', formatter_class=RawDescriptionHelpFormatter, allow_abbrev=False,
        description=f"""\
Simulate scenes live with real ROS 2 nodes, drive them by torques from another
process, record joint states and constraint forces in a rosbag2 bag, and show
what happened. Ends by itself.

Without SCENE: {' and '.join(SHOWN)}, one after the other.
""", epilog=EXIT_CODES)
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
    """Run the demonstration; return the exit code."""
    # Unless requested, nothing leaves this machine.
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    parser, arguments = arguments_of(argv)
    try:
        scenes = [load_scene(name)
                  for name in ([arguments.scene] if arguments.scene else SHOWN)]
        output = _output(arguments.output)
    except (SceneError, MechanismError, OSError) as error:
        parser.error(str(error))
    # The first signal ends the demonstration; later ones do not disturb that.
    watch = SignalWatch(lambda number: None, SIGNALS)
    watch.install()
    try:
        failed = []
        with watch.interrupting():
            for number, scene in enumerate(scenes, 1):
                print(f'[{number}/{len(scenes)}] {scene.name}', flush=True)
                if not demonstrate(scene, arguments.duration, output / scene.name):
                    failed.append(scene.name)
        print(f'Bags, logs and pictures are in {output}/')
        print(f'Live in the browser: closedloop view {arguments.scene or SHOWN[-1]} '
              '(in a checkout after . .venv/activate)')
        if failed:
            print(f"demo: {' and '.join(failed)} did not do what was wanted; see 'verdict' above",
                  file=sys.stderr)
        return 1 if failed else 0
    except Interrupted as interrupt:
        print(f'\nInterrupted; all nodes were stopped. What there is so far: {output}/',
              file=sys.stderr)
        return 128 + interrupt.args[0]
    except (ProgramError, RecordingError, BagReadError) as error:
        print(f'demo: {error}', file=sys.stderr)
        return 1


def demonstrate(scene, duration, directory):
    """
    Run one scene, then report and draw the run, in a directory that is made here.

    Returns whether the machine did what was wanted of it, as far as that can be judged. Raises
    ProgramError where a node failed, RecordingError or BagReadError where nothing was recorded.
    """
    directory.mkdir(parents=True)
    # A name in ROS is letters, digits and underscores, and begins with a letter.
    namespace = '/demo_' + re.sub(r'\W', '_', scene.name, flags=re.ASCII)
    drive = drive_for(scene)
    _say('driven by', drive.description)
    _say('starting', 'the nodes ...')
    last_words = _run_nodes(scene, drive, namespace, duration, directory.resolve())
    run, aim = read_run(directory / 'bag', namespace), aim_of(drive, scene)
    _say('simulator', last_words)
    for key, text in summary(run):
        _say(key, text)
    reasons, faults, failures = not_representative(run, duration), [], []
    if len(run.motion.time) > 2:
        for text, failure in compared(run.motion, aim):
            if text:
                _say('tracking', text)
            failures += [failure] if failure else []
        faults += open_loops(run.motion)
        for path in draw(run.motion, aim, scene.name, directory):
            _say('picture', path)
    else:
        faults.append('nothing moved')
    for text in verdict(faults, failures, reasons, aim is not None):
        _say('verdict', text)
    return not faults and (not failures or bool(reasons))


def verdict(faults, failures, reasons, wanted):
    """
    Return the assessment of a run, in one or two lines.

    ``faults`` are what no lack of time excuses, ``failures`` what was not as wanted otherwise: a
    machine that gets its torques late goes elsewhere. ``reasons`` say why it is not
    representative, ``wanted`` whether more was wanted than that it moves.
    """
    lines, judged = [], faults + ([] if reasons else failures)
    if judged:
        lines.append(f"NOT as wanted: {'; '.join(judged)}")
        lines += [] if reasons else ['the machine had the time that it needed: the cause is '
                                     'another one']
    elif wanted and not failures:
        lines.append('as wanted')
    if reasons:
        lines.append(f"NOT representative, this computer was too busy: {'; '.join(reasons)}")
        lines += [f"not judged therefore: {'; '.join(failures)}"] if failures else []
    return lines or ['it ran in real time; nothing more was wanted']


def _run_nodes(scene, drive, namespace, duration, directory):
    """Run the nodes, each in a process of its own; return the simulator's last lines."""
    cuts = [f'constraint_forces/{cut.name}' for cut in scene.mechanism.cut_joints]
    parameters = ['--ros-args', '--params-file', str(drive.file)] if drive.file else []
    with Programs(directory) as programs:
        def heard(*topics):
            for topic in topics:
                recorder.wait_for(f'{namespace}/{topic}: first message', FINDING, programs.check)

        recorder = programs.start(RECORDER, namespace, output=directory / 'bag')
        recorder.wait_for(READY[RECORDER], FINDING, programs.check)
        waiting = {'wait_for_command': 'true'} if drive.parameters else {}
        simulator = programs.start(
            SIMULATOR, namespace, parameters, **waiting, scene=scene.path.resolve())
        simulator.wait_for(READY[SIMULATOR], LOADING, programs.check)
        heard('joint_states', 'replay_log', *cuts)
        source = None
        if drive.parameters:
            # It begins when both simulator and recorder hear it.
            given = {} if drive.file else drive.parameters
            source = programs.start(
                TORQUE_SOURCE, namespace, parameters, wait_for_subscribers=2, **given)
            source.wait_for(READY[TORQUE_SOURCE], LOADING, programs.check)
            heard('torque_command')
        _let_run(programs, duration, scene.name)
        # The recorder first: the motion without its torques is no part of the demonstration.
        for program in filter(None, (recorder, simulator, source)):
            if program.stop(patience=ENDING) != 0:
                raise ProgramError(
                    f'{program.executable} did not end well, with exit code '
                    f'{program.popen.returncode}; it said last: {program.last_words()}')
        return simulator.last_words()


def _let_run(programs, duration, name):
    """Wait for the motion to last as long as it should, watching the processes."""
    begin = time.monotonic()
    with progress_to(duration, 's', name) as show:
        while (elapsed := time.monotonic() - begin) < duration:
            show(elapsed)
            programs.check()
            time.sleep(POLL)
        show(duration)


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


def _say(key, text):
    print(f'  {key:10} {text}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
