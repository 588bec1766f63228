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

"""What every effect can be asked, and where the joints, bodies and points that it names are."""

from ..mechanism.checks import one_of
from ..mechanism.fields import at, FieldError, normalise


class Machine:
    """A mechanism's names, resolved."""

    def __init__(self, mechanism, rows):
        """Collect the names."""
        self.mechanism, self._rows = mechanism, rows
        self._joints = {joint.name: joint for joint in mechanism.joints}
        self._points = {point.name: point for point in mechanism.points}

    def joint(self, name):
        """Return the place of a joint of one freedom in qd."""
        return self.mechanism.coordinates.index[name]

    def joint_row(self, name):
        """Return the row of the body that a joint carries."""
        return self._rows[self._joints[name].child]

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
            one_of(mechanism.coordinates.of_one_freedom, 'one of the joints')(name)


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


# Field -> refuses a name that the mechanism does not have.
REQUIRE = {'joint': require_joint, 'body': require_body, 'point': require_point,
           'point_a': require_point, 'point_b': require_point}


class Effect:
    """
    An effect with its parameters; a frozen dataclass that checks itself when it is built.

    An effect acts by changing the model's constants, by a row of the table of forces, or on what
    is measured. Each answers what applies to it; here is the answer of all others.

    """

    # Field -> its check, of ``mechanism.checks``; None passes where it is the default.
    CHECKS = {}
    # Names of the columns of the row's output beyond the stored energy, in their order.
    READINGS = ()
    # Whether a change of parameters can make the scene too stiff for its steps.
    STIFFENS = True
    # Whether it acts on mechanisms in space, too.
    IN_SPACE = False
    # Whether steps must end where the effect's joint comes to rest; its first own state is then
    # the direction in which the joint slides (``integration.stick_slip``).
    ENDS_STEPS = False

    def __post_init__(self):
        """Pass the fields through their checks."""
        normalise(self, **{
            key: check for key, check in self.CHECKS.items()
            if getattr(self, key) is not None or getattr(type(self), key, 0) is not None})

    def fit(self, mechanism):
        """
        Refuse a mechanism without the joints, bodies or points that the effect names.

        Raises
        ------
        FieldError

        """
        for key, require in REQUIRE.items():
            if getattr(self, key, None) is not None:
                require(mechanism, key, getattr(self, key))

    def change(self, model, machine):
        """Change the constants of the model."""

    def element(self, machine):
        """
        Return the row of the table.

        Returns
        -------
        table.ForceElement or None
            None where there is no force.

        """

    def drive(self):
        """
        Return the joint whose command passes through the effect, and the command's delay.

        Returns
        -------
        tuple of str and float, or None
            Name; [s]. None where no command does.

        """

    def direction(self, rate):
        """
        Return the direction in which the effect's joint slides, where it ENDS_STEPS.

        Parameters
        ----------
        rate : float
            [rad/s; m/s].

        Returns
        -------
        float
            1 or -1; 0 at rest.

        """
        return 0.0

    def instrument(self):
        """
        Return what measures.

        Returns
        -------
        sensor.Instrument or None
            None where nothing is measured.

        """
