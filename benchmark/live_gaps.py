# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The longest gap between two states of a live simulator while it is disturbed, with empty caches.

Starts a real simulator at 200 Hz for each scene, with a directory of compiled code of its own that
is empty, and disturbs it as a user would: effects switched off and on, rotors, payloads and
friction that were off among them, and their numbers changed, other methods and ways to keep the
loops closed, a wrench on a body, a state set, a motion commanded, a reset; a parallelogram is
driven through its flat position and set onto it, Bennett's linkage turns until it works on other
equations, a ladder has more joints than are unrolled. Printed are the longest gap in the seconds
after each disturbance, by the times at which DDS sent the states, that of a bare loop which sleeps
beside it, of what the machine itself causes, and what the simulator answered.

With ``--pages`` the frames of ``closedloop view`` at 60 Hz instead, without a browser: a point is
pulled as by a mouse, drives, effects and methods are changed, and so are sliders of the machine
while it moves.
"""

import argparse
from dataclasses import replace
import json
import multiprocessing
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time

from closedloop_dynamics.effects.gravity import Gravity
from closedloop_dynamics.effects.joint_friction import JointFriction
from closedloop_dynamics.effects.payload import Payload
from closedloop_dynamics.effects.rotor import Rotor
from closedloop_dynamics.mechanism.validation import validate_mechanism
from closedloop_dynamics.simulation.scene import load_scene
from closedloop_dynamics.simulation.scene_records import Initial, Method, Scene
from closedloop_dynamics.simulation.scene_text import write_scene
from closedloop_dynamics.view.own_motion import own_motion
from closedloop_dynamics.view.runner import RATE as FRAMES, Runner
from families import ladder
from geometry_msgs.msg import WrenchStamped
from machine import description
from node_rate import start, Subscriber
import numpy as np
from rcl_interfaces.srv import SetParameters
from rclpy.executors import SingleThreadedExecutor
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger
from trajectory_msgs.msg import JointTrajectory, JointTrajectoryPoint

RATE = 200.0
NODE = 'closedloop_simulator'
SCENES = ('three_rrr_payload_friction', 'bennett', 'stewart_platform', 'ladder')
PAGES = ('three_rrr_vertical', 'bennett', 'stewart_platform')
# Effects that are off, and numbers of them that are changed once they are on.
NUMBERS = {'part': ('mass', 0.8), 'disc': ('inertia', 0.02), 'grease': ('coulomb', 0.2),
           'rubber': ('parameters.k', 0.2)}
# Of the ladder, two joints each and one more: more than are unrolled.
LOOPS = 24
# Joints whose motion is commanded.
MOVED = {'four_bar': 'crank_joint'}
METHODS = ('rk4', 'semi_implicit_euler', 'dopri5', 'dop853', 'rodas4', 'auto')
# Without stabilisation of positions a parallelogram ends at its flat position, with an error.
DRIFTING = 'velocity_projection'
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
  rubber:
    {type: law, joints: {x: crank_joint}, parameters: {k: 0.1}, forces: {x: -k*x}, enabled: false}
"""}


class BareLoop:
    """A process that does nothing but sleep until the next period is over."""

    def __init__(self, rate):
        """Start it, and wait until it sleeps."""
        context = multiprocessing.get_context('spawn')
        self._longest = context.Value('d', 0.0)
        context.Process(target=_sleep, args=(rate, self._longest), daemon=True).start()
        while self._longest.value == 0.0:
            time.sleep(1.0 / rate)

    def restart(self):
        """Forget the longest gap so far."""
        self._longest.value = 0.0

    @property
    def longest(self):
        """Return the longest gap [ms]."""
        return 1e3 * self._longest.value


