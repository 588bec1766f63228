# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Interface of every effect, and lookup of the joints, bodies and points that it names."""

from ..mechanism.checks import one_of, vector2, vector3
from ..mechanism.fields import among, at, FieldError, normalise

# Whose axes a force is given in.
WORLD, BODY = 'world', 'body'


class NameResolver:
    """
    Indices of what a mechanism's names stand for.

    Parameters
    ----------
    mechanism : Mechanism
    placements : dict of str to simulation.tree_rows.Placement
        Where the bodies' frames are in those of their rows in the kernels' arrays.
    motions : dict of DrivingConstraint to tuple, optional
        By the equation of a prescribed motion, without its name: its row of ``Model.cut``, its
        place among the multipliers, the first of its right-hand sides in ``Model.cut_point``, and
        where the scene starts [rad; m].
    cuts : sequence of str
        Names of the freedoms of cut joints that anything acts along: their places are behind
        those of qd.

    Attributes
    ----------
    determined : frozenset of tuples
        Sums of freedoms, as pairs of names and arms, whose rates loops and prescribed motions
        determine, whatever forces act; of those that dry friction acts along.

    """

    determined = frozenset()

    def __init__(self, mechanism, placements, motions=None, cuts=()):
        self.mechanism, self._placements = mechanism, placements
        self._motions, self.cuts = motions, tuple(cuts)
        self._joints = {joint.name: joint for joint in mechanism.joints}
        self._points = {point.name: point for point in mechanism.points}

    def joint(self, name):
        """
        Return the place of a freedom in qd; of a cut joint's behind them.

        Raises
        ------
        FieldError

        """
        coordinates = self.mechanism.coordinates
        if name in coordinates.index:
            return coordinates.index[name]
        if name not in self.cuts:
            raise FieldError(
                'a joint of the tree, or a cut joint that anything acted in when the scene was '
                'loaded', repr(name), 'load a scene where it does', ('joint',))
        return coordinates.nv + self.cuts.index(name)

    def description(self, name):
        """Return a joint as the mechanism has it."""
        return self._joints[name]

    def motion(self, equation):
        """Return the description above of a prescribed motion."""
        return self._motions[equation]

    def joint_row(self, name):
        """Return the row of the body that a joint carries; 0 for a cut joint."""
        if name in self.cuts:
            return 0
        return self.body(self._joints[self.mechanism.coordinates.joint_of(name)].child)

    def body(self, name):
        """Return the row of a body."""
        return self._placements[name].row

    def placement(self, name):
        """Return where a body's frame is in that of its row."""
        return self._placements[name]

    def point(self, name):
        """Return the row of a point's body, and its place in the row's frame."""
        point = self._points[name]
        placement = self._placements[point.body]
        return placement.row, tuple(placement.place(point.position))

    def carrier(self, name):
        """Return the name of the body that a point belongs to."""
        return self._points[name].body

    def two_points(self, first, second, anchor):
        """Return rows and places, one behind the other, of a point and of another or an anchor."""
        row_a, place_a = self.point(first)
        row_b, place_b = self.point(second) if second else (0, anchor)
        return (row_a, row_b), (*place_a, *place_b)

    def vector(self, values):
        """Return a vector with as many numbers as there are dimensions; no numbers are zeros."""
        return values if self.mechanism.planar or len(values) == 3 else (0.0, 0.0, 0.0)


def require_body(mechanism, key, name):
    """
    Refuse the name of no body.

    Raises
    ------
    FieldError

    """
    with at(key):
        one_of(tuple(body.name for body in mechanism.bodies), 'one of the bodies')(name)


def require_point(mechanism, key, name):
    """Refuse the name of no point; see ``require_body``."""
    with at(key):
        if not mechanism.points:
            raise FieldError('a named point', repr(name),
                             f'{mechanism.name} has none: add `points` to the mechanism')
        one_of(tuple(point.name for point in mechanism.points), 'one of the points')(name)


# Field -> refuses a name that the mechanism does not have.
REQUIRE = {'body': require_body, 'point': require_point,
           'point_a': require_point, 'point_b': require_point}


