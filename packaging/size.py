# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Measure what an installation of the package downloads, and its size on disk, all it needs included.

What is downloaded and installed for it goes into a temporary folder.
"""

import argparse
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory


def pip(command, *arguments):
    """Run pip, without a cache; end with all it said where it fails."""
    done = subprocess.run(
        [sys.executable, '-m', 'pip', '--no-input', '--disable-pip-version-check', command,
         '--quiet', *arguments],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if done.returncode:
        sys.exit(f'{done.stdout}\nError: pip {command} failed')


def size(folder):
    """Return the bytes of all files below a folder."""
    return sum(path.stat().st_size for path in folder.rglob('*') if path.is_file())


def main():
    parser = argparse.ArgumentParser(prog='packaging/size.py', description=__doc__)
    parser.add_argument('wheel', help='what pip installs: dist/WHEEL, or dist/WHEEL[plot,bags]')
    wheel = parser.parse_args().wheel
    with TemporaryDirectory() as place:
        wheels, installed = Path(place, 'wheels'), Path(place, 'installed')
        pip('download', '--dest', str(wheels), '--only-binary', ':all:', wheel)
        # The modules are compiled, as pip does it by default.
        pip('install', '--no-index', '--find-links', str(wheels), '--target', str(installed),
            wheel)
        print(f'{wheel}: {size(wheels) / 1e6:.0f} MB to download, '
              f'{size(installed) / 1e6:.0f} MB on disk, Python {sys.version.split()[0]}')


if __name__ == '__main__':
    main()
