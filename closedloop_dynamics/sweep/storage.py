# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Where results go: a NetCDF file, a Zarr or a Parquet directory, chosen by the name's ending.

Each kind offers ``create(path, layout)`` and ``open(path, layout)``, ``done()`` (which samples
are there), ``write(batch)`` and ``close()``. A batch is written whole, and marked as done last:
whatever ends the program, what is marked is there.

"""

from contextlib import contextmanager
from importlib import import_module
import json
from pathlib import Path
import shutil

from ..mechanism.fields import among, FieldError, shown

# Ending -> module, class, the library that pip installs.
KINDS = {
    '.nc': ('storage_netcdf', 'NetCDF', 'netCDF4'),
    '.zarr': ('storage_zarr', 'Zarr', 'zarr'),
    '.parquet': ('storage_parquet', 'Parquet', 'pyarrow'),
}


class StorageError(OSError):
    """A file of results that cannot be written or continued."""


def checked_path(path):
    """
    Return a path of results, or refuse an ending that stands for no kind of file.

    Parameters
    ----------
    path : str or pathlib.Path
        Where results shall go.

    Returns
    -------
    pathlib.Path

    Raises
    ------
    FieldError
        For an unknown ending.
    StorageError
        Where the library of the kind is not installed.

    """
    path = Path(path)
    if path.suffix not in KINDS:
        raise FieldError(f'a name that ends with {among(KINDS)}', shown(str(path)),
                         path=('output',))
    _kind(path)
    return path


def _kind(path):
    """Return the class that reads and writes a path."""
    module, name, library = KINDS[path.suffix]
    try:
        return getattr(import_module(f'.{module}', __package__), name)
    except ImportError as error:
        raise StorageError(f'{path.suffix} files are written by the Python package {library}, '
                           f'which cannot be used here ({error}). Install it: pip install '
                           f'{library}') from None


@contextmanager
def opened(path, layout, resume=False, overwrite=False):
    """
    Yield the storage of a sweep, new or to be continued.

    Parameters
    ----------
    path : pathlib.Path
        From ``checked_path``.
    layout : Layout
        Of the sweep.
    resume : bool
        Whether to continue a file that is there.
    overwrite : bool
        Whether to replace it.

    Raises
    ------
    FieldError
        Where a file is there and neither is wanted, or another sweep's is to be continued.
    StorageError

    """
    kind = _kind(path)
    if path.exists():
        if resume:
            _require_same(path, kind.identity(path), layout.identity)
        elif overwrite:
            _remove(path, kind)
        else:
            raise FieldError('a name that is free', f'{path}, which exists',
                             'name another one, or add --resume to continue it or --overwrite '
                             'to replace it', ('output',))
    storage = kind.open(path, layout) if path.exists() else kind.create(path, layout)
    try:
        yield storage
    finally:
        storage.close()


def _require_same(path, there, wanted):
    """Refuse to continue what another sweep has begun."""
    for key, value in wanted.items():
        if there.get(key) != value:
            raise FieldError(
                f'the same sweep as the one that began {path}',
                f'another one: {key} was {there.get(key)}, now it is {value}',
                'repeat the first command with --resume, or name another file', ('output',))


def _remove(path, kind):
    """Remove earlier results; nothing else."""
    if path.is_file():
        path.unlink()
        return
    kind.identity(path)
    shutil.rmtree(path)


def identity_of(text, path):
    """Return the identity that a file's attribute holds, or refuse a file without one."""
    try:
        return dict(json.loads(text))
    except (TypeError, ValueError):
        raise StorageError(f'{path} is there, but holds no results of a sweep; name another '
                           'file.') from None
