# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Forces along a motion that was recorded of some joints: inverse dynamics, state by state."""

import warnings

import numpy as np

from .contents import Topic
from .errors import RecordingError
from .message_numbers import NANOSECONDS, stamp_of
from .rosbag2 import open_bag
from .run import moving_joints
from ..kinematics.passive_joint_solver import PassiveJointError, PassiveJointSolver
from ..mechanism.extras import of_an_extra

# Degree of the polynomials between measurements, so that accelerations have continuous slopes.
DEGREE = 5
STATE, WRENCH = 'sensor_msgs/msg/JointState', 'geometry_msgs/msg/WrenchStamped'


def measured_positions(path, topic, joints):
    """
    Read the positions of joints from a topic of a bag.

    Warns of damages of the bag, and of messages that are not used as their time does not increase.

    Parameters
    ----------
    path : path-like
        The bag.
    topic : str
        Full name; its messages are JointState.
    joints : sequence of str
        Names in them.

    Returns
    -------
    stamps : list of int, length n
        Increasing; of the first message of each [ns].
    positions : ndarray, shape (n, number of joints)
        [rad or m].

    Raises
    ------
    RecordingError
        Where they are not in it, or too few.
    OSError
        Where it cannot be read.

    """
    stamps, rows, unordered = [], [], 0
    bag = open_bag(path)
    for _, _, message in bag.messages(topic.__eq__):
        missing = [name for name in joints if name not in message.name]
        if missing or len(message.position) != len(message.name):
            raise RecordingError(
                f'{path}: {topic}: expected positions of {", ".join(joints)}, got those of '
                f'{", ".join(message.name) if missing else "some"}')
        stamp = stamp_of(message)
        if not stamps or stamp > stamps[-1]:
            stamps.append(stamp)
            rows.append([message.position[message.name.index(name)] for name in joints])
        else:
            unordered += 1
    bag.warn()
    if unordered:
        warnings.warn(f'{path}: {topic}: {unordered} messages are not used: expected stamps that '
                      'increase')
    if len(rows) <= DEGREE:
        raise RecordingError(f'{path}: {topic}: expected more than {DEGREE} measurements, got '
                             f'{len(rows)}')
    positions = np.array(rows, dtype=float)
    if not np.isfinite(positions).all():
        raise RecordingError(f'{path}: {topic}: a position is not a finite number')
    return stamps, positions


def smooth(times, positions, deviation):
    """
    Return positions, rates and accelerations of splines near measured positions, shape (3, n, m).

    ``times`` [s], shape (n,); ``positions``, shape (n, m), of angles without jumps by turns. The
    splines are as smooth as a standard ``deviation`` of positions allows [rad or m]; 0: they go
    through all of them.
    """
    from scipy.interpolate import make_interp_spline, UnivariateSpline
    found = np.empty((3, *positions.shape))
    for k, column in enumerate(positions.T):
        spline = make_interp_spline(times, column, DEGREE) if deviation == 0.0 else (
            UnivariateSpline(times, column, k=DEGREE, s=len(times) * deviation ** 2))
        for order in range(3):
            found[order, :, k] = spline(times) if order == 0 else spline.derivative(order)(times)
    return found


def forces_along(simulation, joints, times, positions, deviation=0.0):
    """
    Move a simulation along a measured motion, under the torques that this takes.

    Parameters
    ----------
    simulation : Simulation
        Whose initial position is on the branch of the motion.
    joints : sequence of str
        Measured joints of the tree.
    times : ndarray, shape (n,)
        Increasing [s].
    positions : ndarray, shape (n, number of joints)
        [rad or m].
    deviation : float
        As for ``smooth``.

    Yields
    ------
    int
        Number of the measurement whose state and forces the simulation has now.

    Raises
    ------
    PassiveJointError, SimulationError
        Where the mechanism cannot be there, or its drives cannot move it so.
    ValueError
        For joints that do not determine the others.

    """
    completion = PassiveJointSolver(simulation.mechanism, joints, simulation.position)
    turns = ~simulation.coordinates.lengths[
        [simulation.coordinates.index[name] for name in joints]]
    positions = positions.copy()
    positions[:, turns] = np.unwrap(positions[:, turns], axis=0)
    nq, nv = simulation.coordinates.nq, simulation.coordinates.nv
    for k, (position, rate, acceleration) in enumerate(
            zip(*smooth(times, positions, deviation))):
        completion.complete(position, rate)
        if completion.passed:
            raise PassiveJointError(
                f'at {times[k]:.6g} s the motion touches a singular position, where branches '
                'meet: these joints do not determine the one on which it goes on')
        q, qd = completion.position, completion.velocity
        torque, _ = simulation.inverse_dynamics(q, qd, completion.accelerations(acceleration))
        simulation.data.integrated[:nq] = q
        simulation.data.integrated[nq:nq + nv] = qd
        simulation.advance(simulation.joint_torques(torque), 0)
        yield k


