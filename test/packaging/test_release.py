# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What bloom reads: the manifest, the change log, and that all name the same version."""

import re
from test.packaging.package import PACKAGE, ROOT

from catkin_pkg.changelog import Changelog, populate_changelog_from_rst
from catkin_pkg.package import parse_package
import closedloop_dynamics


def manifest():
    return parse_package(str(ROOT / 'package.xml'))


def test_manifest_is_valid_without_warnings():
    warnings = []
    package = parse_package(str(ROOT / 'package.xml'), warnings=warnings)
    package.validate(warnings=warnings)
    assert package.name == PACKAGE and not warnings


def test_versions_agree():
    setup = re.search(r"version='([^']+)'", (ROOT / 'setup.py').read_text())[1]
    recipe = re.search(r'^  version: ([\d.]+)$', (ROOT / 'packaging' / 'conda' / 'recipe.yaml')
                       .read_text(), flags=re.M)[1]
    assert {manifest().version, setup, recipe} == {closedloop_dynamics.__version__}


def test_check_list_of_a_release_names_all_files_with_placeholders():
    step = re.search(r'A release:\n\n1\. (.*?)\n2\. ', (ROOT / 'CONTRIBUTING.md').read_text(),
                     flags=re.DOTALL)[1]
    for path in ('setup.py', 'package.xml', 'closedloop_hardware/package.xml'):
        assert ('example.org' in (ROOT / path).read_text()) and f'`{path}`' in step, path
    others = [path for path in (*ROOT.glob('*.md'), *ROOT.glob('packaging/**/*.*'), *ROOT.glob(
        'doc/*.md'), ROOT / 'pyproject.toml', ROOT / 'mkdocs.yml') if 'example.org' in
        path.read_text() and path.name != 'CONTRIBUTING.md']
    assert not others


def test_change_log_is_read_once_it_has_a_version():
    version = manifest().version
    title = f'{version} (2026-01-01)'
    text = (ROOT / 'CHANGELOG.rst').read_text()
    # What catkin_prepare_release does.
    text = re.sub(r'^Forthcoming\n-+$', f'{title}\n{"-" * len(title)}', text, flags=re.M)
    log = populate_changelog_from_rst(Changelog(PACKAGE), text)
    assert version in [name for name, *_ in log.foreach_version()]
    assert log.get_content_of_version(version)
    assert f'Changelog for package {PACKAGE}' in text


def test_everything_needed_from_the_package_index_is_in_the_manifest():
    # Keys of rosdep that bring Python packages of other names.
    brought = {'eigen': 'cmeel-eigen', 'python3-numba': 'llvmlite', 'python3-pil': 'pillow'}
    keys = {depend.name for depend in manifest().exec_depends + manifest().build_depends}
    present = {brought.get(key, key.removeprefix('python3-')) for key in keys}
    lines = (ROOT / 'requirements' / 'runtime.txt').read_text().splitlines()
    needed = {re.split(r'[<>=]', line)[0].lower().removeprefix('py') for line in lines
              if line and not line.startswith('#')}
    # Where ROS is, rosbag2_py reads bags.
    assert needed - {'mcap', 'rosbags', 'setuptools'} <= present
    assert 'rosbag2_py' in keys


def test_no_key_is_of_pip_alone():
    # bloom makes packages of a distribution, which cannot depend on what pip installs.
    for path in (ROOT, ROOT / 'closedloop_hardware'):
        package = parse_package(str(path / 'package.xml'))
        keys = {depend.name for depend in (
            *package.build_depends, *package.exec_depends, *package.test_depends)}
        assert not [key for key in keys if key.endswith('-pip') or '-' in key and not
                    key.startswith('python3-')]
        assert {'website', 'repository', 'bugtracker'} == {url.type for url in package.urls}
        assert package.authors


def test_every_ros_package_that_is_imported_is_in_the_manifest():
    keys = {depend.name for depend in manifest().exec_depends}
    sources = [*(ROOT / PACKAGE).rglob('*.py'), *(ROOT / 'launch').glob('*.py')]
    imported = {name for path in sources for name in re.findall(
        r'^\s*(?:from|import) (\w+)', path.read_text(), flags=re.M)}
    ros = {name for name in imported if re.search(
        r'_(msgs|srvs|interfaces|ros)$|^(rclpy|launch|ament_\w+)$', name)}
    assert len(ros) > 10 and ros <= keys


def test_container_recipe_names_what_exists():
    recipe = (ROOT / 'Containerfile').read_text()
    inside = re.findall(rf'src/{PACKAGE}/(requirements/[\w.-]+\.txt)', recipe)
    assert len(inside) == 2 and all((ROOT / path).is_file() for path in inside)
    sources = [line.split()[1] for line in recipe.splitlines() if line.startswith('COPY ')]
    assert sources == ['requirements', '.']
    program = re.search(rf'CMD \["python", "src/{PACKAGE}/([\w./]+)"\]', recipe)[1]
    assert (ROOT / program).is_file()
