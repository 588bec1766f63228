# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""How the engine is compiled: what is compiled again, by which compiler, and what is said."""

import os
from pathlib import Path
import shutil
import subprocess
import sys
import sysconfig
from test.packaging.package import PACKAGE, ROOT

from closedloop_dynamics.engine import build, native
import pytest

ENGINE = ROOT / PACKAGE / 'engine'
WORKING = '#include "number.hpp"\nextern "C" int twice() { return 2 * number; }\n'


@pytest.fixture
def tiny(tmp_path, monkeypatch):
    """Return the folder of an engine of two files and a header, as far as build.py knows."""
    folder = tmp_path / 'engine'
    folder.mkdir()
    shutil.copy(ENGINE / 'build.py', folder)
    (folder / 'number.hpp').write_text('inline constexpr int number = 21;\n')
    (folder / 'twice.cpp').write_text(WORKING)
    # Exported: linkers may leave out what nothing refers to.
    (folder / 'build_info.cpp').write_text(
        'extern "C" __attribute__((visibility("default"))) const char *d = ENGINE_SOURCES;\n')
    monkeypatch.setattr(build, 'FOLDER', folder)
    return folder


def compile_tiny(tiny):
    """Compile it; return the names of the objects that were made."""
    objects = tiny.parent / 'objects'
    before = {path.name: path.stat().st_mtime_ns for path in objects.glob('*.o')}
    build.build(tiny.parent / build.module(), objects)
    return {path.name for path in objects.glob('*.o')
            if before.get(path.name) != path.stat().st_mtime_ns}


def test_only_what_changed_is_compiled_again(tiny):
    output = tiny.parent / build.module()
    assert not build.fresh(output)
    assert compile_tiny(tiny) == {'twice.o', 'build_info.o'}
    assert build.fresh(output)
    assert compile_tiny(tiny) == set()
    (tiny / 'number.hpp').write_text('inline constexpr int number = 22;\n')
    assert not build.fresh(output)
    # With it the digest that build_info.cpp holds.
    assert compile_tiny(tiny) == {'twice.o', 'build_info.o'}
    (tiny / 'other.cpp').write_text('extern "C" int other() { return 0; }\n')
    assert compile_tiny(tiny) == {'other.o', 'build_info.o'}
    (tiny / 'other.cpp').unlink()
    assert compile_tiny(tiny) == {'build_info.o'}


def test_copied_objects_serve_the_same_sources_and_no_others(tiny, monkeypatch):
    compile_tiny(tiny)
    copy = tiny.parent / 'copy' / 'engine'
    for name in ('engine', 'objects'):
        shutil.copytree(tiny.parent / name, copy.parent / name)
    monkeypatch.setattr(build, 'FOLDER', copy)
    assert compile_tiny(copy) == set()
    (copy / 'number.hpp').write_text('inline constexpr int number = 22;\n')
    assert compile_tiny(copy) == {'twice.o', 'build_info.o'}


def test_an_error_in_the_sources_is_shown_and_leaves_what_was_compiled(tiny):
    compile_tiny(tiny)
    output = tiny.parent / build.module()
    before = output.read_bytes()
    (tiny / 'twice.cpp').write_text('int twice() { return unknown; }\n')
    for _ in range(2):
        with pytest.raises(build.BuildError, match='unknown'):
            compile_tiny(tiny)
    assert output.read_bytes() == before and not build.fresh(output)
    (tiny / 'twice.cpp').write_text(WORKING)
    compile_tiny(tiny)
    assert build.fresh(output)


def test_machine_without_a_compiler(tiny, monkeypatch):
    monkeypatch.setenv('PATH', str(tiny))
    monkeypatch.delenv('CXX', raising=False)
    monkeypatch.setattr(build, 'find_spec', lambda name: None)
    assert build.requirements() == [f'ziglang=={build.ZIG}']
    with pytest.raises(build.BuildError, match=r'No C\+\+ compiler .* ziglang'):
        compile_tiny(tiny)
    monkeypatch.setenv('CXX', 'ccache g++')
    assert build.requirements() == [] and build.compiler() == ['ccache', 'g++']


