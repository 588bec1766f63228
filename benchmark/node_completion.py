# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What completing joint states costs.

Prints for each scene, of measurements along a motion of the scene at some rate, CPU time of a
callback [us], from the measured message to the published one: completing (positions and rates) in
it, its tenth percentile, the callback with forces under measured efforts; what follows the answer,
matrices for the next one; the most often that all this allows [Hz]. DDS, and rclpy's conversion of
the message that comes, are not in it.
"""

import os
import statistics
import sys
import time

from closedloop_dynamics.kinematics.passive_joint_solver import PassiveJointSolver
from closedloop_dynamics.ros.joint_states_node import JointStatesNode
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.tables import text_table
from machine import description, parser_of
import numpy as np
import rclpy
from sensor_msgs.msg import JointState

SCENES = ('three_rrr_horizontal', 'delta_robot', 'humanoid_ankle', 'stewart_platform')


def measured(scene, rate, count):
    """Return the driven joints of a scene, and their positions and rates along its motion."""
    simulation = Simulation.from_scene(scene)
    names = [name for name in simulation.actuated_joints if name in simulation.joint_names]
    index = [simulation.coordinates.index[name] for name in names]
    places = simulation.coordinates.place[index]
    rows = []
    # There and back again, as the free motion of some scenes leads into singular positions.
    for _ in range(min(count, rate // 10)):
        simulation.step(duration=1.0 / rate)
        rows.append((simulation.position[places], simulation.velocity[index]))
    turn = rows + [(q, -qd) for q, qd in rows[-2:0:-1]]
    return names, [turn[k % len(turn)] for k in range(count)]


def timed(function, *arguments):
    """Return the CPU time of a call [us]."""
    begin = time.thread_time_ns()
    function(*arguments)
    return 1e-3 * (time.thread_time_ns() - begin)


def callbacks(scene, names, rows, forces):
    """Return the times of the callbacks of a node [us], and of what follows them."""
    node = JointStatesNode(parameter_overrides=[
        rclpy.Parameter('scene', value=scene), rclpy.Parameter('joints', value=names),
        rclpy.Parameter('forces', value=forces)])
    get_ready, found = node.completion.get_ready, []
    node.completion.get_ready = lambda: None
    for number, (position, velocity) in enumerate(rows, 1):
        message = JointState(name=names, position=position.tolist(), velocity=velocity.tolist(),
                             effort=[0.0] * len(names))
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(number, 10 ** 9)
        found.append((timed(node.on_joint_states, message), timed(get_ready)))
    assert node.counts['completed'] == len(rows), node.counts
    node.destroy_node()
    return zip(*found)


def costs(scene, rate, count):
    """
    Return CPU times [us]: completing, callback and its tenth percentile, with forces, ready.

    Medians but for the last, matrices for the next measurement: a mean, as they are rarely made.
    Then the most often that callback and ready allow [Hz].
    """
    names, rows = measured(scene, rate, count)
    simulation, own = Simulation.from_scene(scene), []
    completion = PassiveJointSolver(simulation.mechanism, names, simulation.position)
    for row in rows:
        own.append(timed(completion.complete, *row))
        completion.get_ready()
    whole, ready = callbacks(scene, names, rows, False)
    with_forces, _ = callbacks(scene, names, rows, True)
    middle, after = statistics.median(whole), statistics.mean(ready)
    return (statistics.median(own), middle, np.percentile(whole, 10),
            statistics.median(with_forces), after, 1e6 / (middle + after))


def main(arguments=None):
    """Measure and print."""
    parser = parser_of(__doc__, scenes=SCENES)
    parser.add_argument('--rate', type=int, default=500, help='of measurements [Hz]')
    parser.add_argument('--seconds', type=float, default=3.0, help='for each scene')
    options = parser.parse_args(arguments)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    rclpy.init()
    rows = [(scene, *(f'{value:.0f}' for value in costs(
        scene, options.rate, round(options.rate * options.seconds)))) for scene in options.scenes]
    rclpy.shutdown()
    print(description(), text_table(
        ('scene', 'completing', 'callback', 'tenth percentile', 'with forces', 'ready',
         'at most [Hz]'), rows), sep='\n\n')
    return 0


if __name__ == '__main__':
    sys.exit(main())
