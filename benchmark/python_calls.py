# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What calls from Python cost beside what they compute, and short rollouts beside their steps.

For each scene [us]: an evaluation inside compiled code, and beyond it a call of the evaluator of
accelerations, of that of multipliers, too, of ``forward_dynamics`` and of ``joint_forces`` in a
state that is not evaluated yet; ``inverse_dynamics`` as it is, and over ``forward_dynamics``; the
other readings as they are; one step of ``advance`` beyond a step of many. With ``--rollouts``
what a sample of a short rollout takes beyond its steps [ms], made by the same calls of the
method: torques are held, and the end is recorded. Once with the same model for all and once with
a mass of its own for each.
"""

import sys
import time

from closedloop_dynamics.scene.loading import scene_names
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.tables import text_table
from evaluations import evaluate_again
from machine import description, least, parser_of
import numpy as np

READINGS = ('position', 'velocity', 'points')
CALLS = ('evaluation', 'acceleration +', 'evaluator +', 'forward +', 'inverse', 'over forward',
         *READINGS, 'joint forces +', 'step', 'advance +')
SAMPLES = ('step', 'sample +', 'own mass +')


def least_of_many(tasks, count, repeats):
    """Return the least CPU time of one of ``count`` calls of each task, in turn [s]."""
    def repeated(function):
        def run():
            for _ in range(count):
                function()
        return run

    times = least({name: repeated(function) for name, function in tasks.items()}, repeats,
                  time.thread_time)
    return {name: each / count for name, each in times.items()}


def calls(scene, count, repeats):
    """Return the numbers of ``CALLS`` [s] of a scene."""
    one = Simulation.from_scene(scene, integrator='rk4', step_size=1e-4)
    q, qd, tau = one.position, one.velocity, one.joint_torques(None)
    qdd, _ = one.forward_dynamics(q, qd)

    def joint_forces():
        one.data.touch()
        return one.joint_forces

    def stepped(portion):
        def run():
            one.reset()
            for _ in range(steps // portion):
                one.advance(tau, portion)
        return run

    found = least_of_many({
        'nothing': lambda: None,
        'acceleration +': one.evaluator('acceleration'), 'evaluator +': one.evaluator(),
        'forward +': lambda: one.forward_dynamics(q, qd),
        'inverse': lambda: one.inverse_dynamics(q, qd, qdd),
        **{name: lambda name=name: getattr(one, name) for name in READINGS},
        'joint forces +': joint_forces}, count, repeats)
    # What repeats itself in compiled code.
    steps = count // 4
    inside = least({'evaluation': lambda: evaluate_again(one.data.system, q, qd, count),
                    'step': stepped(steps), 'advance +': stepped(1)}, repeats, time.thread_time)
    found.update({name: each / (count if name == 'evaluation' else steps)
                  for name, each in inside.items()})
    for name in ('forward +', 'inverse', *READINGS, 'joint forces +'):
        found[name] -= found['nothing']
    found['over forward'] = found['inverse'] / found['forward +']
    for name in ('acceleration +', 'evaluator +', 'forward +', 'joint forces +'):
        found[name] -= found['evaluation']
    found['advance +'] -= found['step']
    return found


def samples(scene, repeats):
    """Return the numbers of ``SAMPLES`` [s] of a scene, by its own method."""
    one = Simulation.from_scene(scene)
    count, steps = 8, 10
    torques, tau = np.zeros((count, 1, len(one.actuated_joints))), one.joint_torques(None)
    kept = {'steps': steps, 'every': steps, 'threads': 1}
    body = one.mechanism.bodies[0]
    masses = {f'mechanism.bodies.{body.name}.mass': body.mass * np.linspace(1.0, 1.1, count)}

    def stepped():
        one.reset()
        one.advance(tau, steps)

    found = least({
        'reset': one.reset, 'stepped': stepped,
        'sample +': lambda: one.rollout(torques, **kept),
        'own mass +': lambda: one.rollout(torques, parameters=masses, **kept)}, repeats,
        time.thread_time)
    of_steps = found['stepped'] - found['reset']
    return {'step': of_steps / steps, **{
        name: found[name] / count - of_steps for name in SAMPLES[1:]}}


def main(arguments=None):
    """Print a table; see the module."""
    parser = parser_of(__doc__, scenes=scene_names())
    parser.add_argument('--count', type=int, default=2000, help='calls at once (default: 2000)')
    parser.add_argument('--repeats', type=int, default=15, help='default: 15')
    parser.add_argument('--rollouts', action='store_true', help='samples of short rollouts')
    options = parser.parse_args(arguments)
    columns, unit = (SAMPLES, 1e3) if options.rollouts else (CALLS, 1e6)
    rows = []
    for scene in options.scenes:
        found = samples(scene, options.repeats) if options.rollouts else calls(
            scene, options.count, options.repeats)
        rows.append([scene, *(
            f'{found[name]:.1f}' if name == 'over forward' else f'{unit * found[name]:.3f}'
            for name in columns)])
    print(f'{description()}\n\n{text_table(("scene", *columns), rows)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
