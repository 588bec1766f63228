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

"""Records behind an address: what compiled code finds there is what was laid out."""

from typing import NamedTuple, Optional

from closedloop_dynamics.core.codegen import available, records
from closedloop_dynamics.core.compiled import compiled
import numpy as np
import pytest


class Inner(NamedTuple):
    """Numbers in a table."""

    table: np.ndarray
    nothing: Optional[np.ndarray]


class Outer(NamedTuple):
    """Arrays of several types, and a record in the record."""

    count: np.ndarray
    inner: Inner
    row: np.ndarray


@records.addressed
def _add(record, number, first, out):
    for i in range(first.shape[0]):
        out[i] = first[i] + record.row[i] + record.inner.table[number, i]
    record.count[0] += 1
    return record.inner.table.shape[0]


@compiled
def call_it(addresses, number, first, second):
    return records.call_at(addresses, 2, number, first, second)


@records.addressed
def _count(record, number, first, out):
    record.count[0] += 1
    return 1


@pytest.mark.skipif(not available(), reason='nothing has an address without a compiler')
def test_code_of_several_functions_is_told_apart_by_name_alone():
    # That which is read from the disk was numbered by other processes.
    names = {kernel.py_func.__qualname__ for kernel in (_add, _count)}
    assert names == {f'{__name__}._add', f'{__name__}._count'}


@pytest.mark.parametrize('nothing', [None, np.ones(2)])
def test_code_finds_the_arrays_of_a_record(nothing):
    table = np.arange(12.0).reshape(4, 3)
    record = Outer(np.zeros(1, dtype=np.int64), Inner(table, nothing), np.array([0.5, 0.25, 0.0]))
    addresses, _kept = records.link(record, [None, _add])
    values, out = np.array([100.0, 200.0, 300.0]), np.zeros(3)

    assert call_it(addresses, 2, values, out) == 4
    assert out.tolist() == [106.5, 207.25, 308.0]

    # What has changed in an array since is seen, from Python, too.
    table[0] = 0.0
    assert records.from_python(addresses, 2, values)() == 4
    assert values.tolist() == [100.5, 200.25, 300.0]
    assert record.count[0] == 2