def _sleep(rate, longest):
    before = due = time.perf_counter()
    while True:
        due = max(due + 1.0 / rate, before)
        time.sleep(max(0.0, due - time.perf_counter()))
        now = time.perf_counter()
        longest.value = max(longest.value, now - before)
        before = now


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

    def set_parameter(self, name, value):
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
            off = name in self.scene.switched_off
            for value in (off, not off):
                yield f'{name} {"on" if value else "off"}', self.set_parameter(
                    f'effects.{name}.enabled', value)
                if off and value:
                    key, number = NUMBERS[name]
                    yield f'{name}.{key}', self.set_parameter(f'effects.{name}.{key}', number)
        for name in METHODS:
            yield name, self.set_parameter('integrator', name)
        flat = self.scene.mechanism.name == 'parallelogram'
        for name in STABILISATIONS:
            if not (flat and name == DRIFTING):
                yield name, self.set_parameter('stabilisation', name)
        wrench = WrenchStamped()
        wrench.header.frame_id = self.scene.mechanism.bodies[0].name
        wrench.wrench.force.x = 0.5
        yield 'wrench', self.send('external_wrench', wrench)
        yield 'reset', self.reset
        yield 'moves on', lambda: ''
        if self.scene.name in MOVED:
            point = JointTrajectoryPoint(positions=[2.0])
            point.time_from_start.sec = 1
            yield 'motion', self.send('motion_command', JointTrajectory(
                joint_names=[MOVED[self.scene.name]], points=[point]))
        if flat:
            yield 'driven through flat', self.send('torque_command', Float64MultiArray(data=[8.0]))
            yield 'reset', self.reset
            yield 'set onto flat', self.send(f'{NODE}/set_state', JointState(
                name=['crank_joint', 'coupler_joint', 'rocker_joint'], position=[0.0, 0.0, 0.0]))


def longest(moments):
    """Return the longest gap between moments [ns] in ms; infinite where there is but one."""
    return 1e-6 * np.diff(moments).max() if len(moments) > 1 else np.inf


def measure(scene, duration, bare):
    """Print the lines of a scene."""
    with tempfile.TemporaryDirectory() as folder:
        os.environ['CLOSEDLOOP_CACHE_DIR'] = folder
        live = Live(scene)
        moved = MOVED.get(live.scene.name)
        simulator = start('simulator', f'scene:={scene}', f'publish_rate:={RATE}',
                          *([] if moved is None else [f'motion_joints:=[{moved}]']))
        try:
            live.subscriber.take_until(
                lambda: len(live.sent) > RATE or simulator.poll() is not None)
            for name, disturb in (('nothing', lambda: ''), *live.disturbances()):
                del live.sent[:-1]
                bare.restart()
                answer, begin = disturb(), time.monotonic()
                live.subscriber.take_until(lambda: time.monotonic() - begin > duration)
                if simulator.poll() is not None:
                    print(f'{live.scene.mechanism.name:18}{name:24}   ended  {answer}')
                    return
                print(f'{live.scene.mechanism.name:18}{name:24}'
                      f'{longest(live.sent):8.1f}{bare.longest:8.1f}  {answer}', flush=True)
        finally:
            simulator.terminate()
            simulator.wait()
            live.subscriber.close()


def with_more(name, folder):
    """Write a scene with rotors, payloads and friction that are off; return its path."""
    if name == 'ladder':
        # Hanging, it swings without coming near to where all its loops are flat at once.
        mechanism, position = ladder(LOOPS, -1.2)
        scene = Scene(name, None, '', validate_mechanism(mechanism), Initial(
            position, len(position) * (0.0,)), {'gravity': Gravity((0.0, -9.81))}, Method())
    else:
        scene = load_scene(name)
    joint = next(one.name for one in scene.mechanism.joints if one.actuated)
    more = {'part': Payload(scene.mechanism.bodies[-1].name, 0.5), 'disc': Rotor(joint, 0.01),
            'grease': JointFriction(joint, coulomb=0.1)}
    path = Path(folder, f'{name}.yaml')
    write_scene(replace(scene, effects={**scene.effects, **more},
                        switched_off=(*scene.switched_off, *more)), path)
    return path


