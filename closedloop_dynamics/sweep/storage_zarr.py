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
Results as a Zarr directory (format 2), for xarray, Dask and object stores.

Every batch is a chunk of its own in every array.

"""

import numpy as np
import zarr

from .batch import DONE, FAILED
from .layout import LONGEST_REASON, SAMPLE, TIME
from .storage import identity_of, StorageError

# How xarray knows the dimensions of an array in this format.
DIMENSIONS = '_ARRAY_DIMENSIONS'


class Zarr:
    """An open Zarr directory of results."""

    def __init__(self, group, layout):
        """Take over an open group."""
        self._arrays, self._layout = dict(group.arrays()), layout

    @staticmethod
    def identity(path):
        """Return the identity of the sweep that a directory belongs to."""
        try:
            attributes = zarr.open_group(path, mode='r').attrs
        except (OSError, ValueError) as error:
            raise StorageError(f'{path} is no Zarr directory: {error}') from None
        return identity_of(attributes.get('sweep'), path)

    @classmethod
    def open(cls, path, layout):  # noqa: A003
        """Open the directory of an interrupted sweep."""
        return cls(zarr.open_group(path, mode='r+'), layout)

    @classmethod
    def create(cls, path, layout):
        """Create a directory with all arrays, nothing but coordinates in them."""
        try:
            group = zarr.open_group(path, mode='w-', zarr_format=2)
        except OSError as error:
            raise StorageError(f'{path} cannot be written: {error.strerror or error}') from None

        def define(name, dtype, dimensions, fill, **attributes):
            sizes = [layout.samples if size == SAMPLE else layout.sizes[size]
                     for size in dimensions]
            chunks = [min(layout.batch, layout.samples) if size == SAMPLE else
                      max(layout.sizes[size], 1) for size in dimensions]
            return group.create_array(
                name, shape=sizes, chunks=chunks, dtype=dtype, fill_value=fill,
                attributes={DIMENSIONS: list(dimensions), **attributes})

        for name, words in layout.names.items():
            longest = max(map(len, words), default=1)
            define(name, f'U{longest}', (name,), None)[:] = np.array(words, dtype=f'U{longest}')
        define(TIME, 'f8', (TIME,), np.nan, units='s')[:] = layout.plan.times
        define('reason', f'U{LONGEST_REASON}', (SAMPLE,), None, long_name='why a sample failed')
        for key in layout.keys:
            define(key, 'f8', (SAMPLE,), np.nan, long_name=f'varied: {key}')
        for variable in layout.variables:
            define(variable.name, 'f8', (SAMPLE, *variable.dimensions), np.nan,
                   units=variable.unit, long_name=variable.meaning)
        define('status', 'i1', (SAMPLE,), None, long_name='0 not run, 1 done, 2 failed')
        # Last: a directory without them is not taken for a sweep's.
        group.attrs.update(layout.attributes())
        return cls(zarr.consolidate_metadata(group.store), layout)

    def done(self):
        """Return whether each sample is there, shape (samples,)."""
        return np.isin(self._arrays['status'][:], (DONE, FAILED))

    def write(self, batch):
        """Write a batch; mark it as done when it is there."""
        layout = self._layout
        for key, values in zip(layout.keys, layout.plan.values(batch.samples).T):
            self._put(key, batch.samples, values)
        for variable in layout.variables:
            self._put(variable.name, batch.samples, batch.values[variable.name])
        if any(batch.reasons):
            self._put('reason', batch.samples,
                      np.array(batch.reasons, dtype=f'U{LONGEST_REASON}'))
        self._put('status', batch.samples, batch.status)

    def _put(self, name, samples, values):
        array, first, last = self._arrays[name], int(samples[0]), int(samples[-1])
        if last - first + 1 == len(samples):
            array[first:last + 1] = values
        else:
            array.oindex[samples] = values

    def close(self):
        """Leave nothing behind; every write is complete."""
