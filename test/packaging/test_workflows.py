# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The workflows of continuous integration, which run elsewhere: their form, and what they name."""

import re
import shutil
import subprocess
from test.packaging.package import ROOT

import pytest
import yaml

WORKFLOWS = sorted((ROOT / '.github' / 'workflows').glob('*.yaml'))


def job(workflow, name):
    return yaml.safe_load((ROOT / '.github' / 'workflows' / workflow).read_text())['jobs'][name]


def test_distributions_are_those_that_the_scripts_admit():
    setup = (ROOT / 'scripts' / '_setup.sh').read_text()
    admitted = re.search(r'ROS_DISTRO:-} =~ \^\(([a-z|]+)\)', setup)[1].split('|')
    matrix = job('ros.yaml', 'industrial_ci')['strategy']['matrix']['distribution']
    assert matrix == admitted == ['jazzy', 'kilted', 'lyrical', 'rolling']


def test_sources_are_both_packages():
    step, = (step for step in job('ros.yaml', 'industrial_ci')['steps'] if 'env' in step)
    for folder in step['env']['TARGET_WORKSPACE'].split():
        assert (ROOT / folder / 'package.xml').is_file()


def test_workflows_have_no_finding_of_actionlint():
    if shutil.which('actionlint') is None:
        pytest.skip('needs actionlint')
    done = subprocess.run(['actionlint', '-no-color', *WORKFLOWS], cwd=ROOT, text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    assert WORKFLOWS and done.returncode == 0, done.stdout
