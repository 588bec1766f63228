# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What sweeps leave, read back without the package: NetCDF and Zarr alike."""

import os
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = {**os.environ, 'PYTHONPATH': str(ROOT)}
LIBRARIES = {'.nc': 'netCDF4', '.zarr': 'zarr'}


def need(suffix):
    """Skip the test where the library of a kind is not installed."""
    return pytest.importorskip(LIBRARIES[suffix])


def read(path):
    """Return all numbers of a file by name, and the reasons of failures as a list."""
    return {'.nc': read_netcdf, '.zarr': read_zarr}[path.suffix](path)


def read_netcdf(path):
    import netCDF4
    with netCDF4.Dataset(path) as file:
        file.set_auto_mask(False)
        arrays = {name: variable[:] for name, variable in file.variables.items()}
    arrays.pop('joint'), arrays.pop('cut_joint'), arrays.pop('component')
    return arrays


def read_zarr(path):
    import zarr
    group = zarr.open_group(path, mode='r')
    return {name: array[:] for name, array in group.arrays()
            if name not in ('joint', 'cut_joint', 'component')}


def assert_same(one, other):
    """Check that two files hold the same, bit for bit."""
    assert set(one) == set(other)
    for name, values in one.items():
        np.testing.assert_array_equal(values, other[name], name)