class MessageBag:
    """
    Writes messages of states, wrenches and numbers into a new bag; topics are added as they come.

    A context; ``path`` is its directory, which must not exist. Stamps are in ns.
    """

    def __init__(self, path):
        from .writer import BagFiles
        with of_an_extra():
            from rosbags.typesys import get_typestore, Stores
        self._files, self._store = BagFiles(path, 'mcap'), get_typestore(Stores.ROS2_JAZZY)
        self._channels = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._files.close()

    def state(self, topic, stamp, names, position, velocity, effort):
        """Write a JointState."""
        values = (np.array(each, dtype=float) for each in (position, velocity, effort))
        self._put(topic, STATE, stamp, header=self._header(stamp), name=list(names),
                  **dict(zip(('position', 'velocity', 'effort'), values)))

    def wrench(self, topic, stamp, wrench):
        """Write a WrenchStamped, moments first, shape (3,), in space (6,), axes of the world."""
        torque, force = (0.0, 0.0, wrench[0]), (*wrench[1:], 0.0)
        if len(wrench) == 6:
            torque, force = wrench[:3], wrench[3:]
        vector = self._store.types['geometry_msgs/msg/Vector3']
        self._put(topic, WRENCH, stamp, header=self._header(stamp, 'world'), wrench=(
            self._store.types['geometry_msgs/msg/Wrench'](
                force=vector(*map(float, force)), torque=vector(*map(float, torque)))))

    def _header(self, stamp, frame=''):
        types = self._store.types
        return types['std_msgs/msg/Header'](
            stamp=types['builtin_interfaces/msg/Time'](*divmod(stamp, NANOSECONDS)),
            frame_id=frame)

    def _put(self, topic, kind, stamp, **fields):
        if topic not in self._channels:
            definition, _ = self._store.generate_msgdef(kind, ros_version=2)
            self._channels[topic] = self._files.add_topic(
                Topic(topic, kind, definition, self._store.hash_rihs01(kind)))
        message = self._store.types[kind](**fields)
        self._files.write(self._channels[topic], stamp, bytes(
            self._store.serialize_cdr(message, kind)))


class ForceBag(MessageBag):
    """
    Writes states and constraint forces of a simulation into a new bag.

    Topics are those of the simulator, and ``joint_forces/JOINT``: what the parent exerts on the
    child at the child's origin.
    """

    def __init__(self, path, simulation):
        super().__init__(path)
        self._simulation, self._moving = simulation, moving_joints(simulation)
        mechanism = simulation.mechanism
        self._topics = [f'/constraint_forces/{cut.name}' for cut in mechanism.cut_joints] + [
            f'/joint_forces/{simulation.mechanism.joints[place].name}' for place in self._moving]

    def write(self, stamp):
        """Write the present state, with a stamp [ns]."""
        simulation, coordinates = self._simulation, self._simulation.coordinates
        single = coordinates.single
        self.state('/joint_states', stamp, coordinates.single_names,
                   simulation.position[coordinates.place[single]], simulation.velocity[single],
                   simulation.effort[single])
        for topic, wrench in zip(self._topics, (
                *simulation.constraint_forces, *simulation.data.joint_forces[self._moving])):
            self.wrench(topic, stamp, wrench)
