# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The shipped machine that is estimated, moved by its controller, and messages of its sensors."""

from functools import lru_cache
from types import SimpleNamespace

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.control.files import Controller, read_controller
from closedloop_dynamics.mechanism.config import config_directory
from closedloop_dynamics.recording.forces import MessageBag

FOLDER = config_directory() / 'estimation'
SENSORS, MACHINE = FOLDER / 'three_rrr_sensors.yaml', FOLDER / 'three_rrr_machine.yaml'
PERIOD = 0.01


@lru_cache
def states(count, still=False):
    """
    Return joint names, and times, measured states and efforts of the machine as it moves.

    ``still``: gravity and the drives do nothing, so that it rests.
    """
    simulation = Simulation.from_scene(load_scene(MACHINE))
    if still:
        simulation.set_effect('gravity', False)
    drive = Controller('circle', read_controller(
        config_directory() / 'controllers' / 'three_rrr_circle.yaml'), simulation.scene)
    found = []
    for _ in range(count):
        simulation.step(None if still else drive.torques(
            simulation.time, simulation.position, simulation.velocity), PERIOD)
        position, velocity = simulation.measured()
        found.append((simulation.time, position.copy(), velocity.copy(),
                      simulation.effort.copy(), simulation.position.copy()))
    return simulation.joint_names, found


def write_csv(path, count, still=False):
    """Write what was measured into a CSV file."""
    names, found = states(count, still)
    lines = [','.join(['time', *(f'{kind}.{name}' for kind in (
        'position', 'velocity', 'effort') for name in names)])]
    lines += [','.join(map(repr, map(float, (time, *q, *qd, *effort))))
              for time, q, qd, effort, _ in found]
    path.write_text('\n'.join(lines) + '\n')
    return path


def write_bag(path, count, begin=10 ** 18):
    """Write the same into a bag, as the simulator publishes it."""
    names, found = states(count)
    with MessageBag(path) as bag:
        for time, q, qd, effort, _ in found:
            bag.state('/joint_states', begin + round(1e9 * time), names, q, qd, effort)
    return path


def message(names=(), position=(), velocity=(), effort=(), stamp=0):
    """Return what has the attributes of a JointState."""
    sec, nanosec = divmod(stamp, 10 ** 9)
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=sec, nanosec=nanosec)),
        name=list(names), position=list(position), velocity=list(velocity), effort=list(effort))
