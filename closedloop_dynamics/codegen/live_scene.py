# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The evaluation of a scene as the engine runs it: a mechanism with the laws of its effects.

Laws are traced into the one routine between the motion of the bodies and their accelerations.
Their numbers, states and what was decided about them are loads, so that a change of these compiles
nothing. Readings and powers of the laws come from the routine of each law alone (``law_routine``):
no step needs them. Stored energies are traced for the energies of states in the lanes of a
vector.
"""

import math

import numpy as np

from .expression_graph import arctangent, CALL, chosen, larger, LOAD, QD, smaller, TAKE
from .function_table import (
    AT_REST, COMMAND, CUT_VALUES, ENERGY, ENTRIES, EVALUATION, GAPS, LIMIT, PIECE,
    PRESENT, PRESENT_COLUMNS, RATES, RESPONSE, RESPONSES, SIDES, TRIALS, VALUES)
from .machine_code import machine_code, PACKED
from .routines import MechanismTrace, NAMES, topology, zeros
from .scene_routines import energies_of_bodies, Forces
from .vectors import add, dot, IDENTITY, negate, scale, subtract, ZERO

# Addresses of compiled code, by its dependences.
_addresses = {}
# Added and subtracted, it rounds to a whole number.
_ROUNDER = 6755399441055744.0
# As of ``engine/static_friction.hpp`` [rad/s; m/s].
REST = 1e-6
# Frictions, where there are no more, that a routine balances both; responses of one freedom, as of
# ``engine/static_friction.cpp``.
AT_ONCE, DEPENDENT = 2, 1e-8


def address_of_scene(model, structure, laws, form=PACKED, which=EVALUATION):
    """
    Return the address of a scene's evaluation, or energies, compiled unless it is stored.

    ``structure``: dependences of the code beside the mechanism; ``laws`` returns the laws for
    ``LiveTrace``; ``form`` is that of ``machine_code``; ``which``: ENERGIES for that routine.
    """
    key = topology(model), structure, form, which
    if key not in _addresses:
        find = machine_code(
            key, lambda: [LiveTrace(model, laws()).routine(which)], form)
        _addresses[key] = find(NAMES[which])
    return _addresses[key]


class LiveTrace(MechanismTrace):
    """
    One mechanism with its effects, with symbols in the place of all numbers that may change.

    Parameters
    ----------
    model : Model
        Constant arrays of the mechanism.
    laws : object
        ``effects.scene_code.SceneLaws``: ``act(forces)`` applies the effects, ``motions(trace)``
        returns what prescribed motions have in the places of ``Model.cut_point``, and ``columns``
        gives how many numbers the rows of arrays have, by their places; ``states`` how many states
        the effects have, ``cuts`` the table of the cut joints that anything acts in, ``at_rest``
        which routine it is for: ``EVALUATION`` where all joints under dry friction slide,
        ``AT_REST`` where one may be at rest, or both where there are two, or ``RESPONSES``.

    """

    def __init__(self, model, laws, with_arms=True):
        self.laws, self.first = laws, len(model.tree) - 1
        super().__init__(model, with_arms=with_arms)

    def without_arms(self):
        """Return a trace of the same with all multipliers."""
        return LiveTrace(self.constant, self.laws, with_arms=False)

    def cut_points(self):
        """Return symbols for ``Model.cut_point``; prescribed motions depend on the time."""
        found = super().cut_points()
        for (row, column), values in self.laws.motions(self).items():
            found[row, column:column + len(values)] = values
        return found

    def state(self, place):
        """Return one of the effects' states."""
        return self.graph.put(LOAD, QD, self.first + place)

    def entry(self, place):
        """Return one of the numbers of the effects' entries."""
        return self.graph.put(LOAD, ENTRIES, place)

    def at(self, source, row, column):
        """Return a number of a row of an array of the effects."""
        return self.graph.put(LOAD, source, row * self.laws.columns[source] + column)

    def evaluation(self):
        """Accelerations, multipliers and rates of the effects' states."""
        self.move()
        forces = LiveForces(self)
        self.laws.act(forces)
        torque = self.symbols(COMMAND, (self.nv,)) + forces.torque
        forces.exert()
        qdd, lam = self.accelerate(tau=torque)
        if self.laws.at_rest == AT_REST:
            qdd, lam = self.held(forces.resting, qdd, lam)
        elif self.laws.at_rest == RESPONSES:
            self.store_responses(forces.resting)
        self.store_accelerations(qdd, lam)
        self.store_closures()
        for place, multiplier, (_, rate, _) in forces.driven:
            forces.rates[place] = lam[multiplier] * rate
        self.store(RATES, forces.rates)
        self.outputs += forces.outputs

    def energies(self):
        """Kinetic energy, what gravity and effects store, and all torques in joints by size."""
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        forces = LiveForces(self)
        self.laws.act(forces)
        kinetic, weight = energies_of_bodies(self)
        torques = self.symbols(COMMAND, (self.nv,)) + forces.torque
        for place, value in enumerate((kinetic, weight + forces.stored, sum(map(abs, torques)))):
            self.outputs.append((ENERGY, place, value))

    def held(self, resting, qdd, lam):
        """
        Apply static friction, up to its limit, to joints at rest (``engine/static_friction.hpp``).

        ``resting``: limits of the frictions, all zero but one where there are more than two, and
        the joints that each acts on with its moment arms. Returns accelerations and multipliers,
        given those without it.
        """
        if len(resting) == AT_ONCE:
            return self.held_both(resting, qdd, lam)
        most = self.torques_of(resting)
        more, added = self.response(most)
        joints = {joint for _, arms in resting for joint, _ in arms}
        pull, give = (sum(most[i] * one[i] for i in sorted(joints)) for one in (qdd, more))
        share = least_share(pull, give)
        stays = chosen(abs(share) < 1.0, give, 0.0)
        qdd, lam = qdd + more * share, lam + added * share
        for limit, arms in resting:
            self.stop(arms, stays * limit > 0.0, qdd)
        return qdd, lam

    def held_both(self, resting, qdd, lam):
        """
        Do so for two joints, as ``minimise_in_box`` in ``engine/static_friction.cpp``.

        The shares x of both limits minimise x' G x / 2 + p' x in a square. Where the minimum is
        not inside it is on an edge, with one joint at its limit; where both responses are of one
        freedom, the first joint bears its load, the second what is too much for it.
        """
        responses = [self.response(self.torques_of([one])) for one in resting]

        def along(number, rates):
            limit, arms = resting[number]
            return sum(arm * rates[joint] for joint, arm in arms) * limit

        (first, mixed), (_, second) = (
            [along(number, more) for more, _ in responses] for number in range(AT_ONCE))
        pulls = [along(number, qdd) for number in range(AT_ONCE)]
        after = least_share(pulls[0], first)
        best = after, least_share(pulls[1] + mixed * after, second)
        found = None
        for edge in (-1.0, 1.0):
            for number, (own, other) in enumerate(((first, second), (second, first))):
                share = least_share(pulls[1 - number] + mixed * edge, other)
                cost = 0.5 * own + edge * pulls[number] + share * (
                    0.5 * other * share + pulls[1 - number] + mixed * edge)
                pair = (edge, share) if number == 0 else (share, edge)
                found = (cost, *pair) if found is None else (
                    smaller(cost, found[0]), *(chosen(cost < found[0], new, old)
                                               for new, old in zip(pair, found[1:])))
        whole = chosen(first > 0.0, first, 1.0)
        rest = second - mixed * mixed / whole
        apart = chosen(first > 0.0, rest, 0.0) > DEPENDENT * second
        inner = (mixed * pulls[0] / whole - pulls[1]) / chosen(apart, rest, 1.0)
        outer = -(pulls[0] + mixed * inner) / whole
        beyond = larger(abs(inner), abs(outer)) > 1.0
        shares = [chosen(apart, chosen(beyond, edge, inside), one)
                  for edge, inside, one in zip(found[1:], (outer, inner), best)]
        for share, (more, added) in zip(shares, responses):
            qdd, lam = qdd + more * share, lam + added * share
        for share, give, (_, arms) in zip(shares, (first, second), resting):
            self.stop(arms, chosen(abs(share) < 1.0, give, 0.0) > 0.0, qdd)
        return qdd, lam

    @staticmethod
    def stop(arms, stays, qdd):
        """Have the acceleration of a joint that stays at rest zero; joints of a tendon move."""
        (joint, arm), *others = arms
        if arm == 1.0 and not others:
            qdd[joint] = chosen(stays, 0.0, qdd[joint])

    def torques_of(self, resting):
        """Return the torques of frictions at their limits, in the joints."""
        found = zeros(self.nv)
        for limit, arms in resting:
            for joint, arm in arms:
                found[joint] = found[joint] + limit * arm
        return found

    def store_responses(self, resting):
        """Store the response to each of several frictions, as ``held`` has them, and its limit."""
        for number, one in enumerate(resting):
            found = np.concatenate(self.response(self.torques_of([one])))
            self.store(RESPONSE, found, number * len(found))
            self.outputs.append((LIMIT, number, one[0]))


