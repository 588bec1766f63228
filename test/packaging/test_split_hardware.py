# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The plugin of ros2_control is split off into a repository that bloom can release."""

import os
import shutil
import subprocess
from test.packaging.package import ROOT, run

from catkin_pkg.changelog import Changelog, populate_changelog_from_rst
from catkin_pkg.package import parse_package
import pytest

PLUGIN = 'closedloop_hardware'
SCRIPT = ROOT / 'scripts' / 'split_hardware'


def git(*arguments, cwd):
    return run('git', *arguments, cwd=cwd).splitlines()


@pytest.fixture
def split(tmp_path):
    """Return the folder into which the plugin of the last commit was split off."""
    if not (ROOT / '.git').exists() or shutil.which('git') is None:
        pytest.skip('needs the repository, and git')
    run(SCRIPT, tmp_path / 'split', cwd=tmp_path)
    return tmp_path / 'split'


def test_plugin_is_a_repository_of_one_package(split, tmp_path):
    warnings = []
    package = parse_package(str(split / 'package.xml'), warnings=warnings)
    package.validate(warnings=warnings)
    assert package.name == PLUGIN and not warnings
    tracked = git('ls-tree', '-r', '--name-only', f'HEAD:{PLUGIN}', cwd=ROOT)
    assert sorted(git('ls-files', cwd=split)) == sorted([*tracked, 'LICENSE'])
    assert git('tag', cwd=split) == [package.version]
    # Once more, and nothing has changed.
    run(SCRIPT, split, cwd=tmp_path)
    assert len(git('log', '--format=%h', cwd=split)) == 1
    done = subprocess.run([SCRIPT, tmp_path], capture_output=True, text=True)
    assert done.returncode == 1 and 'expected a folder that does not exist' in done.stderr


def test_change_log_of_the_plugin_is_read():
    text = (ROOT / PLUGIN / 'CHANGELOG.rst').read_text()
    title = '1.0.0 (2026-01-01)'
    text = text.replace(f'Forthcoming\n{"-" * 11}', f'{title}\n{"-" * len(title)}')
    log = populate_changelog_from_rst(Changelog(PLUGIN), text)
    assert log.get_content_of_version('1.0.0')


@pytest.mark.parametrize('page', ['install.md', 'ros2_control.md', 'ros2_control_plugin.md'])
def test_pages_give_the_command_that_builds_both_packages(page):
    # colcon looks for no packages below that at the top.
    assert f'colcon build --base-paths . {PLUGIN}\n' in (ROOT / 'doc' / page).read_text()


@pytest.mark.slow
def test_plugin_that_was_split_off_is_built_and_tested(tmp_path):
    prefixes = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    if not any(os.path.isdir(f'{one}/share/hardware_interface') for one in prefixes if one):
        pytest.skip('needs ros2_control, sourced')
    if shutil.which('colcon') is None:
        pytest.skip('needs colcon')
    assert 'Summary: ' in run(SCRIPT, tmp_path / 'split', '--test', cwd=tmp_path)
