# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Python files of a user, which define effects and register them.

They run where the user has named them, and in processes to which an effect of theirs is sent.
"""

from pathlib import Path
from runpy import run_path

# What a file has defined, by its path.
_defined = {}


def run_code(path):
    """
    Run a Python file, once in a process; relative paths begin where the process works.

    ValueError where it fails, with the path and what it raised.
    """
    path = Path(path).resolve()
    if path not in _defined:
        try:
            _defined[path] = run_path(str(path), run_name=path.stem)
        except Exception as error:
            raise ValueError(f'{path}: {type(error).__name__}: {error}') from None


def definition(kind):
    """Return path and name by which a class is found in a file that was run; None elsewhere."""
    return next(((path, kind.__name__) for path, names in _defined.items()
                 if names.get(kind.__name__) is kind), None)


def defined(path, name):
    """Return the class that a file defines; the file is run unless it was."""
    run_code(path)
    return _defined[path][name]
