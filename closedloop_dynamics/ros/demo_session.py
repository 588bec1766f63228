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

"""One scene of the demonstration: its nodes started, let run, and stopped."""

import math
import signal
import time

from closedloop_dynamics.ros.demo_drive import RECORDER, SIMULATOR, TORQUE_SOURCE
from closedloop_dynamics.ros.demo_observer import Observer
from closedloop_dynamics.ros.demo_processes import Programs
from closedloop_dynamics.studies.progress import progress_bar

# For nodes that compile at their first start, and for nodes that only have to find each other [s].
COMPILING, FINDING = 600.0, 60.0


def run_nodes(scene, drive, namespace, duration, directory):
    """
    Let simulator, torque source and recorder run, each in a process of its own.

    Parameters
    ----------
    scene : scene.Scene
        What is simulated.
    drive : demo_drive.Drive
        What drives it.
    namespace : str
        For all nodes.
    duration : float
        Of the motion [s].
    directory : pathlib.Path
        For the bag and the logs.

    Returns
    -------
    str
        What the simulator said last.

    Raises
    ------
    DemoError
        Where a node ended early, or badly, or did not get going.

    """
    here = ('-r', f'__ns:={namespace}')
    cuts = [cut.name for cut in scene.mechanism.cut_joints]
    with Programs(directory) as programs, \
            Observer(namespace, cuts, programs.check) as observer:
        recorder = programs.start(RECORDER, (*here, '-p', f'output:={directory / "bag"}'))
        observer.wait(lambda: observer.is_followed_by(RECORDER), f'the start of {RECORDER}',
                      FINDING)
        simulator = programs.start(
            SIMULATOR, (*here, *drive.simulator_arguments, '-p', f'scene:={scene.path.resolve()}'))
        observer.wait(lambda: observer.seen['joint_states'], f'the start of {SIMULATOR}',
                      COMPILING)
        observer.wait(
            lambda: all(recorder.says(f'/{topic}: first message') for topic in
                        ('joint_states', *(f'constraint_forces/{cut}' for cut in cuts))),
            f'the first messages at {RECORDER}', FINDING)
        source = None
        if drive.parameters:
            # It begins when simulator, recorder and the observer here hear it.
            source = programs.start(
                TORQUE_SOURCE, (*here, *drive.arguments, '-p', 'wait_for_subscribers:=3'))
            observer.wait(lambda: observer.seen['torque_command'], 'the first torque', COMPILING)
        observer.stop_listening()
        _let_run(observer, duration, scene.name)
        # The recorder first: what the simulator does without its torques is no part of the show.
        recorder.stop(signal.SIGINT)
        simulator.stop(signal.SIGINT)
        if source is not None:
            source.stop(signal.SIGTERM)
        return simulator.last_words()


def _let_run(observer, duration, name):
    """Wait for the motion to last as long as it should, watching the processes."""
    begin = time.monotonic()
    with progress_bar(duration, 's', name) as bar:

        def over():
            elapsed = time.monotonic() - begin
            bar.update(min(elapsed, duration) - bar.n)
            return elapsed >= duration

        observer.wait(over, 'the end', math.inf)
