# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop view``: a mechanism in the browser, live or as it was recorded."""

from contextlib import contextmanager
from importlib.util import find_spec
import os
from pathlib import Path
import sys
import time
import webbrowser

import numpy as np

from .command import (
    Argument, assignment, checked_torques, Command, mapping, Output, pair, positive, read_scene,
    READING_OPTIONS, recording_arguments, recording_of, UsageError, whole, with_motion,
    with_numbers)
from ..control.errors import StartError
from ..mechanism.errors import AssemblyError
from ..mechanism.extras import require
from ..mechanism.fields import FieldError
from ..recording.recording import since_the_last_reset
from ..simulation.signals import program_watch
from ..view.columns import motion_columns
from ..view.description import describe
from ..view.messages import EXPRESSION, FREE, HELD, OWN, POSITION, SPEED, TORQUE
from ..view.own_motion import chosen
from ..view.page import live_page, recorded_page, standalone_page
from ..view.saved import recorded, simulated
from ..view.standalone import standalone
from ..visual.progress import announced, progress_to

# By default, unless it is taken.
USUAL_PORT = 8791
# Simulated time of a saved page [s], its rows per simulated second beside those that paths and
# plots need; and the most rows that a page is given of a recording.
DURATION, RATE, MOST_ROWS = 10.0, 60.0, 36_000
# Options that drive a scene.
DRIVING = 'torque', 'speed', 'position', 'motion', 'controller'
RECORDINGS = ('.csv', '.mcap', '.db3', '.zstd')
# Only ros/ imports ROS: the node is a process of its own.
VIEWER = 'from closedloop_dynamics.ros.process import viewer; viewer()'
LOADING = 'Loading; code is generated for a mechanism that is new ...'


def _run(arguments):
    if arguments.set and (arguments.what is None or _is_recording(arguments.what)):
        raise UsageError('--set: expected a scene, as a recording has the numbers it was made '
                         'with')
    if arguments.node:
        return _attach(arguments)
    if arguments.what is None:
        raise UsageError('expected a scene or a recording, or --node')
    if arguments.save is None:
        for option in ('duration', 'rate', 'overwrite', 'live'):
            if getattr(arguments, option):
                raise UsageError(f'--{option}: expected it with --save')
    if not _is_recording(arguments.what):
        for option in ('scene', 'namespace'):
            if getattr(arguments, option) is not None:
                raise UsageError(f'--{option}: expected a recording, got {arguments.what}')
    if arguments.save is not None:
        return _save(arguments)
    require('websockets')
    if _is_recording(arguments.what):
        for option in DRIVING:
            if getattr(arguments, option):
                raise UsageError(f'--{option}: expected a scene, as a recording is not driven')
        return _play(arguments)
    return _live(arguments)


def _attach(arguments):
    """Become the node ``closedloop_viewer``, which ends with Ctrl-C."""
    for option, given in (('', arguments.what), ('--save ', arguments.save),
                          ('--scene ', arguments.scene)):
        if given is not None:
            raise UsageError(f'--node: expected nothing else to show, got {option}{given}')
    if find_spec('rclpy') is None:
        raise UsageError('--node: expected ROS 2 (rclpy), which is not installed here')
    sys.stdout.flush()
    os.execv(sys.executable, [
        sys.executable, '-c', VIEWER, '--ros-args', '-p', f'nodes:={",".join(arguments.node)}',
        '-p', f'host:={arguments.host}',
        '-p', f'port:={USUAL_PORT if arguments.port is None else arguments.port}'])


def _is_recording(what):
    path = Path(what)
    return path.is_dir() or path.suffix in RECORDINGS


def _live(arguments):
    """Run a simulation until Ctrl-C."""
    # The server's library takes a while, which no other command should.
    from ..view.library import Library
    from ..view.runner import Runner
    scene, motion = _scene_and_motion(arguments)
    with announced(LOADING), _refusing(arguments):
        runner = Runner(scene, own=motion, library=Library(Path.cwd()))
    _with_warnings(runner.described)
    with program_watch.noting() as received:
        server = _served(arguments, [live_page(scene.name)], [runner.feed], runner.resource)
        try:
            runner.run(lambda: not received)
        finally:
            server.close()
    return 128 + received[0]


