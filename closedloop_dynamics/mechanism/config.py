# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Find the mechanisms and scenes that come with the package.

They lie in ``config/`` beside the package in a source checkout, and under
``share/closedloop_dynamics/config`` of the prefix it is installed in (colcon and
pip alike).
"""

from pathlib import Path


def config_directory():
    """
    Return the directory that holds ``mechanisms/`` and ``scenes/``.

    FileNotFoundError where the package was installed without its data files.
    """
    package = Path(__file__).resolve().parents[1]
    candidates = [package.parent / 'config']
    candidates += [parent / 'share' / package.name / 'config' for parent in package.parents]
    for candidate in candidates:
        if (candidate / 'mechanisms').is_dir() and (candidate / 'scenes').is_dir():
            return candidate
    raise FileNotFoundError(
        f'the directory config/ with the mechanisms and scenes of {package.name} is neither '
        f'beside {package} nor in share/{package.name} of any directory above it; '
        'install the package with its data files (colcon build, or pip install)')


def shipped_names(kind):
    """Return the sorted names of the shipped files of a kind: mechanisms or scenes."""
    return sorted(path.stem for path in (config_directory() / kind).glob('*.yaml'))


def shipped_path(kind, name):
    """Return the path of one shipped file; it need not exist."""
    return config_directory() / kind / f'{name}.yaml'
