# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Effects of a running simulation as parameters ``effects.NAME.KEY``, and forces from topics."""

from dataclasses import fields
from functools import partial

from closedloop_dynamics.effects.external_force import ExternalForce
from closedloop_dynamics.effects.registry import effect_type
from closedloop_dynamics.mechanism.errors import StiffnessError
from closedloop_dynamics.ros.pacing import Throttle
from closedloop_dynamics.ros.process import StartError
from geometry_msgs.msg import Vector3
from rcl_interfaces.msg import ParameterDescriptor
from rcl_interfaces.msg import SetParametersResult
from rclpy.parameter import Parameter

ENABLED, FORCE = 'enabled', 'force'


class EffectParameters:
    """
    Declares the parameters of all listed effects; changes act from the next step on.

    ``effects.NAME.enabled`` switches an effect, ``effects.NAME.KEY`` sets one of its values,
    ``effects.NAME.KEY.ENTRY`` one that has a name of its own there (``parameters.stiffness``). An
    impossible value is refused with the reason; what is set together is checked together.
    A force also follows ``geometry_msgs/Vector3`` on the topic ``effects/NAME/force`` [N].
    Raises StartError where a value given at the start is refused.
    """

    def __init__(self, node, simulation):
        self._simulation, self._logger, self._do = simulation, node.get_logger(), node.do
        self._rejection = Throttle()
        given = [parameter for name, record in simulation.effects.items()
                 for parameter in self._declare(node, name, record)]
        try:
            self._apply(given)
        except (ValueError, StiffnessError) as error:
            raise StartError(str(error)) from None
        node.add_on_set_parameters_callback(self._check)
        node.add_post_set_parameters_callback(self._on_set)
        self._subscriptions = [
            node.create_subscription(
                Vector3, f'effects/{name}/{FORCE}',
                lambda message, name=name: self.on_force(name, message), 10)
            for name, record in simulation.effects.items() if isinstance(record, ExternalForce)]

    def _declare(self, node, name, record):
        """Declare the parameters of one effect; return those that differ from the scene."""
        kind = effect_type(record)
        descriptor = ParameterDescriptor(
            description=f'Whether the effect {name!r} ({kind}) is simulated.')
        values = {ENABLED: (name in self._simulation.data.enabled_effects, descriptor)}
        for field in fields(record):
            value = getattr(record, field.name)
            # A whole number serves as a number, and nothing as no limit.
            about = ParameterDescriptor(
                description=f'{field.name} of the effect {name!r} ({kind}), SI units; see '
                            'doc/effects.md.',
                dynamic_typing=True)
            if isinstance(value, dict):
                values.update({f'{field.name}.{key}': (one, about) for key, one in value.items()
                               if isinstance(one, (float, str))})
            else:
                values[field.name] = list(value) if isinstance(value, tuple) else value, about
        declared = [node.declare_parameter(f'effects.{name}.{key}', value, about)
                    for key, (value, about) in values.items()]
        return [parameter for parameter, (value, _) in zip(declared, values.values())
                if _plain(parameter) != value]

    def _changes(self, parameters):
        """Return the new values of each effect, by its name."""
        changes = {}
        for parameter in parameters:
            start, _, rest = parameter.name.partition('.')
            name, _, key = rest.partition('.')
            if start == 'effects' and name in self._simulation.effects:
                values, (key, _, entry) = changes.setdefault(name, {}), key.partition('.')
                if entry:
                    values.setdefault(key, dict(getattr(self._simulation.effects[name], key)))[
                        entry] = _plain(parameter)
                else:
                    values[key] = _plain(parameter)
        return changes

    def _check(self, parameters):
        try:
            for name, values in self._changes(parameters).items():
                self._simulation.stepping.check_effect(name, **values)
        except (ValueError, StiffnessError) as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    def _apply(self, parameters):
        for name, values in self._changes(parameters).items():
            self._simulation.set_effect(name, **values)

    def _on_set(self, parameters):
        """Apply checked changes; effects checked one by one may be too stiff together."""
        try:
            self._apply(parameters)
        except StiffnessError as error:
            self._logger.error(f'A change of effects is not followed: {error}')

    def on_force(self, name, message):
        """Apply a force from a topic, or refuse it."""
        self._do(partial(self._act, name, message))

    def _act(self, name, message):
        force = (message.x, message.y)
        if not self._simulation.mechanism.planar:
            force = (*force, message.z)
        try:
            self._simulation.set_effect(name, **{FORCE: force})
        except ValueError as error:
            if self._rejection.ready():
                self._logger.warning(f'effects/{name}/{FORCE} rejected: {error}')


def _plain(parameter):
    """Return a parameter's value with lists for arrays; None where it has none."""
    if parameter.type_ == Parameter.Type.NOT_SET:
        return None
    value = parameter.value
    return value if isinstance(value, (bool, int, float, str)) else list(value)
