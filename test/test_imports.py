# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The picture of the house: the contracts of setup.cfg, and what they cannot say."""

import ast
import functools
from pathlib import Path
import re
import subprocess
import sys

import grimp

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'closedloop_dynamics'
# What must work for any mechanism alike.
ROOMS_OF_ANY_MECHANISM = ('codegen', 'effects', 'kinematics', 'mechanism', 'scene', 'simulation',
                          'visual')


def test_rooms_import_only_what_lies_below_them():
    done = subprocess.run(
        [sys.executable, '-c', 'from importlinter.cli import lint_imports_command as main; main()',
         '--config', 'setup.cfg', '--no-cache'],
        cwd=ROOT, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert done.returncode == 0, done.stdout
    assert ' 0 broken' in done.stdout


def test_every_file_is_in_a_room():
    assert [path.name for path in (ROOT / PACKAGE).glob('*.py')] == ['__init__.py']
    for room in (ROOT / PACKAGE).glob('*/'):
        if room.name != '__pycache__':
            assert ast.get_docstring(ast.parse((room / '__init__.py').read_text())), room.name


def test_files_named_in_the_architecture_exist():
    text = ''.join((ROOT / 'doc' / f'{page}.md').read_text()
                   for page in ('architecture', 'extending', 'generated_code'))
    named = set(re.findall(r'`([a-z_]+/[a-z_/]+\.py)`', text))
    assert len(named) > 20
    assert not [name for name in sorted(named)
                if not (ROOT / PACKAGE / name).is_file() and not (ROOT / name).is_file()]


def test_laws_of_force_do_not_know_each_other():
    graph = grimp.build_graph(PACKAGE, cache_dir=None)
    room = f'{PACKAGE}.effects'
    laws = {name for name in graph.find_modules_directly_imported_by(f'{room}.registry')
            if name.startswith(room)}
    assert len(laws) > 5
    for law in laws:
        assert not graph.find_modules_directly_imported_by(law) & laws


def test_no_mechanism_is_known_by_name():
    shipped = {path.stem for path in (ROOT / 'config').rglob('*.yaml')}
    assert shipped
    for path in (path for room in ROOMS_OF_ANY_MECHANISM
                 for path in (ROOT / PACKAGE / room).rglob('*.py')):
        tree = ast.parse(path.read_text())
        documentation = {id(node.value) for node in ast.walk(tree)
                         if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)}
        texts = {node.value for node in ast.walk(tree)
                 if isinstance(node, ast.Constant) and id(node) not in documentation}
        assert not shipped & texts, path


def test_a_simulation_is_imported_without_what_few_starts_need():
    heavy = {'asyncio', 'llvmlite.binding', 'matplotlib', 'mujoco', 'multiprocessing', 'rclpy',
             'scipy', 'unittest'}
    done = subprocess.run(
        [sys.executable, '-c',
         'import sys; from closedloop_dynamics import Simulation; print(*sys.modules)'],
        cwd=ROOT, text=True, stdout=subprocess.PIPE, check=True)
    loaded = set(done.stdout.split())
    assert 'closedloop_dynamics.simulation.simulation' in loaded
    assert not heavy & loaded


@functools.lru_cache(maxsize=1)
def nodes_of(folder):
    """Return all nodes of the syntax tree of every file in a folder, by its path."""
    return {path: list(ast.walk(ast.parse(path.read_text())))
            for path in (ROOT / folder).rglob('*.py')}


def private(names):
    """Return those of some names that are private."""
    return {name for name in names if name.startswith('_') and not name.startswith('__')}


def private_members(nodes):
    """Return the private methods and attributes that the classes of a file define."""
    methods = {node.name for each in nodes if isinstance(each, ast.ClassDef)
               for node in each.body if isinstance(node, ast.FunctionDef)}
    return private(methods | {
        node.attr for node in nodes
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store)})


def is_own(node):
    """Return whether a node is ``self.NAME`` or ``cls.NAME``."""
    return isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and (
        node.value.id in ('self', 'cls'))


def test_private_names_are_used_where_they_are_defined():
    files = nodes_of(PACKAGE)
    members_of = {path: private_members(nodes) for path, nodes in files.items()}
    members = set().union(*members_of.values())
    found = []
    for path, nodes in files.items():
        elsewhere = members - members_of[path]
        for node in nodes:
            if isinstance(node, ast.ImportFrom) and (
                    node.level or node.module.startswith(PACKAGE)):
                if private(alias.name for alias in node.names):
                    found.append(f'{path}:{node.lineno}')
            if isinstance(node, ast.Attribute) and node.attr in elsewhere and not is_own(node):
                found.append(f'{path}:{node.lineno} {ast.unparse(node)}')
    assert not found


def defined_privately(nodes):
    """Return the private names that a file gives to functions, classes, values and members."""
    return private_members(nodes) | private(
        getattr(node, 'name', None) or node.id for node in nodes
        if isinstance(node, (ast.FunctionDef, ast.ClassDef))
        or isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store))


def test_tests_use_nothing_private():
    known = set().union(*map(defined_privately, nodes_of(PACKAGE).values()))
    found = []
    for path, nodes in nodes_of('test').items():
        others = known - defined_privately(nodes)
        for node in nodes:
            used = set()
            if isinstance(node, ast.Attribute) and not is_own(node):
                used = {node.attr}
            elif isinstance(node, ast.Call) and (
                    getattr(node.func, 'id', None) or getattr(node.func, 'attr', '')
                    ).endswith('tattr'):
                used = {each.value for each in node.args if isinstance(each, ast.Constant)}
            elif isinstance(node, ast.ImportFrom) and (node.module or '').startswith(PACKAGE):
                used = {alias.name for alias in node.names}
            if used & others:
                found.append(f'{path}:{node.lineno} {ast.unparse(node)}')
    assert not found


def test_no_part_of_a_node_holds_it():
    found = []
    for path, nodes in nodes_of(f'{PACKAGE}/ros').items():
        for node in nodes:
            if isinstance(node, ast.Assign) and any(
                    isinstance(target, ast.Attribute) for each in node.targets
                    for target in ast.walk(each)):
                values = node.value.elts if isinstance(node.value, ast.Tuple) else [node.value]
                found += [f'{path}:{node.lineno}' for value in values
                          if isinstance(value, ast.Name) and value.id == 'node']
    assert not found


def test_attributes_are_not_probed_for():
    found = [f'{path}:{node.lineno}' for room in ('effects', 'ros')
             for path, nodes in nodes_of(f'{PACKAGE}/{room}').items() for node in nodes
             if isinstance(node, ast.Name) and node.id == 'hasattr']
    assert not found
