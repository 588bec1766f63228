# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Build a package of messages, services and actions against the wheels of ROS 2.

    python test/ros/build_interfaces.py SOURCE OUT PACKAGE...

``SOURCE`` has the package.xml, ``PACKAGE`` are those whose types it uses. The wheels have the
generators of rosidl, but no ament_cmake to call them; where ROS 2 is installed, ``colcon build``
does all this. What is built is the type support for C, which rclpy uses. Prints the environment
that nodes need to find the package.
"""

from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import subprocess
import sys
import sysconfig
from xml.etree import ElementTree

import numpy as np

PREFIX = Path(sys.prefix)
SUPPORTS = 'typesupport_fastrtps_c', 'typesupport_introspection_c'
# What every action and service uses.
ALWAYS = ('action_msgs', 'builtin_interfaces', 'service_msgs', 'unique_identifier_msgs')
RUNTIME = ('rosidl_runtime_c', 'rosidl_typesupport_interface', 'rosidl_typesupport_c',
           'rosidl_typesupport_fastrtps_c', 'rosidl_typesupport_fastrtps_cpp', 'fastcdr',
           'rosidl_typesupport_introspection_c', 'rosidl_dynamic_typesupport', 'rmw', 'rcutils',
           'rosidl_runtime_cpp', 'rosidl_typesupport_cpp')


def generate(source, out, package, others):
    """Write IDL to ``out/share`` and sources to ``out``."""
    os.environ.setdefault('AMENT_PREFIX_PATH', str(PREFIX))
    from rosidl_adapter.cli import TranslateActionToIDL, TranslateMsgToIDL, TranslateSrvToIDL
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_generator_type_description.cli import HashTypeDescription
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport
    include = [str(PREFIX / 'share' / other) for other in others]
    share, generated = out / 'share' / package, out / package
    idl = {kind: translator(kind).translate(
        package, [f'{source}:{path.relative_to(source)}'
                  for path in sorted(source.glob(f'{kind}/*.{kind}'))], include, share)
           for kind, translator in (('msg', TranslateMsgToIDL), ('srv', TranslateSrvToIDL),
                                    ('action', TranslateActionToIDL))}
    every = sum(idl.values(), [])
    hashes = HashTypeDescription('type_description').generate_type_hashes(
        package, every, include, share)
    for kind, files in idl.items():
        # By kind: it takes hashes by the name of the file alone.
        GenerateC('c').generate(package, files, include, generated, [
            str(path) for path in hashes if Path(path).parent.name == kind])
    # Each to a folder of its own: some write files of the same name.
    for name, generator in (
            ('', GeneratePython('py')), ('c', GenerateCTypesupport('c')),
            ('fastrtps', GenerateFastRTPSCTypesupport('fastrtps_c')),
            ('introspection', GenerateIntrospectionCTypesupport('introspection_c'))):
        generator.generate(package, every, include, out / name / package)


def compile_libraries(out, package, others):
    """Compile one library of all type supports, and the extension modules that rclpy loads."""
    generated, library = out / package, out / 'lib' / f'lib{package}.so'
    library.parent.mkdir(exist_ok=True)
    folders = [*(out / name for name in ('', 'c', 'fastrtps', 'introspection')),
               sysconfig.get_path('include'), np.get_include(), PREFIX / 'include',
               *(PREFIX / 'include' / name for name in (*RUNTIME, *others))]
    options = ['-O0', '-fPIC', '-w', *(part for folder in folders for part in ('-I', folder))]
    entries = sorted(generated.glob('_*_s.ep.*.c'))
    sources = [path for pattern in ('**/*.c', '**/*.cpp') for path in out.glob(pattern)
               if path not in entries]

    def compiled(path):
        target = path.with_name(f'{path.name}.o')
        _run('gcc' if path.suffix == '.c' else 'g++', *options, '-c', path, '-o', target)
        return target

    with ThreadPoolExecutor(2) as threads:
        objects = list(threads.map(compiled, sources))
    names = [f'{other}__rosidl_{part}' for other in others
             for part in ('*_c', 'generator_py')] + list(RUNTIME)
    libraries = [path for name in names
                 for path in sorted((PREFIX / 'lib').glob(f'lib{name}.so'))]
    link = ['-Wl,-rpath,' + str(PREFIX / 'lib'), '-L', PREFIX / 'lib']
    _run('g++', '-shared', *objects, *libraries, *link, '-o', library)
    # What the middleware looks for.
    for kind in SUPPORTS:
        library.with_name(f'lib{package}__rosidl_{kind}.so').symlink_to(library.name)
    for entry in entries:
        kind = entry.suffixes[-2][1:]
        module = generated / (f'{package}_s__{kind}' + sysconfig.get_config_var('EXT_SUFFIX'))
        _run('gcc', *options, '-shared', entry, library, *libraries, *link,
             f'-Wl,-rpath,{library.parent}', '-o', module)


def _run(*command):
    subprocess.run([str(part) for part in command], check=True)


def main(source, out, *others):
    """Build; print what to export."""
    source, out = Path(source).resolve(), Path(out).resolve()
    package = ElementTree.parse(source / 'package.xml').getroot().findtext('name')
    others = sorted({*ALWAYS, *others})
    generate(source, out, package, others)
    (out / package / '__init__.py').touch()
    compile_libraries(out, package, others)
    marker = out / 'share' / 'ament_index' / 'resource_index' / 'packages'
    marker.mkdir(parents=True, exist_ok=True)
    (marker / package).touch()
    for variable, folder in (('PYTHONPATH', out), ('LD_LIBRARY_PATH', out / 'lib')):
        print(f'export {variable}={folder}:${variable}')


if __name__ == '__main__':
    main(*sys.argv[1:])
