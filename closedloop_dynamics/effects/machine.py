# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""Where the joints, bodies and points that effects name are in the kernels' arrays."""

from ..mechanism.checks import one_of
from ..mechanism.fields import at, FieldError


class Machine:
    """A mechanism's names, resolved."""

    def __init__(self, mechanism, rows):
        """Collect the names."""
        self.mechanism, self._rows = mechanism, rows
        self._joints = {joint.name: k for k, joint in enumerate(mechanism.joints)}
        self._points = {point.name: point for point in mechanism.points}

    def joint(self, name):
        """Return the place of a joint in q."""
        return self._joints[name]

    def joint_row(self, name):
        """Return the row of the body that a joint carries."""
        return self._rows[self.mechanism.joints[self._joints[name]].child]

    def body(self, name):
        """Return the row of a body."""
        return self._rows[name]

    def point(self, name):
        """Return the row of a point's body, and its place in that body's frame."""
        point = self._points[name]
        return self._rows[point.body], point.position


def require_joint(mechanism, key, name, actuated=False):
    """
    Refuse the name of no joint, or of one that is not driven where it should be.

    Raises
    ------
    FieldError

    """
    with at(key):
        if actuated:
            one_of(mechanism.actuated_joints, 'one of the actuated joints')(name)
        else:
            one_of(mechanism.joint_names, 'one of the joints')(name)


def require_body(mechanism, key, name):
    """Refuse the name of no body; see ``require_joint``."""
    with at(key):
        one_of(tuple(body.name for body in mechanism.bodies), 'one of the bodies')(name)


def require_point(mechanism, key, name):
    """Refuse the name of no point; see ``require_joint``."""
    with at(key):
        if not mechanism.points:
            raise FieldError('a named point', repr(name),
                             f'{mechanism.name} has none: add `points` to the mechanism')
        one_of(tuple(point.name for point in mechanism.points), 'one of the points')(name)


def joint_type(mechanism, name):
    """Return the type of a joint, by its name."""
    return next(joint.type for joint in mechanism.joints if joint.name == name)