def requests(runner):
    """Yield requests of a page, each once it is due."""
    yield 'play', {'do': 'play'}
    at = np.zeros(3)
    place = runner.simulation.body_poses[-1]
    at[:2] = place[-2:] if runner.simulation.mechanism.planar else place[:2]
    body = len(runner.simulation.mechanism.bodies) - 1
    yield 'grab', {'do': 'grab', 'body': body, 'place': 0, 'at': at.tolist()}
    yield 'pull', {'do': 'pull', 'at': (at + 0.1).tolist()}
    yield 'release', {'do': 'release'}
    for name in runner.editor.scene.effects:
        for enabled in (False, True):
            yield f'{name} {"on" if enabled else "off"}', {
                'do': 'effect', 'name': name, 'enabled': enabled}
    for values in ({'integrator': 'dopri5'}, {'stabilisation': 'independent'},
                   {'integrator': 'rodas4', 'stabilisation': 'baumgarte'},
                   {'integrator': 'auto', 'stabilisation': 'projection'}):
        yield ' '.join(values.values()), {'do': 'method', 'values': values}
    for slider in runner.editor.sliders()[::3]:
        yield slider['key'], {
            'do': 'set', 'key': slider['key'], 'value': 1.02 * slider['value']}


def measure_page(scene, duration):
    """Print the lines of a scene that a page shows."""
    runner = Runner(load_scene(scene), own=own_motion)
    period, bare = 1.0 / FRAMES, BareLoop(FRAMES)
    for name, message in requests(runner):
        refused = runner.feed.refused
        bare.restart()
        runner.feed.accept('page', json.dumps(message))
        moments, end = [time.monotonic()], time.monotonic() + duration
        while moments[-1] < end or runner.renewing:
            runner.tick()
            time.sleep(max(0.0, moments[-1] + period - time.monotonic()))
            moments.append(time.monotonic())
        controls = json.loads(runner.feed.controls)
        answer = 'refused' if runner.feed.refused > refused else 'accepted'
        print(f'{runner.editor.scene.mechanism.name:18}{name:32}'
              f'{1e3 * np.diff(moments).max():8.1f}{bare.longest:8.1f}  '
              f'{controls["failure"] or answer}', flush=True)


def main(argv=None):
    """Measure and print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--scenes', nargs='*', default=SCENES, help='default: %(default)s')
    parser.add_argument('--duration', type=float, default=2.0,
                        help='after each disturbance [s] (default: %(default)s)')
    parser.add_argument('--pages', nargs='*', metavar='SCENE', help=(
        f'frames of closedloop view (with no name of: {", ".join(PAGES)})'))
    parser.add_argument('--page', help=argparse.SUPPRESS)
    arguments = parser.parse_args(argv)
    if arguments.page:
        measure_page(arguments.page, arguments.duration)
        return
    print(description())
    if arguments.pages is not None:
        print(f'{"mechanism":18}{"request":32}gap [ms]    bare  answer', flush=True)
        for scene in arguments.pages or PAGES:
            with tempfile.TemporaryDirectory() as folder:
                subprocess.run([sys.executable, __file__, '--page', scene, '--duration',
                                str(arguments.duration)], check=True,
                               env={**os.environ, 'CLOSEDLOOP_CACHE_DIR': folder})
        return
    bare = BareLoop(RATE)
    print(f'{"mechanism":18}{"disturbance":24}gap [ms]    bare  answer', flush=True)
    with tempfile.TemporaryDirectory() as folder:
        for name, text in FILES.items():
            Path(folder, name).write_text(text)
        for scene in (Path(folder, 'scene.yaml'), *(
                with_more(name, folder) for name in arguments.scenes), *MOVED):
            measure(scene, arguments.duration, bare)


if __name__ == '__main__':
    main()
