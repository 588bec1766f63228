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
Compiled code on disk, shared by all processes of a user.

Numba's own cache trusts what it reads, so that one damaged file stops every program; it does not
notice edits to callees in other files; and two processes that store at the same time can swap
their entries. Here a file holds the code of one function for one signature, with a checksum, in
a directory for one state of the sources. Without a place to write, nothing is stored.

"""

import contextlib
import functools
import hashlib
import os
from pathlib import Path
import pickle
import re
import shutil
import sys
import time
import uuid
import warnings

import llvmlite
import numba
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
import numpy as np

PACKAGE = Path(__file__).resolve().parents[1]
# Where compiled functions are that others call. One elsewhere depends on its own file, too.
COMPILED_FOLDERS = ('core', 'effects', 'integration', 'visual')
# Code of sources that nobody has used for so long is removed [s].
UNUSED = 30 * 86400.0
_DIGEST_SIZE = 32
_said = set()


@functools.cache
def directory():
    """
    Return where the code compiled from the present sources is.

    Returns
    -------
    pathlib.Path or None
        Below NUMBA_CACHE_DIR, XDG_CACHE_HOME or ``~/.cache``; None where there is no such place.

    """
    place = numba.config.CACHE_DIR or os.environ.get('XDG_CACHE_HOME') or '~/.cache'
    try:
        base = Path(place).expanduser().absolute() / PACKAGE.name
        path = base / _sources()[:16]
        new = not path.is_dir()
        # Processes that start together may each find it missing.
        path.mkdir(parents=True, exist_ok=True)
        if new:
            _remove_unused(base)
        # What is used is not removed.
        with contextlib.suppress(OSError):
            os.utime(path)
    except (OSError, RuntimeError) as error:
        _say_not_stored(place, error)
        return None
    return path


def _sources():
    """Return a digest of what all compiled code depends on: sources and compilers."""
    digest = hashlib.sha256(repr((
        sys.version, numba.__version__, llvmlite.__version__, np.__version__)).encode())
    for folder in COMPILED_FOLDERS:
        for path in sorted((PACKAGE / folder).rglob('*.py')):
            digest.update(str(path.relative_to(PACKAGE)).encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _remove_unused(base):
    for path in base.iterdir():
        # Another process may be removing it.
        with contextlib.suppress(FileNotFoundError):
            if path.stat().st_mtime < time.time() - UNUSED:
                shutil.rmtree(path, ignore_errors=True)


def read(name):
    """
    Return what was stored.

    Parameters
    ----------
    name : str
        Of the file.

    Returns
    -------
    bytes or None
        None where there is nothing, or nothing that is whole.

    """
    if directory() is None:
        return None
    try:
        content = (directory() / name).read_bytes()
    except FileNotFoundError:
        return None
    except OSError:
        content = b''
    data = content[_DIGEST_SIZE:]
    if hashlib.sha256(data).digest() != content[:_DIGEST_SIZE]:
        set_aside(name)
        return None
    return data


def set_aside(name):
    """Rename a file that cannot be used, so that it is written again, and say so."""
    path = directory() / name
    with contextlib.suppress(OSError):
        path.replace(path.with_name(f'{name}.damaged'))
    _say_once('damaged', f'{path} is damaged; it was renamed to {name}.damaged, and its '
              'content is compiled again, as are those of other damaged files beside it')


def write(name, data):
    """
    Store code for later processes; where that is not possible, each compiles its own.

    Parameters
    ----------
    name : str
        Of the file.
    data : bytes
        Its content.

    """
    if directory() is None:
        return
    temporary = directory() / f'{name}.{uuid.uuid4().hex}'
    try:
        try:
            temporary.write_bytes(hashlib.sha256(data).digest() + data)
            temporary.replace(directory() / name)
        finally:
            temporary.unlink(missing_ok=True)
    except OSError as error:
        _say_not_stored(directory(), error)


def _say_not_stored(place, error):
    _say_once('not stored', f'compiled code cannot be stored in {place} ({error}): every start '
              'compiles again, which takes up to a minute; NUMBA_CACHE_DIR names another place')


def _say_once(kind, message):
    if kind not in _said:
        _said.add(kind)
        warnings.warn(message, RuntimeWarning, stacklevel=2)


class KernelCache(NullCache):
    """
    Files of one compiled function, as numba's dispatcher asks for them.

    Parameters
    ----------
    function : function
        In Python; without a closure.

    """

    def __init__(self, function):
        self._function = function

    @property
    def cache_path(self):
        """Where the files are."""
        return str(directory())

    def name(self, signature, target_context):
        """Return the name of the file for a tuple of argument types."""
        function = self._function
        key = repr((signature, target_context.codegen().magic_tuple(),
                    _own_file(function.__code__.co_filename), function.__code__.co_firstlineno))
        place = re.sub(r'[^\w.]', '', f'{function.__module__}.{function.__qualname__}')
        return f'{place}.{hashlib.sha256(key.encode()).hexdigest()[:32]}.nbc'

    def is_stored(self, signature, target_context):
        """Tell whether there is code for a tuple of argument types."""
        return directory() is not None and (
            directory() / self.name(signature, target_context)).is_file()

    def load_overload(self, sig, target_context):
        """Return the stored CompileResult, or None."""
        target_context.refresh()
        name = self.name(sig, target_context)
        data = read(name)
        if data is None:
            return None
        try:
            return CompileResult._rebuild(target_context, *pickle.loads(data))
        except Exception:
            # Whole, but not what this version of numba wrote.
            set_aside(name)
            return None

    def save_overload(self, sig, data):
        """Store a CompileResult, unless it holds addresses of this process."""
        if not data.library.has_dynamic_globals:
            write(self.name(sig, data.target_context), dumps(data._reduce()))


@functools.cache
def _own_file(path):
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()
