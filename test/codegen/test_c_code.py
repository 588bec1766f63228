# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Code by the C compiler of the system, where llvmlite is not installed."""

import json
import os
import subprocess
import sys

from closedloop_dynamics import Model, Simulation
from closedloop_dynamics.codegen import c_code
import numpy as np
import pytest

pytestmark = pytest.mark.skipif(not c_code.compiler(), reason='no C compiler is installed')
# Laws with searches of the engine (curves, profiles), a tree without code for all its bodies, and
# loops in space and in the plane; of the first the states side by side, and derivatives, too.
SCENES = ('four_bar', 'cam_follower', 'geneva_drive')
WITHOUT_LLVM = 'import sys; sys.modules["llvmlite"] = None; '
PRINT = (WITHOUT_LLVM + 'import json; from test.codegen.test_c_code import SCENES, numbers; '
         'print(json.dumps([numbers(name).tolist() for name in SCENES]))')


def numbers(name):
    """Return numbers of a scene, from routines of every form."""
    simulation = Simulation.from_scene(name)
    for _ in range(5):
        simulation.step({}, 1e-3)
    found = [simulation.position, simulation.velocity]
    model = Model.from_scene(name)
    state = model.assemble()
    found += [model.evaluate(state).acceleration, model.evaluate(state).multipliers]
    if name == SCENES[0]:
        found.append(model.linearise(state).A)
        # Twelve states: the last ones fill no vector.
        count = len(simulation.actuated_joints)
        torques = np.linspace(-1.0, 1.0, 36 * count).reshape(12, 3, count)
        found.append(simulation.rollout(torques).position)
    return np.concatenate([np.ravel(each) for each in found])


def run(code, cache, **settings):
    environment = {**os.environ, 'CLOSEDLOOP_CACHE_DIR': str(cache), **settings}
    return subprocess.run([sys.executable, '-c', code], text=True, capture_output=True,
                          env=environment)


def test_numbers_are_those_of_llvm_and_code_is_kept(tmp_path):
    first = run(PRINT, tmp_path)
    assert first.returncode == 0, first.stderr
    # Once, however many routines are compiled.
    assert first.stderr.count('UserWarning: llvmlite is not installed') == 1
    for name, found in zip(SCENES, json.loads(first.stdout)):
        expected = numbers(name)
        # LLVM rounds products with sums once; five steps of 1e-3 s make little of that.
        assert np.abs(np.array(found) - expected).max() <= 1e-9 * np.abs(expected).max(), name
    again = run(PRINT, tmp_path, CC='false')
    assert again.returncode == 0 and again.stdout == first.stdout and not again.stderr


def test_lanes_are_as_alone(tmp_path):
    code = WITHOUT_LLVM + """
import numpy as np
from closedloop_dynamics import Simulation
simulation = Simulation.from_scene('three_rrr', integrator='rk4')
torques = np.linspace(-2.0, 2.0, 24 * 200).reshape(8, 200, 3)
together = simulation.rollout(torques, threads=1).position
print(all(np.array_equal(simulation.rollout(one[np.newaxis], threads=1).position[0], found)
          for one, found in zip(torques, together)))
"""
    found = run(code, tmp_path)
    assert found.stdout.split() == ['True'], found.stderr


@pytest.mark.parametrize('settings, said', [
    ({'CC': '', 'PATH': ''}, 'apt install gcc'), ({'CC': 'false'}, 'could not compile')])
def test_without_llvm_and_compiler_it_says_what_to_install(tmp_path, settings, said):
    done = run(WITHOUT_LLVM + 'from closedloop_dynamics.cli import main; '
               'sys.exit(main(["check", "four_bar"]))', tmp_path, **settings)
    assert done.returncode == 1 and said in done.stderr and 'Traceback' not in done.stderr
