# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What completing joint states costs, and how late the completed ones are.

    python benchmark/node_completion.py                    (from the checkout)
    python benchmark/node_completion.py --scenes delta_robot --seconds 5

Prints for each scene, of measurements along a motion of the scene at some rate:

- CPU time of a callback [us], from the measured message to the published one: completing
  (positions and rates) in it, its tenth percentile, the callback with forces under measured
  efforts; what follows the answer, matrices for the next one; the most often that all this allows
  [Hz]. DDS, and rclpy's conversion of the message that comes, are not in it.
- latency [ms]: from before a measurement is published until the completed one has been taken in by
  its subscriber in this process, the node running in a process of its own. Both ways through DDS
  are in it; echo is the same with a node that sends back what it gets.
"""

import argparse
import os
from pathlib import Path
import statistics
import sys
import tempfile
import threading
import time

from machine import description, ROOT
import numpy as np
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.ros.joint_states_node import JointStatesNode  # noqa: E402,I100
from closedloop_dynamics.ros.process import build_executor  # noqa: E402
from closedloop_dynamics.simulation.passive_joint_solver import PassiveJointSolver  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from programs import Programs  # noqa: E402

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
    back = [(q, -qd) for q, qd in rows[-2:0:-1]]
    turn = rows + back
    return names, [turn[k % len(turn)] for k in range(count)]


def message_of(names, position, velocity, number):
    """Return a measurement, its number as its stamp."""
    message = JointState(name=names, position=position.tolist(), velocity=velocity.tolist(),
                         effort=[0.0] * len(names))
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(number + 1, 10 ** 9)
    return message


def costs(scene, rate, count):
    """
    Return CPU times [us]: completing, callback (and its tenth percentile), with forces, ready.

    Medians but for the last, matrices for the next measurement: a mean, as they are rarely made.
    """
    names, rows = measured(scene, rate, count)
    found, own = {}, []
    simulation = Simulation.from_scene(scene)
    completion = PassiveJointSolver(simulation.mechanism, names, simulation.position)
    for position, velocity in rows:
        begin = time.thread_time_ns()
        completion.complete(position, velocity)
        own.append(time.thread_time_ns() - begin)
        completion.get_ready()
    for forces in (False, True):
        node = JointStatesNode(parameter_overrides=[
            rclpy.Parameter('scene', value=scene), rclpy.Parameter('joints', value=names),
            rclpy.Parameter('forces', value=forces)])
        whole, ready = [], []
        get_ready = node.completion.get_ready
        node.completion.get_ready = lambda: None
        for number, (position, velocity) in enumerate(rows):
            message = message_of(names, position, velocity, number)
            begin = time.thread_time_ns()
            node.on_joint_states(message)
            whole.append(time.thread_time_ns() - begin)
            begin = time.thread_time_ns()
            get_ready()
            ready.append(time.thread_time_ns() - begin)
        assert node.counts['completed'] == count, node.counts
        node.destroy_node()
        found[forces] = whole, statistics.mean(ready)
    (whole, ready), (with_forces, _) = found[False], found[True]
    return 1e-3 * np.array([
        statistics.median(own), statistics.median(whole), np.percentile(whole, 10),
        statistics.median(with_forces), ready])


def round_trips(names, rows, rate, answers):
    """Return times [ms] until an answer to each measurement has come."""
    node = rclpy.create_node('robot')
    publisher = node.create_publisher(JointState, 'joint_states', QoSProfile(depth=1))
    times, waiting = [], threading.Event()
    sent = [0, 0]

    def take(message):
        if message.header.stamp.nanosec == sent[0]:
            times.append(time.monotonic() - sent[1])
            waiting.set()

    node.create_subscription(JointState, answers, take, QoSProfile(depth=1))
    executor = build_executor()
    executor.add_node(node)
    while not (publisher.get_subscription_count() and node.count_publishers(answers)):
        executor.spin_once(timeout_sec=0.05)
    due = time.monotonic()
    for number, (position, velocity) in enumerate(rows):
        message = message_of(names, position, velocity, number)
        due += 1.0 / rate
        time.sleep(max(0.0, due - time.monotonic()))
        waiting.clear()
        sent[:] = number + 1, time.monotonic()
        publisher.publish(message)
        give_up = sent[1] + 0.5
        while not waiting.is_set() and time.monotonic() < give_up:
            executor.spin_once(timeout_sec=0.001)
    executor.shutdown()
    node.destroy_node()
    return 1e3 * np.array(times[len(times) // 10:])


class Echo:
    """Answers each measurement with itself, in a thread of its own process."""

    CODE = """\
import rclpy
from rclpy.qos import QoSProfile
from sensor_msgs.msg import JointState
from closedloop_dynamics.ros.process import build_executor
rclpy.init()
node = rclpy.create_node('echo')
publisher = node.create_publisher(JointState, 'complete_joint_states', QoSProfile(depth=1000))
node.create_subscription(JointState, 'joint_states', publisher.publish, QoSProfile(depth=1))
executor = build_executor()
executor.add_node(node)
print('ready', flush=True)
while True:
    executor.spin_once(timeout_sec=0.1)
"""

    def __enter__(self):
        import subprocess
        self._process = subprocess.Popen(
            [sys.executable, '-c', self.CODE], stdout=subprocess.PIPE, cwd=ROOT)
        self._process.stdout.readline()
        return self

    def __exit__(self, *_):
        self._process.kill()
        self._process.wait()


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--scenes', nargs='+', default=SCENES)
    parser.add_argument('--rate', type=int, default=500, help='of measurements [Hz]')
    parser.add_argument('--seconds', type=float, default=3.0, help='for each scene')
    arguments = parser.parse_args()
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    print(description())
    rclpy.init()
    count = round(arguments.rate * arguments.seconds)
    print(f'{"scene":22}{"completing":>12}{"callback":>10}{"p10":>8}{"forces":>10}{"ready":>8}'
          f'{"at most":>10}{"p50":>9}{"p99":>9}{"echo p50":>10}')
    print(f'{"":22}{"us":>12}{"us":>10}{"us":>8}{"us":>10}{"us":>8}'
          f'{"Hz":>10}{"ms":>9}{"ms":>9}{"ms":>10}')
    for scene in arguments.scenes:
        own, whole, quick, forces, ready = costs(scene, arguments.rate, count)
        names, rows = measured(scene, arguments.rate, count)
        with Echo():
            echo = round_trips(names, rows, arguments.rate, 'complete_joint_states')
        with tempfile.TemporaryDirectory() as folder, Programs(Path(folder)) as programs:
            programs.start('closedloop_joint_states', scene=scene,
                           joints=f'[{",".join(names)}]').wait_until_ready()
            trips = round_trips(names, rows, arguments.rate, 'complete_joint_states')
        middle, late = np.percentile(trips, [50, 99])
        print(f'{scene:22}{own:12.0f}{whole:10.0f}{quick:8.0f}{forces:10.0f}{ready:8.0f}'
              f'{1e6 / (whole + ready):10.0f}{middle:9.3f}{late:9.3f}{np.median(echo):10.3f}')
    rclpy.shutdown()


if __name__ == '__main__':
    main()
