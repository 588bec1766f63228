# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Compile the engine: the C++ sources of this folder into one extension module of Python.

setup.py calls this for every kind of installation, ``scripts/build`` for a checkout. It needs none
of Python's own flags and headers (python_api.hpp): all compilers get the same commands, and the
result runs in every supported Python.
"""

import argparse
from concurrent.futures import ThreadPoolExecutor
import hashlib
from importlib.util import find_spec
import os
from pathlib import Path
import re
import shlex
import shutil
import subprocess
import sys
import tempfile

FOLDER = Path(__file__).resolve().parent
# Folder of the compiled files in a checkout.
OBJECTS = FOLDER.parents[1] / 'build' / 'engine'
# Compiled first, as they take longest: templates of dense decompositions.
SLOW = ('null_space', 'large_singular', 'least_squares', 'bindings', 'driven')
# By tags of wheels, what ziglang calls the machine: the oldest systems that it links for.
TARGETS = {
    'manylinux_2_17_x86_64': 'x86_64-linux-gnu.2.17',
    'manylinux_2_17_aarch64': 'aarch64-linux-gnu.2.17',
    'macosx_11_0_arm64': 'aarch64-macos.11.0',
    'win_amd64': 'x86_64-windows-gnu',
}
# The version of the wheel ziglang, a C++ compiler for machines without one.
ZIG = '0.17.1'
# No instructions beyond the architecture's first ones and no contraction of a * b + c: the same
# numbers on all machines of an architecture. Two numbers in a register wait for one another.
FLAGS = ('-std=c++17', '-O2', '-ffp-contract=off', '-fno-math-errno', '-fno-tree-slp-vectorize',
         '-DNDEBUG', '-fPIC', '-fvisibility=hidden', '-Wall', '-Wextra')
# With the assertions of Eigen and of ours, too.
SANITIZERS = ('-UNDEBUG', '-g1', '-fno-omit-frame-pointer', '-fsanitize=address,undefined',
              '-fno-sanitize-recover=all')


class BuildError(Exception):
    """Something that compiling needs is missing, or the compiler found errors."""


def is_for(system, target):
    """Return whether to compile for ``macos`` or ``windows``, here or for another machine."""
    return f'-{system}' in target if target else sys.platform == {
        'macos': 'darwin', 'windows': 'win32'}[system]


def module(target=None):
    """Return the name of the file that Python loads."""
    return 'native.pyd' if is_for('windows', target) else 'native.abi3.so'


def sources():
    """Return the files that are compiled."""
    return sorted(FOLDER.glob('*.cpp'))


def digest():
    """Return a digest of all that a compiled engine depends on in this folder."""
    text = hashlib.sha256()
    for path in sorted([*FOLDER.glob('*.hpp'), *sources(), FOLDER / 'build.py']):
        text.update(path.name.encode() + b'\0' + path.read_bytes() + b'\0')
    return text.hexdigest()


def fresh(output):
    """Return whether a compiled engine was made of the sources as they are."""
    return output.is_file() and digest().encode() in output.read_bytes()


def compiler():
    """Return the command of the C++ compiler, of ``CXX`` or the machine; empty if none."""
    if is_for('windows', None):
        # Compilers there have commands of their own.
        return []
    if os.environ.get('CXX'):
        return shlex.split(os.environ['CXX'])
    return next(([name] for name in ('g++', 'clang++', 'c++') if shutil.which(name)), [])


def requirements():
    """Return the wheels that a build needs: a compiler, if the machine has none."""
    return [] if compiler() or find_spec('ziglang') else [f'ziglang=={ZIG}']


def zig(*target, language='c++'):
    """Return the command of the compiler in the wheel ziglang, of C++ or, ``cc``, of C."""
    found = find_spec('ziglang')
    if not found:
        raise BuildError(
            'No C++ compiler was found: CXX is not set, neither g++ nor clang++ is on the PATH, '
            'and the wheel ziglang, which is a compiler, is not installed. Install one of these.')
    program = shutil.which('zig', path=Path(found.origin).parent)
    # By itself it would compile for this very processor.
    return [program, language, '-mcpu=baseline', *target]


def python_library(folder):
    """
    Return the library by which the linker of Windows knows what python3.dll has.

    As much as ``python_api.hpp`` declares: no Python for Windows is needed.
    """
    api = (FOLDER / 'python_api.hpp').read_text()
    data = re.findall(r'^extern PyObject \*?(\w+);', api, re.MULTILINE)
    functions = re.findall(r'^\w[\w ]* \*?(Py\w+)\(', api, re.MULTILINE)
    listed, library = folder / 'python3.def', folder / 'python3.lib'
    listed.write_text('\n'.join(
        ['LIBRARY python3.dll', 'EXPORTS', *(f'{name} DATA' for name in data), *functions, '']))
    run([zig()[0], 'dlltool', '-m', 'i386:x86-64', '-d', listed, '-l', library])
    return library


def eigen():
    """Return the directory of Eigen's headers: of the wheel cmeel-eigen, or of the machine."""
    named = os.environ.get('EIGEN3_INCLUDE_DIR')
    places = [Path(named)] if named else [
        *(Path(path, 'cmeel.prefix', 'include', 'eigen3') for path in sys.path),
        *(Path(path, 'include', 'eigen3')
          for path in (sys.prefix, '/usr', '/usr/local', '/opt/homebrew'))]
    for place in places:
        if (place / 'Eigen' / 'Core').is_file():
            return place
    raise BuildError(
        f"EIGEN3_INCLUDE_DIR is '{named}', where there is no Eigen/Core." if named else
        'The headers of Eigen were not found. Install them (Debian, Ubuntu: libeigen3-dev; pip: '
        'cmeel-eigen), or set EIGEN3_INCLUDE_DIR to the directory that holds Eigen/.')


