# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Scenes: a mechanism with its start, effects and method.

``load_scene('three_rrr')`` reads a shipped scene, ``load_scene('my/scene.yaml')``
a file. Every error names file and line, key path, what was expected and what was
got.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, List, Optional, Set, Tuple, Union

import numpy as np

from .records import Initial, Method, Scene
from .tree_choice import cheapest
from ..effects.outlines import outline
from ..effects.registry import EFFECTS
from ..formats.registry import is_model, read_model
from ..mechanism.checks import (
    boolean, list_of, name, NAME_PATTERN, not_negative, number, numbers, one_of, text)
from ..mechanism.config import config_directory, shipped_names, shipped_path
from ..mechanism.csv_columns import read_columns
from ..mechanism.document import Document, plain
from ..mechanism.expressions import Parameters, put_changes
from ..mechanism.fields import among, at, FieldError, keys_of, mapping, nearest, shown
from ..mechanism.mechanism import Mechanism, MechanismError
from ..mechanism.reader import mechanism_of, read_mechanism, with_kept, with_parameters
from ..mechanism.validation import checked

__all__ = ['config_directory', 'Initial', 'load_scene', 'load_scene_or_mechanism', 'Method',
           'Scene', 'scene_names', 'scene_with', 'SceneError']

# Required and optional keys.
SCENE_KEYS = ('mechanism', 'initial'), ('description', 'effects', 'method', 'parameters')
# Where the mechanism is a model in another format, which may start as it is drawn.
MODEL_KEYS = ('mechanism',), (
    'initial', 'loops', 'mend_inertias', 'model', 'arguments', 'anywhere', 'ignore',
    'tolerance', *SCENE_KEYS[1])
INITIAL_KEYS = (), ('position', 'at', 'poses', 'hold', 'velocity')
# What a start is drawn by: places of pins and points, and poses of bodies.
DRAWN = 'at', 'poses'
# Effects for whose joints others are cut, where there is a choice.
RATHER_IN_TREE = ('prescribed_motion', 'rotor')


class SceneError(ValueError):
    """A scene that cannot be read or simulated."""


def scene_names() -> List[str]:
    """Return the names of the shipped scenes, sorted."""
    return shipped_names('scenes')


def load_scene(name_or_path: Union[str, Path, Mapping[str, Any]],
               tolerance: Optional[float] = None, **reading: Any) -> Scene:
    """
    Read a scene from a file, or build one of the same data.

    Parameters
    ----------
    name_or_path : str, pathlib.Path or mapping
        A shipped scene by its name (a single word), or the path of a file: of a scene, or of a
        model in another format (``formats``), under gravity, at rest, with the loops closed. Or
        the keys and values of a scene, in which ``mechanism`` may be a ``Mechanism``, too; paths
        in it are from the working directory on.
    tolerance : float, optional
        As of a Mechanism: of the scene's, in the place of its own one.
    **reading
        Of a model: options of ``formats.registry.read_model``.

    Raises
    ------
    SceneError
        Where there is no such scene, or it or its mechanism is faulty.

    """
    if isinstance(name_or_path, Mapping):
        if reading:
            raise SceneError(f'expected a model in another format, which is read with '
                             f'{among(reading)}, got a mapping')
        try:
            scene = _read(plain(name_or_path), None)
        except FieldError as error:
            raise SceneError(str(error)) from None
        return _agreeing(scene, tolerance)
    path = _scene_path(name_or_path)
    if is_model(path):
        # Here, as most scenes need nothing of other formats.
        from .model_scene import scene_of_model
        if tolerance is not None:
            reading['tolerance'] = tolerance
        return scene_of_model(path, read_model(path, **reading))
    if reading:
        raise SceneError(f'{path}: expected a model in another format, which is read with '
                         f'{among(reading)}, got another file (a scene of a model has these keys)')
    return _agreeing(_scene_of(Document(path, SceneError)), tolerance)


