# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
YAML to Mechanism.

Every error names file and line, key path, what was expected and what was got:
``arm.yaml:12: joints.elbow.parent: expected the name of a body or 'ground',
got the text 'uper_arm' (did you mean 'upper_arm'?)``.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Dict, Optional, Tuple, Union

from .between import BETWEEN, link, with_tree
from .checks import number
from .coupling_law import read_law
from .cylinders import SECTION as CYLINDERS, with_cylinders
from .document import Document, plain
from .expressions import Parameters, put_changes
from .fields import among, at, FieldError, keys_of, mapping, nearest, normalise
from .mechanism import Joint, Mechanism, MechanismError, MESH
from .shapes import visuals, with_shape
from .validation import checked, SECTIONS, SPATIAL_SECTIONS, validate_mechanism

# What a massless body need not say, beside its centre of mass.
_NOTHING = {'mass': 0.0, 'inertia': 0.0}
# Keys of a body that follow from its shape.
_SHAPE_KEYS = {'shape': 'm', 'density': 'kg/m^3'}

__all__ = ['mechanism_of', 'read_mechanism', 'validate_mechanism', 'with_cuts', 'with_data',
           'with_kept', 'with_parameters']


def read_mechanism(
        path: Union[str, Path, Mapping[str, Any]],
        parameters: Optional[Mapping[str, float]] = None) -> Mechanism:
    """
    Read a mechanism from a YAML file, or from its data.

    Parameters
    ----------
    path : str, pathlib.Path or mapping
        Of the file; or its keys and values, paths of meshes from the working directory on.
    parameters : mapping of str to float, optional
        Values in the place of those that its section ``parameters`` gives.

    Returns
    -------
    Mechanism

    Raises
    ------
    MechanismError
        Where the file cannot be read or describes no mechanism.

    """
    if isinstance(path, Mapping):
        try:
            return mechanism_of(plain(path), Path(), parameters)
        except FieldError as error:
            raise MechanismError(str(error)) from None
    document = Document(path, MechanismError)
    with document.errors():
        return mechanism_of(document.data, Path(path).parent, parameters)


def mechanism_of(data: Any, folder: Path,
                 parameters: Optional[Mapping[str, float]] = None) -> Mechanism:
    """
    Return the mechanism of plain data, with the paths of meshes from a folder on.

    Raises
    ------
    FieldError

    """
    return _mechanism(_located(data, folder.resolve()), parameters or {})


def _located(data: Any, folder: Path) -> Any:
    """Return data with the paths of meshes, which are relative to a folder, as a whole."""
    bodies = data.get('bodies') if isinstance(data, Mapping) else None
    drawn = [body.get('visual') for body in (
        bodies.values() if isinstance(bodies, Mapping) else ()) if isinstance(body, Mapping)]
    if isinstance(data, Mapping):
        drawn.append(data.get('ground_visual'))
    for visual in drawn:
        for shape in visual if isinstance(visual, list) else ():
            mesh = shape.get(MESH) if isinstance(shape, Mapping) else None
            if isinstance(mesh, dict) and isinstance(mesh.get('file'), str):
                mesh['file'] = str(folder / mesh['file'])
    return data


def with_parameters(mechanism: Mechanism, parameters: Mapping[str, float]) -> Mechanism:
    """
    Return a mechanism that was read from a file with other values of its parameters.

    Parameters
    ----------
    mechanism : Mechanism
        As it was read, or changed since in numbers.
    parameters : mapping of str to float
        Those that change; what follows from others that change with them, too.

    Raises
    ------
    FieldError
        Where it has no such parameter, or a value is impossible.

    """
    if mechanism.source is None:
        raise FieldError('a mechanism that was read from a file with parameters',
                         'one that was built in Python', path=('parameters',))
    data, given, orders = mechanism.source
    return checked(put_changes(
        mechanism, _mechanism(data, given, orders),
        _mechanism(data, {**given, **parameters}, orders)))