def _scene_and_motion(arguments):
    """Return a scene, and a function that gives what drives it from the start."""
    return with_numbers(read_scene(arguments.what, arguments), arguments), chosen(
        _drives(arguments), arguments.drives, arguments.controller)


@contextmanager
def _refusing(arguments):
    """Report a scene that does not start as a fault of the command line."""
    try:
        yield
    except (AssemblyError, StartError) as error:
        raise UsageError(f'{arguments.what}: {error}') from None
    except FieldError as error:
        raise UsageError(f'drives: {error}') from None


def _drives(arguments):
    """Return mode and value of the drives that the command line names, by joint."""
    found = {}
    for mode, option in ((TORQUE, 'torque'), (SPEED, 'speed'), (POSITION, 'position'),
                         (EXPRESSION, 'motion')):
        for joint, value in mapping(getattr(arguments, option), f'--{option}').items():
            if joint in found:
                raise UsageError(f'--{option} {joint}: expected one way to drive it, got also '
                                 f'{found[joint][0]}')
            found[joint] = mode, value
    return found


def _play(arguments):
    """Show a recording until Ctrl-C."""
    page = _recorded_page(arguments)
    with program_watch.noting() as received:
        server = _served(arguments, [page], [])
        try:
            while not received:
                time.sleep(0.1)
        finally:
            server.close()
    return 128 + received[0]


def _with_warnings(described):
    """Return a description; print the meshes that cannot be shown on stderr."""
    for text in described['missing']:
        print(f'closedloop view: {text}; drawn as lines', file=sys.stderr)
    return described


def _served(arguments, pages, feeds, resource=lambda path: None):
    """Return a server of pages, and print their addresses."""
    from ..view.server import Server
    try:
        server = Server(pages, feeds, arguments.host,
                        USUAL_PORT if arguments.port is None else arguments.port, resource)
    except OSError as error:
        if arguments.port is not None:
            raise UsageError(f'--port {arguments.port}: {error.strerror or error}') from None
        try:
            server = Server(pages, feeds, arguments.host, resource=resource)
        except OSError:
            raise UsageError(f'--host {arguments.host}: {error.strerror or error}') from None
    print(f'{server.url}\nCtrl-C ends it.', flush=True)
    # Elsewhere it would be a browser in the terminal.
    if not arguments.no_open and any(
            os.environ.get(name) for name in ('DISPLAY', 'WAYLAND_DISPLAY')):
        webbrowser.open(server.url)
    return server


def _recorded_page(arguments):
    recording = recording_of(arguments, arguments.what)
    motion = since_the_last_reset(recording.motion)
    times, rows = recorded(motion, MOST_ROWS)
    if len(times) < len(motion.time):
        print(f'{arguments.what}: {len(motion.time)} states, of which the {len(times)} are shown '
              'that straight lines between them would miss', file=sys.stderr)
    title = recording.scene.name
    return recorded_page(
        title, _with_warnings(describe(
            motion.mechanism, motion_columns(motion.mechanism), recording.scene.effects,
            mode='recording', title=title)), times, rows)


def _save(arguments):
    page = (_standalone_page if arguments.live else _recorded_page if _is_recording(
        arguments.what) else _simulated_page)(arguments)
    arguments.save.write_text(page, encoding='utf-8')
    print(f'{arguments.save}: {arguments.save.stat().st_size / 1e6:.2g} MB')
    return 0


def _standalone_page(arguments):
    if _is_recording(arguments.what):
        raise UsageError('--live: expected a scene, as a recording is not simulated')
    for option in ('duration', 'rate'):
        if getattr(arguments, option):
            raise UsageError(f'--{option}: expected it without --live, where the page itself '
                             'simulates')
    scene, motion = _scene_and_motion(arguments)
    with announced(LOADING), _refusing(arguments):
        description, machine = standalone(scene, motion(scene))
    return standalone_page(scene.name, _with_warnings(description), machine)


