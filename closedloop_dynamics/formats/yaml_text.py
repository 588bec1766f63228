# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A mechanism, and the scene of a model, as YAML that people read and change."""

from dataclasses import fields, MISSING
import json

from ..mechanism.coupling_law import law_data
from ..mechanism.mechanism import MESH, UNTURNED
from ..mechanism.shapes import as_data
from ..mechanism.validation import SECTIONS

LONGEST_LINE = 110


def mechanism_text(mechanism, notes=()):
    """
    Return a mechanism as a file of our own, with comments above it.

    What ``mechanism.reader`` makes of it is the mechanism again, to the last digit.
    """
    parts = [*(f'# {note}' for note in notes), f'name: {mechanism.name}']
    if mechanism.description:
        parts.append(f'description: {json.dumps(mechanism.description, ensure_ascii=False)}')
    if mechanism.ground_visual:
        parts += ['', 'ground_visual:', *(
            f'  - {_value(_quoted(as_data(visual, not mechanism.planar)))}'
            for visual in mechanism.ground_visual)]
    for section in SECTIONS:
        records = getattr(mechanism, section)
        if records:
            parts += ['', f'{section}:', *(
                line for record in records
                for line in _entry(record.name, _values(record, not mechanism.planar)))]
    return '\n'.join(parts) + '\n'


def scene_text(imported, q, mechanism_path):
    """
    Return a scene of an ``Imported`` model as YAML: its start and its effects.

    ``q``, shape (nq,), are the coordinates at the start; ``mechanism_path`` is the mechanism's
    file as the scene names it.
    """
    mechanism = imported.mechanism
    position = mechanism.coordinates.by_name('position', q)
    parts = [f'mechanism: {mechanism_path}',
             f'description: {json.dumps(mechanism.description)}', '', 'initial:',
             '  position:', *(f'    {name}: {_value(value)}' for name, value in position.items())]
    if imported.effects:
        parts += ['', 'effects:', *(line for name, values in imported.effects.items()
                                    for line in _entry(name, values))]
    return '\n'.join(parts) + '\n'


def _values(record, spatial):
    """Return the keys of a record that differ from their defaults."""
    values = {
        field.name: value for field in fields(record) if field.name != 'name'
        and ((value := getattr(record, field.name)) != field.default or field.default is MISSING)}
    if values.get('massless'):
        values = {key: values[key] for key in ('massless', 'visual') if key in values}
    if 'visual' in values:
        values['visual'] = [_quoted(as_data(visual, spatial)) for visual in values['visual']]
    if values.get('orientation', UNTURNED) != UNTURNED:
        values['orientation'] = {'quaternion': values['orientation']}
    if values.get('law') is not None:
        law = values['law'] = law_data(values['law'])
        if 'expression' in law:
            law['expression'] = json.dumps(law['expression'])
    return values


def _quoted(shape):
    """Return a shape with the path of a mesh as YAML has text."""
    mesh = shape.get(MESH)
    return {MESH: {**mesh, 'file': json.dumps(mesh['file'])}} if mesh else shape


def _entry(name, values):
    """Return the lines of one entry, in flow style as long as it fits into one."""
    line = f'  {name}: {_value(values)}'
    if len(line) <= LONGEST_LINE:
        return [line]
    return [f'  {name}:', *(f'    {key}: {_value(value)}' for key, value in values.items())]


def _value(value):
    if isinstance(value, dict):
        return '{' + ', '.join(f'{key}: {_value(item)}' for key, item in value.items()) + '}'
    if isinstance(value, (tuple, list)):
        return '[' + ', '.join(map(_value, value)) + ']'
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, (int, float)):
        return repr(float(value)) if 'e' in repr(value) else repr(float(value)).removesuffix('.0')
    return str(value)