def least_share(pull, give):
    """Return the share of a limit, 1 at most, that holds a joint against a pull."""
    share = larger(-1.0, smaller(1.0, -pull / chosen(give > 0.0, give, 1.0)))
    return chosen(give > 0.0, share, 0.0)


class LiveForces(Forces):
    """
    Inputs and outputs of laws of force that are traced for the engine.

    ``driven``: of motions the state of their work, the multiplier, and position, rate and
    acceleration; ``resting``: as of
    ``LiveTrace.held``; ``outputs``: as of ``Routine``; ``begin``, ``count``: where the entries of
    the effect whose turn it is begin, and how many they are.
    """

    def __init__(self, trace):
        trace.values = None
        super().__init__(trace)
        self.trace, self.nv = trace, trace.nv
        self.efforts = zeros(len(trace.laws.cuts))
        self.rates = zeros(trace.laws.states)
        self.driven, self.outputs = [], []
        self.resting = []

    def turn_to(self, row, held=None):
        """Have the turn of a row."""
        super().turn_to(row)
        self.begin, self.count = row.begin, row.count

    def arms(self, row):
        return [self.trace.entry(row.begin - row.summed + k) for k in range(row.summed)]

    def numbers(self, row):
        return [self.trace.at(VALUES, row, n) for n in range(self.trace.laws.columns[VALUES])]

    def state(self, number):
        """Return a state of the effect."""
        return self.trace.state(self.first + number)

    @property
    def command(self):
        """Return the commanded torque of the effect's joint."""
        (joint, _), = self.joint.arms
        return self.commanded(joint)

    def commanded(self, joint):
        """Return the commanded torque of a joint."""
        return self.trace.graph.put(LOAD, COMMAND, joint)

    def coordinate(self, joint):
        """Return the coordinate of a joint of one freedom, of cut joints behind."""
        return super().coordinate(joint) if joint < self.nv else self._cut(joint - self.nv).value

    def rate(self, joint):
        return super().rate(joint) if joint < self.nv else self._cut(joint - self.nv).rate

    def twist(self, joint, torque):
        """Apply a torque or force in a joint."""
        if joint < self.nv:
            super().twist(joint, torque)
        else:
            self.efforts[joint - self.nv] = self.efforts[joint - self.nv] + torque

    def touches(self, gap, rate):
        """Store a gap and its rate; return whether the contact acts: by its mode or by the gap."""
        trace = self.trace
        side = trace.at(SIDES, self.row, 0)
        fastest, wrong = (trace.at(TRIALS, self.row, n) for n in (0, 2))
        touching = side > 1.5
        self.record(GAPS, 0, gap, rate)
        self.record(TRIALS, 0, larger(fastest, abs(rate)))
        self.record(TRIALS, 2, larger(wrong, chosen(touching, gap, -gap)))
        return self.on_side(side, gap)

    def pressed(self, depth, rate):
        """Store a depth and its rate; return the depth where the contact acts, zero elsewhere."""
        self.touches(-depth, -rate)
        # By limits that are known before the depth is: a comparison of it would be waited for.
        side = self.trace.at(SIDES, self.row, 0)
        least = chosen(side > 1.5, -math.inf, 0.0)
        most = chosen(side > 0.5, -least, math.inf)
        return larger(smaller(depth, most), least)

    def pass_by(self, place, speed):
        """Store the path of a roller beside a body that it may pass; see ``store_path``."""
        self.record(GAPS, 2, *place)
        self.record(TRIALS, 1, larger(self.trace.at(TRIALS, self.row, 1), speed))

    def record(self, source, column, *values):
        """Store numbers of the effect's row."""
        first = self.row * self.trace.laws.columns[source] + column
        self.outputs += [(source, first + n, value) for n, value in enumerate(values)]

    def entry(self, number):
        """Return a number of the effect's entries."""
        return self.trace.entry(self.begin + number)

    def piece(self, columns, place):
        """Return the numbers of the last of the effect's entries that begins before a place."""
        return self.call_engine(PIECE, columns, float(columns), place, results=columns - 1)

    def keep_entry(self, number, value):
        """Keep a number for readings among the entries; no step does."""

    def present_piece(self):
        """Return when the period and the piece of a profile began, and its coefficients."""
        return [self.trace.at(PRESENT, self.row, n) for n in range(1, PRESENT_COLUMNS)]

    def drive(self, position, rate, change):
        """Have the closure equation of a motion follow the time, and do the multiplier's work."""
        self.flow(1.0, 0.0)
        self.driven.append((self.first + 2, self._turn.equation[1], (position, rate, change)))

    def rub(self, most, limit):
        """Return the force of dry friction, up to most; at rest a limit of zero holds nothing."""
        rate, direction = self.joint.rate, self.state(0)
        slides = abs(direction) > 0.5
        if self.trace.laws.at_rest == EVALUATION:
            # At rest other forces follow from accelerations.
            bool(slides)
            return chosen(direction < 0.0, most, -most)
        # One that breaks away within a step goes on as one that slides.
        breaks_away = abs(rate) > REST
        direction = chosen(slides, direction, rate)
        self.resting.append((
            chosen(slides, 0.0, chosen(breaks_away, 0.0, limit)), self.joint.arms))
        sliding = chosen(direction < 0.0, most, -most)
        return chosen(slides, sliding, chosen(breaks_away, sliding, 0.0))

    def call_engine(self, function, columns, flag, x, y=0.0, results=0):
        """Call a function of the engine on the effect's entries of so many numbers each."""
        graph = self.trace.graph
        found = graph.put(CALL, *map(float, (function, self.row, self.begin)), *(
            one.place if hasattr(one, 'place') else float(one)
            for one in (columns * self.count, flag, x, y)))
        return [found, *(graph.put(TAKE, found.place, float(n)) for n in range(results))]

    def exert(self):
        """Apply the efforts along cut joints, commanded ones too, and update their angles."""
        for k in range(len(self.efforts)):
            self._cut(k).exert(self.efforts[k] + self.commanded(self.nv + k))

    def _cut(self, k):
        return CutFreedom(self, k)


