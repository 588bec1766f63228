# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the nodes: typed, described, range-checked, with errors in one line."""

import textwrap

from closedloop_dynamics.control.settings import Setting
from closedloop_dynamics.ros.process import StartError
from rcl_interfaces.msg import FloatingPointRange
from rcl_interfaces.msg import IntegerRange
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.exceptions import InvalidParameterValueException
from rclpy.exceptions import ParameterNotDeclaredException
from rclpy.parameter import Parameter as RosParameter

_Type = RosParameter.Type
# What to write on a command line, by the type of the default.
_EXAMPLES = {
    _Type.STRING: 'a string',
    _Type.BOOL: 'true or false',
    _Type.INTEGER: 'a whole number',
    _Type.DOUBLE: 'a number',
    _Type.DOUBLE_ARRAY: 'a list of numbers (write [5.0] or [1.0, 2.5], not 5.0)',
    _Type.STRING_ARRAY: 'a list of strings (write [name_1, name_2])',
}
# Whole numbers serve as floating-point ones.
_WIDER = {_Type.INTEGER: _Type.DOUBLE, _Type.INTEGER_ARRAY: _Type.DOUBLE_ARRAY}
# Width of the text of --help.
_HELP_WIDTH = 96


class Parameter(Setting):
    """A setting as a parameter of a node, with its text for ``ros2 param describe``."""

    @property
    def kind(self):
        """Return the type, as ROS counts them."""
        return _Type.from_parameter_value(self.default)

    def help_text(self):
        """Return the description, as a paragraph of text."""
        change = '; changes at run time' if not self.read_only else ''
        allowed = f'; {self._choices()}' if self.choices else (
            '; {:g} to {:g}'.format(*self.limits) if self.limits else '')
        kind = self.kind.name.lower().replace('_', ' ')
        head = f'{self.name}  ({kind}, default {in_yaml(self.default)}{allowed}{change})'
        return '\n'.join((
            textwrap.fill(head, _HELP_WIDTH, initial_indent='  ', subsequent_indent='      '),
            textwrap.fill(self.description, _HELP_WIDTH, initial_indent='      ',
                          subsequent_indent='      ')))

    def descriptor(self):
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
        """Raise ValueError if a value of the right type is not one of the choices."""
        if self.choices and value not in self.choices:
            raise ValueError(f"parameter '{self.name}': expected one of {self._choices()}; "
                             f"got '{value}'")

    def _choices(self):
        return ', '.join(choice or "''" for choice in self.choices)


# Parameter of every node that reads scenes.
ALLOW_CODE = Parameter(
    'allow_code', [''],
    'Python files that run first: they register effects that the scene names, which runs no code '
    'by itself.')


def declare(node, parameters):
    """
    Declare parameters on a node and return their values by name, lists without empty names.

    A node is given its values on the command line, or by a file. Raises StartError if one has the
    wrong type, is out of range or not a choice.
    """
    return {parameter.name: _declare(node, parameter) for parameter in parameters}


def _declare(node, parameter):
    # A value given at the start can have any type: rclpy passes it to a parameter of no type.
    given = _widened(node.declare_parameter(
        parameter.name, parameter.default, ParameterDescriptor(dynamic_typing=True)),
        parameter.kind)
    node.undeclare_parameter(parameter.name)
    if given.type_ != parameter.kind:
        raise StartError(f"parameter '{parameter.name}': expected {_EXAMPLES[parameter.kind]}")
    try:
        value = node.declare_parameter(
            parameter.name, given.value, parameter.descriptor(), ignore_override=True).value
        parameter.require_choice(value)
    except (InvalidParameterValueException, ValueError) as error:
        raise StartError(str(error)) from None
    return list(filter(None, value)) if parameter.kind == _Type.STRING_ARRAY else value


def _widened(given, kind):
    """Return a given parameter as one of another type, if it holds whole numbers for that."""
    if _WIDER.get(given.type_) != kind:
        return given
    value = given.value
    return RosParameter(given.name, kind, (
        float(value) if kind == _Type.DOUBLE else list(map(float, value))))


def watch_changes(node):
    """
    Accept whole numbers for floating-point parameters, refuse undeclared names; once a node.

    rclpy itself takes an empty name for a declared one, and leaves out the name that it refuses.
    """
    def checked(parameters):
        unknown = [given.name for given in parameters if not node.has_parameter(given.name)]
        if unknown:
            raise ParameterNotDeclaredException(unknown)
        return [_widened(given, _Type(node.describe_parameter(given.name).type))
                for given in parameters]

    node.add_pre_set_parameters_callback(checked)


def usage(name, node_class, parameters):
    """Return the text of ``--help`` of a node's executable and its parameters."""
    return '\n'.join((
        f'usage: {name} [--ros-args [-p NAME:=VALUE ...] [--params-file FILE] '
        '[-r FROM:=TO ...]]', '', node_class.__doc__.split('\n\n')[0].strip(), '', 'Parameters:',
        *(parameter.help_text() for parameter in parameters), '',
        'Topics, services and exit codes: doc/interface.md.'))


def in_yaml(value):
    """Return a value of a parameter as one writes it on a command line."""
    if isinstance(value, list):
        return f'[{", ".join(map(in_yaml, value))}]'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value or "''"
    return '.nan' if value != value else str(value)


def declare_fact(node, name, values, description):
    """
    Declare a read-only list of strings that the node publishes.

    An empty list is declared as a parameter without a value: rclpy takes an
    empty Python list for an array of bytes.
    """
    descriptor = ParameterDescriptor(description=description, read_only=True)
    node.declare_parameter(
        name, list(values) if values else RosParameter.Type.STRING_ARRAY, descriptor,
        ignore_override=True)
