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
a mass of its own for each. With ``--poses`` what ``Model.assemble`` takes to close the loops of a
pose near the start [us], by itself and in a batch; with the scene's joints held, and with none.
"""

import argparse
import sys
import time

from evaluations import evaluate_again
from machine import description, ROOT
import numpy as np

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.simulation.model import Model  # noqa: E402,I100
from closedloop_dynamics.simulation.scene import scene_names  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from closedloop_dynamics.visual.tables import text_table  # noqa: E402

READINGS = ('position', 'velocity', 'points')
CALLS = ('evaluation', 'acceleration +', 'evaluator +', 'forward +', 'inverse', 'over forward',
         *READINGS, 'joint forces +', 'step', 'advance +')
SAMPLES = ('step', 'sample +', 'own mass +')
POSES = ('alone', 'in a batch', 'held, alone', 'held, in a batch')
# Poses of a batch, and how far from the start they are [rad, m].
MANY, NEAR = 4096, 0.01


def repeated(function):
    """Return a function that calls another one so many times."""
    def run(count):
        for _ in range(count):
            function()
    return run


def least(tasks, count, repeats):
    """Return the least CPU time of one call of each, measured in turn [s]."""
    shortest = {}
    for _ in range(repeats):
        for name, run in tasks.items():
            begin = time.thread_time()
            run(count)
            passed = (time.thread_time() - begin) / count
            shortest[name] = min(shortest.get(name, np.inf), passed)
    return shortest


def calls(scene, count, repeats):
    """Return the numbers of ``CALLS`` [s] of a scene."""
    one = Simulation.from_scene(scene, integrator='rk4', step_size=1e-4)
    q, qd, tau = one.position, one.velocity, one.joint_torques(None)
    qdd, _ = one.forward_dynamics(q, qd)

    def joint_forces():
        one.data.touch()
        return one.joint_forces

    def stepped(portion):
        def run(number):
            one.reset()
            for _ in range(number // portion):
                one.advance(tau, portion)
        return run

    found = least({
        'nothing': repeated(lambda: None),
        'evaluation': lambda number: evaluate_again(one.data.system, q, qd, number),
        'acceleration +': repeated(one.evaluator('acceleration')),
        'evaluator +': repeated(one.evaluator()),
        'forward +': repeated(lambda: one.forward_dynamics(q, qd)),
        'inverse': repeated(lambda: one.inverse_dynamics(q, qd, qdd)),
        **{name: repeated(lambda name=name: getattr(one, name)) for name in READINGS},
        'joint forces +': repeated(joint_forces)}, count, repeats)
    for name in ('forward +', 'inverse', *READINGS, 'joint forces +'):
        found[name] -= found['nothing']
    found['over forward'] = found['inverse'] / found['forward +']
    for name in ('acceleration +', 'evaluator +', 'forward +', 'joint forces +'):
        found[name] -= found['evaluation']
    steps = count // 4
    found.update(least({'step': stepped(steps), 'advance +': stepped(1)}, steps, repeats))
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
        'reset': repeated(one.reset), 'stepped': repeated(stepped),
        'sample +': repeated(lambda: one.rollout(torques, **kept)),
        'own mass +': repeated(lambda: one.rollout(torques, parameters=masses, **kept)),
    }, 1, repeats)
    of_steps = found['stepped'] - found['reset']
    return {'step': of_steps / steps, **{
        name: found[name] / count - of_steps for name in SAMPLES[1:]}}


def poses(scene, repeats):
    """Return the numbers of ``POSES`` [s] of a scene."""
    model, rng = Model.from_scene(scene), np.random.default_rng(0)
    names, few = model.coordinates, MANY // 64
    q = names.moved(np.tile(model.assemble().q, (MANY, 1)), NEAR * rng.uniform(
        -1.0, 1.0, (MANY, names.nv)))
    tasks, counts = {}, {}
    for prefix, hold in (('', ()), ('held, ', model.scene.initial.hold)):
        tasks[f'{prefix}alone'] = repeated(lambda hold=hold: [
            model.assemble(one, hold=hold) for one in q[:few]])
        tasks[f'{prefix}in a batch'] = repeated(lambda hold=hold: model.assemble(q, hold=hold))
        counts.update({f'{prefix}alone': few, f'{prefix}in a batch': MANY})
    return {name: found / counts[name] for name, found in least(tasks, 1, repeats).items()}


def main(arguments=None):
    """Print a table; see the module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scenes', nargs='*', default=scene_names(), metavar='SCENE',
                        help='shipped scenes (default: all)')
    parser.add_argument('--count', type=int, default=2000, help='calls at once (default: 2000)')
    parser.add_argument('--repeats', type=int, default=15, help='default: 15')
    parser.add_argument('--rollouts', action='store_true', help='samples of short rollouts')
    parser.add_argument('--poses', action='store_true', help='closing the loops of poses')
    options = parser.parse_args(arguments)
    columns, unit = ((SAMPLES, 1e3) if options.rollouts else (POSES, 1e6) if options.poses else
                     (CALLS, 1e6))
    rows = []
    for scene in options.scenes:
        found = samples(scene, options.repeats) if options.rollouts else poses(
            scene, options.repeats) if options.poses else calls(
            scene, options.count, options.repeats)
        rows.append([scene, *(
            f'{found[name]:.1f}' if name == 'over forward' else f'{unit * found[name]:.3f}'
            for name in columns)])
    print(f'{description()}\n\n{text_table(("scene", *columns), rows)}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