def with_data(mechanism: Mechanism, data: Mapping[str, Any],
              parameters: Mapping[str, float]) -> Mechanism:
    """
    Return the mechanism of other data, with the same joints cut.

    Parameters
    ----------
    mechanism : Mechanism
        As it was read.
    data : mapping
        As its file would have them.
    parameters : mapping of str to float
        Values in the place of those of the data.

    Raises
    ------
    FieldError, MechanismError

    """
    _, given, orders = mechanism.source
    return _mechanism(data, {**given, **parameters}, orders)


def with_cuts(mechanism: Mechanism, cut: Sequence[str]) -> Mechanism:
    """
    Return a mechanism that was read from a file with other joints cut.

    Parameters
    ----------
    mechanism : Mechanism
        With ``tree``.
    cut : sequence of str
        Joints between bodies; all others of them are kept.

    Raises
    ------
    FieldError
        Where these leave no tree.

    """
    data, given, _ = mechanism.source
    found = _mechanism(data, given, {
        name: name in cut for name, values in data['joints'].items() if BETWEEN in values})
    return replace(found, tree=replace(
        found.tree, listed=mechanism.tree.listed, open=mechanism.tree.open))


def with_kept(mechanism: Mechanism, joints: Collection[str]) -> Mechanism:
    """
    Return a mechanism with some joints in its tree, where the program may choose.

    Parameters
    ----------
    mechanism : Mechanism
        As it was read.
    joints : collection of str
        Names of joints that something acts in; of others they do not count.

    Returns
    -------
    Mechanism
        Itself where nothing is to choose.

    Raises
    ------
    FieldError
        Where these leave no joint of a loop to cut.

    """
    if mechanism.tree is None or not set(joints) & set(mechanism.tree.open):
        return mechanism
    kept = set(joints) & set(mechanism.tree.open)
    data, given, _ = mechanism.source
    found = _mechanism(data, given, dict.fromkeys(kept, False))
    return replace(found, tree=replace(
        found.tree, listed=mechanism.tree.listed,
        open=tuple(name for name in mechanism.tree.open if name not in kept)))


def _mechanism(
        data: Any, given: Mapping[str, float],
        orders: Optional[Mapping[str, bool]] = None) -> Mechanism:
    """Return the mechanism of plain data and of requested cuts, or raise FieldError."""
    required, optional = keys_of(Mechanism, leave_out=('source', 'tree', 'motions', 'rounded'))
    source = mapping(data, required, [*optional, CYLINDERS])
    parameters = Parameters.read(data.get('parameters'), given)
    with at('parameters'):
        for key, value in given.items():
            if key not in parameters.values:
                raise FieldError(
                    f'one of the parameters {among(parameters.values) or "(there are none)"}',
                    repr(key), nearest(key, parameters.values))
            with at(key):
                number(value)
    spatial = _is_spatial(data)
    if CYLINDERS in data:
        data = with_cylinders(data, parameters, spatial)
    links: Dict[str, Any] = {}
    ground = ()
    if 'ground_visual' in data:
        with at('ground_visual'):
            ground = visuals(_evaluated(data['ground_visual'], parameters), spatial)
    values: Dict[str, Any] = {
        key: _records(value, key, parameters, spatial, links, data) if key in SECTIONS else value
        for key, value in data.items()}
    mechanism = Mechanism(**{
        **values, 'parameters': dict(parameters.values), 'source': (source, dict(given), orders),
        'ground_visual': ground})
    origin: Any = (0.0, 0.0, 0.0) if spatial else (0.0, 0.0)
    bodies = tuple(
        replace(body, center_of_mass=origin)
        if body.massless is True and body.center_of_mass is None else body
        for body in mechanism.bodies or ())
    mechanism = replace(mechanism, bodies=bodies)
    if all(isinstance(one, Joint) for one in links.values()):
        return checked(mechanism)
    return checked(with_tree(_checked_parts(mechanism, spatial), links, orders))


