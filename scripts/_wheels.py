# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Make the archive of sources, and from it a wheel for each platform; check them."""

import argparse
from pathlib import Path
import shutil
import subprocess
import sys
import tarfile
from tempfile import TemporaryDirectory
from zipfile import ZipFile

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / 'closedloop_dynamics' / 'engine'))
import build  # noqa: E402, I100

DIST = ROOT / 'dist'
# What libraries for the platforms begin with: the format, then the processor at a place.
HEADS = {
    'manylinux_2_17_x86_64': (b'\x7fELF', 18, 62),
    'manylinux_2_17_aarch64': (b'\x7fELF', 18, 183),
    'macosx_11_0_arm64': (b'\xcf\xfa\xed\xfe', 4, 0x0c),
    'win_amd64': (b'MZ', 0, 0x4d),
}


def call(*command, cwd=ROOT):
    """Run a program of this environment; end with its output where it fails."""
    done = subprocess.run([sys.executable, *map(str, command)], cwd=cwd, text=True,
                          stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                          stderr=subprocess.STDOUT)
    if done.returncode:
        sys.exit(f'{done.stdout}\nError: {" ".join(map(str, command[:3]))} failed')
    return done.stdout


def backend(step, cwd):
    """Take a step of setuptools, as pip does."""
    return call('-c', f'from setuptools import build_meta; build_meta.{step}', cwd=cwd)


def make(archive, platform):
    """Make the wheel of a platform from the archive of sources; return its path."""
    with TemporaryDirectory() as place:
        with tarfile.open(archive) as sources:
            sources.extractall(place, filter='data')
        folder, = Path(place).iterdir()
        # Objects are kept, as in a checkout.
        objects = build.OBJECTS.with_name(f'engine-{build.TARGETS[platform]}')
        with open(folder / 'setup.cfg', 'a') as settings:
            settings.write(f'\n[build_ext]\nbuild_temp = {objects}\n')
        backend(f'build_wheel({str(DIST)!r}, '
                f'{{"--build-option": ["--plat-name={platform}"]}})', folder)
    wheel, = DIST.glob(f'*-cp311-abi3-{platform}.whl')
    return wheel


def check(wheel, platform):
    """Look at the library in a wheel: its format, its processor, and its entry for Python."""
    with ZipFile(wheel) as content:
        name, = (name for name in content.namelist()
                 if name.endswith(f'/engine/{build.module(build.TARGETS[platform])}'))
        library = content.read(name)
    magic, place, processor = HEADS[platform]
    if not library.startswith(magic) or library[place] != processor:
        sys.exit(f'Error: {wheel.name}: {name} is for another platform')
    if b'PyInit_native' not in library:
        sys.exit(f'Error: {wheel.name}: {name} has no function PyInit_native')
    # Of Python the stable interface alone.
    call('-m', 'abi3audit', '--strict', wheel)
    if platform.startswith('manylinux'):
        said = call('-m', 'auditwheel', 'show', wheel)
        if f'"{platform}"' not in said:
            sys.exit(f'{said}\nError: {wheel.name} is not for {platform}')
    print(f'{wheel.name}: {wheel.stat().st_size / 1e6:.1f} MB, {name} {len(library) / 1e6:.1f} MB')


def main():
    parser = argparse.ArgumentParser(prog='scripts/wheels', description=__doc__)
    parser.add_argument('platform', nargs='*', help=f'of {", ".join(build.TARGETS)}')
    platforms = parser.parse_args().platform or list(build.TARGETS)
    if set(platforms) - set(build.TARGETS):
        parser.error(f'platform: expected some of {", ".join(build.TARGETS)}')
    if DIST.exists():
        # With the folders that a build which was interrupted leaves there.
        shutil.rmtree(DIST)
    DIST.mkdir()
    backend(f'build_sdist({str(DIST)!r})', ROOT)
    archive, = DIST.glob('*.tar.gz')
    for platform in platforms:
        print(f'{platform}: compiling, some minutes the first time', flush=True)
        check(make(archive, platform), platform)
    call('-m', 'twine', 'check', '--strict', *DIST.iterdir())
    print(f'All are in {DIST}')


if __name__ == '__main__':
    main()
