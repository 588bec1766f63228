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
Run one node in this process and leave cleanly, whatever signals arrive.

rclpy's own handlers shut the context down under the node's feet (no last log
line, no ordered close), and a second Ctrl-C while they do kills the process.
Here SIGINT and SIGTERM only ask the spin loop to end; the node closes while
its context is still alive, and every further signal is ignored.

This module is light on purpose: an executable starts watching for signals
before it imports rclpy and numba, which take seconds.

"""

from contextlib import contextmanager
from contextlib import nullcontext
import gc
import os
import signal
import socket
import sys
import threading
import warnings

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class StartError(RuntimeError):
    """A node that cannot start or go on; the message is for the user, in one line."""


class SignalWatch:
    """
    Turn SIGINT and SIGTERM into one request to stop.

    The C-level handler writes to a socket that a thread reads, so that a
    request is noticed at once even while the main thread waits in DDS or
    compiles. Before ``on_stop`` was called, and within ``leaving_at_once()``,
    there is nothing to close, and the process simply leaves.

    """

    def __init__(self):
        self._lock = threading.Lock()
        self._wake = None
        self._requested = threading.Event()
        self._reader, self._writer = socket.socketpair()
        self._writer.setblocking(False)

    @property
    def requested(self):
        """Return whether a signal has asked this process to stop."""
        return self._requested.is_set()

    def install(self):
        """Start watching; to be called from the main thread."""
        for number in SIGNALS:
            signal.signal(number, _noticed_by_the_watch)
        signal.set_wakeup_fd(self._writer.fileno(), warn_on_full_buffer=False)
        threading.Thread(target=self._watch, name='signal_watch', daemon=True).start()

    def on_stop(self, wake):
        """Call ``wake()`` (from another thread) when a signal asks to stop."""
        with self._lock:
            self._wake = wake
            if self.requested:
                wake()

    def ignore(self):
        """Make the process immune for its last moments, the interpreter's end included."""
        for number in SIGNALS:
            signal.signal(number, signal.SIG_IGN)

    @contextmanager
    def leaving_at_once(self):
        """Let a signal end the process without further ado while the body runs."""
        with self._lock:
            if self.requested:
                _leave_at_once()
            wake, self._wake = self._wake, None
        try:
            yield
        finally:
            with self._lock:
                self._wake = wake

    def _watch(self):
        while True:
            if not set(self._reader.recv(64)).intersection(SIGNALS):
                continue
            with self._lock:
                if self._wake is None:
                    _leave_at_once()
                if not self.requested:
                    self._requested.set()
                    self._wake()


def _leave_at_once():
    print('stopped while loading or compiling', file=sys.stderr, flush=True)
    os._exit(0)


def _noticed_by_the_watch(number, frame):
    """Do nothing: Python needs a handler for the wakeup descriptor to be written."""


_watch = None


def watch_signals():
    """Return the watch of this process, installed at the first call."""
    global _watch
    if _watch is None:
        _watch = SignalWatch()
        _watch.install()
    return _watch


def stop_requested():
    """Return whether a signal has asked this process to stop."""
    return _watch is not None and _watch.requested


def leaving_at_once():
    """
    Let a signal end the process at once while the body of a ``with`` runs.

    For work that cannot be interrupted, such as compiling, while there is nothing to lose.

    """
    return _watch.leaving_at_once() if _watch is not None else nullcontext()


def run(create_node, name, args=None):
    """
    Create a node, spin it until a signal or the node itself ends it, close it.

    Parameters
    ----------
    create_node : callable
        Returns the node. The node offers ``exit_code`` (None as long as it
        wants to go on) and ``close()``, called while its context is alive; one that has
        something to do in time, ``take_over()``, ``due()`` and ``act()``, as ``spin`` asks.
    name : str
        Name for messages before there is a node.
    args : list of str, optional
        Command line with the program's name first; ``sys.argv`` if None.

    Returns
    -------
    int
        Exit code: the node's own, 0 after a signal, 2 if it could not start.

    """
    watch = watch_signals()
    import rclpy
    from rclpy.signals import SignalHandlerOptions
    args = sys.argv if args is None else args
    try:
        _refuse_stray_arguments(args)
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        print(f'[{name}] cannot start: {_one_line(error)}', file=sys.stderr, flush=True)
        return 2
    try:
        return _run_in_context(create_node, name, watch)
    finally:
        watch.ignore()
        rclpy.try_shutdown()


def leave(code):
    """
    End the process at once.

    Parameters
    ----------
    code : int
        Exit code.

    """
    import rclpy
    # Without this, the shared memory of DDS would stay behind.
    rclpy.get_default_context().destroy()
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _run_in_context(create_node, name, watch):
    from closedloop_dynamics.ros.spinning import build_executor
    from closedloop_dynamics.ros.spinning import spin
    from rclpy.exceptions import NameValidationException
    from rclpy.logging import get_logger
    warnings.showwarning = lambda message, *where: get_logger(name).warning(_one_line(message))
    # From here on there may be something to close, such as a bag: a signal waits until it can be.
    watch.on_stop(_nothing)
    try:
        node = create_node()
    except (StartError, NameValidationException) as error:
        get_logger(name).fatal(_one_line(error))
        return 2
    # What was loaded stays: looking through half a million objects for garbage takes tens of
    # milliseconds, in which nothing is published.
    gc.freeze()
    executor = build_executor()
    executor.add_node(node)
    # An empty task is what makes a waiting spin_once() return.
    watch.on_stop(lambda: executor.create_task(_nothing))
    try:
        spin(executor, lambda: node.exit_code is not None or watch.requested,
             node if hasattr(node, 'take_over') else None)
    finally:
        watch.on_stop(_nothing)
        try:
            node.close()
        finally:
            executor.shutdown()
            node.destroy_node()
    return node.exit_code or 0


def _nothing():
    pass


def _refuse_stray_arguments(argv):
    """Name a plain argument: rclpy would ignore it, and the user wonder."""
    from rclpy.utilities import remove_ros_args
    stray = remove_ros_args(argv)[1:]
    if stray:
        raise StartError(
            f'unexpected argument {stray[0]!r}; parameters are given as '
            f'--ros-args -p NAME:=VALUE, or --ros-args --params-file FILE')


def _one_line(error):
    return ' '.join(str(error).split())