def _agreeing(scene: Scene, tolerance: Optional[float]) -> Scene:
    """Return a scene whose mechanism has another tolerance of digits, if one is given."""
    if tolerance is None:
        return scene
    mechanism = _with_tolerance(scene.mechanism, tolerance)
    return replace(scene, mechanism=mechanism, source=(
        scene.source and (*scene.source[:2], mechanism)))


def _with_tolerance(mechanism: Mechanism, tolerance: Optional[float]) -> Mechanism:
    if tolerance is None:
        return mechanism
    try:
        return checked(replace(mechanism, tolerance=tolerance))
    except FieldError as error:
        raise SceneError(str(error)) from None


def load_scene_or_mechanism(
        name_or_path: Union[str, Path], tolerance: Optional[float] = None,
        **reading: Any) -> Union[Scene, Mechanism]:
    """
    Read a scene, or a mechanism where a file or shipped name is that of one.

    Parameters
    ----------
    name_or_path, tolerance, **reading
        As for ``load_scene``.

    Raises
    ------
    SceneError, MechanismError

    """
    if reading and (_is_name(name_or_path) or not is_model(name_or_path)):
        return load_scene(name_or_path, **reading)
    if not _is_name(name_or_path) and is_model(name_or_path):
        return _with_tolerance(read_model(name_or_path, **reading).mechanism, tolerance)
    if _is_name(name_or_path):
        if name_or_path in scene_names() or name_or_path not in shipped_names('mechanisms'):
            return load_scene(name_or_path, tolerance)
        path = shipped_path('mechanisms', name_or_path)
    else:
        path = name_or_path
        data = Document(path, SceneError).data
        if not (isinstance(data, Mapping) and 'bodies' in data):
            return load_scene(path, tolerance)
    return _with_tolerance(cheapest(read_mechanism(path)), tolerance)


def _is_name(name_or_path: Any) -> bool:
    return isinstance(name_or_path, str) and NAME_PATTERN.fullmatch(name_or_path) is not None


def _scene_path(name_or_path: Union[str, Path]) -> Path:
    if not _is_name(name_or_path):
        return Path(name_or_path)
    try:
        with at('scene'):
            return _shipped('scenes', name_or_path)
    except FieldError as error:
        raise SceneError(str(error)) from None


def _shipped(kind: str, value: Any) -> Path:
    """Return the path of the shipped scene or mechanism that ``value`` names."""
    names = shipped_names(kind)
    if value not in names:
        raise FieldError(
            f'one of {among(names)}, or the path of a YAML file (./NAME.yaml)', shown(value),
            nearest(value, names))
    return shipped_path(kind, value)


def scene_of_yaml(text: str, path: Union[str, Path]) -> Scene:
    """
    Read a scene from the text of its file.

    Parameters
    ----------
    text : str
        YAML.
    path : str or pathlib.Path
        Of the file, which need not exist: other files that the scene names are beside it.

    Raises
    ------
    SceneError

    """
    return _scene_of(Document(path, SceneError, text))


def _scene_of(document: Document) -> Scene:
    with document.errors():
        return _read(document.data, document.path)


def _read(data: Any, path: Optional[Path]) -> Scene:
    """Return the scene of plain data, from a file or from none, or raise FieldError."""
    directory = Path() if path is None else path.parent
    if isinstance(data, Mapping) and 'bodies' in data:
        raise FieldError(
            'a scene', 'a mechanism', 'a scene names one under `mechanism` and says under '
            '`initial` where it starts', ('bodies',))
    mapping(data, ('mechanism',))
    model = _model(data, directory)
    mapping(data, *(SCENE_KEYS if model is None else MODEL_KEYS))
    if model is None:
        with at('mechanism'):
            mechanism = _mechanism(data['mechanism'], directory, *_acted_on(data))
    else:
        mechanism = model.mechanism
        if 'initial' not in data:
            from .model_scene import closed_start
            model, start = closed_start(model)
            mechanism = model.mechanism
            data = {**data, 'initial': {
                'position': mechanism.coordinates.by_name('position', start.position)}}
    return _scene(data, {}, path, mechanism)


