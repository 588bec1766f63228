# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Write ``doc/scene_keys.md``: every key of mechanism and scene files, from the code that reads them.

Keys and defaults are those of the records, meanings and units those of their docstrings.
"""

from dataclasses import fields, MISSING
import inspect
from pathlib import Path
import re

from closedloop_dynamics.effects.external_force import BODY, WORLD
from closedloop_dynamics.effects.registry import EFFECTS
from closedloop_dynamics.mechanism.expressions import FUNCTIONS, UNITS
from closedloop_dynamics.mechanism.fields import keys_of
from closedloop_dynamics.mechanism.meanings import documented
from closedloop_dynamics.mechanism.mechanism import CouplingLaw, Mechanism, UNTURNED
from closedloop_dynamics.mechanism.shapes import SHAPES
from closedloop_dynamics.mechanism.validation import SECTIONS
from closedloop_dynamics.scene.integrators import INTEGRATORS, STABILISATIONS
from closedloop_dynamics.scene.loading import SCENE_KEYS
from closedloop_dynamics.scene.records import Initial, Method

PAGE = Path(__file__).with_name('scene_keys.md')
TYPES = {'str': 'text', 'bool': 'true or false', 'float': 'number', 'int': 'whole number',
         'int or None': 'whole number',
         'tuple of 2 floats': '[x, y]', 'float or None': 'number', 'str or None': 'text',
         'tuple of 2 floats or None': '[x, y]', 'tuple of str': 'list of names',
         'tuple of floats': 'list of numbers', 'float, or tuple of floats': 'number, or a list',
         'float, or tuple of 2 floats': 'number, or [least, largest]',
         'tuple of floats or None': 'list of numbers',
         'bool or None': 'true or false',
         'tuple of 2 or 3 floats': '[x, y], in space [x, y, z]',
         'tuple of 2 floats, or 3 in space': '[x, y], in space [x, y, z]',
         'tuple of 2 floats, or 3 in space, or None': '[x, y], in space [x, y, z]',
         'float, or tuple of 3 floats in space': 'number, in space [x, y, z]',
         'float, or tuple of 3 or 6 floats': 'number, in space a list',
         'float, or tuple of 3 or 6 floats in space': 'number, in space a list',
         'tuple of 3 floats or None': '[x, y, z]',
         'tuple of 4 floats': '{rpy: [r, p, y]} or {quaternion: [x, y, z, w]}',
         'dict of str to str': 'expression by name',
         'dict of str to str, or None': 'text by name',
         'dict of str to float, or None': 'number by name',
         'dict of str to ends, or None': '[end, end] by name: names of points, or places',
         'dict of str to point and axis, or None': '[point, x, y or z] by name',
         'CouplingLaw or None': 'keys below',
         'dict of str to float': 'number by joint name', 'tuple of Visual': 'list of shapes',
         'tuple of nv floats': 'number by joint name',
         'tuple of nq floats': 'number by joint name'}
CHOICES = {'integrator': INTEGRATORS, 'stabilisation': STABILISATIONS,
           'axes': (WORLD, BODY)}
HEAD = """\
# Keys of mechanism and scene files

