# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
XML from anywhere, read as plain elements that remember their lines.

Nothing is fetched and no entity is expanded: a file with a document type definition is refused.
Size, depth and number of elements are limited while it is read. What a reader of a format never
asks for is reported as ignored.
"""

import math
from pathlib import Path
from xml.parsers import expat

import numpy as np

from ..mechanism.fields import among, nearest
from ..mechanism.files import read_file
from ..mechanism.mechanism import MechanismError

MOST_BYTES = 10_000_000
MOST_ELEMENTS = 200_000
DEEPEST = 100
LONGEST_SHOWN = 60


class Element:
    """
    One element.

    Attributes
    ----------
    tag : str
        With its prefix, as it is written.
    attributes : dict of str to str
    children : list of Element
    text : str
        Its text beside its children, stripped.
    source, line
        The file's path and the line of its start.

    """

    def __init__(self, tag, attributes, source, line):
        self.tag, self.attributes, self.source, self.line = tag, attributes, source, line
        self.children, self.text, self._asked = [], '', set()

    @property
    def where(self):
        """Return file, line and tag, with the name where it has one."""
        named = self.attributes.get('name')
        named = '' if named is None else f' name={_shown(named)}'
        return f'{self.source}:{self.line}: <{self.tag}{named}>'

    def error(self, expected, got, note=''):
        """Return the error of something in this element."""
        note = f' ({note})' if note else ''
        return MechanismError(f'{self.where}: expected {expected}, got {got}{note}')

    def all(self, *tags):  # noqa: A003
        """Return the children of some tags."""
        self._asked.update(tags)
        return [child for child in self.children if child.tag in tags]

    def child(self, tag):
        """Return the only child of a tag, None where there is none."""
        found = self.all(tag)
        if len(found) > 1:
            raise found[1].error(f'one <{tag}> in <{self.tag}>', 'another')
        return found[0] if found else None

    def required(self, tag):
        """Return the only child of a tag."""
        found = self.child(tag)
        if found is None:
            raise self.error(f'a child <{tag}>', 'none')
        return found

    def get(self, key, default=None):
        """Return an attribute as text."""
        self._asked.add(key)
        return self.attributes.get(key, default)

    def word(self, key, choices=None):
        """Return an attribute that must be there, one of some choices where they are given."""
        value = self.get(key)
        if not value:
            raise self.error(f'the attribute {key}', 'none' if value is None else 'nothing in it')
        if choices is not None and value not in choices:
            raise self.error(f'{key} to be one of {among(choices)}', _shown(value),
                             nearest(value, choices))
        return value

    def number(self, key, default=None):
        """Return an attribute as a finite number."""
        value = self.get(key)
        return default if value is None else self.values(value, 1, key)[0]

    def numbers(self, key, count, default=None):
        """Return an attribute as finite numbers, an array."""
        value = self.get(key)
        return (None if default is None else np.array(default, dtype=float)) \
            if value is None else np.array(self.values(value, count, key))

    def values(self, text, count, what='numbers'):
        """Return text as so many finite numbers."""
        words = text.split()
        try:
            found = [float(word) for word in words]
        except ValueError:
            found = [math.nan]
        if len(words) != count or not all(map(math.isfinite, found)):
            raise self.error(
                f'{what} to be {count} finite number{"s" if count > 1 else ""}', _shown(text))
        return found

    def direction(self, key, default=None):
        """Return an attribute as a unit vector."""
        return self.unit(self.numbers(key, 3, default), key)

    def unit(self, vector, key):
        """Return a vector with the length 1."""
        length = np.linalg.norm(vector)
        if not 1e-100 < length < math.inf:
            raise self.error(f'{key} to be a direction that is not zero', _shown(
                ' '.join(f'{value:g}' for value in vector)))
        return vector / length

    def unasked(self, above=()):
        """
        Yield the parts that were not read.

        A tag, or a tag and an attribute as ``tag@attribute``; the attribute's value, or the
        element; and its ancestors, the outermost first.
        """
        above = (*above, self)
        for key, value in self.attributes.items():
            if key not in self._asked and not key.startswith('xmlns'):
                yield f'{self.tag}@{key}', value, above
        for child in self.children:
            if child.tag in self._asked:
                yield from child.unasked(above)
            else:
                yield child.tag, child, above


def read_xml(path, root, text=None):
    """
    Read an XML file, whose outermost element is one of ``root``; return that element.

    ``text``: that of the file, where it was read before. MechanismError where it cannot be read,
    is not XML or larger than a model should be.
    """
    content = read_bytes(path) if text is None else text
    if len(content) > MOST_BYTES:
        raise MechanismError(f'{path}: expected a file of at most {MOST_BYTES} bytes, got a '
                             'larger one')
    found = _Parser(Path(path)).read(content)
    if found.tag not in root:
        raise found.error(f'one of the elements {among(f"<{tag}>" for tag in root)} outermost',
                          f'<{found.tag}>')
    return found


def read_bytes(path):
    """Return the contents of a file, up to one byte beyond its limit; raise MechanismError."""
    try:
        return read_file(path, MOST_BYTES)
    except (OSError, ValueError) as error:
        reason = getattr(error, 'strerror', None) or error
        raise MechanismError(f'{str(path)!r}'[1:-1] + ': expected a file that can be read, got: '
                             f'{reason}') from None


class _Parser:
    """Elements from expat's events."""

    def __init__(self, path):
        self.path, self.root, self.open, self.count = path, None, [], 0
        self.parser = expat.ParserCreate()
        self.parser.StartElementHandler = self._start
        self.parser.EndElementHandler = self._end
        self.parser.CharacterDataHandler = self._characters
        self.parser.StartDoctypeDeclHandler = self._doctype
        self.parser.buffer_text = True

    def read(self, content):
        try:
            self.parser.Parse(content, True)
        except expat.ExpatError as error:
            raise self._error('XML', f'a syntax error: {expat.ErrorString(error.code)}',
                              error.lineno) from None
        except (LookupError, ValueError) as error:
            # An encoding that Python does not have.
            raise self._error('XML in UTF-8', f'{error}') from None
        for element in self._texts(self.root):
            element.text = ''.join(element.text).strip()
        return self.root

    def _texts(self, element):
        yield element
        for child in element.children:
            yield from self._texts(child)

    def _error(self, expected, got, line=None):
        line = self.parser.CurrentLineNumber if line is None else line
        return MechanismError(f'{self.path}:{line}: expected {expected}, got {got}')

    def _start(self, tag, attributes):
        self.count += 1
        if self.count > MOST_ELEMENTS:
            raise self._error(f'at most {MOST_ELEMENTS} elements', 'more')
        if len(self.open) > DEEPEST:
            raise self._error(f'elements at most {DEEPEST} deep', 'deeper ones')
        element = Element(tag, attributes, self.path, self.parser.CurrentLineNumber)
        element.text = []
        if self.open:
            self.open[-1].children.append(element)
        else:
            self.root = element
        self.open.append(element)

    def _end(self, tag):
        self.open.pop()

    def _characters(self, text):
        self.open[-1].text.append(text)

    def _doctype(self, name, *where):
        raise self._error('plain elements', f'a document type definition (<!DOCTYPE {name}>), '
                          'whose entities are not expanded')


def _shown(text):
    return repr(text if len(text) <= LONGEST_SHOWN else text[:LONGEST_SHOWN] + '...')
