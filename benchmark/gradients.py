# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What derivatives of steps cost: the gradient of a trajectory, and the Jacobians of a step.

    python benchmark/gradients.py                         (from the checkout)

The gradient is that of a cost of all states by all torques, the start and the mass of a body, by
the adjoint of 200 RK4 steps; the trajectory is part of its time. Without one: ``rollout``. Both
in turn, CPU time. Compiling is apart: with an empty cache it is what a first use waits for. Of a
step: one RK4 step of a ``Stepper``, with A and B in independent coordinates and without.
"""

import argparse
import os
import sys
from tempfile import TemporaryDirectory
import time
from unittest.mock import patch

from machine import description, ROOT

sys.path.insert(0, str(ROOT))

import closedloop_dynamics as cld  # noqa: E402,I100
from closedloop_dynamics.visual.tables import markdown_table  # noqa: E402
import numpy as np  # noqa: E402

SCENES = 'four_bar', 'carpet_scraper', 'three_rrr', 'rssr_four_bar', 'stewart_platform'
METHOD, STEPS, ROWS = {'integrator': 'rk4', 'step_size': 1e-3}, 200, 20


def measured(scene, repeats):
    """Return the time of a rollout and of a gradient [s], and of the first gradient beyond."""
    model = cld.Model.from_scene(scene)
    start = model.assemble()
    body = next(body.name for body in model.mechanism.bodies if body.mass > 0.0)
    sensitivity = cld.Sensitivity(model, METHOD, (f'mechanism.bodies.{body}.mass',))
    torques = 0.01 * np.random.default_rng(1).normal(size=(ROWS, len(model.actuated_joints)))

    def gradient():
        trajectory = sensitivity.trajectory(start, torques, steps=STEPS)
        return trajectory.gradient(trajectory.position, trajectory.velocity)

    def rollout():
        return cld.rollout(model, start, torques, steps=STEPS, method=METHOD)

    rollout()
    began = time.process_time()
    gradient()
    first, times = time.process_time() - began, ([], [])
    for _ in range(repeats):
        for found, run in zip(times, (rollout, gradient)):
            began = time.process_time()
            run()
            found.append(time.process_time() - began)
    return *map(min, times), first - min(times[1])


def of_a_step(scene, repeats, calls=300):
    """Return the time of a step without and with its Jacobians [us]."""
    model, found = cld.Model.from_scene(scene), []
    for jacobians in (False, True):
        stepper, times = cld.Stepper(model, 1e-3, steps=1, jacobians=jacobians), []
        for _ in range(repeats):
            began = time.process_time()
            for _ in range(calls):
                stepper()
            times.append(time.process_time() - began)
        found.append(1e6 * min(times) / calls)
    return found


def main(arguments=None):
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('scenes', nargs='*', default=SCENES, help='which are measured')
    parser.add_argument('--repeats', type=int, default=40)
    options = parser.parse_args(arguments)
    with TemporaryDirectory() as folder, patch.dict(os.environ, CLOSEDLOOP_CACHE_DIR=folder):
        found = [(scene, *measured(scene, options.repeats)) for scene in options.scenes]
        steps = [(scene, *of_a_step(scene, options.repeats)) for scene in options.scenes]
    print(description())
    print(markdown_table(
        ['', 'rollout [ms]', 'gradient with its trajectory [ms]', 'ratio', 'compiling [s]'],
        [[f'`{scene}`', f'{1e3 * run:.2f}', f'{1e3 * both:.2f}', f'{both / run:.2f}',
          f'{first:.2f}'] for scene, run, both, first in found]))
    print(markdown_table(
        ['', 'step [us]', 'with A and B [us]', 'ratio'],
        [[f'`{scene}`', f'{alone:.2f}', f'{both:.2f}', f'{both / alone:.1f}']
         for scene, alone, both in steps]))
    return 0


if __name__ == '__main__':
    sys.exit(main())
