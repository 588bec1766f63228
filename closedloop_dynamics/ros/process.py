# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Run one node in this process and leave cleanly, whatever signals arrive.

rclpy's own handlers shut the context down under the node's feet (no last log
line, no ordered close), and a second Ctrl-C while they do kills the process.
Here SIGINT and SIGTERM only ask the spin loop to end; the node closes while
its context is still alive, and every further signal is ignored.

The executables watch for signals before they import their node: the import takes seconds,
and Ctrl-C must not end in a traceback there either. They leave without Python's own clean-up,
which takes seconds, too, with all that was compiled.

A step of a simulation may take long, and cannot be interrupted: a signal then ends the process
after a while, in the midst of the step.
"""

from contextlib import contextmanager, ExitStack
import gc
from importlib import import_module
from importlib.util import find_spec
import inspect
import os
import sys
import threading
import warnings

from closedloop_dynamics.control.errors import StartError
from closedloop_dynamics.mechanism.extras import MissingLibraryError
from closedloop_dynamics.ros.executor import build_executor, spin
from closedloop_dynamics.simulation.signals import SignalWatch

# For a node to end after a signal, before its process does so without it; for what it leaves to be
# closed: topics, its context, shared memory [s].
STOP_PATIENCE, CLOSE_PATIENCE = 1.5, 0.4


class StopRequest:
    """Stop requests of this process by signals; a thread then calls ``wake()`` once."""

    def __init__(self):
        self.wake = _nothing
        self._made = threading.Event()

    def __bool__(self):
        return self._made.is_set()

    def __call__(self, number):
        """Handle a signal."""
        if not self:
            self._made.set()
            self.wake()


def watch_signals():
    """End this process at once on a signal, until a node runs in it."""
    _watch.install_thread()


def stop_requested():
    """Return whether a signal has requested this process to stop."""
    return bool(_stop)


@contextmanager
def leaving_at_once():
    """
    End the process at once on a signal while the body of a ``with`` runs.

    For work that cannot be interrupted, such as loading, while there is nothing to lose.
    """
    with _watch.reacting(_leave_at_once):
        if _stop:
            _leave_at_once()
        yield


def _leave_at_once(number=None):
    print('stopped while loading', file=sys.stderr, flush=True)
    os._exit(0)


def _nothing():
    pass


_watch, _stop = SignalWatch(_leave_at_once), StopRequest()


def run(create_node, name, help_text, args=None, timed=False, loses_nothing=False):
    """
    Create a node, spin it until a signal or the node itself ends it, close it.

    ``create_node()`` returns the node, which offers ``exit_code`` (None as long as it wants to go
    on) and ``close()``, called while its context is alive. ``name`` is that of the executable;
    ``help_text`` is for ``--help``; ``args`` is the command line with the program's name first, or
    None: that of this process. A node that is ``timed`` offers what ``spin`` asks of a beat. After
    a signal one that ``loses_nothing`` has ``STOP_PATIENCE`` to end in order.

    Returns the exit code: the node's own, 0 after a signal, 2 if it could not start.
    """
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    args = sys.argv if args is None else args
    try:
        plain = _plain_arguments(args)
        if {'-h', '--help'} & set(plain):
            print(help_text)
            return 0
        _refuse(plain)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        print(f'[{name}] cannot start: {_one_line(error)}', file=sys.stderr, flush=True)
        return 2
    with ExitStack() as limits:
        limits.callback(rclpy.try_shutdown)
        limits.callback(_watch.ignore)
        # From here on there may be something to close, such as a bag: a signal waits until it
        # can be.
        with _watch.reacting(_stop):
            return _run_in_context(create_node, name, timed, loses_nothing, limits)


def leave(code):
    """End the process at once with an exit code."""
    import rclpy
    sys.stdout.flush()
    sys.stderr.flush()
    with _closing_in_time(code):
        # Without this, the shared memory of DDS would stay behind.
        rclpy.get_default_context().destroy()
        os._exit(code)


@contextmanager
def _closing_in_time(code):
    """
    End the process with an exit code where the body takes long: DDS may wait for its peers.

    By a timer, as the main thread is in DDS then and hears nothing.
    """
    limit = threading.Timer(CLOSE_PATIENCE, os._exit, [code])
    limit.daemon = True
    limit.start()
    try:
        yield
    finally:
        limit.cancel()


def _run_in_context(create_node, name, timed, loses_nothing, limits):
    from rclpy.exceptions import NameValidationException
    from rclpy.logging import get_logger
    warnings.showwarning = lambda message, *where: get_logger(name).warning(_one_line(message))
    try:
        node = create_node()
    except (StartError, NameValidationException) as error:
        get_logger(name).fatal(_one_line(error))
        return 2
    # rclpy looks up where a message that it logs comes from: among all modules, the first time.
    inspect.getmodule(inspect.currentframe())
    # What was loaded stays: looking through half a million objects for garbage takes tens of
    # milliseconds, in which nothing is published.
    gc.freeze()
    executor = build_executor()
    executor.add_node(node)
    ended = threading.Event()

    def wake():
        # An empty task is what makes a waiting spin_once() return.
        executor.create_task(_nothing)
        # In the thread that watches for signals, whose next ones change nothing.
        if loses_nothing and not ended.wait(STOP_PATIENCE):
            _leave_in_the_midst(name)

    _stop.wake = wake
    try:
        spin(executor, lambda: node.exit_code is not None or stop_requested(),
             node if timed else None)
    finally:
        _stop.wake = _nothing
        ended.set()
        node.close()
        if _stop:
            limits.enter_context(_closing_in_time(node.exit_code or 0))
        executor.shutdown()
        node.destroy_node()
    return node.exit_code or 0


def _leave_in_the_midst(name):
    """End the process while a step is computed, which cannot be interrupted."""
    print(f'[{name}] stopped in the midst of a step', file=sys.stderr, flush=True)
    leave(0)


def _plain_arguments(argv):
    from rclpy.utilities import remove_ros_args
    return remove_ros_args(argv)[1:]


def _refuse(stray):
    """Name a plain argument: rclpy would ignore it, and the user wonder."""
    if stray:
        raise StartError(
            f'unexpected argument {stray[0]!r}; parameters are given as '
            f'--ros-args -p NAME:=VALUE, or --ros-args --params-file FILE; --help lists them')


def _one_line(error):
    return ' '.join(str(error).split())


def simulator():
    """Run ``closedloop_simulator``; end the process with its exit code."""
    _run_main('simulator_node')


def torque_source():
    """Run ``closedloop_torque_source``; end the process with its exit code."""
    _run_main('torque_source_node')


def viewer():
    """Run ``closedloop_viewer``; end the process with its exit code."""
    _run_main('viewer_node')


def recorder():
    """Run ``closedloop_recorder``; end the process with its exit code."""
    _run_main('recorder_node')


def joint_states():
    """Run ``closedloop_joint_states``; end the process with its exit code."""
    _run_main('joint_states_node')


def estimator():
    """Run ``closedloop_estimator``; end the process with its exit code."""
    _run_main('estimator_node')


def _run_main(module):
    """Watch for signals, then load a node's module and run its ``main``."""
    watch_signals()
    if find_spec('rclpy') is None:
        print('cannot start: this Python finds no ROS 2 (package rclpy). Source the setup.bash of '
              "ROS 2, or install it: pip install 'ros-jazzy-rclpy[fastrtps]' "
              'ros-jazzy-common-interfaces',
              file=sys.stderr, flush=True)
        os._exit(2)
    try:
        main = import_module(f'closedloop_dynamics.ros.{module}').main
    except MissingLibraryError as error:
        print(f'cannot start: {error}', file=sys.stderr, flush=True)
        os._exit(2)
    leave(main())
