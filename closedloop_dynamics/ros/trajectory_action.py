# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The action ``FollowJointTrajectory``: a trajectory with tolerances, feedback and an outcome."""

from closedloop_dynamics.control.references import TrajectoryError, Waypoints
from closedloop_dynamics.mechanism.coordinates import EITHER
from closedloop_dynamics.ros.joint_trajectory import points_of, seconds_of
from control_msgs.action import FollowJointTrajectory
import numpy as np
from rclpy.action import ActionServer
from rclpy.action import CancelResponse
from rclpy.action import GoalResponse
from rclpy.task import Future
from trajectory_msgs.msg import JointTrajectoryPoint

Result = FollowJointTrajectory.Result
# A goal that is cancelled comes to rest in so long [s].
BRAKING_TIME = 0.2
# Between two messages of feedback [s].
FEEDBACK_PERIOD = 0.05
NO_LIMIT = -1.0


class TrajectoryAction:
    """
    One goal at a time; a new one, or a trajectory from elsewhere, replaces it.

    ``node`` serves ``~/follow_joint_trajectory``; ``follow(points)`` has the ``joints`` led along
    Waypoints from the next state on.
    """

    def __init__(self, node, joints, follow):
        self._joints, self._follow = list(joints), follow
        self._logger, self._clock = node.get_logger(), node.get_clock()
        self._points = self._goal = self._outcome = self._begin = None
        self._limits, self._due, self._braking = {}, 0.0, False
        self._server = ActionServer(
            node, FollowJointTrajectory, '~/follow_joint_trajectory', self._execute,
            goal_callback=self._examine, cancel_callback=lambda goal: CancelResponse.ACCEPT)

    def _examine(self, request):
        """Accept a goal that can be followed; the log has the reason where it cannot."""
        try:
            if request.multi_dof_trajectory.points:
                raise TrajectoryError('expected no multi_dof_trajectory')
            points_of(request.trajectory, self._joints)
            self._limits_of(request)
        except TrajectoryError as error:
            self._logger.warning(f'follow_joint_trajectory refused: {error}')
            return GoalResponse.REJECT
        return GoalResponse.ACCEPT

    def _limits_of(self, request):
        """Return largest errors along the path and at its end, by derivative; inf: none."""
        found = {}
        for key, given in (('path', request.path_tolerance), ('goal', request.goal_tolerance)):
            found[key] = np.full((2, len(self._joints)), np.inf)
            for each in given:
                if each.name not in self._joints:
                    raise TrajectoryError(f"{key}_tolerance: '{each.name}' is not one of the "
                                          f'joints {", ".join(self._joints)}')
                for row, value in enumerate((each.position, each.velocity)):
                    if value > 0.0:
                        found[key][row, self._joints.index(each.name)] = value
                    elif value not in (0.0, NO_LIMIT):
                        raise TrajectoryError(f'{key}_tolerance: expected 0 or more, or -1 for '
                                              f"none, got {value} for '{each.name}'")
        return found

    async def _execute(self, goal):
        self.replaced()
        self._goal, self._outcome = goal, Future()
        self._points = points_of(goal.request.trajectory, self._joints)
        self._limits = self._limits_of(goal.request)
        self._begin, self._due, self._braking = None, 0.0, False
        self._follow(self._points)
        code, text = await self._outcome
        if code == Result.SUCCESSFUL:
            (goal.canceled if goal.is_cancel_requested else goal.succeed)()
        else:
            goal.abort()
        return Result(error_code=code, error_string=text)

    def replaced(self):
        """End the goal that is followed, if there is one: another trajectory takes its place."""
        self._end(Result.INVALID_GOAL, 'another trajectory has replaced it')

    def refused(self, reason):
        """End the goal that could not be begun."""
        self._end(Result.OLD_HEADER_TIMESTAMP, reason)

    def _end(self, code, text=''):
        outcome, self._outcome = self._outcome, None
        if outcome is not None:
            outcome.set_result((code, text))

    def begun(self, time):
        """Note when the trajectory began [s]."""
        self._begin = time

    def on_state(self, time, desired, actual):
        """
        Judge a state, at a time [s], that was answered.

        Desired and actual are positions and velocities, shape (2, number of joints).
        """
        if self._outcome is None or self._begin is None:
            return
        if self._goal.is_cancel_requested:
            self._brake(time, *desired)
            return
        if time >= self._due:
            self._due = time + FEEDBACK_PERIOD
            self._goal.publish_feedback(self._feedback(desired, actual))
        elapsed, error = time - self._begin, actual - desired
        ahead = self._points.times[-1] + (
            self._points.stamp - self._begin if self._points.stamp else 0.0) - elapsed
        if ahead > 0.0:
            if text := self._violation('path', error):
                self._end(Result.PATH_TOLERANCE_VIOLATED, text)
                self._brake(time, *desired)
            return
        text = self._violation('goal', error)
        if not text:
            self._end(Result.SUCCESSFUL)
        elif -ahead > seconds_of(self._goal.request.goal_time_tolerance):
            self._end(Result.GOAL_TOLERANCE_VIOLATED, text)

    def _violation(self, key, error):
        """Return which error is too large, or ''."""
        limits = self._limits[key]
        row, joint = np.unravel_index(np.argmax(np.abs(error) / limits), error.shape)
        if abs(error[row, joint]) <= limits[row, joint]:
            return ''
        what = ('position', 'velocity')[row]
        return (f'{self._joints[joint]}: expected an error of {what} of at most '
                f'{limits[row, joint]:g} {EITHER[what]}, got {error[row, joint]:g}')

    def _brake(self, time, position, velocity):
        """Come to rest, then end the goal."""
        if not self._braking:
            self._braking, self._begin = True, None
            self._follow(Waypoints(
                0.0, np.array([BRAKING_TIME]), [(position + 0.5 * BRAKING_TIME * velocity)[None]]))
            self._points = Waypoints(0.0, np.array([BRAKING_TIME]), [])
        elif self._begin is not None and time - self._begin >= BRAKING_TIME:
            self._end(Result.SUCCESSFUL, 'cancelled')

    def _feedback(self, desired, actual):
        feedback = FollowJointTrajectory.Feedback(joint_names=self._joints)
        feedback.header.stamp = self._clock.now().to_msg()
        for key, values in (('desired', desired), ('actual', actual), ('error', desired - actual)):
            setattr(feedback, key, JointTrajectoryPoint(
                positions=values[0].tolist(), velocities=values[1].tolist()))
        return feedback