Written by `python doc/make_scene_keys.py` from the code that reads the files; a test compares.
SI units and radians. [Describe your own mechanism](describe_a_mechanism.md) shows them in use,
[effects.md](effects.md) describes the effects.
"""


def default(record_type, key):
    """Return the default of a key as a file would have it."""
    value = next(field.default for field in fields(record_type) if field.name == key)
    if value is MISSING or value in (None, (), '', UNTURNED):
        return 'none'
    if isinstance(value, bool):
        return str(value).lower()
    return f'{list(value)}' if isinstance(value, tuple) else f'{value}'


def table(record_type, keys):
    """Return the lines of a table of keys."""
    required, optional = keys
    texts = documented(record_type)
    lines = ['| Key | | Value | Meaning |', '|---|---|---|---|']
    for key in (*required, *optional):
        kind, meaning = TYPES[texts[key][0]], texts[key][1] or 'Its name.'
        if key in CHOICES:
            kind = ', '.join(f'`{choice}`' for choice in CHOICES[key])
        given = 'required' if key in required else f'optional, {default(record_type, key)}'
        lines.append(f'| `{key}` | {given} | {kind} | {_plain(meaning)} |')
    return lines


def _plain(text):
    """Return the text of a docstring for readers of files: names without quotes."""
    return re.sub(r'`+\'?([^`\']*)\'?`+', r'`\1`', text).replace('None for', 'none for').replace(
        'None where', 'none where')


def page():
    """Return the whole page."""
    lines = [HEAD, '## Mechanism', '', *_names(
        keys_of(Mechanism, leave_out=('source', 'tree', 'motions', 'rounded')))]
    for section, (record_type, _) in SECTIONS.items():
        lines += ['', f'### An entry of `{section}`, by its name', '',
                  *table(record_type, keys_of(record_type, leave_out=('name',)))]
    lines += ['', '### The keys of a `law` of a coupling', '',
              *table(CouplingLaw, keys_of(CouplingLaw))]
    lines += ['', 'Of a body with `massless: true`, `mass`, `center_of_mass` and `inertia` may be '
              'left out. A body may have a `shape` in the place of `center_of_mass` and '
              '`inertia`, and a `density` [kg/m^3] in the place of `mass`. A joint may have '
              '`between` (two bodies) and '
              '`points` (its places in their frames) in the place of `parent`, `child` and '
              '`position`, and say `cut: true` or `false`. A shape is one of', '',
              *(f'- `{shape}`, with ' + ', '.join(f'`{key}`' for key in required)
                + ' and optionally ' + ', '.join(f'`{key}`' for key in optional)
                for shape, (required, optional) in SHAPES.items()), '',
              'in metres: a box has three lengths along the axes of the body, or of its own '
              '`orientation`; a cylinder an axis; `center` is its centre of mass, by default the '
              'origin of the body; a rod is a solid cylinder between two places, from the origin '
              'and thin by default. In `visual` a shape may be a `mesh`, too: a `file` (STL, OBJ, '
              'PLY, GLB; from the file of the mechanism on) with `scale`, `center` and '
              '`orientation`. All of these may have a `color`: red, green and blue, 0 to 1. '
              '`ground_visual` of a mechanism is such a list for the ground.',
              '', '### An entry of `cylinders`, by its name', '',
              'A rod of variable length: `between` two bodies, at '
              '`points` in their frames, with the `mass` of barrel and rod together and the '
              '`length` of each, uniform bars, in space an `axis` along which it lies in the '
              'first body at angles zero of its foot, and optionally `actuated`. It stands for '
              'the bodies `NAME_barrel` and `NAME_rod`, the pins `NAME_foot` and `NAME_head`, in '
              'space a universal joint and a spherical one, and the '
              'joint `NAME`, whose coordinate is the distance of both pins.',
              '', '### `parameters`', '',
              'Numbers by name, of a mechanism and of a scene. Every other number may be an '
              'expression of them, as text: numbers, `pi`, + - * / ** and brackets, and the '
              'functions ' + ', '.join(f'`{name}`' for name in FUNCTIONS) + '. A number may '
              'have a unit behind it, ' + ', '.join(f'`{name}`' for name in UNITS) + ': `40 mm`; '
              'without one it is in SI units. A scene gives '
              'other values to the parameters of its mechanism, and may add its own.', '',
              '## Scene', '', *_names(SCENE_KEYS),
              '`mechanism` is the name of a shipped mechanism, the path of a file, or what such a '
              'file has.', '', '### `initial`', '',
              *table(Initial, (('position',), ('hold', 'velocity'))), '',
              'In the place of `position` the start may be drawn: `at` has places in the world of '
              'joints, cut joints and points by name, of a joint that slides where the body that '
              'it carries has its joint; `poses` has frames of bodies as they are described, `[x, '
              'y, angle]`, in space `[x, y, z, roll, pitch, yaw]`. Approximate is enough, too; '
              '`position` is then of joints that nothing of this is about.',
              '', '### `method`', '',
              *table(Method, keys_of(Method)), '', '### `effects`', '',
              'Entries by name, each of one `type` below. Of every type but `prescribed_motion` '
              'one with `enabled: false` is switched off at the start, and can be switched on '
              'while the scene runs.']
    for kind, record_type in EFFECTS.items():
        summary = inspect.getdoc(record_type).partition('\n')[0]
        lines += ['', f'### An entry of `effects` with `type: {kind}`', '', summary, '',
                  *table(record_type, keys_of(record_type))]
        for key, columns in record_type.FILES.items():
            lines += ['', f'Or `{key}` in the place of {" and ".join(f"`{c}`" for c in columns)}: '
                      'the path of a CSV file with these columns, from the scene on.']
    return '\n'.join(lines) + '\n'


def _names(keys):
    return ['Required: ' + ', '.join(f'`{key}`' for key in keys[0]) + '. Optional: '
            + ', '.join(f'`{key}`' for key in keys[1]) + '.']


if __name__ == '__main__':
    PAGE.write_text(page(), encoding='utf-8')
