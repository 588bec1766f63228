# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0
"""
Frames on ``/tf``: one at each cut point, to which constraint forces refer, and those of links.

Those that do not move are on ``/tf_static``, once.

``joint_states`` do not have the joints with an orientation, and robot_state_publisher leaves out
floating joints: the links that they carry always have a frame here.

A wrench's moment refers to the origin of its ``frame_id``. So constraint forces carry a frame
whose origin is the cut point of body A; its axes are those of the world.
"""

from closedloop_dynamics.mechanism.coordinates import WITH_ORIENTATION
from closedloop_dynamics.mechanism.kinematics import place_on, poses_in_space
from closedloop_dynamics.mechanism.mechanism import FIXED, GROUND, UNTURNED
from closedloop_dynamics.ros.messages import LATCHED_QOS, SerializedTemplate
from closedloop_dynamics.ros.parameters import declare, Parameter
from closedloop_dynamics.ros.process import StartError
from geometry_msgs.msg import TransformStamped
import numpy as np
from rclpy.qos import QoSProfile

try:
    from tf2_msgs.msg import TFMessage
except ImportError:
    # It comes with ROS installations, but not from the Python package index.
    TFMessage = None

WORLD = 'world'
FRAME_PARAMETERS = (
    Parameter(
        'cut_frames', True,
        'Broadcast a frame at every cut point, axes as those of world, on /tf; constraint forces '
        'refer to it. false, or where tf2_msgs is not installed: their frame_id is world.'),
    Parameter(
        'publish_tf', False,
        'Broadcast the frames of all links on /tf, in place of robot_state_publisher.'),
    Parameter('frame_prefix', '', 'In front of the names of all frames on /tf.'),
)


class Frames:
    """
    Broadcasts frames with every state, while ``/tf`` has subscribers; at once those that rest.

    ``node`` broadcasts and is given ``FRAME_PARAMETERS``. ``of_cuts``: ``frame_id`` of the force
    at each cut joint; ``any``: whether there are frames that move. StartError if frames of
    links are asked for and there is no message type for them.
    """

    def __init__(self, node, simulation):
        values = declare(node, FRAME_PARAMETERS)
        self._simulation, self._prefix = simulation, values['frame_prefix']
        cuts = simulation.mechanism.cut_joints
        bodies = [GROUND, *(body.name for body in simulation.mechanism.bodies)]
        origin, unmoved = ((0.0, 0.0), (0.0, 0.0, 0.0)) if simulation.mechanism.planar else (
            (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, *UNTURNED))
        floating = {joint.child for joint in simulation.mechanism.joints
                    if joint.type in WITH_ORIENTATION and TFMessage is not None}
        with_cuts, with_links = values['cut_frames'] and bool(cuts), values['publish_tf']
        if TFMessage is None:
            if with_links:
                raise StartError("parameter 'publish_tf': the message type tf2_msgs/msg/TFMessage "
                                 'is not installed here; it comes with a ROS installation')
            if with_cuts:
                with_cuts = False
                node.get_logger().info(
                    'no frames at cut points, as tf2_msgs is not installed: the frame_id of '
                    f"constraint forces is '{self._prefix}{WORLD}'")
        self.of_cuts = [self._prefix + (f'constraint_forces/{cut.name}' if with_cuts else WORLD)
                        for cut in cuts]
        # Name, body, place on it, and whether it turns with it.
        frames = [*((name, cut.body_a, cut.point_a, False)
                    for name, cut in zip(self.of_cuts, cuts) if with_cuts),
                  *((self._prefix + body, body, origin, True)
                    for body in bodies if with_links or body in floating)]
        still = _fixed_to_ground(simulation.mechanism)
        moving, at_rest = ([frame for frame in frames if (frame[1] in still) == rests]
                           for rests in (False, True))
        self._poses = np.tile(unmoved, (len(bodies), 1))
        self.any = bool(moving)
        if moving:
            self._moving = _Group(moving, bodies, self._prefix)
            self._publisher = node.create_publisher(TFMessage, '/tf', QoSProfile(depth=100))
        if at_rest:
            self._still = node.create_publisher(TFMessage, '/tf_static', LATCHED_QOS)
            stamp = node.get_clock().now().to_msg()
            self._still.publish(_Group(at_rest, bodies, self._prefix).message(
                stamp, self._present()))

    def _present(self):
        """Return the present poses of all bodies, the ground first, which stays as it is."""
        self._poses[1:] = self._simulation.body_poses
        return self._poses

    def on_state(self, stamp):
        """Broadcast the frames of the present state that move."""
        if self._publisher.get_subscription_count():
            self._publisher.publish(self._moving.message(stamp, self._present()))


def _fixed_to_ground(mechanism):
    """Return the names of the bodies that do not move, the ground among them."""
    still, count = {GROUND}, 0
    while count != len(still):
        count = len(still)
        still |= {joint.child for joint in mechanism.joints
                  if joint.type == FIXED and joint.parent in still}
    return still


class _Group:
    """
    Frames that are broadcast together.

    ``frames``: name, body, place on it, and whether it turns with it, of each.
    """

    def __init__(self, frames, bodies, prefix):
        self._names, of, points, turns = zip(*frames)
        self._world = prefix + WORLD
        self._rows = np.array([bodies.index(body) for body in of])
        self._points, self._turns = np.array(points), np.array(turns)[:, np.newaxis]
        self._transforms = np.zeros((len(frames), 7))
        self._message = SerializedTemplate(self._build, len(frames) * [7])

    def message(self, stamp, poses):
        """Return a TFMessage of the poses of all bodies."""
        # Origins [m] and quaternions x, y, z, w.
        out, poses = self._transforms, poses[self._rows]
        out[:, :self._points.shape[1]] = place_on(poses, self._points)
        out[:, 3:] = np.where(self._turns, poses_in_space(poses)[:, 3:], UNTURNED)
        return self._message.filled(stamp.sec, stamp.nanosec, *out)

    def _build(self, sec, nanosec, *transforms):
        message = TFMessage()
        for name, numbers in zip(self._names, transforms):
            frame = TransformStamped(child_frame_id=name)
            frame.header.frame_id = self._world
            frame.header.stamp.sec, frame.header.stamp.nanosec = sec, nanosec
            place, turn = frame.transform.translation, frame.transform.rotation
            place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w = numbers.tolist()
            message.transforms.append(frame)
        return message