class CutFreedom:
    """
    One coordinate of a cut joint, as of ``engine/cut_coordinates.cpp``, in a row of their table.

    ``forces``: after the outward recursion.
    """

    def __init__(self, forces, k):
        self._forces, self._one, self._number = forces, forces.trace.laws.cuts[k], k

    def _vector(self, first):
        return [self._forces.trace.at(CUT_VALUES, self._number, first + n) for n in range(3)]

    @property
    def _scale(self):
        return self._forces.trace.at(CUT_VALUES, self._number, self._one.columns['SCALE'])

    def _turned(self, body, name):
        vector = self._vector(self._one.columns[name])
        return self._forces.turned(body, vector[:2] if self._one.in_plane else vector)

    @property
    def _axis(self):
        if self._one.in_plane and not self._one.slides:
            return IDENTITY[2]
        return self._turned(self._one.row_b, 'AXIS')

    def _place(self, body, name):
        return add(self._forces.origin(body), self._turned(body, name))

    @property
    def value(self):
        """Return the coordinate [rad, m]."""
        forces, one = self._forces, self._one
        if one.slides:
            apart = subtract(self._place(one.row_a, 'POINT_A'), self._place(one.row_b, 'POINT_B'))
            return self._scale * dot(self._axis, apart)
        if one.in_plane:
            return forces.angle(one.row_a) - forces.angle(one.row_b) - forces.trace.at(
                CUT_VALUES, self._number, one.columns['ZERO'])
        followed = forces.trace.state(one.followed) if one.followed >= 0 else None
        if one.rate_only:
            return 0.0 if followed is None else followed
        side = self._turned(one.row_a, 'SIDE_A')
        found = arctangent(*(dot(side, self._turned(one.row_b, name))
                             for name in ('ACROSS_B', 'SIDE_B')))
        if followed is not None:
            found = found + ((followed - found) / math.tau + _ROUNDER - _ROUNDER) * math.tau
        return found

    @property
    def rate(self):
        forces, one = self._forces, self._one
        a, b = one.row_a, one.row_b
        if not one.slides:
            return self._scale * dot(self._axis, subtract(forces.spin(a), forces.spin(b)))
        place = self._place(a, 'POINT_A')
        rates = [forces.place(body, subtract(place, forces.origin(body)))[1] for body in (a, b)]
        return self._scale * dot(self._axis, subtract(*rates))

    def exert(self, effort):
        """Apply an effort along it."""
        forces, one = self._forces, self._one
        if one.followed >= 0:
            forces.rates[one.followed] = self.rate
        along = scale(self._axis, self._scale * effort)
        place = self._place(one.row_a, 'POINT_A') if one.slides else None
        for body, push in ((one.row_a, along), (one.row_b, negate(along))):
            if one.slides:
                forces.push(body, subtract(place, forces.origin(body)), push)
            else:
                forces.push(body, ZERO, ZERO, push)
