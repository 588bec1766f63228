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

from functools import partial
import os
import sys
from tempfile import TemporaryDirectory
from unittest.mock import patch

import closedloop_dynamics as cld
from closedloop_dynamics.visual.tables import markdown_table
from machine import description, in_turn, least, parser_of
import numpy as np

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
    (first,), = in_turn({'gradient': gradient}, 1).values()
    run, both = least({'rollout': rollout, 'gradient': gradient}, repeats).values()
    return run, both, first - both


def of_a_step(scene, repeats, calls=300):
    """Return the time of a step without and with its Jacobians [us]."""
    model = cld.Model.from_scene(scene)

    def stepped(stepper):
        for _ in range(calls):
            stepper()

    times = least({jacobians: partial(stepped, cld.Stepper(
        model, 1e-3, steps=1, jacobians=jacobians)) for jacobians in (False, True)}, repeats)
    return [1e6 * each / calls for each in times.values()]


def main(arguments=None):
    """Measure, and print a table."""
    parser = parser_of(__doc__, scenes=SCENES)
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