def test_machine_without_the_headers_of_eigen(tiny, monkeypatch):
    monkeypatch.setenv('EIGEN3_INCLUDE_DIR', str(tiny))
    with pytest.raises(build.BuildError, match="EIGEN3_INCLUDE_DIR is '.*engine'"):
        compile_tiny(tiny)
    monkeypatch.delenv('EIGEN3_INCLUDE_DIR')
    monkeypatch.setattr(Path, 'is_file', lambda path: False)
    with pytest.raises(build.BuildError, match='libeigen3-dev; pip: cmeel-eigen'):
        compile_tiny(tiny)


def imported(directory):
    """Return what importing the engine of a copy of the package prints."""
    done = subprocess.run(
        [sys.executable, '-P', '-c', f'import {PACKAGE}.engine'], cwd=directory, text=True,
        env={**os.environ, 'PYTHONPATH': str(directory)}, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    return done.stdout


def test_an_engine_that_is_missing_or_old_is_refused_with_the_command_to_compile_it(tmp_path):
    copy = tmp_path / PACKAGE / 'engine'
    shutil.copytree(ENGINE, copy, ignore=shutil.ignore_patterns('__pycache__'))
    shutil.copy(ROOT / PACKAGE / '__init__.py', copy.parent)
    shutil.copy(native.__file__, copy)
    assert not imported(tmp_path)
    with open(copy / 'bindings.cpp', 'a') as source:
        source.write('// changed\n')
    said = imported(tmp_path).splitlines()[-1]
    assert said.startswith('ImportError: The sources of the engine changed')
    assert 'scripts/build' in said
    (copy / build.module()).unlink()
    said = imported(tmp_path).splitlines()[-1]
    assert said.startswith('ImportError: The compiled engine of closedloop_dynamics is missing')
    assert 'scripts/build' in said


def test_numbers_are_the_same_on_all_machines_of_an_architecture():
    flags = native.flags.split()
    assert '-ffp-contract=off' in flags
    assert not [flag for flag in flags if flag.startswith(('-march', '-mtune', '-Ofast'))
                or 'fast-math' in flag]


@pytest.mark.skipif(not Path(sysconfig.get_path('include'), 'Python.h').is_file(),
                    reason='the headers of Python are not installed')
def test_declarations_of_the_interface_of_python_are_its_own(tmp_path):
    def check(api):
        (tmp_path / 'python_api.hpp').write_text(api)
        source = tmp_path / 'check.cpp'
        source.write_text('#define Py_LIMITED_API 0x030B0000\n#include <Python.h>\n'
                          '#include "python_api.hpp"\n'
                          'static_assert(c_contiguous == PyBUF_C_CONTIGUOUS);\n')
        build.run([*(build.compiler() or build.zig()), '-std=c++17', '-Wall', '-Wextra', '-Werror',
                   '-pedantic', '-isystem', sysconfig.get_path('include'), '-fsyntax-only',
                   source])

    api = (ENGINE / 'python_api.hpp').read_text()
    check(api)
    for right, wrong in (('METH_NOARGS 0x0004', 'METH_NOARGS 0x0008'),
                         ('Py_mod_exec 2', 'Py_mod_exec 3'),
                         ('*PyFloat_FromDouble(double)', '**PyFloat_FromDouble(double)'),
                         ('c_contiguous = 0x0038', 'c_contiguous = 0x0030')):
        assert right in api
        with pytest.raises(build.BuildError):
            check(api.replace(right, wrong))


@pytest.mark.slow
@pytest.mark.skipif(not build.find_spec('ziglang'), reason='the wheel ziglang is not installed')
def test_engine_is_compiled_for_another_machine(tmp_path):
    build.build(tmp_path / build.module(), tmp_path / 'objects', target='aarch64-linux-gnu')
    # The field e_machine of ELF.
    assert (tmp_path / build.module()).read_bytes()[18:20] == bytes([183, 0])