def scene_with(scene: Scene, values: Mapping[str, float]) -> Scene:
    """
    Return a scene that was read from a file with other values of its parameters.

    Parameters
    ----------
    scene : Scene
        As it was read, or changed since in numbers.
    values : mapping of str to float
        Of its own parameters, and of those of its mechanism.

    Returns
    -------
    Scene

    Raises
    ------
    FieldError
        Where it has no such parameter, or a value is impossible.

    """
    if scene.source is None:
        raise FieldError('a scene that was read from a file with parameters',
                         'one that was built in Python', path=('parameters',))
    for key in values:
        with at('parameters'):
            one_of(tuple(scene.parameters), 'one of the parameters')(key)
    data, given, mechanism = scene.source
    return put_changes(scene, _scene(data, given, scene.path, mechanism),
                       _scene(data, {**given, **values}, scene.path, mechanism))


def _scene(
        data: Mapping[str, Any], given: Mapping[str, float], path: Optional[Path],
        read: Mechanism) -> Scene:
    """Return the scene of plain data, with the mechanism read and parameters given beside it."""
    parameters = Parameters.read(data.get('parameters'), given)
    mechanism = read
    own = {key: value for key, value in {**parameters.values, **given}.items()
           if key in read.parameters}
    if own:
        with at('mechanism'):
            mechanism = with_parameters(read, own)
    names = Parameters({**mechanism.parameters, **parameters.values})
    with at('initial'):
        initial = _initial(data['initial'], mechanism, names)
    with at('effects'):
        directory = Path() if path is None else path.parent
        effects: Dict[str, Any] = {}
        switched_off: List[str] = []
        for key, values in _section(data, 'effects').items():
            effects[key], acts = _effect(key, values, names, directory, mechanism.tree)
            if not acts:
                switched_off.append(key)
    with at('method'):
        method = _method(names.record(Method, _section(data, 'method')))
    for key in parameters.values:
        if key not in read.parameters and key not in names.used | parameters.used:
            raise FieldError(
                'a parameter of the mechanism, or one that an expression of this scene names',
                repr(key), nearest(key, read.parameters), ('parameters', key))
    return Scene('scene' if path is None else path.stem, path, data.get('description', ''),
                 mechanism, initial, effects, method, parameters=dict(names.values),
                 source=(data, dict(given), read), switched_off=tuple(switched_off))


