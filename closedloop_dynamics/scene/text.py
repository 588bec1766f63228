# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A scene with its mechanism as plain data: for a file, or to travel in a bag as one text.

What the readers of scenes and mechanisms make of the data is the scene again, to the last digit:
it went through the same checks as any other file. Expressions stand there as their values, and
joints between bodies as those of the tree and cut joints.
"""

from dataclasses import fields, MISSING, replace
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union

from .loading import load_scene, SceneError
from .records import Scene
from ..effects.registry import effect_type
from ..mechanism.coupling_law import law_data
from ..mechanism.mechanism import Mechanism
from ..mechanism.shapes import as_data
from ..mechanism.validation import SECTIONS

FORMAT = 1
MECHANISM_FILE = 'mechanism.yaml'
# Longest line of a file where a mapping could be divided.
LONGEST_LINE = 110


def scene_text(scene: Scene, effects: Optional[Mapping[str, Any]] = None,
               switched_off: Optional[Sequence[str]] = None, **facts: Any) -> str:
    """
    Return a scene as text.

    Parameters
    ----------
    scene : scene_records.Scene
        With its mechanism.
    effects : dict of str to record, optional
        In place of the scene's own: with values that were changed since.
    switched_off : sequence of str, optional
        In place of the scene's own: names of effects.
    **facts
        Further entries, as JSON can hold: a simulated time, say.

    """
    data = scene_data(scene, effects, switched_off)
    mechanism = data['mechanism']
    return json.dumps({
        'format': FORMAT, 'name': scene.name, **facts,
        'scene': {**data, 'mechanism': f'./{MECHANISM_FILE}'}, 'mechanism': mechanism},
        allow_nan=False, ensure_ascii=False)


def scene_data(
        scene: Scene, effects: Optional[Mapping[str, Any]] = None,
        switched_off: Optional[Sequence[str]] = None) -> Dict[str, Any]:
    """
    Return a scene as ``load_scene`` takes it, with its mechanism.

    Parameters
    ----------
    scene : scene_records.Scene
        With its mechanism.
    effects : mapping of str to record, optional
        In place of the scene's own.
    switched_off : sequence of str, optional
        Likewise.

    Returns
    -------
    dict of str to object
        Mappings, lists, text, numbers and truth values.

    """
    initial, coordinates = scene.initial, scene.mechanism.coordinates
    effects = scene.effects if effects is None else effects
    switched_off = scene.switched_off if switched_off is None else switched_off
    return {
        'mechanism': _mechanism(scene.mechanism),
        'description': scene.description,
        'initial': {
            'position': {
                **coordinates.by_name('position', initial.position), **initial.turned},
            'hold': list(initial.hold),
            'velocity': {
                name: value for name, value
                in coordinates.by_name('velocity', initial.velocity).items()
                if not initial.hold
                or {name, coordinates.joint_of(name)} & set(initial.hold)}},
        'effects': {name: {
            'type': effect_type(record), **_values(record),
            **({'enabled': False} if name in switched_off else {})}
            for name, record in effects.items()},
        'method': {key: value for key, value in _values(scene.method).items()
                   if key not in scene.method.unused}}


def write_scene(scene: Scene, path: Union[str, Path]) -> None:
    """
    Write a scene with its mechanism to one YAML file, which ``load_scene`` reads.

    Parameters
    ----------
    scene : scene_records.Scene
        From a file or built in Python.
    path : str or pathlib.Path
        Of the file; one that is there is replaced.

    Raises
    ------
    OSError
        Where it cannot be written.

    """
    Path(path).write_text(scene_yaml(scene), encoding='utf-8')


def scene_yaml(scene: Scene) -> str:
    """Return the text of ``write_scene``."""
    lines: List[str] = []
    for key, value in scene_data(scene).items():
        _write(lines, '', key, value)
    return '\n'.join(lines) + '\n'


def _write(lines: List[str], indent: str, key: str, value: Any) -> None:
    """Append the lines of a key; a value short enough for one line as JSON, a part of YAML."""
    line = f'{indent}{key}: {json.dumps(value, allow_nan=False, ensure_ascii=False)}'
    if len(line) <= LONGEST_LINE or not isinstance(value, dict):
        lines.append(line)
        return
    lines.append(f'{indent}{key}:')
    for below, one in value.items():
        _write(lines, f'{indent}  ', below, one)


def read_scene_text(text: str) -> Tuple[Scene, Dict[str, Any]]:
    """
    Return the scene in a text, and the facts beside it.

    Returns
    -------
    scene : scene_records.Scene
    facts : dict
        Its further entries.

    Raises
    ------
    SceneError
        Where the text is not a scene, or is faulty.

    """
    try:
        facts = json.loads(text)
        scene, mechanism = facts.pop('scene'), facts.pop('mechanism')
        number, name = facts.pop('format'), str(facts.pop('name'))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise SceneError(f'expected the text of a scene, got something else ({error})') from None
    if number != FORMAT:
        raise SceneError(f'expected the text of a scene in format {FORMAT}, got {number!r}; a '
                         'newer version of this package may read it')
    with TemporaryDirectory() as directory:
        path = Path(directory) / 'scene.yaml'
        path.write_text(json.dumps(scene, ensure_ascii=False), encoding='utf-8')
        (path.parent / MECHANISM_FILE).write_text(
            json.dumps(mechanism, ensure_ascii=False), encoding='utf-8')
        return replace(load_scene(path), name=name, path=None), facts


def _mechanism(mechanism: Mechanism) -> Dict[str, Any]:
    """Return a mechanism as its file has it."""
    drawn = {'ground_visual': [as_data(visual, not mechanism.planar) for visual in (
        mechanism.ground_visual)]} if mechanism.ground_visual else {}
    return {'name': mechanism.name, 'description': mechanism.description, **drawn, **{
        key: {record.name: _record(record, not mechanism.planar)
              for record in getattr(mechanism, key)}
        for key in SECTIONS}}


def _record(record: Any, spatial: bool) -> Dict[str, Any]:
    """Return the fields of a part of a mechanism as a file has them."""
    values = _values(record, leave_out=('name',))
    if 'orientation' in values:
        values['orientation'] = {'quaternion': values['orientation']}
    if 'law' in values:
        values['law'] = law_data(values['law'])
    if 'visual' in values:
        values['visual'] = [as_data(visual, spatial) for visual in values['visual']]
    return values


def _values(record: Any, leave_out: Sequence[str] = ()) -> Dict[str, Any]:
    """Return the fields of a record that differ from their defaults."""
    return {
        field.name: value for field in fields(record)
        if field.name not in leave_out
        and ((value := getattr(record, field.name)) != field.default
             or field.default is MISSING)}