def _checked_parts(mechanism: Mechanism, spatial: bool) -> Mechanism:
    """Return a mechanism with all but its joints checked one by one."""
    sections = SPATIAL_SECTIONS if spatial else SECTIONS
    found: Dict[str, Any] = {}
    for key, (_, checks) in sections.items():
        if key in ('bodies', 'cut_joints', 'points', 'couplings'):
            with at(key):
                found[key] = tuple(_checked_record(record, checks)
                                   for record in getattr(mechanism, key) or ())
    return replace(mechanism, **found)


def _checked_record(record: Any, checks: Mapping[str, Any]) -> Any:
    if getattr(record, 'massless', False):
        return record
    with at(record.name):
        return normalise(replace(record), **checks)


def _is_spatial(data: Mapping[str, Any]) -> bool:
    """Return whether data describe a mechanism in space, as their first joint does."""
    joints = data.get('joints')
    first = next(iter(joints.values()), None) if isinstance(joints, Mapping) else None
    place = first.get('position') if isinstance(first, Mapping) else None
    if isinstance(first, Mapping) and BETWEEN in first:
        points = first.get('points')
        place = points[0] if isinstance(points, list) and points else None
    return isinstance(place, list) and len(place) == 3


def _records(
        section: Any, key: str, parameters: Parameters, spatial: bool,
        links: Dict[str, Any], data: Mapping[str, Any]) -> Tuple[Any, ...]:
    """Return the records of one section of the file; put joints, of both kinds, into links."""
    record_type, _ = SECTIONS[key]
    required, optional = keys_of(record_type, leave_out=('name',))
    if key == 'bodies':
        optional = [*optional, *_SHAPE_KEYS]
    records = []
    with at(key):
        for entry, values in mapping({} if section is None else section).items():
            with at(entry):
                if isinstance(values, Mapping):
                    values = parameters.record(record_type, values)
                    if key == 'joints' and BETWEEN in values:
                        with at('points'):
                            points = parameters.evaluated(values.get('points'), 'm')
                        links[entry] = link(entry, {**values, 'points': points} if (
                            'points' in values) else values, data['bodies'] or (), spatial)
                        continue
                    if key == 'bodies':
                        values = _body(values, parameters, spatial)
                    if key == 'couplings' and values.get('law') is not None:
                        with at('law'):
                            values = {**values, 'law': read_law(values['law'], parameters)}
                records.append(record_type(entry, **mapping(values, required, optional)))
                if key == 'joints':
                    links[entry] = records[-1]
    return tuple(records)


def _evaluated(shapes: Any, parameters: Parameters) -> Any:
    """Return shapes with numbers in the place of expressions; paths of meshes stay."""
    if not isinstance(shapes, list):
        return shapes
    found = []
    for index, shape in enumerate(shapes):
        mesh = shape.get(MESH) if isinstance(shape, Mapping) else None
        with at(index):
            if isinstance(mesh, Mapping) and 'file' in mesh:
                with at(MESH):
                    rest = parameters.evaluated(
                        {key: value for key, value in mesh.items() if key != 'file'}, 'm')
                found.append({**shape, MESH: {**rest, 'file': mesh['file']}})
            else:
                found.append(parameters.evaluated(shape, 'm'))
    return found


def _body(values: Dict[str, Any], parameters: Parameters, spatial: bool) -> Dict[str, Any]:
    """Return the keys of a body, with its optional ones."""
    for key, unit in _SHAPE_KEYS.items():
        if key in values:
            with at(key):
                values[key] = parameters.evaluated(values[key], unit)
    if 'visual' in values:
        with at('visual'):
            values['visual'] = visuals(_evaluated(values['visual'], parameters), spatial)
    values = with_shape(values, spatial)
    if values.get('massless') is True:
        values = {**_NOTHING, 'center_of_mass': None, **values}
    return values
