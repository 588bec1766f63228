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

"""Ask another node for its list of actuated joints."""

import time

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters

PARAMETER = 'actuated_joints'
# A question without an answer for so long is asked again: the node asked may
# have gone in between [s].
ANSWER_TIMEOUT = 0.5


class JointQuestion:
    """
    The parameter ``actuated_joints`` of a simulator node, asked for until it answers.

    Parameters
    ----------
    node : rclpy.node.Node
        Who asks.
    simulator : str
        Name of the node asked, relative to the asking node's namespace.

    Attributes
    ----------
    answer : tuple of str or None
        None as long as there is none.

    """

    def __init__(self, node, simulator):
        self.answer = None
        self._client = node.create_client(GetParameters, f'{simulator}/get_parameters')
        self._pending = None
        self._asked = None

    def ask(self):
        """Send the question if that makes sense now; to be called again and again."""
        now = time.monotonic()
        if self._pending is not None:
            if now - self._asked < ANSWER_TIMEOUT:
                return
            self._client.remove_pending_request(self._pending)
            self._pending = None
        if self._client.service_is_ready():
            self._asked = now
            self._pending = self._client.call_async(GetParameters.Request(names=[PARAMETER]))
            self._pending.add_done_callback(self._on_answer)

    def _on_answer(self, future):
        values = future.result().values
        self._pending = None
        # A node without the parameter, or a simulator that is still
        # starting, answers with a value that is not set.
        if values and values[0].type == ParameterType.PARAMETER_STRING_ARRAY:
            self.answer = tuple(values[0].string_array_value)
