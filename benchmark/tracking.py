# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
How well the controllers to start from track, in lockstep and with the clock.

Starts a real simulator and a real torque source with the parameters of config/controllers,
listens to the states, and prints for each rate and mode how far the platform's centre is from its
circle, and how far the crank is from its speed, once settled.
"""

import argparse
import os
import sys
import time

from machine import description, ROOT
from node_rate import start
import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

sys.path.insert(0, str(ROOT))

from test.ros.test_controllers import center_of, misses, moving  # noqa: E402,I100

CIRCLE, SPEED = 'three_rrr_circle', 'carpet_scraper_speed'
WANTED = 4.71238898038469
# What the start takes [s]: the first turn of the circle, and until the crank has its speed.
SETTLING = {CIRCLE: 4.0, SPEED: 1.5}


def record(controller, mode, rate, duration, parameters):
    """Return positions and velocities of a run, from the first motion on."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node('tracking', context=context)
    states = []
    subscription = node.create_subscription(
        JointState, 'joint_states', lambda message: None, QoSProfile(depth=10000))
    file = ROOT / 'config' / 'controllers' / f'{controller}.yaml'
    processes = [start('simulator', f'publish_rate:={rate}', f'mode:={mode}', *parameters,
                       file=file)]
    try:
        source = None
        while len(states) < 2 or len(moving(states)) < duration * rate:
            with subscription.handle:
                while taken := subscription.handle.take_message(JointState, False):
                    states.append(taken[0])
            if states and source is None:
                source = start('torque_source', file=file)
                processes.append(source)
            time.sleep(0.005)
    finally:
        for process in reversed(processes):
            process.terminate()
            process.wait()
        node.destroy_node()
        rclpy.try_shutdown(context=context)
    chosen = moving(states)
    return (np.array([state.position for state in chosen]),
            np.array([state.velocity for state in chosen]))


def line(controller, mode, rate, duration, parameters):
    """Return the line of one run."""
    position, velocity = record(controller, mode, rate, duration, parameters)
    settled = slice(int(SETTLING[controller] * rate), None)
    if controller == SPEED:
        crank = velocity[settled, 0]
        said = (f'between {crank.min():.4f} and {crank.max():.4f} rad/s, '
                f'rms {np.sqrt(np.mean((crank - WANTED) ** 2)):.4f} rad/s')
    else:
        said = circle(position, settled)
    return f'{controller:22}{mode:10}{rate:6.0f} Hz  {said}'


def circle(position, settled):
    """Return how far the platform's centre is from its circle."""
    center, mechanism = center_of(CIRCLE)
    off = 1e3 * misses(mechanism, position, center)
    return (f'off by {off.max():.5f} mm at most, rms {np.sqrt(np.mean(off[settled] ** 2)):.5f} mm '
            'after the first turn')


def main(argv=None):
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('--rates', type=float, nargs='+', default=[100.0, 500.0], help='[Hz]')
    parser.add_argument('--modes', nargs='+', default=['lockstep', 'realtime'])
    parser.add_argument('--controllers', nargs='+', default=[CIRCLE, SPEED])
    parser.add_argument('--duration', type=float, default=8.0, help='of each [s]')
    parser.add_argument('--keep-core-awake', action='store_true',
                        help='with that parameter of the simulator')
    arguments = parser.parse_args(argv)
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    parameters = ['keep_core_awake:=true'] if arguments.keep_core_awake else []
    print(description())
    for controller in arguments.controllers:
        for mode in arguments.modes:
            for rate in arguments.rates:
                print(line(controller, mode, rate, arguments.duration, parameters), flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
