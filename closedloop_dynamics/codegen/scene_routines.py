# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Routines of a mechanism with its effects, for programs without effects of their own.

Laws of force are traced into the evaluation: beside gravity and torques it knows springs, dampers
and constant forces. Their numbers are inputs, like masses and lengths.
"""

from . import forward_dynamics
from .expression_graph import chosen, LOAD, Routine
from .function_table import behind, CLOSURE, CORRECTIONS, ENERGY, SHARED, SIDES, TAU, VALUES
from .routines import MechanismTrace, zeros
from .spatial import rigid
from .vectors import add, cross, dot, in_space, is_zero, scale, subtract, times, ZERO
from ..engine.types import BALL, COORDINATE, DOF, PARENT, TYPE

# Inputs and outputs beside those of a function table: numbers of points; places, their rates, and
# their accelerations where the joint rates stay as they are; power that effects dissipate, and
# that they bring in.
POINT, PLACE, PLACE_RATE, POWER, PLACE_BIAS = behind(SHARED, 5)


class SceneTrace(MechanismTrace):
    """
    One mechanism with its effects, with symbols in the place of all numbers that may change.

    ``act`` takes a ``Forces`` and applies the effects; ``values``: shape of the array of their
    numbers; ``with_arms``, ``by``: as of ``MechanismTrace``. ``decided``: whether contacts are on
    the sides that the engine has decided on, not on those of their gaps.
    """

    def __init__(self, model, act, values, with_arms=False, by=forward_dynamics):
        super().__init__(model, with_arms=with_arms, by=by)
        self.values, self.decided, self.decays = self.symbols(VALUES, values), False, False
        self._act = act

    def without_arms(self):
        """Return a trace of the same with all multipliers."""
        return SceneTrace(self.constant, self._act, self.values.shape, by=None)

    def moved(self):
        """Run the outward recursion and apply the effects; return their forces."""
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        return self.acted()

    def acted(self):
        """Apply the effects; return their forces."""
        forces = self.forces_type(self)
        self._act(forces)
        return forces

    @property
    def forces_type(self):
        """Return what laws act by: ``Forces``, or a class of it."""
        return Forces

    def evaluation(self):
        """Accelerations and multipliers."""
        self.move()
        found = self.accelerate(tau=self.symbols(TAU, (self.nv,)) + self.acted().torque)
        # What the engine counts is left out.
        self.outputs.clear()
        self.store_accelerations(*found)

    def correction(self):
        """Least changes of coordinates and of rates that close the loops."""
        super().correction()
        self.outputs = [one for one in self.outputs if one[0] in (CORRECTIONS, CLOSURE)]

    def energies(self):
        """Kinetic energy, that of gravity, and that stored in effects [J]."""
        forces = self.moved()
        for place, energy in enumerate((*energies_of_bodies(self), forces.stored)):
            self.outputs.append((ENERGY, place, energy))

    def places(self, rows):
        """Places of points of bodies, their velocities, and their accelerations where qdd = 0."""
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        size = len(self.model.gravity)
        points = self.symbols(POINT, (len(rows), size))
        for n, (row, point) in enumerate(zip(rows, points)):
            motion = self.recursion.motion[row]
            offset = times(motion.frame, in_space(point))
            place = add(motion.origin, offset)
            rate = add(motion.velocity, cross(motion.spin, offset))
            # Accelerations of bodies begin at that of free fall, upwards.
            bias = add(add(motion.acceleration, motion.convective_acceleration(offset)),
                       in_space(self.model.gravity))
            for output, values in (PLACE, place), (PLACE_RATE, rate), (PLACE_BIAS, bias):
                self.outputs += [(output, n * size + k, values[k]) for k in range(size)]

    def named(self, name):
        return Routine(name, self.graph, self.outputs)


def energies_of_bodies(trace):
    """
    Return the kinetic energy of all bodies, and their potential energy in gravity [J].

    Parameters
    ----------
    trace : routines.MechanismTrace
        After the outward recursion.

    """
    one, kinetic, weight = trace.recursion, 0.0, 0.0
    for i, row in list(enumerate(trace.constant.tree))[1:]:
        body, motion, rate = one.bodies[i], one.motion[i], trace.qd[row[DOF]]
        inertia, _ = rigid(body, motion)
        rates = motion.spin + motion.velocity
        kinetic = kinetic + dot(rates, times(inertia, rates))
        if body.armature is not None:
            kinetic = kinetic + body.armature * rate * rate
        if not is_zero(body.rotor):
            kinetic = kinetic + 2.0 * rate * dot(one.rotor[i], one.motion[row[PARENT]].spin)
        moment = add(scale(motion.origin, body.mass), times(motion.frame, body.moment))
        weight = weight - dot(trace.model.gravity, moment)
    return 0.5 * kinetic, weight


class Freedom:
    """What an effect in a joint acts along: its coordinate, or a sum r_1 q_1 + r_2 q_2 ..."""

    def __init__(self, forces, *arms):
        """Have the joints and arms, pairs, of a ``Forces``."""
        self._forces, self.arms = forces, arms

    @property
    def value(self):
        """Return the coordinate [rad, m]."""
        return sum(arm * self._forces.coordinate(joint) for joint, arm in self.arms)

    @property
    def rate(self):
        return sum(arm * self._forces.rate(joint) for joint, arm in self.arms)

    def push(self, force):
        """Apply a force along it [N m; N]."""
        for joint, arm in self.arms:
            self._forces.twist(joint, arm * force)


class Forces:
    """
    Inputs and outputs of laws of force while they are traced, after the outward recursion.

    Of the effect whose turn it is (``turn_to``): ``row`` in the table and place of its ``first``
    state; ``joints``, each a Freedom, one for all where the law acts along a sum; rows of
    ``bodies``; ``values``: its parameters; ``terms`` that its law has, None: all that it may have;
    ``held``: its force, where the time is held, or the time. ``size``: numbers of a place in a
    body. ``torque``, shape (nv,): of effects in the joints; ``stored``: energy; ``rates``: of the
    effects' states, such as losses, by their places.
    """

    def __init__(self, unrolling):
        self._unrolling, self._values = unrolling, unrolling.values
        self._joints = {row[DOF]: row for row in unrolling.constant.tree[1:]}
        self.torque, self.stored = zeros(unrolling.nv), 0.0
        self.rates = {}

    @property
    def _one(self):
        return self._unrolling.recursion

    @property
    def size(self):
        return len(self._unrolling.model.gravity)

    def turn_to(self, row, held=None):
        """Have the turn of a ``effects.element.Row``."""
        self._turn, self.row, self.first, self.held = row, row.number, row.state, held
        self.values, self.terms = self.numbers(row.number), row.law.terms(row)
        self.bodies = row.bodies
        arms = self.arms(row) if row.summed else len(row.joints) * (1.0,)
        pairs = tuple(zip(row.joints, arms))
        self.joints = [self.freedom(*pairs)] if row.summed else [
            self.freedom(pair) for pair in pairs]

    def freedom(self, *arms):
        return Freedom(self, *arms)

    @property
    def joint(self):
        """Return the only freedom of an effect in a joint, or along a sum."""
        only, = self.joints
        return only

    def arms(self, row):
        """Return the arms of a sum."""
        return row.arms.tolist()

    def numbers(self, row):
        """Return the numbers of a row of the table of effects."""
        return self._values[row]

    def entry(self, number):
        """Return a number of the effect's entries, here a constant."""
        return float(self._turn.data[number])

    def entries(self, first, count):
        """Return several of them."""
        return [self.entry(number) for number in range(first, first + count)]

    def piece(self, columns, place):
        """Return the numbers of the last of the effect's entries that begins before a place."""
        pieces = self._turn.data.reshape(-1, columns).tolist()
        found = pieces[0]
        for piece in pieces[1:]:
            begun = place >= piece[0]
            found = [chosen(begun, one, before) if one != before else before
                     for one, before in zip(piece, found)]
        return found

    def coordinate(self, joint):
        """Return the coordinate of a joint of one degree of freedom."""
        assert self._joints[joint][TYPE] != BALL
        return self._unrolling.q[self._joints[joint][COORDINATE]]

    def rate(self, joint):
        return self._unrolling.qd[joint]

    def twist(self, joint, torque):
        """Apply a torque or force in a joint."""
        self.torque[joint] = self.torque[joint] + torque

    def turned(self, body, vector):
        """Return a vector of two or three numbers in a body's frame in world axes."""
        return times(self._one.motion[body].frame, in_space(vector))

    def angle(self, body):
        """Return the angle of a body, in the plane."""
        return self._one.motion[body].angle

    def origin(self, body):
        """Return the place of a body's origin."""
        return self._one.motion[body].origin

    def spin(self, body):
        """Return the angular velocity of a body in world axes."""
        return self._one.motion[body].spin

    def place(self, body, offset):
        """Return the place of a point at an offset in world axes, and its velocity."""
        motion = self._one.motion[body]
        return add(motion.origin, offset), add(motion.velocity, cross(motion.spin, offset))

    def push(self, body, offset, force, moment=ZERO):
        """Apply a force at an offset in world axes, and a moment; the ground takes any."""
        if body > 0:
            self._one.force[body] = subtract(
                self._one.force[body], add(moment, cross(offset, force)) + tuple(force))

    def store(self, energy):
        self.stored = self.stored + energy

    def flow(self, *rates, first=0):
        """Store the rates of the effect's states, from one on."""
        for place, rate in enumerate(rates, start=self.first + first):
            self.rates[place] = rate

    def read(self, *values, first=1):
        """Take the readings of the effect, which nothing asks for here."""

    def touches(self, gap, rate):
        """Return whether a contact of a given gap, and its rate, acts."""
        if not self._unrolling.decided:
            return gap < 0.0
        return self.on_side(self._unrolling.graph.put(LOAD, SIDES, self.row), gap)

    @staticmethod
    def on_side(side, gap):
        """Return whether a contact acts, as decided or, where nothing is, by the gap."""
        return chosen(side > 0.5, side > 1.5, gap < 0.0)
