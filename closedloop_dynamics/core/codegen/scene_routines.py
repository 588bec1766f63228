# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Routines of a mechanism with its effects, for programs without effects of their own.

Laws of force are traced into the evaluation: beside gravity and torques it knows springs, dampers
and constant forces. Their numbers are inputs, like masses and lengths.
"""

from . import forward_dynamics
from .expression_graph import chosen, LOAD, Routine
from .function_table import CLOSURE, CORRECTIONS, ENERGY, LAM, QDD, SIDES, TAU, VALUES
from .routines import MechanismTrace, zeros
from .spatial import rigid
from .vectors import add, cross, dot, in_space, is_zero, scale, subtract, times, ZERO
from ..types import BALL, COORDINATE, DOF, PARENT, TYPE

# Inputs and outputs beside those of a function table: numbers of points; places and their rates.
POINT, PLACE, PLACE_RATE = 47, 55, 56


class SceneTrace(MechanismTrace):
    """
    One mechanism with its effects, with symbols in the place of all numbers that may change.

    ``act`` takes a ``Forces`` and applies the effects; ``values``: shape of the array of their
    numbers. ``decided``: whether contacts are on the sides that the engine has decided on, not on
    those of their gaps.
    """

    def __init__(self, model, act, values):
        super().__init__(model)
        self.values, self.decided = self.symbols(VALUES, values), False
        self._act = act

    def moved(self):
        """Run the outward recursion and apply the effects; return their forces."""
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        forces = Forces(self)
        self._act(forces)
        return forces

    def evaluation(self):
        """Accelerations and multipliers."""
        forces = self.moved()
        qdd, lam = zeros(self.nv), zeros(self.nc)
        tau = self.symbols(TAU, (self.nv,)) + forces.torque
        bool(forward_dynamics.accelerate(
            self.recursion, self.model, self.work, tau, 0.0, qdd, lam))
        self.store(QDD, qdd)
        self.store(LAM, lam)

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
        """Places of points of bodies, and their velocities."""
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        size = len(self.model.gravity)
        points = self.symbols(POINT, (len(rows), size))
        for n, (row, point) in enumerate(zip(rows, points)):
            motion = self.recursion.motion[row]
            offset = times(motion.frame, in_space(point))
            place = add(motion.origin, offset)
            rate = add(motion.velocity, cross(motion.spin, offset))
            self.outputs += [(PLACE, n * size + k, place[k]) for k in range(size)]
            self.outputs += [(PLACE_RATE, n * size + k, rate[k]) for k in range(size)]

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


class Forces:
    """
    Inputs and outputs of laws of force while they are traced, after the outward recursion.

    ``torque``, shape (nv,): of effects in the joints; ``stored``: energy; ``row``, ``first``: of
    the effect whose turn it is, in the table, and the place of its first state; ``rates``: of the
    effects' states, such as losses, by their places.
    """

    def __init__(self, unrolling):
        self._one, self._values = unrolling.recursion, unrolling.values
        self._q, self._qd, tree = unrolling.q, unrolling.qd, unrolling.constant.tree
        self._row = {row[DOF]: row for row in tree[1:]}
        self.torque, self.stored = zeros(unrolling.nv), 0.0
        self.row = self.first = 0
        self.rates, self._unrolling = {}, unrolling

    def numbers(self, row):
        """Return the numbers of a row of the table of effects."""
        return self._values[row]

    def coordinate(self, joint):
        """Return the coordinate of a joint of one degree of freedom."""
        assert self._row[joint][TYPE] != BALL
        return self._q[self._row[joint][COORDINATE]]

    def rate(self, joint):
        return self._qd[joint]

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

    def read(self, *values):
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
