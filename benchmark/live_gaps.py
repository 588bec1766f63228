# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The longest gap between two states of a live simulator while it is disturbed, with empty caches.

Starts a real simulator at 200 Hz for each scene, with a directory of compiled code of its own that
is empty, and disturbs it as a user would: effects switched off and on, other methods and ways to
keep the loops closed, a wrench on a body, a state set, a reset; a parallelogram is driven through
its flat position and set onto it. Printed are the longest gap in the seconds after each
disturbance, by the times at which DDS sent the states, what the simulator answered, and the
longest gaps of a bare sleeping loop before and after.

"""

import argparse
import os
from pathlib import Path
import tempfile
import time

from geometry_msgs.msg import WrenchStamped
from machine import description
from node_rate import floor, start, Subscriber
import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from closedloop_dynamics.simulation.scene import load_scene

RATE = 200.0
NODE = 'closedloop_simulator'
SCENES = ('three_rrr_payload_friction', 'bennett', 'stewart_platform')
METHODS = ('rk4', 'semi_implicit_euler', 'dopri5', 'dop853', 'rodas4', 'auto')
# Without stabilisation a parallelogram ends at its flat position, with an error.
STABILISATIONS = ('baumgarte', 'velocity_projection', 'independent', 'projection')
# Waited for answers at most [s].
PATIENCE = 60.0
FILES = {
    'parallelogram.yaml': """\
name: parallelogram
bodies:
  crank: {mass: 0.5, center_of_mass: [0.1, 0.0], inertia: 0.002}
  coupler: {mass: 1.0, center_of_mass: [0.2, 0.0], inertia: 0.013}
  rocker: {mass: 0.5, center_of_mass: [0.1, 0.0], inertia: 0.002}
joints:
  crank_joint: {type: revolute, parent: ground, child: crank, position: [0.0, 0.0], actuated: true}
  coupler_joint: {type: revolute, parent: crank, child: coupler, position: [0.2, 0.0]}
  rocker_joint: {type: revolute, parent: ground, child: rocker, position: [0.4, 0.0]}
cut_joints:
  cut: {type: revolute, body_a: coupler, point_a: [0.4, 0.0], body_b: rocker, point_b: [0.2, 0.0]}
""",
    'scene.yaml': """\
mechanism: parallelogram.yaml
initial:
  position: {crank_joint: 1.0, coupler_joint: -1.0, rocker_joint: 1.0}
  hold: [crank_joint]
effects:
  gravity: {type: gravity, acceleration: [0.0, -9.81]}
"""}


class Live:
    """What is sent to a running simulator."""

    def __init__(self, scene):
        self.subscriber, self.scene = Subscriber(str(scene)), load_scene(str(scene))
        self.node, self.sent = self.subscriber.node, self.subscriber.taken.sent

    def call(self, kind, name, request):
        """Return the answer of a service, and take states meanwhile."""
        client = self.node.create_client(kind, f'{NODE}/{name}')
        self.subscriber.take_until(client.service_is_ready)
        answer = client.call_async(request)
        executor = SingleThreadedExecutor(context=self.subscriber.context)
        executor.add_node(self.node)
        end = time.monotonic() + PATIENCE

        def over():
            executor.spin_once(timeout_sec=0.0)
            return answer.done() or time.monotonic() > end

        self.subscriber.take_until(over)
        executor.remove_node(self.node)
        self.node.destroy_client(client)
        return answer.result()

    def set(self, name, value):
        """Return a disturbance that sets a parameter."""
        def disturb():
            answer = self.call(SetParameters, 'set_parameters', SetParameters.Request(
                parameters=[Parameter(name, value=value).to_parameter_msg()]))
            if answer is None:
                return 'no answer'
            done, = answer.results
            return 'accepted' if done.successful else f'refused: {done.reason}'
        return disturb

    def reset(self):
        """Bring the simulator back to its start."""
        answer = self.call(Trigger, 'reset', Trigger.Request())
        return 'no answer' if answer is None else answer.message or 'accepted'

    def send(self, topic, message):
        """Return a disturbance that sends a message."""
        publisher = self.node.create_publisher(type(message), topic, 10)

        def disturb():
            self.subscriber.take_until(publisher.get_subscription_count)
            publisher.publish(message)
            return 'sent'
        return disturb

    def disturbances(self):
        """Yield names of disturbances, and functions that return what was answered."""
        for name in self.scene.effects:
            for value in (False, True):
                yield f'{name} {"on" if value else "off"}', self.set(
                    f'effects.{name}.enabled', value)
        for name in METHODS:
            yield name, self.set('integrator', name)
        for name in STABILISATIONS:
            yield name, self.set('stabilisation', name)
        wrench = WrenchStamped()
        wrench.header.frame_id = self.scene.mechanism.bodies[0].name
        wrench.wrench.force.x = 0.5
        yield 'wrench', self.send('external_wrench', wrench)
        yield 'reset', self.reset
        if self.scene.mechanism.name == 'parallelogram':
            yield 'driven through flat', self.send('torque_command', Float64MultiArray(data=[8.0]))
            yield 'reset', self.reset
            yield 'set onto flat', self.send(f'{NODE}/set_state', JointState(
                name=['crank_joint', 'coupler_joint', 'rocker_joint'], position=[0.0, 0.0, 0.0]))


def measure(scene, duration):
    """Print the lines of a scene."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ['CLOSEDLOOP_CACHE_DIR'] = folder
        live = Live(scene)
        simulator = start('simulator', f'scene:={scene}', f'publish_rate:={RATE}')
        try:
            live.subscriber.take_until(lambda: len(live.sent) > RATE)
            for name, disturb in (('nothing', lambda: ''), *live.disturbances()):
                del live.sent[:-1]
                answer, begin = disturb(), time.monotonic()
                live.subscriber.take_until(lambda: time.monotonic() - begin > duration)
                if simulator.poll() is not None:
                    print(f'{live.scene.mechanism.name:18}{name:24}   ended  {answer}')
                    return
                print(f'{live.scene.mechanism.name:18}{name:24}'
                      f'{1e-6 * np.diff(live.sent).max():8.1f}  {answer}', flush=True)
        finally:
            simulator.terminate()
            simulator.wait()
            live.subscriber.close()


def main(argv=None):
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--scenes', nargs='*', default=SCENES, help='default: %(default)s')
    parser.add_argument('--duration', type=float, default=2.0,
                        help='after each disturbance [s] (default: %(default)s)')
    arguments = parser.parse_args(argv)
    print(description())
    print(floor(RATE), '(the last number: off by at most [ms])')
    print(f'{"mechanism":18}{"disturbance":24}gap [ms]  answer')
    with tempfile.TemporaryDirectory() as folder:
        for name, text in FILES.items():
            Path(folder, name).write_text(text)
        for scene in (Path(folder, 'scene.yaml'), *arguments.scenes):
            measure(scene, arguments.duration)
    print(floor(RATE))


if __name__ == '__main__':
    main()
