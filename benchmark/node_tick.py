# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What one tick of the simulator node costs, part by part.

Prints, for each scene, CPU times [us] of one thread: the physics of a tick, reading the state
and the constraint forces out of it, filling and publishing its messages (and, for comparison,
publishing them as message objects), what goes along with a state, and one round of diagnostics.
Nobody subscribes; subscribers add what DDS takes to send.
"""

import argparse
import statistics
import sys
import time

from machine import description, ROOT
import rclpy

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.ros.simulator_node import SimulatorNode  # noqa: E402,I100

COLUMNS = ('physics', 'reading', 'filling', 'publishing', 'companions', 'whole tick',
           'as objects', 'diagnostics')


def timed(function, count):
    """Return the median CPU time of a call [us]."""
    times = []
    for _ in range(count):
        begin = time.thread_time_ns()
        function()
        times.append(time.thread_time_ns() - begin)
    return 1e-3 * statistics.median(times)


def parts(node, rate, count):
    """Return the times of the parts of a tick, in the order of ``COLUMNS``."""
    simulation, states = node.simulation, node.states
    steps = max(1, round(1.0 / (rate * simulation.step_size)))
    stamp = node.live.stamps.now()

    def read():
        # Something new to read: as after a step.
        simulation.data.touch()
        return (*simulation.measured(), simulation.effort, simulation.constraint_forces)

    content = read()
    sec, nanosec = divmod(stamp, 10 ** 9)
    wrench = states._wrenches[0]

    def fill():
        states._state.filled(sec, nanosec, *content[:3])
        for message in states.templates:
            message.filled(sec, nanosec, wrench)

    def publish_objects():
        states.state_publisher.publish(states.joint_state(sec, nanosec, *content[:3]))
        for publisher in states.force_publishers:
            publisher.publish(wrench_message)

    wrench_message = states.templates[0]._build(sec, nanosec, wrench)
    physics = timed(lambda: node.live.advance(steps), count)
    reading = timed(read, count)
    filling = timed(fill, count)
    publishing = timed(lambda: states.publish(stamp, *content), count) - filling
    companions = timed(lambda: [follow(states.stamp) for follow in node.live.on_published], count)

    def tick():
        node.live.advance(steps)
        node.live.publish()

    return (physics, reading, filling, publishing, companions, timed(tick, count),
            timed(publish_objects, count), timed(node.publish_diagnostics, max(count // 10, 5)))


def measure(scene, rate, count):
    """Return the times for a scene."""
    context = rclpy.Context()
    rclpy.init(context=context)
    values = {'scene': scene, 'publish_rate': rate}
    node = SimulatorNode(context=context, parameter_overrides=[
        rclpy.Parameter(name, value=value) for name, value in values.items()])
    try:
        parts(node, rate, 10)
        return parts(node, rate, count)
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def main(argv=None):
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.strip().splitlines()[0])
    parser.add_argument('scenes', nargs='*', default=['three_rrr', 'carpet_scraper'],
                        help='default: %(default)s')
    parser.add_argument('--rate', type=float, default=1000.0, help='of publishing [Hz]')
    parser.add_argument('--count', type=int, default=2000, help='ticks timed')
    arguments = parser.parse_args(argv)
    print(f'{description()}\nCPU time [us], at {arguments.rate:g} Hz')
    print(f'{"scene":26}' + ''.join(f'{name:>12}' for name in COLUMNS))
    for scene in arguments.scenes:
        times = measure(scene, arguments.rate, arguments.count)
        print(f'{scene:26}' + ''.join(f'{value:12.1f}' for value in times), flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
