# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""C++ around Pinocchio, compiled when a benchmark first asks for it."""

import ctypes
import hashlib
import os
from pathlib import Path
import subprocess
import sys
import tempfile

import pinocchio as pin


def compiled(source, *libraries):
    """
    Compile a file against the installed wheel, once for each version of both.

    Parameters
    ----------
    source : pathlib.Path
        C++ with functions in the manner of C.
    libraries : str
        Options that link more than Pinocchio itself.

    Returns
    -------
    ctypes.CDLL or None
        None where there is no compiler, or the headers do not suffice.

    """
    prefix = Path(pin.__file__).resolve().parents[4]
    options = ['-O3', '-DNDEBUG', '-std=c++17', '-shared', '-fPIC', '-w',
               '-DBOOST_MPL_LIMIT_LIST_SIZE=30', '-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS',
               f'-I{prefix}/include', f'-I{prefix}/include/eigen3']
    links = [f'-L{prefix}/lib', '-lpinocchio_default', *libraries,
             f'-Wl,-rpath,{prefix}/lib']
    text = source.read_text() + ' '.join(options + links) + pin.__version__
    cache = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    library = cache / 'closedloop_dynamics' / (
        f'{source.stem}_{hashlib.sha256(text.encode()).hexdigest()[:16]}.so')
    if not library.exists():
        print(f'compiling {source.name} around Pinocchio (a minute, this time alone) ...',
              file=sys.stderr)
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as scratch:
            made = Path(scratch) / 'made.so'
            try:
                subprocess.run([os.environ.get('CXX', 'g++'), *options, str(source), '-o',
                                str(made), *links], check=True, capture_output=True, text=True)
            except (OSError, subprocess.CalledProcessError) as error:
                lines = (getattr(error, 'stderr', '') or str(error)).strip().splitlines()
                print(f'no loops in C++: {lines[0] if lines else error}', file=sys.stderr)
                return None
            made.replace(library)
    return ctypes.CDLL(str(library))
