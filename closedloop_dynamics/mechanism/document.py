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
Load one YAML file as plain data that remembers its lines.

Scalars follow the YAML 1.2 core schema: ``1e-3`` is a number, ``yes``, ``on``
and ``1:30`` are text. A key given twice is an error. Nothing but mappings,
lists, text, numbers, truth values and null can come out: no tags, no objects.

"""

from contextlib import contextmanager
from pathlib import Path
import re

import yaml

from .fields import at, FieldError

# Far above any real description; they stop aliases that expand without end.
DEEPEST = 20
MOST_NODES = 100_000
LONGEST_INTEGER = 400

_TAGS = tuple(f'tag:yaml.org,2002:{kind}' for kind in ('str', 'map', 'seq'))
_SCALARS = (
    (r'~|null|Null|NULL|', lambda word: None),
    (r'true|True|TRUE', lambda word: True),
    (r'false|False|FALSE', lambda word: False),
    (r'[-+]?[0-9]+', lambda word: int(word) if len(word) < LONGEST_INTEGER else float(word)),
    (r'0o[0-7]+|0x[0-9a-fA-F]+', lambda word: int(word, 0)),
    (r'[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?', float),
    (r'[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)', lambda word: float(word.replace('.', ''))),
)


class Document:
    """
    The data of one YAML file, and the line of every key in it.

    Attributes
    ----------
    path : pathlib.Path
    data : object
        Mappings as dict, lists as list, scalars as YAML 1.2 has them.

    """

    def __init__(self, path, error_type):
        """
        Load ``path``; where it cannot be loaded, raise ``error_type``.

        Parameters
        ----------
        path : str or pathlib.Path
            Of the file.
        error_type : type
            The exception that :meth:`errors` turns a FieldError into.

        """
        self.path = Path(path)
        self._error_type = error_type
        self._lines = {(): 1}
        self._nodes = 0
        with self.errors():
            self.data = self._value(self._compose(), ())

    @contextmanager
    def errors(self):
        """Head a FieldError raised in this block by file and line."""
        try:
            yield
        except FieldError as error:
            place = f'{self.path}:{self._line(error.path)}'
            raise self._error_type(f'{place}: {error}') from None

    def _line(self, path):
        """Return the line of a key path, or of the part of it that is in the file."""
        while path not in self._lines:
            path = path[:-1]
        return self._lines[path]

    def _compose(self):
        """Return the root node of the file."""
        try:
            return yaml.compose(self.path.read_text(encoding='utf-8-sig'), Loader=_Loader)
        except OSError as error:
            raise self._error_type(f'{self.path}: expected a YAML file that can be read, '
                                   f'got: {error.strerror or error}') from None
        except UnicodeDecodeError as error:
            raise FieldError('a YAML file in UTF-8', str(error)) from None
        except RecursionError:
            raise FieldError('a YAML file', 'nesting without end') from None
        except yaml.YAMLError as error:
            mark = getattr(error, 'problem_mark', None)
            self._lines[()] = mark.line + 1 if mark else 1
            got = getattr(error, 'problem', None) or str(error).partition('\n')[0]
            raise FieldError('a YAML file', f'a syntax error: {got}',
                             'look for indentation, a missing space after a colon, '
                             'or brackets left open') from None

    def _value(self, node, path):
        """Return the plain data of a node at ``path``."""
        if node is None:
            return None
        self._nodes += 1
        if len(path) > DEEPEST or self._nodes > MOST_NODES:
            raise FieldError('a short description', 'aliases or nesting without end', path=path)
        if node.tag not in _TAGS:
            raise FieldError('plain data', f'the tag {node.tag}', 'remove it', path)
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [self._item(item, (*path, index)) for index, item in enumerate(node.value)]
        return node.value if node.style else _plain(node.value)

    def _item(self, node, path):
        self._lines[path] = node.start_mark.line + 1
        return self._value(node, path)

    def _mapping(self, node, path):
        data = {}
        for key_node, value_node in node.value:
            with at(*path):
                key = self._key(key_node)
            line = key_node.start_mark.line + 1
            if key in data:
                first = self._lines[(*path, key)]
                self._lines[(*path, key)] = line
                raise FieldError('every key once', f'this key again, first given in line {first}',
                                 'rename or remove one', (*path, key))
            self._lines[(*path, key)] = line
            data[key] = self._value(value_node, (*path, key))
        return data

    def _key(self, node):
        if not isinstance(node, yaml.ScalarNode):
            raise FieldError('a key of one word', 'a list or mapping as key')
        return node.value


class _Loader(yaml.SafeLoader):
    """Composes nodes and leaves it to this module what a plain scalar is."""

    yaml_implicit_resolvers = {}


def _plain(word):
    """Return the value of an unquoted scalar by the YAML 1.2 core schema."""
    for pattern, convert in _SCALARS:
        if re.fullmatch(pattern, word):
            return convert(word)
    return word