class Effect:
    """
    An effect with its parameters; a frozen dataclass that checks itself when it is built.

    An effect acts by changing the model's constants, by a row of the table of forces, or on what
    is measured. Each answers what applies to it; here is the answer of all others.
    """

    # Field -> its check, of ``mechanism.checks``; None passes where it is the default.
    CHECKS = {}
    # What the row's output has first.
    ENERGY = 'stored_energy'
    # Names of the columns of the row's output beyond that, in their order.
    READINGS = ()
    # Whether a change of parameters can make the scene too stiff for its steps.
    STIFFENS = True
    # Word for ``joint`` in error messages.
    JOINTS = 'one of the joints'
    # Fields that are vectors: of two numbers in the plane, of three in space.
    VECTORS = ()
    # Whether steps must end where the effect's joint comes to rest, its first own state being the
    # direction in which the joint slides (``engine/stick_slip.hpp``), or where its profile over
    # time has corners (``engine/time_events.hpp``).
    ENDS_STEPS = False
    # Whether the effect exerts the torque that a drive of its joint would be commanded.
    COMMANDS = False
    # Whether a page shows a spring between its points, ``point_a`` and ``point_b`` or ``anchor``.
    DRAWN_AS_SPRING = False
    # Files that a scene may name: key -> the fields that take their columns.
    FILES = {}

    def __post_init__(self):
        """Pass the fields through their checks; an effect with an anchor has that or point_b."""
        normalise(self, **{
            key: check for key, check in self.CHECKS.items()
            if getattr(self, key) is not None or getattr(type(self), key, 0) is not None})
        ends = 'anchor' in self.CHECKS and self.point_a and not getattr(self, 'joint', None)
        if ends and (self.point_b is None) == (self.anchor is None):
            raise FieldError('either point_b or anchor', 'both' if self.anchor else 'neither',
                             path=('point_b',))

    def fit(self, mechanism):
        """
        Refuse a mechanism without the joints, bodies or points that the effect names.

        And one in the plane for vectors in space, or the other way round.

        Raises
        ------
        FieldError

        """
        for key in self.VECTORS:
            # What was not given fits either.
            if getattr(self, key) != getattr(type(self), key, None):
                with at(key):
                    (vector2 if mechanism.planar else vector3)(getattr(self, key))
        if getattr(self, 'joint', None) is not None:
            with at('joint'):
                self._require_joint(mechanism)
        for key, require in REQUIRE.items():
            if getattr(self, key, None) is not None:
                require(mechanism, key, getattr(self, key))

    def _require_joint(self, mechanism):
        """Refuse the name of a joint that the effect cannot act in."""
        cut = mechanism.cut_joint(mechanism.coordinates.joint_of(self.joint))
        if cut is None or cut.type in mechanism.measured_types:
            one_of(self.joints(mechanism), self.JOINTS)(self.joint)
            return
        raise FieldError(
            'a joint of the tree, or a cut joint with coordinates '
            f'({among(mechanism.measured_types)})',
            f'{self.joint!r}, which closes a loop and is {cut.type}',
            'cut another joint of that loop, or write joints `between` bodies and none as '
            'cut: the program then keeps those that effects name')

    def joints(self, mechanism):
        """Return the names that ``joint`` may be: but of spherical and free joints."""
        return mechanism.coordinates.single_names + mechanism.measured_cuts

    def reserve(self, model, machine):
        """Reserve the constants of the model that ``change`` may change, on or off."""

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

    @property
    def depends_on_reactions(self):
        """Whether its force depends on the reaction in its joint."""
        return False

    def drive(self):
        """
        Return the joint whose command passes through the effect, and the command's delay.

        Returns
        -------
        tuple of str and float, or None
            Name; [s]. None where no command does.

        """

    def motion(self, key):
        """
        Return the closure equation of an effect that prescribes a motion.

        Parameters
        ----------
        key : str
            The effect's, after which the equation is named.

        Returns
        -------
        mechanism.DrivingConstraint or None
            None where nothing is prescribed.

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

    def clock(self, time):
        """
        Return the first own states of an effect that follows the time.

        Parameters
        ----------
        time : float
            Of the simulation [s].

        Returns
        -------
        tuple of floats, or None
            The time, and, where it has a profile, which segment of that is the present one
            (``engine/time_events.hpp``); None where the effect knows no time.

        """

    def winding_places(self, columns):
        """
        Return which cables are declared to be wound round pulleys.

        Parameters
        ----------
        columns : int
            Numbers of an entry of the effect's data.

        Returns
        -------
        dict of str to int
            By point: the place in these data of a length on the pulley [m], the radius before it.

        """
        return {}

    def start_notes(self, name, readings, weight):
        """
        Return notes of a start that may be unintended.

        Parameters
        ----------
        name : str
            Of the effect.
        readings : callable
            Returns the effect's readings at the start, by name.
        weight : float
            Of all bodies on earth [N].

        Returns
        -------
        list of str
            Sentences.

        """
        return []

    def instrument(self, sequence=()):
        """
        Return the instrument that measures.

        Parameters
        ----------
        sequence : tuple of int
            Numbers that distinguish noises of one seed.

        Returns
        -------
        sensor.Instrument or None
            None where nothing is measured.

        """
