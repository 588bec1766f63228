# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Load one YAML file as plain data that remembers its lines.

Scalars follow the YAML 1.2 core schema: ``1e-3`` is a number, ``yes``, ``on``
and ``1:30`` are text. A key given twice is an error. Nothing but mappings,
lists, text, numbers, truth values and null can come out: no tags, no objects.
Size and nesting are limited while the file is read, not afterwards.
"""

from collections.abc import Mapping
from contextlib import contextmanager
import json
import math
from pathlib import Path
import re

import numpy as np
import yaml

from .fields import at, FieldError
from .files import read_file

# Formats of models that are not read, by how a file's name ends.
UNREAD = {'.osim': 'OpenSim', **dict.fromkeys(('.usd', '.usda', '.usdc', '.usdz'), 'USD'),
          '.mo': 'Modelica', '.fmu': 'FMI', '.lua': 'Lua', '.biomod': 'bioMod',
          '.slx': 'Simulink', '.mdl': 'Simulink', '.adm': 'Adams', '.cmd': 'Adams'}
DEEPEST = 20
MOST_VALUES = 100_000
MOST_BYTES = 4_000_000
LONGEST_INTEGER = 400

_TAGS = (None, '!', *(f'tag:yaml.org,2002:{kind}' for kind in ('str', 'map', 'seq')))


def _integer(base):
    def convert(word):
        # What no float can hold; Python would refuse to write it in decimal digits, too.
        if len(word) > LONGEST_INTEGER:
            return -math.inf if word[0] == '-' else math.inf
        return int(word, base)
    return convert


_SCALARS = tuple((re.compile(pattern), convert) for pattern, convert in (
    (r'~|null|Null|NULL|', lambda word: None),
    (r'true|True|TRUE', lambda word: True),
    (r'false|False|FALSE', lambda word: False),
    (r'[-+]?[0-9]+', _integer(10)),
    (r'0o[0-7]+|0x[0-9a-fA-F]+', _integer(0)),
    (r'[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?', float),
    (r'[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)', lambda word: float(word.replace('.', ''))),
))
# Numbers that YAML 1.1 takes for text, and keys of what is text in any case.
_EXPONENT = re.compile(r'[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)[eE][-+]?[0-9]+')
_TEXTS = ('description', 'arguments')
_WORD = re.compile(r'[A-Za-z_][A-Za-z0-9_. -]*(?<! )')


class Document:
    """
    The data of one YAML file, its path, and the line of every key in it.

    Mappings are dicts, sequences lists, scalars as YAML 1.2 has them.
    """

    def __init__(self, path, error_type, text=None):
        """
        Load ``path``, or ``text``, which it need not exist for.

        Where that fails, and where :meth:`errors` meets a FieldError, ``error_type`` is raised.
        """
        self.path = Path(path)
        self._error_type = error_type
        self._lines = {(): 1}
        kind = UNREAD.get(self.path.suffix.lower())
        if kind is not None:
            raise error_type(
                f'{str(self.path)!r}'[1:-1] + ': expected a YAML file, or a model in URDF, xacro, '
                f'SDF or MJCF (.urdf, .xacro, .sdf, .world, .mjcf, .xml), got {kind}, which is '
                'not read: convert it to one of these first')
        with self.errors():
            try:
                self.data = self._root(self._text() if text is None else _bounded(text))
            except yaml.YAMLError as error:
                mark = getattr(error, 'problem_mark', None)
                self._lines[()] = mark.line + 1 if mark else 1
                got = getattr(error, 'problem', None) or str(error).partition('\n')[0]
                raise _syntax_error(got) from None

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

    def _text(self):
        """Return the contents of the file."""
        try:
            content = read_file(self.path, MOST_BYTES)
        except (OSError, ValueError) as error:
            reason = getattr(error, 'strerror', None) or getattr(error, 'reason', None) or error
            raise self._error_type(f'{str(self.path)!r}'[1:-1] + ': expected a YAML file that '
                                   f'can be read, got: {reason}') from None
        if len(content) > MOST_BYTES:
            raise FieldError(f'a file of at most {MOST_BYTES} bytes', 'a larger one')
        try:
            return content.decode('utf-8-sig')
        except UnicodeDecodeError as error:
            raise FieldError('a YAML file in UTF-8', str(error)) from None

    def _root(self, text):
        """Return the data of the only document in ``text``."""
        self._events = yaml.parse(text, Loader=yaml.CSafeLoader)
        self._read, self._again, self._anchors, self._values = [], [], {}, 0
        self._next()    # the start of the stream
        if isinstance(self._next(), yaml.StreamEndEvent):
            return None
        data = self._value(self._next(), ())
        self._next()    # the end of the document
        after = self._next()
        if not isinstance(after, yaml.StreamEndEvent):
            self._lines[()] = after.start_mark.line + 1
            raise _syntax_error('another document')
        return data

    def _next(self):
        """Return the next event; of an alias, the first one of its anchor."""
        event = self._again.pop() if self._again else next(self._events)
        if isinstance(event, yaml.AliasEvent):
            if event.anchor not in self._anchors:
                self._lines[()] = event.start_mark.line + 1
                raise _syntax_error(f'the alias *{event.anchor} of nothing before it')
            first, end = self._anchors[event.anchor]
            if end is None:
                raise FieldError('a short description', 'aliases without end')
            self._again += reversed(self._read[first:end])
            event = self._again.pop()
        self._read.append(event)
        return event

    def _value(self, event, path):
        """Return the plain data at ``path``, which begins with ``event``."""
        self._values += 1
        if self._values > MOST_VALUES:
            raise FieldError(f'at most {MOST_VALUES} values, aliases counted as what they stand '
                             'for', 'more', path=path)
        if len(path) > DEEPEST:
            raise FieldError(f'a nesting of at most {DEEPEST} levels', 'a deeper one', path=path)
        with at(*path):
            _require_plain(event)
        first = len(self._read) - 1
        if event.anchor is not None:
            self._anchors[event.anchor] = first, None
        if isinstance(event, yaml.MappingStartEvent):
            data = self._mapping(path)
        elif isinstance(event, yaml.SequenceStartEvent):
            data = self._sequence(path)
        else:
            data = _plain(event.value) if event.implicit[0] else event.value
        if event.anchor is not None:
            self._anchors[event.anchor] = first, len(self._read)
        return data

    def _sequence(self, path):
        data = []
        while not isinstance(event := self._next(), yaml.SequenceEndEvent):
            place = (*path, len(data))
            self._lines[place] = event.start_mark.line + 1
            data.append(self._value(event, place))
        return data

    def _mapping(self, path):
        data = {}
        while not isinstance(event := self._next(), yaml.MappingEndEvent):
            with at(*path):
                key = self._key(event)
            line = event.start_mark.line + 1
            if key in data:
                first = self._lines[(*path, key)]
                self._lines[(*path, key)] = line
                raise FieldError('every key once', f'this key again, first given in line {first}',
                                 'rename or remove one', (*path, key))
            self._lines[(*path, key)] = line
            data[key] = self._value(self._next(), (*path, key))
        return data

    def _key(self, event):
        if not isinstance(event, yaml.ScalarEvent):
            raise FieldError('a key of one word', 'a list or mapping as key')
        _require_plain(event)
        return event.value


def plain(value):
    """
    Return data that were built in Python as a file would have them, as a copy.

    Mappings become dict, sequences and arrays lists, numbers of NumPy those of Python, and text
    such as ``'1e6'``, which readers of YAML 1.1 leave of a number, numbers; anything else stays as
    it is.
    """
    if isinstance(value, Mapping):
        return {key: one if key in _TEXTS else plain(one) for key, one in value.items()}
    if isinstance(value, str) and _EXPONENT.fullmatch(value):
        return float(value)
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, (list, tuple)):
        return [plain(one) for one in value]
    return value


def _bounded(text):
    if len(text.encode('utf-8', 'replace')) > MOST_BYTES:
        raise FieldError(f'a file of at most {MOST_BYTES} bytes', 'a larger one')
    return text


def with_scalars(text, values):
    """
    Return YAML with some scalars replaced; all else, comments included, is unchanged.

    ``values``: what is written in the place of a scalar, by keys, with places in lists as numbers
    in text. None where one of them stands nowhere in the text, or within what an alias repeats.
    """
    root, places = _composed(text), []
    for keys, value in values.items():
        node = _node(root, keys)
        if not isinstance(node, yaml.ScalarNode):
            return None
        places.append((node.start_mark.index, node.end_mark.index, value))
    for start, end, value in sorted(places, reverse=True):
        text = text[:start] + value + text[end:]
    return text


def _composed(text):
    """Return the root of YAML, and the nodes that stand for several places, by identity."""
    root, seen, shared = yaml.compose(text, Loader=yaml.SafeLoader), set(), {}

    def visit(node):
        if id(node) in seen:
            shared[id(node)] = node
            return
        seen.add(id(node))
        for below in node.value if isinstance(node, yaml.CollectionNode) else ():
            for one in below if isinstance(below, tuple) else (below,):
                visit(one)

    if root is not None:
        visit(root)
    return root, shared


def _node(composed, keys):
    """Return the node of a key path; None where there is none, or it stands for others, too."""
    node, shared = composed
    for key in keys:
        if isinstance(node, yaml.MappingNode):
            node = next((below for one, below in node.value if one.value == key), None)
        elif isinstance(node, yaml.SequenceNode) and key.isdecimal() and (
                int(key) < len(node.value)):
            node = node.value[int(key)]
        else:
            return None
        if id(node) in shared:
            return None
    return node


def with_entry(text, keys, name, value):
    """
    Return YAML with an entry added to a mapping; all else, comments included, is unchanged.

    ``keys`` are those of the mapping, of which the last one need not be there yet; ``name`` is not
    there yet, ``value`` plain data, written in one line. None where there is no place for it.
    """
    root = _composed(text)
    node = _node(root, keys)
    above = _node(root, keys[:-1]) if node is None and keys else None
    if isinstance(above, yaml.MappingNode) and all(
            key.value != keys[-1] for key, _ in above.value):
        return with_entry(text, keys[:-1], keys[-1], {name: value})
    entry = f'{name}: {in_one_line(value)}'
    if isinstance(node, yaml.ScalarNode) and not node.value:
        # A key with nothing below it.
        at_end = node.end_mark.index
        return f'{text[:at_end]} {{{entry}}}{text[at_end:]}'
    if not isinstance(node, yaml.MappingNode):
        return None
    if node.flow_style:
        at_end = node.end_mark.index - 1
        return (text[:at_end].rstrip() + (', ' if node.value else '') + entry + text[at_end:])
    indent = ' ' * node.value[0][0].start_mark.column
    at_end = text.find('\n', _last_mark(node))
    if at_end < 0:
        return f'{text}\n{indent}{entry}\n'
    return f'{text[:at_end]}\n{indent}{entry}{text[at_end:]}'


def without_entry(text, keys):
    """
    Return YAML without an entry of a mapping; all else, other comments too, is unchanged.

    With it goes the comment that stands right above it or behind it in its line, and a mapping
    that had nothing else. None where the text does not contain it.
    """
    node = _node(_composed(text), keys[:-1])
    if not isinstance(node, yaml.MappingNode):
        return None
    names = [key.value for key, _ in node.value]
    if keys[-1] not in names:
        return None
    if len(names) == 1 and len(keys) > 1:
        return without_entry(text, keys[:-1])
    index = names.index(keys[-1])
    start, end = node.value[index][0].start_mark.index, _last_mark(node.value[index][1])
    if not node.flow_style:
        start = text.rfind('\n', 0, start) + 1
        margin = ' ' * node.value[index][0].start_mark.column + '#'
        while text[:start - 1].rpartition('\n')[2].startswith(margin):
            start = text.rfind('\n', 0, start - 1) + 1
        end = text.find('\n', end) + 1
        return text[:start] + text[end:] if end else text[:start]
    if index:
        # With the comma before it.
        start = _last_mark(node.value[index - 1][1])
    elif len(names) > 1:
        end = node.value[1][0].start_mark.index
    return text[:start] + text[end:]


def _last_mark(node):
    """Return where the text of a node ends; mappings' own marks reach further."""
    if isinstance(node, yaml.MappingNode) and node.value and not node.flow_style:
        return _last_mark(node.value[-1][1])
    if isinstance(node, yaml.SequenceNode) and node.value and not node.flow_style:
        return _last_mark(node.value[-1])
    end = node.end_mark.index
    # A block of text ends where the next line begins.
    return end - 1 if getattr(node, 'style', None) in ('|', '>') else end


