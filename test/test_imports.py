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
The layers of the package: who may import whom, read from the sources.

Nothing is imported here, so that imports inside functions count, too.

"""

import ast
from pathlib import Path
import sys

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'closedloop_dynamics'

# Each may import the layers above it in this table, and within its own. A new module is given
# its place here.
LAYERS = (
    ('child', 'config', 'core', 'errors', 'mechanism', 'signals'),
    ('appearance', 'assembly', 'bags', 'effects', 'health', 'integration', 'inverse_dynamics',
     'key_paths', 'modeling', 'recording', 'recording_together', 'rollout',
     'rollout_input', 'scene', 'scene_records', 'scene_text', 'urdf'),
    # '' is the package itself: it offers Simulation.
    ('simulation', ''),
    ('prepare', 'studies', 'sweep', 'visual'),
    ('cli', 'ros'),
)
# These import nothing else of ours, not even within their layer.
SELF_CONTAINED = {'child', 'config', 'core', 'errors', 'mechanism', 'cli', 'signals'}
# llvmlite is numba's own compiler.
CORE_LIBRARIES = {'llvmlite', 'numba', 'numpy'}
ROS_LIBRARIES = {'rclpy', 'ament_index_python', 'launch', 'launch_ros', 'rosbag2_py'}
ROS_LIBRARY_ENDINGS = ('_msgs', '_srvs', '_interfaces')
# Of what users write; of a bag's metadata.
YAML_READERS = ('mechanism.document', 'bags.metadata')


def module_name(path):
    """Return the name of a module below the package; the package itself is empty."""
    parts = path.relative_to(ROOT / PACKAGE).with_suffix('').parts
    return '.'.join(parts[:-1] if parts[-1] == '__init__' else parts)


SOURCES = {module_name(path): path for path in sorted((ROOT / PACKAGE).rglob('*.py'))}


def absolute(node, module):
    """Return the full name that an import statement starts from."""
    if not node.level:
        return node.module
    is_package = SOURCES[module].name == '__init__.py'
    parents = [PACKAGE, *filter(None, module.split('.'))]
    parents = parents[:len(parents) - node.level + is_package]
    return '.'.join(parents + ([node.module] if node.module else []))


def imported_names(module):
    """Yield the full names that a module imports, wherever in the file."""
    for node in ast.walk(ast.parse(SOURCES[module].read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = absolute(node, module)
            for alias in node.names:
                full = f'{base}.{alias.name}'
                is_module = full.removeprefix(f'{PACKAGE}.') in SOURCES
                yield full if is_module else base


def our_imports(module):
    """Return the modules of the package that a module imports."""
    ours = (name for name in imported_names(module) if name.split('.')[0] == PACKAGE)
    return {name.removeprefix(PACKAGE).removeprefix('.') for name in ours} - {module}


def foreign_imports(module):
    """Return the libraries outside the standard one that a module imports."""
    roots = {name.split('.')[0] for name in imported_names(module)}
    return roots - {PACKAGE} - sys.stdlib_module_names


def unit(module):
    """Return the folder or top-level module that the table of layers names."""
    return module.split('.')[0]


def layer(module):
    """Return the height of a module in the table of layers."""
    for height, units in enumerate(LAYERS):
        if unit(module) in units:
            return height
    return pytest.fail(f'{PACKAGE}.{module} has no place among LAYERS in {Path(__file__).name}')


def test_sources_are_found():
    assert len(SOURCES) > 10
    assert 'mechanism.mechanism' in SOURCES


@pytest.mark.parametrize('module', SOURCES)
def test_imported_modules_exist(module):
    assert our_imports(module) <= set(SOURCES)


@pytest.mark.parametrize('module', SOURCES)
def test_imports_point_one_way(module):
    for imported in our_imports(module):
        assert layer(imported) <= layer(module), f'{module} imports {imported}, of a higher layer'
        if unit(module) in SELF_CONTAINED and layer(imported) == layer(module):
            assert unit(imported) == unit(module), f'{module} imports {imported}, from beside it'


@pytest.mark.parametrize(
    'module', [name for name in SOURCES if unit(name) in ('core', 'mechanism')])
def test_core_and_mechanism_import_nothing_else_of_ours(module):
    assert {unit(imported) for imported in our_imports(module)} <= {unit(module)}


@pytest.mark.parametrize('module', [name for name in SOURCES if unit(name) == 'core'])
def test_core_imports_only_numerics(module):
    assert foreign_imports(module) <= CORE_LIBRARIES


@pytest.mark.parametrize('module', [name for name in SOURCES if unit(name) == 'mechanism'])
def test_mechanism_is_not_compiled(module):
    assert 'numba' not in foreign_imports(module)


def effects():
    """Return the modules of the force laws: what the registry brings together."""
    return {name for name in our_imports('effects.registry') if unit(name) == 'effects'}


@pytest.mark.parametrize('module', sorted(effects()))
def test_effects_never_see_each_other(module):
    assert not our_imports(module) & effects()


@pytest.mark.parametrize('module', [name for name in SOURCES if unit(name) != 'ros'])
def test_only_ros_imports_ros(module):
    ros = {name for name in foreign_imports(module)
           if name in ROS_LIBRARIES or name.endswith(ROS_LIBRARY_ENDINGS)}
    assert not ros


@pytest.mark.parametrize('module', [name for name in SOURCES if name not in YAML_READERS])
def test_yaml_is_parsed_in_one_place(module):
    assert not {'yaml', 'ruamel'} & foreign_imports(module)


def test_no_module_imports_itself_in_a_circle():
    finished = set()

    def visit(module, path):
        assert module not in path, 'a circle: ' + ' -> '.join([*path, module])
        if module in finished:
            return
        for imported in our_imports(module) & set(SOURCES):
            visit(imported, [*path, module])
        finished.add(module)

    for module in SOURCES:
        visit(module, [])


MACHINE_FREE = ('appearance', 'assembly', 'bags', 'core', 'effects', 'integration',
                'inverse_dynamics', 'mechanism', 'modeling', 'scene',
                'scene_records', 'scene_text', 'simulation', 'urdf')


@pytest.mark.parametrize('module', [name for name in SOURCES if unit(name) in MACHINE_FREE])
def test_no_mechanism_is_known_by_name(module):
    shipped = {path.stem for path in (ROOT / 'config').rglob('*.yaml')}
    assert shipped
    tree = ast.parse(SOURCES[module].read_text())
    documentation = {id(node.value) for node in ast.walk(tree)
                     if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)}
    texts = {node.value for node in ast.walk(tree)
             if isinstance(node, ast.Constant) and id(node) not in documentation}
    assert not shipped & texts
