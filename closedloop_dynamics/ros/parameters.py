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

"""Parameters of the nodes: typed, described, range-checked, with errors in one line."""

from dataclasses import dataclass
import math
from typing import Any, Optional, Tuple

from closedloop_dynamics.ros.process import StartError
from rcl_interfaces.msg import FloatingPointRange
from rcl_interfaces.msg import IntegerRange
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.exceptions import InvalidParameterValueException
from rclpy.parameter import Parameter as RosParameter

# What to write on a command line, by the type of the default.
_EXAMPLES = {
    RosParameter.Type.STRING: 'a string',
    RosParameter.Type.BOOL: 'true or false',
    RosParameter.Type.INTEGER: 'a whole number',
    RosParameter.Type.DOUBLE: 'a floating-point number (write 5.0, not 5)',
    RosParameter.Type.DOUBLE_ARRAY:
        'a list of floating-point numbers (write [5.0] or [1.0, 2.5], not 5 or [5])',
    RosParameter.Type.STRING_ARRAY: 'a list of strings (write [name_1, name_2])',
}


@dataclass(frozen=True)
class Parameter:
    """
    One parameter of a node.

    Attributes
    ----------
    name : str
    default : object
        Its type is the type of the parameter.
    description : str
        One or two sentences with the unit, for ``ros2 param describe``.
    limits : tuple of 2 numbers, optional
        Smallest and largest value of a floating-point or integer parameter.
    choices : tuple of str
        Values of a string parameter; empty: any string.
    read_only : bool
        Whether the value is fixed once the node runs.

    """

    name: str
    default: Any
    description: str
    limits: Optional[Tuple[float, float]] = None
    choices: Tuple[str, ...] = ()
    read_only: bool = True

    def descriptor(self):
        """Return the ParameterDescriptor."""
        descriptor = ParameterDescriptor(
            description=self.description, read_only=self.read_only)
        if self.limits is not None:
            smallest, largest = self.limits
            if isinstance(self.default, int):
                descriptor.integer_range = [
                    IntegerRange(from_value=smallest, to_value=largest, step=1)]
            else:
                descriptor.floating_point_range = [
                    FloatingPointRange(from_value=smallest, to_value=largest)]
        if self.choices:
            descriptor.additional_constraints = f'One of: {self._choices()}.'
        return descriptor

    def require_choice(self, value):
        """
        Refuse what is none of the choices.

        Parameters
        ----------
        value : object
            Of the right type.

        Raises
        ------
        ValueError

        """
        if self.choices and value not in self.choices:
            raise ValueError(f"parameter '{self.name}': expected one of {self._choices()}; "
                             f"got '{value}'")

    def _choices(self):
        return ', '.join(choice or "''" for choice in self.choices)


def declare(node, parameters):
    """
    Declare parameters on a node and return their values.

    Parameters
    ----------
    node : rclpy.node.Node
        Given its values on the command line, or by a file.
    parameters : iterable of Parameter
        What to declare.

    Returns
    -------
    dict
        Name to value.

    Raises
    ------
    StartError
        If a given value has the wrong type, is out of range or not a choice.

    """
    return {parameter.name: _declare(node, parameter) for parameter in parameters}


def _declare(node, parameter):
    try:
        value = node.declare_parameter(
            parameter.name, parameter.default, parameter.descriptor()).value
    except InvalidParameterTypeException:
        kind = RosParameter.Type.from_parameter_value(parameter.default)
        raise StartError(
            f"parameter '{parameter.name}': expected {_EXAMPLES[kind]}") from None
    except InvalidParameterValueException as error:
        raise StartError(str(error)) from None
    try:
        parameter.require_choice(value)
    except ValueError as error:
        raise StartError(str(error)) from None
    return value


def declare_fact(node, name, values, description):
    """
    Declare a read-only list of strings that the node tells and nobody sets.

    An empty list is declared as a parameter without a value: rclpy takes an
    empty Python list for an array of bytes.

    """
    descriptor = ParameterDescriptor(description=description, read_only=True)
    node.declare_parameter(
        name, list(values) if values else RosParameter.Type.STRING_ARRAY, descriptor,
        ignore_override=True)


def per_joint(name, values, joints, nan_allowed=False):
    """
    Spread a list parameter over joints.

    Parameters
    ----------
    name : str
        Of the parameter, for messages.
    values : sequence of float
        One value for all joints, or one for each.
    joints : sequence of str
        Names, for messages.
    nan_allowed : bool
        Whether NaN is a value.

    Returns
    -------
    list of float
        One value per joint.

    Raises
    ------
    StartError
        If the length fits neither, or a value is not finite.

    """
    if not all(math.isfinite(value) or nan_allowed and math.isnan(value) for value in values):
        raise StartError(
            f"parameter '{name}': expected {'no infinite' if nan_allowed else 'finite'} "
            f'numbers, got {list(values)}')
    if len(values) == 1:
        return [values[0]] * len(joints)
    if len(values) != len(joints):
        raise StartError(
            f"parameter '{name}': expected 1 value, or {len(joints)} in the order "
            f'{", ".join(joints)}; got {len(values)}')
    return list(values)
