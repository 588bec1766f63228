# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The tasks of compare.py, run with the files of whichever commit is on the path.

Its arguments name tasks, all when there are none. Prints their names, then for each name that it
reads the CPU time of one call. Of the package
it uses only what has long been there; a task that this commit does not know is left out.
"""

from functools import partial
import json
import sys
import time

from closedloop_dynamics import Simulation
from closedloop_dynamics.engine import native
from closedloop_dynamics.simulation.system import number_of_states
import numpy as np

# A measurement takes at least so long [s]: the first calls after a wait for the other commit find
# cold caches, and runs begin with what they do once.
PORTION = 2e-2


def again(system, q, qd):
    """Return evaluations of one state inside compiled code."""
    state = np.zeros(number_of_states(system))
    state[:len(q) + len(qd)] = np.concatenate((q, qd))
    if hasattr(native, 'evaluate_again'):
        # In earlier commits.
        return partial(native.evaluate_again, system.native, state)
    return partial(system.native.evaluate_again, state)


def evaluation(one):
    """Return one evaluation of the accelerations of a simulation inside compiled code."""
    return again(one.data.system, one.position, one.velocity)


def python_call(scene):
    """Return one evaluation called from Python."""
    one = Simulation.from_scene(scene)
    q, qd = one.position, one.velocity

    def call(count):
        for _ in range(count):
            one.forward_dynamics(q, qd)
    return call


def steps(scene, **method):
    """Return one step of a long run."""
    one = Simulation.from_scene(scene, **method)
    tau = one.joint_torques(None)

    def run(count):
        one.reset()
        one.advance(tau, count)
    return run


def large_ladder():
    """Return one evaluation of a ladder of 201 joints."""
    # Where it is used: what a commit does not know is then left out, with its task alone.
    from closedloop_dynamics.kinematics.modeling import build_model
    from closedloop_dynamics.simulation.system import build_system
    from families import ladder
    mechanism, position = ladder(100)
    system = build_system(build_model(mechanism))
    # All cranks turn alike: the rates close the loops, too.
    rates = np.tile([1.0, -1.0], 101)[:len(position)]
    return again(system, np.array(position), rates)


def beside_flat(loops, tilt):
    """Return one evaluation of a ladder of parallelograms so far from flat [rad]."""
    from closedloop_dynamics.scene.records import Method
    from hard_machines import ladder, scene
    return evaluation(Simulation(scene(*ladder(loops, 0.5 * np.pi - tilt), Method())))


def rollouts(scene):
    """Return a hundred steps of sixteen samples at once."""
    one = Simulation.from_scene(scene, integrator='rk4', step_size=1e-3)
    torques = len(one.actuated_joints)
    return lambda count: one.rollout(np.zeros((16, 100 * count, torques)), threads=1)


TASKS = {
    **{f'evaluation {text}': lambda scene=scene: evaluation(Simulation.from_scene(scene))
       for text, scene in (('three_rrr', 'three_rrr'), ('carpet_scraper', 'carpet_scraper'),
                           ('on_carpet', 'carpet_scraper_on_carpet'))},
    'evaluation ladder of 201 joints': large_ladder,
    **{f'evaluation, {2 * loops + 1} joints {text} flat': partial(beside_flat, loops, tilt)
       for loops in (1, 3) for text, tilt in (('beside', 1e-2), ('nearly', 1e-4))},
    'Python call three_rrr': lambda: python_call('three_rrr'),
    'RK4 step three_rrr': lambda: steps('three_rrr', integrator='rk4', step_size=1e-3),
    'RK4 step carpet_scraper': lambda: steps('carpet_scraper', integrator='rk4', step_size=1e-3),
    'DOP853 ms three_rrr': lambda: steps(
        'three_rrr', integrator='dop853', step_size=1e-3, tolerance=1e-8),
    'RK4 steps, 100 of 16 three_rrr': lambda: rollouts('three_rrr'),
}


def prepared(chosen):
    """Return {task: (function of a number of calls, that number)}, ready to be timed."""
    result = {}
    for name in chosen or TASKS:
        try:
            function = TASKS[name]()
            # The first calls generate code, and make what samples of the error are computed with.
            function(50)
        except Exception as error:  # noqa: B902
            print(f'{name} is left out: {error!r}', file=sys.stderr)
            continue
        count = 50
        while elapsed(function, count) < PORTION:
            count *= 2
        result[name] = function, count
    return result


def elapsed(function, count):
    """Return the CPU time of so many calls [s]."""
    begin = time.process_time()
    function(count)
    return time.process_time() - begin


def main():
    """Answer, line by line."""
    tasks = prepared(sys.argv[1:])
    print(json.dumps(list(tasks)), flush=True)
    for line in sys.stdin:
        function, count = tasks[line.strip()]
        print(elapsed(function, count) / count, flush=True)


if __name__ == '__main__':
    main()
