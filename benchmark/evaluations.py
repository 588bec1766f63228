# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Evaluations of one state again and again, inside compiled code.

As a command, it prints what an evaluation costs beside and exactly at a singular position, over a
regular one of the same machine: the distances are angles from flat [rad]. Runs read no forces of
an evaluation; at the position itself the last column is with the least joint forces.

"""

from functools import partial
import math
import time

from closedloop_dynamics.scene.records import Method
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.simulation.system import number_of_states
import hard_machines as machines
from machine import in_turn, least, parser_of
import numpy as np

# Of a regular position, then of those beside a singular one [rad].
REGULAR, DISTANCES = 0.6, (0.0099, 3e-3, 1e-3, 1e-4, 1e-6, 0.0)
# An evaluation is timed for so long in each round [s].
PORTION, ROUNDS = 5e-3, 15


def state_of(system, q, qd):
    """Return the state vector of coordinates and rates."""
    state = np.zeros(number_of_states(system))
    state[:len(q) + len(qd)] = np.concatenate((q, qd))
    return state


def evaluate_again(system, q, qd, count):
    """
    Evaluate a state so many times, each evaluation waiting for the one before.

    Parameters
    ----------
    system : simulation.system.System
        Model and workspace of the mechanism.
    q, qd : ndarray, shapes (nq,) and (nv,)
        Coordinates and rates.
    count : int
        How often.

    """
    system.native.evaluate_again(state_of(system, q, qd), count)


def ladder(loops, massless=(), lift=lambda mechanism: mechanism):
    """Return a function of the distance: parallelograms in a row, some bodies without mass."""
    def machine(distance):
        mechanism, q, qd = machines.ladder(loops, 0.5 * math.pi - distance)
        return lift(machines.with_masses(mechanism, dict.fromkeys(massless, 0.0))), q, qd
    return machine


def pantograph(distance):
    """Return a pantograph of two freedoms."""
    return machines.pantograph(-1.9, -1.9 + distance, 1.0, -3.0)


def four_bar(distance):
    """Return the four-bar that has a change point, its crank so far from there."""
    mechanism, _, _ = machines.change_point_linkage()
    crank, coupler, rocker, ground = 1.0, 3.0, 2.0, 4.0
    angle = math.pi - distance
    span = ground - crank * np.exp(1j * angle)
    along = (coupler ** 2 - rocker ** 2 + abs(span) ** 2) / (2.0 * abs(span))
    up = math.sqrt(max(0.0, coupler ** 2 - along ** 2))
    unit = span / abs(span)
    bar = np.angle(unit * (along + 1j * up))
    arm = np.angle(unit * (along - abs(span) + 1j * up))
    if distance == 0.0:
        # The closure equation's second derivative decides.
        bar_rate = 0.2 - math.sqrt(8.0 / 75.0)
        arm_rate = (crank - coupler * bar_rate) / rocker
    else:
        bar_rate = crank / coupler * math.sin(arm - angle) / math.sin(bar - arm)
        arm_rate = crank / rocker * math.sin(bar - angle) / math.sin(bar - arm)
    return mechanism, np.array([angle, bar - angle, arm]), np.array(
        [1.0, bar_rate - 1.0, arm_rate])


MACHINES = {
    'parallelogram': ladder(1),
    'three parallelograms': ladder(3),
    'pantograph': pantograph,
    'four-bar': four_bar,
    'parallelogram in space': ladder(1, lift=machines.in_space),
    'three in space': ladder(3, lift=machines.in_space),
    'massless legs': ladder(1, ('leg_0', 'leg_1')),
    'massless legs of three': ladder(3, ('leg_1', 'leg_2')),
    'massless legs in space': ladder(1, ('leg_0', 'leg_1'), machines.in_space),
}


def called_again(system, q, qd, count):
    """Do the same with forces, by calls from Python."""
    state = state_of(system, q, qd)
    for _ in range(count):
        system.native.evaluate_state(state)


def ratios(machine, rounds):
    """
    Measure a machine, a function from the distance to mechanism, coordinates and rates.

    Regular evaluations and those at all distances are made in turn, so many rounds. Returns the
    least time of a regular evaluation [s], and a list of the least times at each of DISTANCES over
    that, then with forces at the last one.
    """
    mechanism, q, qd = machine(REGULAR)
    effects = machines.gravity() if len(mechanism.bodies[0].center_of_mass) == 2 else (
        machines.gravity_in_space())
    system = Simulation(machines.scene(mechanism, q, qd, Method(), effects)).data.system
    tasks = {distance: partial(evaluate_again, system, *machine(distance)[1:])
             for distance in (REGULAR, *DISTANCES)}
    tasks['called'], tasks['forces'] = (
        partial(called_again, system, *machine(distance)[1:]) for distance in (REGULAR, 0.0))
    once = in_turn({key: partial(run, 100) for key, run in tasks.items()}, 1, time.thread_time)
    counts = {key: max(1, int(PORTION / (first / 100))) for key, (first,) in once.items()}
    found = least({key: partial(run, counts[key]) for key, run in tasks.items()}, rounds,
                  time.thread_time)
    regular, *others, called, with_forces = (each / counts[key] for key, each in found.items())
    # Without the call itself.
    others.append(with_forces - called + regular)
    return regular, [other / regular for other in others]


def main(arguments=None):
    """Print the ratios of all machines."""
    parser = parser_of(__doc__, 'few rounds')
    parser.add_argument('--machine', action='append', choices=MACHINES,
                        help='this one alone; may be repeated')
    options = parser.parse_args(arguments)
    print(f'{"machine":24}{"regular":>12}', *(f'{distance:>8g}' for distance in DISTANCES),
          f'{"forces":>8}')
    for name in options.machine or MACHINES:
        regular, found = ratios(MACHINES[name], 3 if options.quick else ROUNDS)
        print(f'{name:24}{1e9 * regular:9.0f} ns', *(f'{ratio:8.1f}' for ratio in found),
              flush=True)


if __name__ == '__main__':
    main()
