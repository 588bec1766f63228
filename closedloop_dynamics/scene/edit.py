# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The files of a scene with other numbers in their places, and all else as it was written.

Comments and order of the author stay. It works where each number has a place in the file: not
left out, nor what follows from others. What is written is read again and compared; where it
differs, and where numbers have no place, ``write_scene`` writes the whole scene.
"""

from pathlib import Path

from .key_paths import changed, numbers, resolve
from .loading import load_scene, SceneError
from .text import write_scene
from ..mechanism.config import shipped_path
from ..mechanism.document import with_scalars
from ..mechanism.mechanism import MechanismError

# Name of the file of the mechanism beside that of the scene.
MECHANISM = '{}_mechanism.yaml'


def write_with_numbers(scene, values, path):
    """
    Write a scene with other numbers, in its own words where these have a place for them.

    ``values`` are by key path; of those under ``initial.position``, the ones in the file. Beside
    the file of ``path`` there is one of the mechanism where that has its own. Returns the files,
    and whether the words of the author were kept. FieldError, MechanismError for impossible
    numbers; OSError.
    """
    values = {'.'.join(resolve(scene, key)): float(value) for key, value in values.items()}
    other = changed(scene, {resolve(scene, key): value for key, value in values.items()})
    files = _edited(scene, values, path)
    if files is not None:
        if _is_same(path, other):
            return files, True
        for file in files:
            file.unlink()
    write_scene(other, path)
    return [path], False


def _edited(scene, values, path):
    """Write files with other numbers; return their paths, None where they have no place."""
    source, mechanism = scene.path, None
    if source is None or source.suffix not in ('.yaml', '.yml'):
        return None
    data = scene.source[0] if scene.source else {}
    named = data.get('mechanism')
    if isinstance(named, str):
        mechanism = (shipped_path('mechanisms', named) if '.' not in named and '/' not in named
                     else source.parent / named)
        if mechanism.suffix not in ('.yaml', '.yml'):
            return None
    own, of_mechanism = {}, {}
    for key, value in values.items():
        keys = tuple(key.split('.'))
        given = data.get('initial', {}).get('position', {})
        if keys[:2] == ('initial', 'position') and '.'.join(keys[2:]) not in given:
            continue
        inside = keys[0] == 'mechanism' and mechanism is not None
        if keys[0] == 'parameters' and keys[1] not in (data.get('parameters') or {}):
            inside = mechanism is not None
            of_mechanism[keys] = repr(value)
        elif inside:
            of_mechanism[keys[1:]] = repr(value)
        else:
            own[keys] = repr(value)
    files = [path]
    if of_mechanism:
        beside = path.with_name(MECHANISM.format(path.stem))
        text = with_scalars(_text(mechanism), of_mechanism)
        own[('mechanism',)] = f'./{beside.name}'
        files.append(beside)
        if text is None:
            return None
    scene_text = with_scalars(_text(source), own)
    if scene_text is None:
        return None
    path.write_text(scene_text, encoding='utf-8')
    if of_mechanism:
        beside.write_text(text, encoding='utf-8')
    return files


def _text(path):
    return path.read_text(encoding='utf-8-sig')


def _is_same(path, scene):
    """Return whether a file has the numbers of a scene, but for where its loops are closed."""
    try:
        found, wanted = (
            {key: value for key, value in numbers(one).items()
             if not key.startswith('initial.position.')}
            for one in (load_scene(Path(path)), scene))
    except (SceneError, MechanismError):
        return False
    return found == wanted
