# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Controllers from files: those shipped for a mechanism, and others in the same form."""

from .controller import closed_loop, open_loop
from .errors import StartError
from .references import PathError
from .settings import FEEDBACK_MODES, SETTINGS
from ..mechanism.checks import list_of, number, one_of, text
from ..mechanism.config import shipped_names, shipped_path
from ..mechanism.document import Document
from ..mechanism.errors import SimulationError
from ..mechanism.fields import at, FieldError, mapping, shown
from ..simulation.simulation import Simulation

KIND = 'controllers'
# The node whose parameters a file has, and parameters of nodes that set no controller.
NODE, PARAMETERS = 'closedloop_torque_source', 'ros__parameters'
OF_NODES = ('allow_code', 'use_sim_time')


class Controller:
    """
    A controller of a simulation: torques from states.

    Parameters
    ----------
    name : str
        For people.
    values : dict
        Of ``settings.SETTINGS``, as ``read_controller`` returns them.
    scene : simulation.scene_records.Scene
        The scene to control. The controller has a model of it for itself.

    Attributes
    ----------
    name : str
    joints : tuple of str
        Driven joints.

    Raises
    ------
    StartError
        Where the controller does not fit the scene.

    """

    def __init__(self, name, values, scene):
        self.name, self._values, self._model = name, values, Simulation(scene)
        self.joints = self._model.actuated_joints
        driven = [cut.name for cut in self._model.mechanism.cut_joints if cut.actuated]
        if driven or not self.joints:
            raise StartError(f'{name}: expected joints of the tree to drive, got '
                             f'{driven[0] if driven else "none"}')
        self._singles = values['mode'] not in FEEDBACK_MODES
        self._by_joint = values['mode'] == 'pd'
        if self._singles:
            self._law = open_loop(values, self.joints)
        else:
            self._law = closed_loop(values, self.joints,
                                    None if self._by_joint else self._model)

    def on(self, scene):
        """Return the same for another scene; raise StartError where it does not fit."""
        return Controller(self.name, self._values, scene)

    def restart(self):
        """Treat the next state as the first one."""
        if not self._singles:
            self._law.restart()

    def torques(self, time, position, velocity):
        """
        Return the torques by joint [N m or N], at a time [s].

        ``position``, ``velocity``: of all joints, shapes (nq,) and (nv,) [rad or m, rad/s or m/s].
        """
        if self._singles:
            found = self._law(time)
        elif self._by_joint:
            places = self._model.data.actuated
            found = self._law.torque(
                time, self._model.coordinates.by_freedom(position)[places], velocity[places])
        else:
            found = self._law.torque(time, position, velocity)
        return dict(zip(self.joints, found.tolist()))

    def know(self, name, enabled, values):
        """Change an effect of the controller's model, as ``Simulation.set_effect``."""
        self._model.set_effect(name, enabled, **values)


def read_controller(path):
    """
    Return the settings in a file of parameters, those not given at their defaults.

    StartError where the file is not that of a controller.
    """
    document = Document(path, StartError)
    with document.errors():
        nodes = [key for key in mapping(document.data) if key.rpartition('/')[2] == NODE]
        if len(nodes) != 1:
            raise FieldError(f'parameters of one {NODE}', f'{len(nodes)} of them')
        with at(nodes[0]):
            section = mapping(document.data[nodes[0]], (PARAMETERS,))
            with at(PARAMETERS):
                return _settings(mapping(section[PARAMETERS]))


def _settings(given):
    known = {setting.name: setting for setting in SETTINGS}
    values = {name: setting.default for name, setting in known.items()}
    for key, value in given.items():
        with at(key):
            if key in OF_NODES:
                continue
            one_of(tuple(known), 'one of the settings')(key)
            values[key] = _checked(known[key], value)
    return values


def _checked(setting, value):
    """Return a value as the default of a setting is."""
    if isinstance(setting.default, str):
        return one_of(setting.choices)(value) if setting.choices else text(value)
    if isinstance(setting.default, list):
        return list(list_of(text if isinstance(setting.default[0], str) else number)(value))
    if isinstance(setting.default, int) and type(value) is not int:
        raise FieldError('a whole number', shown(value))
    value = value if isinstance(setting.default, int) else number(value)
    if setting.limits and not setting.limits[0] <= value <= setting.limits[1]:
        raise FieldError('{:g} to {:g}'.format(*setting.limits), f'{value:g}')
    return value


def shipped_controller(scene, model=None):
    """
    Return the shipped controller of a scene, or None.

    That is one made for the scene, or for another one of the same mechanism that can follow it
    from the start of this one. Its model is that of another scene where one is given: with more
    effects, say.
    """
    if not scene.mechanism.actuated_joints:
        return None
    fitting, others = [], []
    for name in shipped_names(KIND):
        values = read_controller(shipped_path(KIND, name))
        if values['scene'] == scene.name:
            fitting.append((name, values))
        elif _mechanism_of(values['scene']) == scene.mechanism.name:
            others.append((name, values))
    for name, values in fitting + others:
        try:
            return Controller(name, values, scene if model is None else model)
        except (StartError, PathError, SimulationError):
            # From another start the path may lead elsewhere.
            continue
    return None


def _mechanism_of(scene):
    return Document(shipped_path('scenes', scene), StartError).data.get('mechanism')