def _simulated_page(arguments):
    torque = mapping(arguments.torque, '--torque')
    for option in ('speed', 'position', 'controller'):
        if getattr(arguments, option):
            raise UsageError(f'--{option}: expected it without --save, where joints move exactly: '
                             'by --motion')
    scene = with_motion(with_numbers(read_scene(arguments.what, arguments), arguments), arguments)
    with announced(LOADING):
        simulation = checked_torques(arguments.what, scene, torque)
    duration = arguments.duration or DURATION
    with progress_to(duration, 's', scene.name) as show:
        columns, times, rows = simulated(
            simulation, duration, arguments.rate or min(RATE, MOST_ROWS / duration), torque, show)
    return recorded_page(
        scene.name, _with_warnings(describe(
            scene.mechanism, columns, scene.effects, mode='recording', title=scene.name)),
        np.array(times), np.array(rows))


COMMAND = Command(
    name='view',
    summary='show a mechanism live in the browser, and drive and drag it',
    description="""\
Open a page in the browser that shows a mechanism in three dimensions. A scene runs live: play,
pause, slow motion, sliders for its drives, effects and methods switched while it runs, points
dragged by the mouse, plots beside it. A recording plays with a time slider. The page comes from
this computer and needs no network. Closing it changes nothing; Ctrl-C ends the command.
""",
    examples=(
        'view three_rrr',
        'view four_bar --set mechanism.bodies.crank.mass=2',
        "view four_bar --motion 'crank_joint=1.05+2*pi*t'",
        'view stewart_platform --drives held',
        'view my_bag',
        'view --node /closedloop_simulator',
        'view three_rrr --duration 10 --torque theta_1=5 --save run.html',
        'view three_rrr --save machine.html --live'),
    arguments=(
        *recording_arguments('what', 'SCENE_OR_RECORDING', '?', 'a shipped scene by its name, a '
                             'YAML file, a bag, or what `closedloop simulate --output` wrote'),
        Argument('--node', metavar='NAME', action='append', default=[],
                 help='show a running simulator of this name, through its topics; may be '
                      'repeated'),
        Output('--save', 'FILE', 'write one HTML file that plays the motion anywhere, offline, '
               'instead of showing it', ('.html',)),
        Argument('--live', action='store_true',
                 help='with --save, a page that simulates the scene by itself, opened from disk '
                      'or any web server'),
        Argument('--duration', metavar='SECONDS', type=positive,
                 help=f'with --save, how much of a scene is simulated (default: {DURATION:g})'),
        Argument('--rate', metavar='HZ', type=positive,
                 help='with --save, states per simulated second, beside those between that paths '
                      f'and plots need (default: {RATE:g}, fewer beyond {MOST_ROWS} rows)'),
        *(Argument(f'--{name}', type=assignment, action='append', default=[],
                   metavar='JOINT=VALUE', help=f'{what}; may be repeated')
          for name, what in (
              ('torque', 'constant torque of an actuated joint [N m], or force of a prismatic one '
               '[N]'),
              ('speed', 'speed that a drive holds [rad/s or m/s]'),
              ('position', 'position that a drive holds [rad or m]'))),
        Argument('--motion', type=pair('JOINT=EXPRESSION'), action='append', default=[],
                 metavar='JOINT=EXPRESSION',
                 help='position that a drive tracks, an expression in the time t, such as '
                      'theta_1=1.05+2*pi*t [rad or m]; with --save the exact motion of the '
                      'joint; may be repeated'),
        Argument('--drives', choices=(OWN, HELD, FREE), default=OWN,
                 help='how the other joints are driven: by the motion of its own that a shipped '
                      'machine has, held where they are, or free (default: own)'),
        Argument('--controller', metavar='FILE.yaml', type=Path,
                 help='drive the machine by a controller, as in config/controllers'),
        Argument('--host', metavar='ADDRESS', default='127.0.0.1',
                 help='address to listen on; any but that of this host needs the token in the '
                      'address that is printed (default: 127.0.0.1)'),
        Argument('--port', metavar='NUMBER', type=whole(0, 65535),
                 help=f'to listen on (default: {USUAL_PORT}, or any that is free)'),
        Argument('--no-open', action='store_true', help='do not open a browser'),
        *READING_OPTIONS),
    run=_run)