def _section(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """Return an optional mapping; a key with nothing below it counts as absent."""
    value = data.get(key)
    return mapping({} if value is None else value)


def _acted_on(data: Mapping[str, Any]) -> Tuple[Set[str], ...]:
    """
    Return the names of joints that a scene acts on.

    Returns
    -------
    kept : set of str
        Those that its start holds or moves.
    rather : set of str
        Those with effects that are rather in the tree.
    named : set of str
        Those that other effects name.

    """
    found: List[str] = []
    rather: List[Any] = []
    named: List[Any] = []
    for key, place in (('initial', 'hold'), ('initial', 'velocity')):
        section = data.get(key)
        held = section.get(place) if isinstance(section, Mapping) else None
        found += held if isinstance(held, (list, Mapping)) else []
    effects = data.get('effects')
    for values in effects.values() if isinstance(effects, Mapping) else ():
        if isinstance(values, Mapping):
            (rather if values.get('type') in RATHER_IN_TREE else named).append(
                values.get('joint'))
    return tuple({name.partition('.')[0] for name in names if isinstance(name, str)}
                 for names in (found, rather, named))


def _mechanism(value: Any, directory: Path, kept: Set[str], rather: Set[str],
               named: Set[str]) -> Mechanism:
    """
    Return the mechanism that ``value`` is, names or is the path of, some joints not cut.

    Those that effects name are cut where a loop leaves no other.
    """
    try:
        if isinstance(value, Mechanism):
            return value
        if isinstance(value, Mapping):
            read = mechanism_of(value, directory)
        else:
            read = read_mechanism(_shipped('mechanisms', value) if _is_name(value) or not (
                isinstance(value, str)) else directory / value)
        for more in (rather | named, rather):
            with suppress(FieldError):
                return cheapest(with_kept(read, kept | more))
        return cheapest(with_kept(read, kept))
    except MechanismError as error:
        raise FieldError('a valid mechanism', f'this error in its file:\n{error}') from None


def _model(data: Mapping[str, Any], directory: Path) -> Any:
    """Return the data that the model of a scene was read from; None for a mechanism."""
    path = data['mechanism']
    if not isinstance(path, str) or _is_name(path) or not is_model(path):
        return None
    with at('mend_inertias'):
        mend = boolean(data.get('mend_inertias', False))
    asked = {}
    for key, check in (('model', text), ('arguments', _words), ('anywhere', boolean),
                       ('ignore', list_of(text)), ('tolerance', not_negative)):
        if key in data:
            with at(key):
                asked[key] = check(data[key])
    try:
        with at('loops'):
            return read_model(
                directory / path, loops=data.get('loops'), mend_inertias=mend, **asked)
    except MechanismError as error:
        raise FieldError('a valid mechanism', f'this error in its file:\n{error}',
                         path=('mechanism',)) from None


def _words(value: Any) -> Dict[str, str]:
    """Return a mapping of words or numbers as one of text."""
    return {key: one if isinstance(one, str) else shown(one)
            for key, one in mapping(value).items()}


def _initial(value: Any, mechanism: Mechanism, names: Parameters) -> Initial:
    """Return the initial state of a mechanism."""
    mapping(value, *INITIAL_KEYS)
    coordinates = mechanism.coordinates
    drawn = any(key in value for key in DRAWN)
    if not drawn and 'position' not in value:
        raise FieldError('this required key, or one of at and poses', 'none', path=('position',))
    with at('position'):
        cut = () if mechanism.tree is None else mechanism.tree.cut
        turning = mechanism.turning_cuts
        section = _section(value, 'position')
        # Where the start is drawn, of joints that nothing of the drawing is about.
        given = _evaluated(mapping(section, () if drawn else coordinates.keys, [
            *coordinates.keys, *(key for key in section if key in turning
                                 or key.partition('.')[0] in cut)]), coordinates, names)
        # Positions of cut joints follow from the others, but for how often they have turned round.
        turned = {key: number(one) for key, one in given.items() if key in turning}
        given = {key: one for key, one in given.items()
                 if key not in turning and key.partition('.')[0] not in cut}
        position = coordinates.filled('position', given, coordinates.start())
    if drawn:
        position = _drawn(value, mechanism, names, position)
    with at('hold'):
        hold = list_of(one_of(coordinates.can_be_held, 'one of the joints'))(
            value.get('hold', ()))
    with at('velocity'):
        given = _evaluated(_section(value, 'velocity'), coordinates, names)
        velocity = coordinates.filled('velocity', given, np.zeros(coordinates.nv))
        for joint in given:
            if hold and not {joint, coordinates.joint_of(joint)} & set(hold):
                raise FieldError(f'velocities of held joints only ({among(hold)})',
                                 f'one of {joint!r}', 'the others follow from the loops; '
                                 'add the joint to hold, or remove its velocity', (joint,))
    return Initial(tuple(position.tolist()), tuple(velocity.tolist()), hold, turned)


def _evaluated(section: Mapping[str, Any], coordinates: Any, names: Parameters) -> Dict[str, Any]:
    """Return numbers of joints in the place of expressions, of lengths where they slide."""
    found, units = {}, coordinates.units('position')
    for key, value in section.items():
        place = coordinates.index.get(key)
        with at(key):
            found[key] = names.evaluated(value, None if place is None else units[place])
    return found


def _drawn(value: Mapping[str, Any], mechanism: Mechanism, names: Parameters,
           start: np.ndarray) -> np.ndarray:
    """Return the position of a mechanism where pins, points and bodies are drawn."""
    # Here, as few scenes need it.
    from .drawn_start import drawn_position
    found: Dict[str, Dict[str, Any]] = {key: {} for key in DRAWN}
    axes = 2 if mechanism.planar else 3
    of_pose = (*axes * ('m',), *(1 if mechanism.planar else 3) * ('rad',))
    for key, units in zip(DRAWN, (axes * ('m',), of_pose)):
        count = len(units)
        with at(key):
            for one, place in _section(value, key).items():
                with at(one):
                    found[key][one] = numbers(
                        names.evaluated(place, units), count, f'a list of {count} finite numbers')
    return drawn_position(mechanism, found['at'], found['poses'], start)


def _effect(
        key: str, values: Any, names: Parameters, directory: Path,
        tree: Any) -> Tuple[Any, bool]:
    """
    Return the record of one effect, and whether it acts from the start.

    Files that it names stand beside the scene.
    """
    with at(key):
        name(key)
        values = dict(mapping(values, ('type',)))
        with at('enabled'):
            acts = boolean(values.pop('enabled', True))
        with at('type'):
            kind = one_of(tuple(EFFECTS), 'one of the effects')(values['type'])
            record_type: Any = EFFECTS[kind]
        required, optional = keys_of(record_type)
        values = _with_columns(values, record_type.FILES, directory)
        if kind == 'body_contact' and 'outline' in values:
            values = _with_outline(values, names)
        values = dict(mapping(values, ['type', *required], optional))
        del values['type']
        record = record_type(**names.record(record_type, values))
        if tree is not None and hasattr(record, 'body') and hasattr(record, 'position'):
            # In the body's frame as it was described; left out, that is its origin.
            shift, place = tree.shifts.get(record.body), record.position
            if 'position' not in values and shift is not None:
                place = len(shift) * (0.0,)
            if shift is not None and len(place) == len(shift):
                record = replace(record, position=tuple(
                    one - step for one, step in zip(place, shift)))
        return record, acts


def _with_columns(
        values: Mapping[str, Any], files: Mapping[str, Any],
        directory: Path) -> Dict[str, Any]:
    """Return the keys of an effect with columns of numbers in the place of files."""
    found = dict(values)
    for key in files:
        if key in found:
            with at(key):
                for column in files[key]:
                    if column in found:
                        raise FieldError(f'this key or {column}', 'both')
                found.update(zip(files[key], read_columns(
                    found.pop(key), directory, len(files[key]))))
    return found


def _with_outline(values: Mapping[str, Any], names: Parameters) -> Dict[str, Any]:
    """Return the keys of a contact with the points of a curve in the place of its outline."""
    for key in ('x', 'y', 'radii', 'polar', 'interpolation'):
        if key in values:
            raise FieldError(f'this key or {key}', 'both', path=('outline',))
    with at('radius'):
        radius = not_negative(names.evaluated(values.get('radius', 0.0)))
    with at('outline'):
        found = outline(radius, mapping(names.evaluated(values['outline'])))
    return {**{key: one for key, one in values.items() if key != 'outline'}, **found}


def _method(values: Mapping[str, Any]) -> Method:
    if isinstance(values, Mapping) and 'formulation' in values:
        raise FieldError(
            'no such key', f'the key with {shown(values["formulation"])}', 'every scene is '
            'evaluated subsystem by subsystem, the fastest way to the same accelerations: leave '
            'the key out', ('formulation',))
    method = Method(**mapping(values, *keys_of(Method)))
    for key, need in method.unused.items():
        if key in values:
            raise FieldError(
                f'this key only with {need}',
                f'it with integrator: {method.integrator}, stabilisation: {method.stabilisation}',
                'remove it', (key,))
    return method
