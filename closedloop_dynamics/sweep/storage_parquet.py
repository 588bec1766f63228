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
Results as a directory of Parquet files, for pandas, Polars, DuckDB and Spark.

A row is a sample; what is kept at every instant are lists. Each batch is a file of its own,
which appears whole or not at all.

"""

import json
import os

import numpy as np
import pyarrow as pa
from pyarrow import parquet

from .batch import FAILED
from .layout import TIME
from .storage import identity_of, StorageError

# Readers pass over files whose names begin like this.
IDENTITY = '_sweep.json'
STATUS = {FAILED: 'failed'}


class Parquet:
    """A directory of results."""

    def __init__(self, path, layout):
        """Take over a directory."""
        self._path, self._layout = path, layout

    @staticmethod
    def identity(path):
        """Return the identity of the sweep that a directory belongs to."""
        try:
            attributes = json.loads((path / IDENTITY).read_text())
        except (OSError, ValueError):
            attributes = {}
        return identity_of(attributes.get('sweep'), path)

    @classmethod
    def open(cls, path, layout):  # noqa: A003
        """Open the directory of an interrupted sweep."""
        return cls(path, layout)

    @classmethod
    def create(cls, path, layout):
        """Create a directory that says whose it is."""
        try:
            path.mkdir()
            (path / IDENTITY).write_text(json.dumps(layout.attributes(), indent=2) + '\n')
        except OSError as error:
            raise StorageError(f'{path} cannot be written: {error.strerror or error}') from None
        return cls(path, layout)

    def done(self):
        """Return whether each sample is there, shape (samples,)."""
        done = np.zeros(self._layout.samples, dtype=bool)
        for part in sorted(self._path.glob('part-*.parquet')):
            done[parquet.read_table(part, columns=['sample'])['sample'].to_numpy()] = True
        return done

    def write(self, batch):
        """Write a batch as a file of its own."""
        layout, count = self._layout, len(batch.samples)
        columns = {
            'sample': np.asarray(batch.samples, dtype=np.int64),
            'status': [STATUS.get(int(status), 'done') for status in batch.status],
            'reason': list(batch.reasons)}
        columns.update(zip(layout.keys, layout.plan.values(batch.samples).T))
        if layout.plan.keep:
            columns[TIME] = [layout.plan.times] * count
        for variable in layout.variables:
            columns.update(self._columns(variable, batch.values[variable.name]))
        path = self._path / f'part-{int(batch.samples[0]):09d}.parquet'
        whole = path.with_name(f'.{path.name}.{os.getpid()}')
        parquet.write_table(pa.table(columns), whole)
        os.replace(whole, path)

    def _columns(self, variable, values):
        """Return the columns of a variable: one for each joint, cut joint and component."""
        dimensions = [name for name in variable.dimensions if name != TIME]
        kept = len(dimensions) < len(variable.dimensions)
        columns = {}
        for place in np.ndindex(*(self._layout.sizes[name] for name in dimensions)):
            names = [self._layout.names[name][k] for name, k in zip(dimensions, place)]
            part = values[(..., *place)]
            columns['.'.join([variable.name, *names])] = list(part) if kept else part
        return columns

    def close(self):
        """Leave nothing behind; every write is complete."""
