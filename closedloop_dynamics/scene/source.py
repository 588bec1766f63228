# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A scene as one YAML text in the words of its author, with other numbers and with more in it.

The mechanism stands in the text, too, so that one file has all. Comments and order stay; what
is made is read again and compared, and where a scene has no text of its own, or its text no place
for a number, all of it is rewritten.
"""

from pathlib import Path
from typing import Any, Dict, Mapping, Optional, Tuple

from .key_paths import numbers
from .loading import scene_of_yaml, SceneError
from .records import Scene
from .text import scene_yaml
from ..mechanism.config import shipped_path
from ..mechanism.document import with_entry, with_mapping, with_scalars

MECHANISM = 'mechanism'


def source_of(scene: Scene) -> Tuple[str, bool]:
    """
    Return the text of a scene, and whether it is in the words of the author.

    It is as it was read, or changed since in numbers.
    """
    text = _as_written(scene)
    if text is not None:
        found = _read(text, scene)
        if found is not None and not _is_like(found, scene):
            text = with_numbers(text, found, scene)
        if text is not None and _is_like(_read(text, scene), scene):
            return text, True
    return scene_yaml(scene), False


def with_numbers(text: str, base: Scene, scene: Scene) -> Optional[str]:
    """
    Return a text with the numbers of another scene, and with other effects switched off.

    It is that of ``base``, which is like ``scene`` but for these. None where a number has no place
    in the text, or stands for others, too.
    """
    before, after = numbers(base), numbers(scene)
    given = (base.source[0] if base.source else {})
    values: Dict[Tuple[str, ...], str] = {}
    for key, value in after.items():
        if value != before.get(key) and value is not None:
            keys = tuple(key.split('.'))
            if keys[0] == 'parameters' and keys[1] not in (given.get('parameters') or {}):
                keys = (MECHANISM, *keys)
            values[keys] = repr(value)
    entries: Dict[Tuple[str, ...], Any] = {}
    for name in set(base.switched_off) ^ set(scene.switched_off):
        acts = name not in scene.switched_off
        if name in base.switched_off:
            values['effects', name, 'enabled'] = str(acts).lower()
        else:
            entries['effects', name, 'enabled'] = acts
    changed = with_scalars(text, values)
    if changed is not None:
        # Where it says so already, it gets no new entry.
        switched = with_scalars(changed, dict.fromkeys(entries, 'false'))
        changed = with_entries(changed, entries) if switched is None else switched
    return changed if changed is not None and _is_like(_read(changed, base), scene) else None


def with_entries(text: str, entries: Mapping[Tuple[str, ...], Any]) -> Optional[str]:
    """
    Return a text of a scene with more in it; None where there is no place.

    ``entries``: plain data by the keys of their places, of which the last one is new.
    """
    for (*keys, name), value in entries.items():
        more = with_entry(text, tuple(keys), name, value)
        if more is None:
            return None
        text = more
    return text


def _as_written(scene: Scene) -> Optional[str]:
    """Return the text of a file, that of the mechanism in it; None where that cannot be."""
    path = scene.path
    meshes = any(visual.file for body in scene.mechanism.bodies for visual in body.visual)
    if path is None or not path.is_file() or path.suffix not in ('.yaml', '.yml') or meshes:
        return None
    text = path.read_text(encoding='utf-8-sig')
    named = scene.source[0].get(MECHANISM) if scene.source else None
    if not isinstance(named, str):
        return text
    other = (shipped_path('mechanisms', named) if '.' not in named and '/' not in named
             else path.parent / named)
    if other.suffix not in ('.yaml', '.yml'):
        return None
    return with_mapping(text, (MECHANISM,), other.read_text(encoding='utf-8-sig'))


def _read(text: str, scene: Scene) -> Optional[Scene]:
    try:
        return scene_of_yaml(text, scene.path or Path('scene.yaml'))
    except SceneError:
        return None


def _is_like(found: Optional[Scene], wanted: Scene) -> bool:
    """Return whether two scenes are the same machine with the same numbers."""
    if found is None:
        return False
    return (found.mechanism == wanted.mechanism and dict(found.effects) == dict(wanted.effects)
            and found.initial == wanted.initial and found.method == wanted.method
            and set(found.switched_off) == set(wanted.switched_off))
