# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Where results go: a NetCDF file or a Zarr directory of the same variables.

A batch is written whole, and marked as done last: whatever ends the program, what is marked is
there, and can be read.
"""

from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib import import_module
import json
import math
from pathlib import Path
import shutil
from typing import Optional, Tuple

import numpy as np

from .batch import SAMPLE_DONE, SAMPLE_FAILED
from .plan import Plan
from .. import __version__
from ..mechanism.coordinates import EITHER
from ..mechanism.extras import remedy
from ..mechanism.fields import among, FieldError, shown

SAMPLE, TIME, JOINT, CUT, COMPONENT = 'sample', 'time', 'joint', 'cut_joint', 'component'
POINT, AXIS = 'point', 'axis'
# In place of the joint, of positions, where there are orientations.
COORDINATE = 'coordinate'
# In place of the joint, of forces in joints, where joints have several numbers or none.
TREE_JOINT = 'tree_joint'
# The longest reason in bytes.
STATUS, REASON, LONGEST_REASON = 'status', 'reason', 400

# Variable -> dimensions after the sample, unit, description.
MOTION = {
    'position': ((TIME, JOINT), EITHER['position'], 'joint coordinates'),
    'velocity': ((TIME, JOINT), EITHER['velocity'], 'joint rates'),
    'acceleration': ((TIME, JOINT), EITHER['acceleration'], 'joint accelerations'),
    'effort': ((TIME, JOINT), EITHER['effort'], 'joint torques, behind the drives'),
    'constraint_forces': ((TIME, CUT, COMPONENT), 'N m, N, N',
                          'what body B exerts on body A at the cut joints, world axes'),
    'joint_forces': ((TIME, JOINT, COMPONENT), 'N m, N, N',
                     'what the parent exerts on the child in the joints, world axes'),
    'points': ((TIME, POINT, AXIS), 'm', 'places of the named points'),
    'closure': ((TIME,), EITHER['position'], 'largest closure error of the loops'),
    'energy': ((TIME,), 'J', 'kinetic and stored energy'),
}
SUMMARY = {
    'final_position': ((JOINT,), EITHER['position'], 'joint coordinates at the end'),
    'final_velocity': ((JOINT,), EITHER['velocity'], 'joint rates at the end'),
    'initial_energy': ((), 'J', 'kinetic and stored energy at the start'),
    'final_energy': ((), 'J', 'kinetic and stored energy at the end'),
    'peak_force': ((CUT,), 'N', 'largest force at the cut joints, over the instants'),
    'peak_moment': ((CUT,), 'N m', 'largest moment at the cut joints, over the instants'),
    'peak_effort': ((JOINT,), EITHER['effort'], 'largest joint torques, over the instants'),
    'peak_closure': (
        (), EITHER['position'], 'largest closure error of the loops, over the instants'),
}


@dataclass(frozen=True)
class Variable:
    """One array of a file of results."""

    name: str
    dimensions: Tuple[str, ...]  # Names; the sample comes first where there is one value for each
    # Unit and meaning, by the conventions of NetCDF.
    attributes: dict = field(default_factory=dict)
    kind: type = float  # float, int (of 8 bits) or str
    length: int = 1  # Most characters of a text
    values: Optional[object] = None  # What it holds from the beginning


class Layout:
    """
    The variables of a sweep, and the sizes and names of their dimensions.

    ``batch``: samples that are written at once; ``identity``: attributes in which a file and the
    plan must agree to be continued; ``results``: names of the variables that a batch brings;
    ``sizes``: of all dimensions but the sample.
    """

    def __init__(self, plan: Plan, batch):
        mechanism = plan.scene.mechanism
        self.plan, self.batch, self.identity = plan, batch, plan.identity()
        self.samples = plan.samples
        coordinates, planar = mechanism.coordinates, mechanism.planar
        axes = 'xyz'[:2 if planar else 3]
        names = {JOINT: coordinates.names,
                 CUT: tuple(cut.name for cut in mechanism.cut_joints),
                 COMPONENT: ('moment', 'x', 'y') if planar else (
                     *(f'moment_{axis}' for axis in axes), *axes)}
        if coordinates.with_orientation:
            names |= {COORDINATE: tuple(coordinates.columns('position'))}
        if 'joint_forces' in plan.keep and coordinates.names != mechanism.joint_names:
            names |= {TREE_JOINT: mechanism.joint_names}
        if 'points' in plan.keep:
            names |= {POINT: tuple(point.name for point in mechanism.points), AXIS: tuple(axes)}
        self.sizes = {TIME: plan.schedule.instants,
                      **{name: len(places) for name, places in names.items()}}
        longest = max((len(word) for words in names.values() for word in words), default=1)
        kept = {**{name: MOTION[name] for name in plan.keep}, **SUMMARY}
        for name, other in (('position', COORDINATE), ('final_position', COORDINATE),
                            ('joint_forces', TREE_JOINT)):
            if name in kept and other in names:
                dimensions, *rest = kept[name]
                kept[name] = tuple(other if each == JOINT else each for each in dimensions), *rest
        self._keys, self.results = tuple(each.key for each in plan.variations), tuple(kept)
        self.variables = (
            Variable(TIME, (TIME,), {'units': 's', 'long_name': 'time since the start'},
                     values=plan.times),
            *(Variable(name, (name,), {}, str, longest, words) for name, words in names.items()),
            Variable(REASON, (SAMPLE,), {'long_name': 'why a sample failed'}, str,
                     LONGEST_REASON),
            *(Variable(key, (SAMPLE,), {'long_name': f'varied: {key}'}) for key in self._keys),
            *(Variable(name, (SAMPLE, *dimensions), {'units': unit, 'long_name': meaning})
              for name, (dimensions, unit, meaning) in kept.items()),
            Variable(STATUS, (SAMPLE,), {
                'flag_values': np.array([SAMPLE_DONE, SAMPLE_FAILED], dtype=np.int8),
                'flag_meanings': 'done failed',
                'long_name': '1 done, 2 failed, all else: not run'}, int))

    def columns(self, batch):
        """Return the arrays of a batch but its status, by the names of variables."""
        columns = dict(zip(self._keys, self.plan.values(batch.samples).T))
        columns.update((name, batch.values[name]) for name in self.results)
        if any(batch.reasons):
            # Whole characters, however many bytes each takes.
            columns[REASON] = [reason.encode()[:LONGEST_REASON].decode(errors='ignore')
                               for reason in batch.reasons]
        return columns

    def attributes(self):
        """Return the global attributes of a file."""
        scene = self.plan.scene
        return {
            'title': f'sweep of {scene.name}: {scene.description}'.strip(': '),
            'source': f'closedloop_dynamics {__version__}',
            'mechanism': scene.mechanism.name,
            'sweep': json.dumps(self.identity)}

    def bytes_per_sample(self):
        """Return how much the results of one sample take in memory [B]."""
        return sum(8 * math.prod(self.sizes[name] for name in variable.dimensions[1:])
                   for variable in self.variables if variable.name in self.results)


class StorageError(OSError):
    """A file of results that cannot be written or continued."""


class NetCDF:
    """
    One NetCDF file, for xarray, MATLAB, ncdump and the like.

    It is of the classic model with 64-bit data (CDF-5): its header stands from the beginning and
    a sample is a record, so that a program that is killed leaves a valid file.
    """

    library = 'netCDF4'

    def __init__(self, path, layout):
        netcdf = import_module(self.library)
        if path.exists():
            self._file = netcdf.Dataset(path, 'a')
            return
        file = self._file = netcdf.Dataset(path, 'w', format='NETCDF3_64BIT_DATA')
        file.setncatts(layout.attributes())
        for name, size in {SAMPLE: None, **layout.sizes}.items():
            file.createDimension(name, size)
        for each in layout.variables:
            dimensions, attributes = each.dimensions, each.attributes
            if each.kind is str:
                characters = f'{each.name}_text' if SAMPLE in dimensions else 'text'
                if characters not in file.dimensions:
                    file.createDimension(characters, each.length)
                dimensions = (*dimensions, characters)
                attributes = {**attributes, '_Encoding': 'utf-8'}
            file.createVariable(
                each.name, {float: 'f8', int: 'i1', str: 'S1'}[each.kind], dimensions,
                fill_value=np.nan if each.kind is float and SAMPLE in dimensions else None
            ).setncatts(attributes)
        # Every variable is defined before any is written.
        for each in layout.variables:
            if each.values is not None and len(each.values):
                self.put(each.name, slice(None), each.values)
        file.sync()

    @staticmethod
    def sweep_of(path):
        """Return the attribute of a file that identifies its sweep."""
        with import_module(NetCDF.library).Dataset(path) as file:
            return getattr(file, 'sweep', None)

    def status(self):
        """Return the status of samples, of the first ones at least."""
        self._file[STATUS].set_auto_mask(False)
        return self._file[STATUS][:]

    def put(self, name, where, values):
        """Write values of some samples."""
        variable = self._file[name]
        if variable.dtype.kind == 'S':
            length = variable.shape[-1]
            values = np.array([text.encode() for text in values],
                              dtype=f'S{length}').view('S1').reshape(-1, length)
        variable[where] = values

    def flush(self):
        """Flush the file to the system."""
        self._file.sync()

    def close(self):
        """Close the file."""
        self._file.close()


class Zarr:
    """
    A Zarr directory (format 2), for xarray, Dask and object stores.

    Every batch is a chunk of its own in every array, and every write is complete.
    """

    library = 'zarr'

    def __init__(self, path, layout):
        zarr = import_module(self.library)
        if path.exists():
            self._arrays = dict(zarr.open_group(path, mode='r+').arrays())
            return
        group = zarr.open_group(path, mode='w-', zarr_format=2)
        sizes = {SAMPLE: layout.samples, **layout.sizes}
        chunks = {name: max(size, 1) for name, size in sizes.items()}
        chunks[SAMPLE] = min(layout.batch, layout.samples)
        for each in layout.variables:
            array = group.create_array(
                each.name, shape=[sizes[name] for name in each.dimensions],
                chunks=[chunks[name] for name in each.dimensions],
                dtype={float: 'f8', int: 'i1', str: f'U{each.length}'}[each.kind],
                fill_value=np.nan if each.kind is float else None,
                # The first gives xarray the dimensions of an array in this format.
                attributes={'_ARRAY_DIMENSIONS': list(each.dimensions), **{
                    name: value.tolist() if isinstance(value, np.ndarray) else value
                    for name, value in each.attributes.items()}})
            if each.values is not None:
                array[:] = np.array(each.values, dtype=array.dtype)
        # Last: a directory without them is not taken for a sweep's.
        group.attrs.update(layout.attributes())
        self._arrays = dict(zarr.consolidate_metadata(group.store).arrays())

    @staticmethod
    def sweep_of(path):
        """Return the attribute of a directory that identifies its sweep."""
        return import_module(Zarr.library).open_group(path, mode='r').attrs.get('sweep')

    def status(self):
        """Return the status of all samples."""
        return self._arrays[STATUS][:]

    def put(self, name, where, values):
        """Write values of some samples."""
        array = self._arrays[name]
        (array if isinstance(where, slice) else array.oindex)[where] = np.asarray(
            values, dtype=array.dtype)

    def flush(self):
        """Nothing waits to be written."""

    def close(self):
        """Nothing is held open."""


KINDS = {'.nc': NetCDF, '.zarr': Zarr}


class Storage:
    """The results of one sweep on disk, in one of the kinds of file."""

    def __init__(self, path, layout):
        self._layout = layout
        try:
            self._file = KINDS[path.suffix](path, layout)
        except OSError as error:
            raise StorageError(f'{path} cannot be written: {error.strerror or error}') from None
        self.close = self._file.close

    def done(self):
        """Return whether each sample is there, shape (samples,)."""
        done = np.zeros(self._layout.samples, dtype=bool)
        status = self._file.status()
        done[:len(status)] = np.isin(status, (SAMPLE_DONE, SAMPLE_FAILED))
        return done

    def write(self, batch):
        """Write a batch; mark it as done when it is there."""
        first, last = int(batch.samples[0]), int(batch.samples[-1])
        # Samples that follow one another are written at once.
        where = (slice(first, last + 1) if last - first + 1 == len(batch.samples)
                 else batch.samples)
        for name, values in self._layout.columns(batch).items():
            self._file.put(name, where, values)
        self._file.flush()
        self._file.put(STATUS, where, batch.status)
        self._file.flush()


def checked_path(path):
    """
    Return a path of results.

    Raises FieldError for an unknown ending, StorageError where its library is not installed.
    """
    path = Path(path)
    if path.suffix not in KINDS:
        raise FieldError(f'a name that ends with {among(KINDS)}', shown(str(path)),
                         path=('output',))
    library = KINDS[path.suffix].library
    try:
        import_module(library)
    except ImportError as error:
        raise StorageError(f'{path.suffix} files need {remedy(library, error)}') from None
    return path


@contextmanager
def opened(path, layout, resume=False, overwrite=False):
    """
    Yield the storage of a sweep, new or to be continued.

    FieldError where a file is there and neither is wanted, or another sweep's is to be continued;
    StorageError.
    """
    if path.exists():
        if resume:
            _require_same(path, _identity(path), layout.identity)
        elif overwrite:
            _remove(path)
        else:
            raise FieldError('a name that is free', f'{path}, which exists',
                             'name another one, or add --resume to continue it or --overwrite '
                             'to replace it', ('output',))
    storage = Storage(path, layout)
    try:
        yield storage
    finally:
        storage.close()


def _require_same(path, there, wanted):
    """Refuse to continue another sweep's file."""
    for key, value in wanted.items():
        if there.get(key) != value:
            raise FieldError(
                f'the same sweep as the one that began {path}',
                f'another one: {key} was {there.get(key)}, now it is {value}',
                'repeat the first command with --resume, or name another file', ('output',))


def _remove(path):
    """Remove earlier results; nothing else."""
    if path.is_file():
        path.unlink()
        return
    _identity(path)
    shutil.rmtree(path)


def _identity(path):
    """Return the identity of the sweep that a file belongs to, or refuse any other file."""
    try:
        return dict(json.loads(KINDS[path.suffix].sweep_of(path)))
    except OSError as error:
        raise StorageError(f'{path} cannot be read: {error.strerror or error}') from None
    except (TypeError, ValueError):
        raise StorageError(f'{path} is there, but holds no results of a sweep; name another '
                           'file.') from None
