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

"""Definitions of message types, for a bag that can be read without them."""

from importlib import import_module
from pathlib import Path

from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg
from rosbags.typesys import get_typestore
from rosbags.typesys import Stores
from rosbags.typesys import TypesysError


class UnknownTypeError(LookupError):
    """A message type that is not installed here."""


class MessageTypes:
    """
    Message types by name: their Python classes and their definitions.

    The definitions of Jazzy's own messages come with ``rosbags``; others are
    read from the ``.msg`` files installed with their package.

    Attributes
    ----------
    typestore : rosbags.typesys.store.Typestore
        Holds every type that ``message_class`` returned.

    """

    def __init__(self):
        self.typestore = get_typestore(Stores.ROS2_JAZZY)

    def message_class(self, name):
        """
        Return the class of a type and make sure of its definition.

        Parameters
        ----------
        name : str
            ``package/msg/Type``.

        Returns
        -------
        type

        Raises
        ------
        UnknownTypeError
            If the type, or one it is made of, is not installed here.

        """
        self._define(name)
        package, _, type_name = name.split('/')
        try:
            return getattr(import_module(f'{package}.msg'), type_name)
        except (ImportError, AttributeError) as error:
            raise UnknownTypeError(f'{name} has no Python messages here ({error})') from None

    def _define(self, name):
        if name in self.typestore.fielddefs:
            return
        try:
            types = get_types_from_msg(_definition_path(name).read_text(), name)
        except (OSError, TypesysError) as error:
            raise UnknownTypeError(f'{name} has no readable definition ({error})') from None
        self.typestore.register(types)
        for _, fields in types.values():
            for _, description in fields:
                self._define_nested(description)

    def _define_nested(self, description):
        kind, detail = description
        if kind == Nodetype.NAME:
            self._define(detail)
        elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            self._define_nested(detail[0])


def _definition_path(name):
    """Return the ``.msg`` file of a type, in share/ of the prefix its Python package is in."""
    package, _, type_name = name.split('/')
    try:
        module = Path(import_module(package).__file__).resolve()
    except ImportError:
        raise UnknownTypeError(f'{name}: package {package} is not installed here') from None
    for prefix in module.parents:
        path = prefix / 'share' / package / 'msg' / f'{type_name}.msg'
        if path.is_file():
            return path
    raise UnknownTypeError(f'{name}: no {type_name}.msg in share/{package} above {module.parent}')
