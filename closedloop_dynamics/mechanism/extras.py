# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Libraries that only some uses need, which extras of the package install."""

from contextlib import contextmanager
from importlib.util import find_spec

# By their names in Python: what pip installs, and the extra of the package that has it.
LIBRARIES = {
    'PIL': ('pillow', 'plot'),
    'control': ('control', 'control'),
    'distributed': ('distributed', 'sweep'),
    'ezdxf': ('ezdxf', 'drawing'),
    'fpdf': ('fpdf2', 'report'),
    'gymnasium': ('gymnasium', 'gymnasium'),
    'jax': ('jax', 'jax'),
    'matplotlib': ('matplotlib', 'plot'),
    'mcap': ('mcap', 'bags'),
    'mujoco': ('mujoco', 'models'),
    'netCDF4': ('netCDF4', 'sweep'),
    'piqp': ('piqp', 'predictive'),
    'rainflow': ('rainflow', 'report'),
    'rosbags': ('rosbags', 'bags'),
    'torch': ('torch', 'torch'),
    'trimesh': ('trimesh', 'models'),
    'websockets': ('websockets', 'view'),
    'xacro': ('xacro', 'models'),
    'zarr': ('zarr', 'sweep'),
    'zstandard': ('zstandard', 'bags'),
}


class MissingLibraryError(ImportError):
    """A library that is needed and cannot be imported; the message says what to do."""


def remedy(library, error=None):
    """
    Return the name of a library and what to do, to go behind 'needs'.

    ``error``: why it could not be imported, if not because it is not installed.
    """
    package, extra = LIBRARIES[library]
    if error is None or isinstance(error, ModuleNotFoundError) and error.name == library:
        return f"{package}: pip install {package}, or 'closedloop_dynamics[{extra}]'"
    return (f'{package}, which is installed, but cannot be used: {" ".join(str(error).split())} '
            f'(mend the installation: pip install --force-reinstall {package})')


@contextmanager
def of_an_extra():
    """Import libraries of extras; raise MissingLibraryError where one cannot be imported."""
    try:
        yield
    except ImportError as error:
        library = (error.name or '').split('.')[0]
        if library not in LIBRARIES:
            raise
        raise MissingLibraryError(f'this needs {remedy(library, error)}', name=library) from error


def require(library):
    """Raise MissingLibraryError where a library is not installed, before work is done for it."""
    if find_spec(library) is None:
        raise MissingLibraryError(f'this needs {remedy(library)}', name=library)