def run(command):
    """Run a command here; raise BuildError with all it said if it fails, show that otherwise."""
    done = subprocess.run(
        [str(part) for part in command], cwd=FOLDER, stdin=subprocess.DEVNULL, text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if done.returncode:
        raise BuildError(
            f'{shlex.join(map(str, command))}\nexited with {done.returncode}:\n{done.stdout}')
    if done.stdout:
        print(done.stdout, file=sys.stderr)


def state(command, dependencies):
    """Return a digest of a command and of the files that it reads; None if one is not there."""
    text = hashlib.sha256(repr(command).encode())
    for path in dependencies:
        if not path.is_file():
            return None
        text.update(path.read_bytes())
    return text.hexdigest()


def read_by(rule):
    """
    Return the files that a compiler's rule for make names; none if there is no rule.

    Those of this folder have no directory there: a copy of the objects serves the same sources
    elsewhere, and no others.
    """
    if not rule.is_file():
        return []
    return [FOLDER / name for name in shlex.split(rule.read_text().replace('\\\n', ''))[1:]]


def compile_source(source, command, folder):
    """Compile one file, unless this was done with the same command and text; return the object."""
    compiled, rule, kept = (
        folder / f'{source.stem}.{ending}' for ending in ('o', 'd', 'state'))
    if not compiled.is_file() or not kept.is_file() or (
            kept.read_text() != state(command, read_by(rule))):
        kept.unlink(missing_ok=True)
        run([*command, '-MMD', '-MF', rule, '-c', source.name, '-o', compiled])
        kept.write_text(state(command, read_by(rule)))
    return compiled


def build(output, folder, sanitize=False, target=None):
    """
    Compile the engine.

    Parameters
    ----------
    output : Path
        The file to make; it is replaced at once, when all went well.
    folder : Path
        Where the objects are kept, so that only changed sources are compiled again.
    sanitize : bool
        With the checks of addresses and undefined behaviour.
    target : str
        Another machine to compile for, by ziglang, such as ``aarch64-linux-gnu``.

    Raises
    ------
    BuildError
        No compiler, no Eigen, or an error in the sources, with what the compiler says.

    """
    output, folder = output.absolute(), folder.absolute()
    target = target or (TARGETS['win_amd64'] if is_for('windows', None) else None)
    program = zig('-target', target) if target else compiler() or zig()
    flags = [*FLAGS, *(SANITIZERS if sanitize else ())]
    if is_for('windows', target):
        flags.append('-D_USE_MATH_DEFINES')
    if is_for('macos', target):
        # Eigen's is the C++ type long there, another one than that of 64 bits.
        flags.append('-DEIGEN_DEFAULT_DENSE_INDEX_TYPE=long long')
    about = [f'-DENGINE_SOURCES="{digest()}"', f'-DENGINE_FLAGS="{shlex.join(flags)}"']
    command = [*program, *flags, '-isystem', str(eigen())]
    folder.mkdir(parents=True, exist_ok=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        compiled = list(pool.map(
            lambda source: compile_source(
                source, command + (about if source.stem == 'build_info' else []), folder),
            sorted(sources(), key=lambda source: source.stem not in SLOW)))
    output.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=output.parent) as near:
        # The functions of Python are found in the program that loads the module; Windows wants to
        # know in which library.
        run([*program, *flags, '-shared', *compiled,
             *(['-undefined', 'dynamic_lookup'] if is_for('macos', target) else []),
             *([python_library(folder)] if is_for('windows', target) else []),
             *([] if sanitize else ['-Wl,-S']), '-o', Path(near, output.name)])
        os.replace(Path(near, output.name), output)


def main():
    """Compile the engine as the command line says, into this folder by default."""
    parser = argparse.ArgumentParser(
        prog='scripts/build', description='Compile the engine of the package.')
    parser.add_argument('--sanitize', action='store_true',
                        help='check addresses and undefined behaviour at run time')
    parser.add_argument('--target', help='another machine to compile for, by the wheel ziglang')
    parser.add_argument('--output', type=Path,
                        help='the file to make (default: in place; below build/ for a target '
                             'and with --sanitize)')
    parser.add_argument('--requirements', action='store_true',
                        help='only print what pip must install before: nothing where the engine '
                             'is up to date')
    options = parser.parse_args()
    kind = '-'.join(filter(None, (OBJECTS.name, options.target, 'sanitize' * options.sanitize)))
    folder = OBJECTS.with_name(kind)
    output = options.output or (
        FOLDER if folder == OBJECTS else folder) / module(options.target)
    needed = not fresh(output)
    if options.requirements:
        print(*(requirements() if needed else ()))
    elif needed:
        print('Compiling the engine: this takes about a minute', file=sys.stderr)
        try:
            build(output, folder, options.sanitize, options.target)
        except BuildError as error:
            sys.exit(f'Error: {error}')


if __name__ == '__main__':
    main()
