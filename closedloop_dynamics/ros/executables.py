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
Entry points of the executables.

Each watches for signals before it imports its node: the import takes seconds,
and Ctrl-C must not end in a traceback there either. And each leaves without Python's own
clean-up, which takes seconds, too, with all that was compiled.

"""

from closedloop_dynamics.ros.process import leave, watch_signals


def simulator():
    """Run ``closedloop_simulator``; end the process with its exit code."""
    watch_signals()
    from closedloop_dynamics.ros.simulator_node import main
    leave(main())


def torque_source():
    """Run ``closedloop_torque_source``; end the process with its exit code."""
    watch_signals()
    from closedloop_dynamics.ros.torque_source_node import main
    leave(main())


def recorder():
    """Run ``closedloop_recorder``; end the process with its exit code."""
    watch_signals()
    from closedloop_dynamics.ros.recorder_node import main
    leave(main())
