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
What deals with singular configurations, compiled before a live simulation meets one.

It takes half a minute to compile, and most runs never need it. So the node begins without, and
another process compiles it meanwhile, once for an installation.

"""

import sys
import time

from closedloop_dynamics.integration import ahead
from closedloop_dynamics.ros.child import start_child
from rclpy.clock import Clock
from rclpy.clock import ClockType

# A node that ends sooner has not begun to compile anything [s].
DELAY = 5.0
# Between two looks whether the process has ended [s].
LOOK = 1.0
COMMAND = (sys.executable, '-m', 'closedloop_dynamics.ros.prepare')


class Preparation:
    """
    Gets the rank-revealing path ready: from disk at once, or in the background.

    Parameters
    ----------
    node : simulator_node.SimulatorNode
        With its simulation.
    scene : str
        Name or path, as the node was given it.

    """

    def __init__(self, node, scene):
        self._node, self._scene = node, scene
        self._process = self._timer = self._began = None
        self._left = ahead.preparations(node.simulation.system)
        if ahead.is_stored(node.simulation.system):
            while self._left:
                self._left.pop()()
        else:
            self._again_after(DELAY, self.start)

    def start(self):
        """Start the process that compiles."""
        self._began = time.monotonic()
        try:
            self._process = start_child(*COMMAND, self._scene)
        except OSError as error:
            self._give_up(str(error))
            return
        self._node.get_logger().info(
            'compiling in the background what deals with singular configurations (once for an '
            'installation, about a minute)')
        self._again_after(LOOK, self.look)

    def look(self):
        """Load what was compiled, one kernel at a time, for that takes 0.05 s each."""
        code = self._process.poll()
        if code is None:
            return
        if code != 0:
            self._give_up(f'exit code {code}')
        elif self._left:
            self._left.pop()()
        else:
            self._stop_timer()
            self._node.get_logger().info(
                f'singular configurations: ready after {time.monotonic() - self._began:.0f} s')

    def close(self):
        """End the process, if it still runs."""
        self._stop_timer()
        if self._process is not None and self._process.poll() is None:
            self._process.kill()
            self._process.wait()

    def _give_up(self, reason):
        self._stop_timer()
        self._node.get_logger().warning(
            f'what deals with singular configurations could not be compiled ahead ({reason}): '
            'the simulation will stand still for about a minute where it first meets one')

    def _again_after(self, period, action):
        self._stop_timer()
        self._timer = self._node.create_timer(
            period, action, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _stop_timer(self):
        if self._timer is not None:
            self._node.destroy_timer(self._timer)
            self._timer = None
