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
Results as one NetCDF file, for xarray, MATLAB, ncdump and the like.

It is of the classic model with 64-bit offsets (CDF-5): its header stands from the beginning and a
sample is a record, so that a program that is killed leaves a valid file.

"""

import netCDF4
import numpy as np

from .batch import DONE, FAILED
from .layout import LONGEST_REASON, SAMPLE, TIME
from .storage import identity_of, StorageError

REASON, TEXT = 'reason', 'text'


class NetCDF:
    """An open NetCDF file of results."""

    def __init__(self, file, layout):
        """Take over an open file."""
        self._file, self._layout = file, layout

    @staticmethod
    def identity(path):
        """Return the identity of the sweep that a file belongs to."""
        try:
            with netCDF4.Dataset(path) as file:
                return identity_of(getattr(file, 'sweep', None), path)
        except OSError as error:
            raise StorageError(f'{path} cannot be read: {error.strerror or error}') from None

    @classmethod
    def open(cls, path, layout):  # noqa: A003
        """Open the file of an interrupted sweep."""
        return cls(netCDF4.Dataset(path, 'a'), layout)

    @classmethod
    def create(cls, path, layout):
        """Create a file with its header and coordinates."""
        try:
            file = netCDF4.Dataset(path, 'w', format='NETCDF3_64BIT_DATA')
        except OSError as error:
            raise StorageError(f'{path} cannot be written: {error.strerror or error}') from None
        file.setncatts(layout.attributes())
        file.createDimension(SAMPLE, None)
        for name, size in layout.sizes.items():
            file.createDimension(name, size)
        longest = max((len(word) for words in layout.names.values() for word in words), default=1)
        file.createDimension(TEXT, longest)
        file.createDimension(f'{REASON}_{TEXT}', LONGEST_REASON)
        cls._define(file, layout)
        for name, words in layout.names.items():
            if words:
                file[name][:] = _characters(words, longest)
        file[TIME][:] = layout.plan.times
        file.sync()
        return cls(file, layout)

    @staticmethod
    def _define(file, layout):
        """Define all variables, before any is written."""
        def define(name, kind, dimensions, fill=None, **attributes):
            variable = file.createVariable(name, kind, dimensions, fill_value=fill)
            variable.setncatts(attributes)

        define(TIME, 'f8', (TIME,), units='s', long_name='time since the start')
        for name in layout.names:
            define(name, 'S1', (name, TEXT), _Encoding='utf-8')
        define('status', 'i1', (SAMPLE,), flag_values=np.array([DONE, FAILED], dtype=np.int8),
               flag_meanings='done failed', long_name='1 done, 2 failed, all else: not run')
        define(REASON, 'S1', (SAMPLE, f'{REASON}_{TEXT}'), _Encoding='utf-8',
               long_name='why a sample failed')
        for key in layout.keys:
            define(key, 'f8', (SAMPLE,), fill=np.nan, long_name=f'varied: {key}')
        for variable in layout.variables:
            define(variable.name, 'f8', (SAMPLE, *variable.dimensions), fill=np.nan,
                   units=variable.unit, long_name=variable.meaning)

    def done(self):
        """Return whether each sample is there, shape (samples,)."""
        done = np.zeros(self._layout.samples, dtype=bool)
        self._file['status'].set_auto_mask(False)
        status = self._file['status'][:]
        done[:len(status)] = np.isin(status, (DONE, FAILED))
        return done

    def write(self, batch):
        """Write a batch; mark it as done when it is there."""
        file, layout = self._file, self._layout
        where = _index(batch.samples)
        parameters = layout.plan.values(batch.samples)
        for key, values in zip(layout.keys, parameters.T):
            file[key][where] = values
        for variable in layout.variables:
            file[variable.name][where] = batch.values[variable.name]
        if any(batch.reasons):
            file[REASON][where] = _characters(batch.reasons, LONGEST_REASON)
        file.sync()
        file['status'][where] = batch.status
        file.sync()

    def close(self):
        """Close the file."""
        self._file.close()


def _index(samples):
    """Return a slice where samples follow one another, which is written at once."""
    first, last = int(samples[0]), int(samples[-1])
    return slice(first, last + 1) if last - first + 1 == len(samples) else samples


def _characters(words, length):
    """Return texts as rows of single characters."""
    texts = np.array([word.encode()[:length] for word in words], dtype=f'S{length}')
    return netCDF4.stringtochar(texts)
