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

"""Parameters of the simulator that may change while it runs."""

from dataclasses import replace

from closedloop_dynamics.ros.modes import period_steps
from closedloop_dynamics.ros.process import leaving_at_once
from closedloop_dynamics.ros.simulator_parameters import REALTIME, SIMULATOR_PARAMETERS
from closedloop_dynamics.simulation.errors import SimulationError
from closedloop_dynamics.simulation.scene import load_scene
from rcl_interfaces.msg import SetParametersResult

METHOD = ('integrator', 'step_size', 'stabilisation')
CHANGEABLE = {
    parameter.name: parameter for parameter in SIMULATOR_PARAMETERS if not parameter.read_only}


class RunParameters:
    """
    Checks changes together, and lets them take effect together.

    Parameters
    ----------
    node : simulator_node.SimulatorNode
        What they change.
    scene : str
        Name or path: what it says itself holds where a value is left empty.

    """

    def __init__(self, node, scene):
        self._node, self._own = node, load_scene(scene).method
        self._prepared = None
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._apply)

    def _values(self, parameters):
        return {parameter.name: parameter.value for parameter in parameters
                if parameter.name in CHANGEABLE}

    def _check(self, parameters):
        """Refuse what is impossible; compile a method that is not in use yet."""
        self._prepared = None
        values = self._values(parameters)
        try:
            for name, value in values.items():
                CHANGEABLE[name].require_choice(value)
            changes = self._method_changes(values)
            self._require_whole_periods(values, changes)
            if changes:
                self._prepared = self._prepare(changes)
        except (ValueError, SimulationError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _method_changes(self, values):
        """Return what changes of the method in use."""
        used = self._node.simulation.scene.method
        wanted = {key: values[key] or getattr(self._own, key) for key in METHOD if key in values}
        changes = {key: value for key, value in wanted.items() if value != getattr(used, key)}
        # Refuses what makes no sense.
        replace(used, **changes)
        return changes

    def _require_whole_periods(self, values, changes):
        node = self._node
        if node.mode.name != REALTIME and ('publish_rate' in values or 'step_size' in changes):
            period_steps(values.get('publish_rate', node.get_parameter('publish_rate').value),
                         changes.get('step_size', node.simulation.step_size))

    def _prepare(self, changes):
        node = self._node
        node.get_logger().info(
            'taking another method: ' + ', '.join(f'{k} {v}' for k, v in changes.items())
            + ' (time stands still while it compiles, if it has not been used before)')
        with node.standing_still(), leaving_at_once():
            return node.simulation.prepare_method(**changes)

    def _apply(self, parameters):
        node, values = self._node, self._values(parameters)
        if self._prepared is not None and set(values) & set(METHOD):
            take_effect, self._prepared = self._prepared, None
            with node.standing_still():
                take_effect()
            node.pacer.step_size = node.simulation.step_size
        if 'real_time_factor' in values:
            node.pacer.real_time_factor = values['real_time_factor']
        node.command_timeout = values.get('command_timeout', node.command_timeout)
        node.control.step_count = values.get('step_count', node.control.step_count)
        if 'keep_core_awake' in values:
            node.keep_core_awake = values['keep_core_awake']
            node.attend_to_core()
        if {'publish_rate', 'step_size'} & set(values):
            node.mode.set_rate(node.get_parameter('publish_rate').value)
            node.renew_timer()