def with_value(text, keys, value):
    """Return YAML with other data in a place, in one line; None where it spans a block."""
    node = _node(_composed(text), keys)
    if node is None or not (isinstance(node, yaml.ScalarNode) or node.flow_style):
        return None
    return text[:node.start_mark.index] + in_one_line(value) + text[node.end_mark.index:]


def in_one_line(value):
    """Return plain data as YAML in one line, words without quotes where these are not needed."""
    if isinstance(value, Mapping):
        return '{' + ', '.join(
            f'{in_one_line(key)}: {in_one_line(one)}' for key, one in value.items()) + '}'
    if isinstance(value, (list, tuple)):
        return '[' + ', '.join(map(in_one_line, value)) + ']'
    if isinstance(value, str) and _WORD.fullmatch(value) and isinstance(_plain(value), str):
        return value
    return json.dumps(value, allow_nan=False, ensure_ascii=False)


def with_mapping(text, keys, below):
    """
    Return YAML in which a mapping, given as YAML in block style, replaces a scalar.

    That is the value of a key of a block; None where there is no place for it.
    """
    node = _node(_composed(text), keys)
    if not isinstance(node, yaml.ScalarNode):
        return None
    start, end = node.start_mark.index, node.end_mark.index
    line = text[text.rfind('\n', 0, start) + 1:start]
    margin = ' ' * (len(line) - len(line.lstrip()) + 2)
    body = '\n'.join(margin + one if one.strip() else '' for one in below.strip('\n').split('\n'))
    return f'{text[:start].rstrip()}{_comment(text, end)}\n{body}{_rest_of_line(text, end)}'


def _comment(text, end):
    """Return the rest of a line after a value, a comment or nothing."""
    line_end = text.find('\n', end)
    return text[end:len(text) if line_end < 0 else line_end].rstrip()


def _rest_of_line(text, end):
    line_end = text.find('\n', end)
    return '\n' if line_end < 0 else text[line_end:]


def _require_plain(event):
    """Refuse a tag that makes something else of a value or a key."""
    if event.tag not in _TAGS:
        raise FieldError('plain data', f'the tag {event.tag}', 'remove it')


def _syntax_error(got):
    return FieldError('a YAML file', f'a syntax error: {got}',
                      'look for indentation, a missing space after a colon, or brackets left open')


def _plain(word):
    """Return the value of an unquoted scalar by the YAML 1.2 core schema."""
    for pattern, convert in _SCALARS:
        if pattern.fullmatch(word):
            return convert(word)
    return word
