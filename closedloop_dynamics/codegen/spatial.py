# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The recursions of one evaluation in space, on symbols.

One engine serves the plane and space. Each body has six coordinates of motion, in world axes at
its own origin. Components that a description fixes at 0 or 1 (an axis, a position out of the
plane) are numbers here, all others symbols; what these numbers decide vanishes before
anything is compiled. Of a planar mechanism the planar recursions are left.

A row of the tree is a body with a joint of one degree of freedom. The methods of ``Recursion``
are the recursions of ``forward_dynamics``; for mechanisms too large to be unrolled the engine
loops over kernels of single bodies instead (``joint_kernels``, ``engine/recursion.cpp``,
``loop_closure.cpp``).
"""

from typing import NamedTuple

from .expression_graph import chosen, cosine, sine
from .vectors import (
    add, cross, dot, IDENTITY, is_number, is_zero, negate, product, scale, skew, subtract,
    symmetric, times, transpose, ZERO)
from ..engine.types import (
    BODY_A, BODY_B, COORDINATE, DINV, DOF, DZ, LEVERS, NO_RESPONSES, PARENT, PATH_A, PATH_B,
    PATH_COMMON, PATH_END, REDUCED, RHS, ROW, ROWS)

X, Y, Z = range(3)


class Body(NamedTuple):
    """Constants of one row of the tree; numbers or symbols."""

    #: ``turns``, ``slides``: How far the body turns about its axis, and slides along it, for a
    #: unit of its coordinate.
    turns: float
    slides: float
    #: X, Y or Z: the column of the body's frame. What turns does so about Z, but for a ball.
    axis: int
    #: Whether this is one of the three rows of a spherical joint. They turn about the world's
    #: axes; the last one, of axis Z, has the orientation, a quaternion (x, y, z, w) in q, and the
    #: angular velocity relative to the parent in its own axes in qd.
    ball: bool
    place: tuple  # The joint in the parent's frame [m] (tuple of 3)
    #: The joint's frame in the parent's frame; None where it shares the Z axis (tuple of 3 tuples
    #: or None).
    turned: tuple
    angle: object  # Of the joint's frame about Z [rad] (number)
    mass: object  # [kg] (number)
    moment: tuple  # First moments in the body's frame [kg m] (tuple of 3)
    inertia: tuple  # About the body's origin, in the body's frame [kg m^2] (tuple of 3 tuples)
    armature: object  # Inertia of rotors as seen at the joint (number or None)
    #: Angular momentum of rotors that stand on the parent, for a unit of the joint's rate, in the
    #: parent's frame (tuple of 3).
    rotor: tuple = ZERO


class Cut(NamedTuple):
    """Constants of a cut joint; numbers or symbols."""

    #: Axes of its frame on body B along which nothing moves; the world's where they are three and
    #: not ``carried`` (tuple of int).
    along: tuple
    #: Axes of its frames on body A and on body B that stay perpendicular (tuple of pairs of int).
    perpendicular: tuple
    #: ``point_a``, ``point_b``: The joint in the frames of both bodies [m] (tuple of 3).
    point_a: tuple
    point_b: tuple
    #: ``turned_a``, ``turned_b``: Its frames in those of the bodies; None where they are the
    #: bodies' own (tuple of 3 tuples or None).
    turned_a: tuple
    turned_b: tuple
    angle: object  # Of the frame on body B, about its Z axis [rad] (number)
    #: The equations that do not hold anyway, in the order of ``along`` and ``perpendicular``, but
    #: for those that are left out (tuple of int).
    kept: tuple
    length: object = None  # Distance of the two points, where that is held [m] (number or None)
    #: How far body A slides along Z of body B for an angle about it, where that is held [m/rad]
    #: (number or None).
    lead: object = None
    #: Of a coupling of joints, which holds nothing else: the sum that is held, and pairs of a row
    #: of the tree and the factor of its coordinate in that sum (tuple or None).
    coupling: tuple = None
    #: A function of another joint's coordinate that is added to that sum: the row of that joint,
    #: and what ``coupling_law.law_of`` returns for it (tuple or None).
    law: tuple = None
    #: Of a prescribed motion, which holds nothing else: what its position, rate and acceleration
    #: are to be (tuple of 3 or None).
    motion: tuple = None
    #: Whether what is coupled to joints, or else moved as prescribed, is the place along an axis
    #: or the angle of body A in body B.
    between: bool = False
    #: Whether the angle about Z of frames that are turned is held, in the place of anything else.
    turns: bool = False
    #: Whether it is as ``space.is_carried`` says.
    carried: bool = False
    #: Rows of spherical joints that turn its places least (tuple of int).
    rolling: tuple = ()

    def left(self, equations):
        """Return which of all equations the elimination works on."""
        return [equations[n] for n in self.kept]

    def equations(self, first, second):
        """Return all equations, of the motion of both bodies."""
        if self.turns:
            return [_turn(self, first, second)]
        at_a = times(first.frame, self.point_a)
        at_b = times(second.frame, self.point_b)
        found = [*_translations(self, first, second, at_a, at_b),
                 *_rotations(self, first, second)]
        if self.length is not None:
            found.append(_distance(self, first, second, at_a, at_b))
        if self.lead is not None:
            found.append(_screw(self, first, second, at_a, at_b))
        return found if self.motion is None else [self.moved(one) for one in found]

    def moved(self, equation):
        """Return an equation whose two sides differ by the prescribed motion."""
        value, rate, acceleration = self.motion
        return equation._replace(value=equation.value - value, rate=equation.rate - rate,
                                 bias=equation.bias - acceleration)


class BodyKinematics(NamedTuple):
    """Pose, velocity and acceleration of a body, in world axes."""

    #: The frame that the angles of bodies in a row with parallel axes are counted from (tuple of 3
    #: tuples).
    base: tuple
    carrier: int  # The body that this frame is fixed in
    #: Whether any of these bodies turns, this one included; true of the ground's frame.
    joined: bool
    angle: object  # From there [rad] (number)
    frame: tuple  # The body's axes are its columns (tuple of 3 tuples)
    #: ``origin``, ``offset``: The body's origin, from the world's and from its parent's [m] (tuple
    #: of 3).
    origin: tuple
    offset: tuple
    #: ``spin``, ``velocity``: Angular velocity, velocity of the origin (tuple of 3).
    spin: tuple
    velocity: tuple
    #: ``spin_rate``, ``acceleration``: Their rates for qdd = 0, from q, qd and gravity (tuple of
    #: 3).
    spin_rate: tuple
    acceleration: tuple
    axis: tuple  # The motion for a unit rate of the body's own joint (tuple of 6)

    def convective_acceleration(self, vector):
        """Return the acceleration of a point at a place fixed in the body, from its origin."""
        return times(self.gradient(), vector)

    def gradient(self):
        """Return the matrix of that: vector products with the spin's rate, twice the spin."""
        (x, y, z), (xx, yy, zz) = self.spin, (s * s for s in self.spin)
        xy, xz, yz = x * y, x * z, y * z
        ax, ay, az = self.spin_rate
        return ((0.0 - (yy + zz), xy - az, xz + ay),
                (xy + az, 0.0 - (xx + zz), yz - ax),
                (xz - ay, yz + ax, 0.0 - (xx + yy)))


class Closure(NamedTuple):
    """One equation of a cut joint."""

    #: ``value``, ``rate``, ``bias``: psi, J qd and Jdot qd (number).
    value: object
    rate: object
    bias: object
    #: ``on_a``, ``on_b``: Moment and force of a unit multiplier on both bodies, at their origins
    #: (tuple of 6).
    on_a: tuple
    on_b: tuple
    #: Rows of the tree and the forces of a unit multiplier in their joints (tuple of pairs).
    in_joints: tuple = ()


class Recursion:
    """
    The passes of one evaluation.

    Parameters
    ----------
    bodies : sequence of Body
        One for each row of the tree; the first is the ground and is ignored.
    cuts : sequence of Cut
        In the model's order.
    gravity : tuple of 3
        [m/s^2].
    hinges : sequence of tuples of 3 int
        Rows of three joints through one place, without mass in between, outwards. They are
        eliminated as a spherical joint is, which turns about the world's axes; ``inward`` and
        ``outward_acceleration`` take torques and give accelerations of the three.

    Attributes
    ----------
    motion : list of BodyKinematics
        After ``outward``.
    inertia : list of 6 by 6 tuples
        Of the rigid bodies after ``outward``, articulated after ``inward``.
    force : list of tuples of 6
        Forces for the accelerations of ``motion``; with those of all bodies further out after
        ``inward``.
    apart : bool
        Whether ``force`` is that of effects alone, without the forces of ``motion``.
    rotor : list of tuples of 3
        Angular momentum of rotors on the parents for unit rates of the bodies' joints, in world
        axes.

    """

    def __init__(self, bodies, cuts, gravity, hinges=()):
        self.bodies, self.cuts, self.hinges, self.apart = bodies, cuts, hinges, False
        self.ground = BodyKinematics(
            IDENTITY, 0, True, 0.0, IDENTITY, ZERO, ZERO, ZERO, ZERO, ZERO, negate(gravity),
            2 * ZERO)
        self.motion, self.inertia, self.force = [], [], []
        self.rotor = len(bodies) * [ZERO]
        self.factors, self.acceleration = {}, {}
        self._coordinates, self._across = {}, {}

    @property
    def in_one_frame(self):
        """Return whether all angles are counted from the ground's frame, in space, too."""
        return all(body.turned is None and not body.ball for body in self.bodies[1:])

    def load_coordinates(self, model, q, qd):
        """Store the coordinates and rates that couplings read."""
        for i in range(1, len(self.bodies)):
            self._coordinates[i] = q[model.tree[i, COORDINATE]], qd[model.tree[i, DOF]]

    def coordinate(self, i):
        """Return coordinate and rate of a row of the tree."""
        return self._coordinates[i]

    def outward(self, model, q, qd, work, written=None):
        """Outward kinematics, traced; ``written`` has another motion for a row and its own."""
        self.motion, self.inertia, self.force = [self.ground], [None], [None]
        self.load_coordinates(model, q, qd)
        for i in range(1, len(self.bodies)):
            p, first, dof = (model.tree[i, column] for column in (PARENT, COORDINATE, DOF))
            motion = (self.spherical_kinematics(i, p, q[first:first + 4], qd[dof - 2:dof + 1])
                      if self.bodies[i].ball else self.joint_kinematics(i, p, q[first], qd[dof]))
            if written is not None:
                motion = written(i, motion)
            inertia, force = rigid(self.bodies[i], motion)
            self.motion.append(motion)
            self.inertia.append(inertia)
            self.force.append(2 * ZERO if self.apart else force)
            rotor = times(self.motion[p].frame, self.bodies[i].rotor)
            self.rotor[i] = rotor
            if not is_zero(rotor):
                # What turns the rotors with their carrier.
                turning = scale(cross(self.motion[p].spin, rotor), qd[dof])
                self.force[p] = add(self.force[p], turning + ZERO)
        self._join()

    def _join(self):
        """Replace the axes of three hinges through one place by the world's."""
        self._across = {}
        for rows in self.hinges:
            one, two, three = (self.motion[i].axis[:3] for i in rows)
            across = cross(two, three), cross(three, one), cross(one, two)
            # Rows of the inverse of the matrix whose columns are the axes.
            self._across[rows] = [scale(row, 1.0 / dot(one, across[0])) for row in across], (
                one, two, three)
            for i, axis in zip(rows, IDENTITY):
                self.motion[i] = self.motion[i]._replace(axis=axis + ZERO)

    def joint_kinematics(self, i, p, coordinate, rate):
        """Return the motion of a body on its parent."""
        body, parent = self.bodies[i], self.motion[p]
        base, carrier, joined, angle = parent.base, parent.carrier, parent.joined, parent.angle
        if body.turned is not None:
            base, carrier, joined, angle = product(parent.frame, body.turned), p, False, 0.0
        own = body.angle
        if body.turns:
            own = own + coordinate
        # Not one after the other: the bodies beyond wait for this.
        angle = angle + own
        frame = turned_frame(base, angle)
        direction = transpose(frame)[body.axis]
        turn, slide = scale(direction, body.turns), scale(direction, body.slides)
        offset = add(times(parent.frame, body.place), scale(slide, coordinate))
        sliding, spinning = scale(slide, rate), scale(turn, rate)
        return BodyKinematics(
            base, carrier, joined or bool(body.turns), angle, frame,
            add(parent.origin, offset), offset,
            add(parent.spin, spinning),
            add(add(parent.velocity, sliding), cross(parent.spin, offset)),
            add(parent.spin_rate, cross(parent.spin, spinning)),
            # Coriolis acceleration of sliding along a turning axis.
            add(add(parent.acceleration, scale(cross(parent.spin, sliding), 2.0)),
                parent.convective_acceleration(offset)),
            turn + slide)

    def spherical_kinematics(self, i, p, quaternion, rates):
        """Return the motion of a row of a spherical joint on the row before it."""
        body, parent = self.bodies[i], self.motion[p]
        axis = IDENTITY[body.axis] + ZERO
        offset = times(parent.frame, body.place)
        base = parent.frame if body.turned is None else product(parent.frame, body.turned)
        motion = parent._replace(
            base=base, carrier=i, joined=False, angle=0.0, frame=base,
            origin=add(parent.origin, offset),
            offset=offset, velocity=add(parent.velocity, cross(parent.spin, offset)),
            acceleration=add(parent.acceleration, parent.convective_acceleration(offset)),
            axis=axis)
        if body.axis != Z:
            return motion
        # The quaternion may have any length: between steps integrators leave the unit sphere.
        frame = product(base, rotation(quaternion, 2.0 / dot(quaternion, quaternion)))
        spinning = times(frame, rates)
        return motion._replace(
            base=frame, frame=frame, spin=add(parent.spin, spinning),
            spin_rate=add(parent.spin_rate, cross(parent.spin, spinning)))

    def inward(self, model, tau, work, massless=False, before=None):
        """As the engine's function; ``before`` is called with each row, and with 0."""
        self.inertia, self.force = list(self.inertia), list(self.force)
        tau = self.about_world(model, self._between(model, tau))
        for i in range(len(self.bodies) - 1, -1, -1):
            if before is not None:
                before(i)
            if i > 0:
                work.body[i, DINV], work.body[i, RHS] = self.eliminate(
                    i, model.tree[i, PARENT], tau[model.tree[i, DOF]], massless)

    def eliminate(self, i, parent, torque, massless=False):
        """
        Eliminate a joint from its body; pass articulated inertia and force to the parent.

        The ground takes nothing; ``torque`` is that in the joint [N m, N]; ``massless``: whether
        joints may carry no inertia. Returns one over the joint's pivot D, and D times its own
        share of I^-1 phi.
        """
        inertia, force, axis = self.inertia[i], self.force[i], self.motion[i].axis
        alone, armature = self.alone(i), self.bodies[i].armature
        share = times(inertia, axis)
        pivot = dot(axis, share)
        if armature is not None:
            pivot = pivot + armature
        inverse = _inverse(pivot, massless)
        right = torque - dot(axis, force)
        if not is_zero(self.rotor[i]):
            share = add(share, self.rotor[i] + ZERO)
            right = right - dot(self.rotor[i], self.motion[parent].spin_rate)
        self.factors[i] = share, alone
        if parent > 0:
            scaled = scale(share, inverse)
            # An axis of the world's takes its whole row and column: the remainder is exactly zero.
            left = symmetric(
                lambda m, n: (0.0 if alone in (m, n) else inertia[m][n] - share[m] * scaled[n]),
                size=6)
            self.inertia[parent] = tuple(
                map(add, self.inertia[parent], shifted(left, self.motion[i].offset)))
            self.hand_over(i, parent, torque, scaled, right)
        return inverse, right

    def hand_over(self, i, parent, torque, scaled, right):
        """
        Add the articulated force of a body to its parent's, which is not the ground.

        ``torque``: in the joint [N m, N]; ``scaled``: U / D of the joint; ``right`` as
        ``eliminate`` returns it.
        """
        force, alone = self.force[i], self.alone(i)
        force = tuple(torque if alone == n else force[n] + scaled[n] * right for n in range(6))
        self.force[parent] = add(self.force[parent], at_parent(force, self.motion[i].offset))

    def alone(self, i):
        """Return the index of the world axis along which the joint axis lies, or None."""
        if self.bodies[i].armature is not None or not is_zero(self.rotor[i]):
            return None
        return aligned(self.motion[i].axis)

    def propagate_acceleration(self, i, before, qdd):
        """Return the acceleration of a body from that at its parent's origin and its joint's."""
        motion = self.motion[i]
        before = before[:3] + add(before[3:], cross(before[:3], motion.offset))
        return add(before, scale(motion.axis, qdd))

    def outward_acceleration(self, model, work, qdd, after=None):
        """As the engine's function of this name; ``after`` is called with each row, and with 0."""
        self.acceleration = {0: 2 * ZERO}
        if after is not None:
            after(0)
        for i in range(1, len(self.bodies)):
            dof = model.tree[i, DOF]
            qdd[dof] = work.body[i, DZ] = self.accelerate(
                i, model.tree[i, PARENT], work.body[i, DINV], work.body[i, RHS])
            if self._counts_angles(i):
                motion = self.motion[i]
                since, turn = self.acceleration[motion.carrier], motion.axis[:3]
                work.body[i, DZ] = dot(turn, self.acceleration[i][:3]) - dot(turn, since[:3])
            if after is not None:
                after(i)
        self.about_own(model, qdd)

    def accelerate(self, i, parent, inverse, right):
        """
        Complete the acceleration of a body; return that of its joint.

        ``inverse``, ``right`` as ``eliminate`` returns them, ``right`` with the share of the cut
        forces.
        """
        before, motion = self.acceleration[parent], self.motion[i]
        before = before[:3] + add(before[3:], cross(before[:3], motion.offset))
        share, alone = self.factors[i]
        for n in range(6):
            if n != alone:
                right = right - share[n] * before[n]
        change = right * inverse
        if alone is None:
            self.acceleration[i] = add(before, scale(motion.axis, change))
            return change
        # What the joint's own coordinate and all before it add up to.
        self.acceleration[i] = before[:alone] + (change,) + before[alone + 1:]
        return change - before[alone]

    def balls(self, model):
        """Yield frames and places in qd of the bodies on spherical joints."""
        for i, body in enumerate(self.bodies):
            if i > 0 and body.ball and body.axis == Z:
                dof = model.tree[i, DOF]
                yield self.motion[i].frame, slice(dof - 2, dof + 1)

    def _between(self, model, tau):
        """Return torques, with the effect of forces on the bodies between three hinges."""
        tau = list(tau)
        for rows, (_, axes) in self._across.items():
            first, second, _ = rows
            beyond = add(self.force[first], self.force[second])
            for i, axis, force in zip(rows, axes, (beyond, self.force[second])):
                tau[model.tree[i, DOF]] = tau[model.tree[i, DOF]] - dot(axis, force[:3])
            parent = model.tree[first, PARENT]
            if parent > 0:
                self.force[parent] = add(
                    self.force[parent], at_parent(beyond, self.motion[first].offset))
            self.force[first] = self.force[second] = 2 * ZERO
        return tau

    def about_world(self, model, tau):
        """Return torques, those of spherical joints and of three hinges about the world's axes."""
        tau = list(tau)
        for frame, places in self.balls(model):
            tau[places] = times(frame, tau[places])
        for rows, (across, _) in self._across.items():
            places = [model.tree[i, DOF] for i in rows]
            turned = times(transpose(across), [tau[place] for place in places])
            for place, value in zip(places, turned):
                tau[place] = value
        return tau

    def about_own(self, model, qdd):
        """Turn accelerations from the world's axes into the body's, and the hinges', in place."""
        for frame, places in self.balls(model):
            qdd[places] = times(transpose(frame), qdd[places])
        for rows, (across, _) in self._across.items():
            places = [model.tree[i, DOF] for i in rows]
            for place, value in zip(places, times(across, [qdd[place] for place in places])):
                qdd[place] = value

    def _counts_angles(self, i):
        """Return whether levers and accelerations are those of a body's angle, not its joint's."""
        body = self.bodies[i]
        return self.in_one_frame and bool(body.turns) and is_zero((body.slides,))

    def _joined_before(self, model, i):
        """Return whether the angle of a body is counted from before its own joint."""
        parent = self.motion[model.tree[i, PARENT]]
        return self.bodies[i].turned is None and parent.joined

    def update(self, model, work, responses):
        """Closure errors and Jacobians, traced."""
        for a, cut in enumerate(model.cut):
            equations = self.closures(model, a)
            assert len(equations) == cut[ROWS]
            for row, equation in enumerate(equations):
                place = cut[ROW] + row
                work.closure[place] = equation.value
                work.closure_rate[place] = equation.rate
                work.bias[place] = equation.bias
                if responses != NO_RESPONSES:
                    self._respond(model, work, responses, cut, row, equation)

    def closures(self, model, a):
        """Return the equations of a cut joint, but for those that always hold."""
        return self.cuts[a].left(self.equations(model, a))

    def equations(self, model, a):
        """Return all equations of a cut joint."""
        cut = self.cuts[a]
        if cut.coupling is not None and not cut.between:
            equation = self._coupled(cut)
            return [equation if cut.motion is None else cut.moved(equation)]
        both = [self.motion[model.cut[a, body]] for body in (BODY_A, BODY_B)]
        if cut.coupling is None:
            return cut.equations(*both)
        joints = self._coupled(cut)
        asked = cut._replace(motion=(0.0 - joints.value, 0.0 - joints.rate, 0.0))
        return [one._replace(in_joints=joints.in_joints) for one in asked.equations(*both)]

    def _coupled(self, cut):
        """Return the equation that holds a sum of joint coordinates."""
        held, factors = cut.coupling
        value, rate, bias = 0.0 - held, 0.0, 0.0
        for i, factor in factors:
            coordinate, speed = self._coordinates[i]
            value, rate = value + factor * coordinate, rate + factor * speed
        if cut.law is not None:
            i, law = cut.law
            coordinate, speed = self._coordinates[i]
            asked, slope, curvature = law(coordinate)
            value, rate = value - asked, rate - slope * speed
            bias = bias - curvature * speed * speed
            factors = (*factors, (i, 0.0 - slope))
        return Closure(value, rate, bias, 2 * ZERO, 2 * ZERO, factors)

    def _respond(self, model, work, responses, cut, row, equation):
        """Carry a unit multiplier's wrenches inward and keep their share at each joint."""
        if equation.in_joints:
            self._respond_in_joints(model, work, responses, cut, row, equation)
            return
        middle, common, end = cut[PATH_B], cut[PATH_COMMON], cut[PATH_END]
        one = self._reduced(model, work, responses, cut[PATH_A], middle, row, equation.on_a)
        other = self._reduced(model, work, responses, middle, common, row, equation.on_b)
        self._reduced(model, work, responses, common, end, row, add(one, other))

    def _respond_in_joints(self, model, work, responses, cut, row, equation):
        """Responses to forces in joints, too; a body comes before its parent."""
        forces, arrived = dict(equation.in_joints), {}
        for body, wrench in ((BODY_A, equation.on_a), (BODY_B, equation.on_b)):
            arrived[cut[body]] = add(arrived.get(cut[body], 2 * ZERO), wrench)
        for entry in range(cut[PATH_A], cut[PATH_END]):
            i = model.path_body[entry]
            wrench, parent = arrived.pop(i, 2 * ZERO), model.tree[i, PARENT]
            wrench = self._pass(model, work, responses, entry, row, wrench, forces.get(i, 0.0))
            arrived[parent] = add(arrived.get(parent, 2 * ZERO), wrench)

    def _reduced(self, model, work, responses, begin, end, row, wrench):
        """Carry a wrench inward along a path; return the wrench on the last parent."""
        for entry in range(begin, end):
            wrench = self._pass(model, work, responses, entry, row, wrench)
        return wrench

    def _pass(self, model, work, responses, entry, row, wrench, own=0.0):
        """Store the joint forces of a wrench on a path; return the wrench on the parent."""
        i, scaled = model.path_body[entry], 0.0
        if responses != REDUCED:
            beyond = responses == LEVERS and self._counts_angles(i) and self._joined_before(
                model, i)
            force, wrench = self.transmit_wrench(i, wrench, beyond, own)
        else:
            force, scaled, wrench = self.transmit_articulated_wrench(
                i, work.body[i, DINV], wrench, own)
        work.response[entry, row], work.response_scaled[entry, row] = force, scaled
        return wrench

    def transmit_wrench(self, i, wrench, beyond=False, own=0.0):
        """
        Transmit a wrench on a body, at its origin, to its parent.

        ``beyond``: whether the joint's angle counts from the frame that its parent's does, too: no
        other angle turns the bodies beyond; ``own``: a force in the joint itself. Returns its
        share in the joint, and the wrench at the parent's origin.
        """
        motion = self.motion[i]
        force = dot(motion.axis, wrench) + own
        if beyond:
            wrench = (_beyond(wrench, motion.axis, force) if is_zero((own,))
                      else subtract(wrench, scale(motion.axis, force)))
        return force, at_parent(wrench, motion.offset)

    def transmit_articulated_wrench(self, i, inverse, wrench, own=0.0):
        """
        Transmit a wrench on a body, at its origin, through its articulated joint to the parent.

        ``inverse``: one over the joint's pivot; ``own``: a force in the joint itself. Returns its
        share in the joint, that times ``inverse``, and the wrench at the parent's origin.
        """
        motion = self.motion[i]
        share, alone = self.factors[i]
        force = dot(motion.axis, wrench) + own
        scaled = force * inverse
        wrench = tuple(0.0 - own if n == alone else wrench[n] - share[n] * scaled
                       for n in range(6))
        return force, scaled, at_parent(wrench, motion.offset)


def turned_frame(base, angle):
    """Return a frame that is turned about its Z axis."""
    if is_zero((angle,)):
        return base
    x, y, z = transpose(base)
    cos, sin = cosine(angle), sine(angle)
    return transpose((add(scale(x, cos), scale(y, sin)),
                      subtract(scale(y, cos), scale(x, sin)), z))


def rigid(body, motion):
    """Return a body's inertia and the force that its acceleration takes, at its origin."""
    moment = times(motion.frame, body.moment)
    about = _turned_inertia(motion.frame, body.inertia)
    coupling = skew(moment)
    inertia = tuple(
        one + other for one, other in zip(about, coupling)) + tuple(
        one + tuple(body.mass if n == m else 0.0 for m in range(3))
        for n, one in enumerate(transpose(coupling)))
    force = add(scale(motion.acceleration, body.mass), motion.convective_acceleration(moment))
    torque = add(cross(moment, motion.acceleration),
                 add(times(about, motion.spin_rate),
                     cross(motion.spin, times(about, motion.spin))))
    return inertia, torque + force


def rotation(quaternion, double=2.0):
    """Return the matrix of a quaternion x, y, z, w; ``double``: 2 over the square of its norm."""
    x, y, z, w = quaternion
    x2, y2, z2 = double * x, double * y, double * z
    xx, yy, zz = x * x2, y * y2, z * z2
    xy, xz, yz, wx, wy, wz = x * y2, x * z2, y * z2, w * x2, w * y2, w * z2
    return ((1.0 - (yy + zz), xy - wz, xz + wy), (xy + wz, 1.0 - (xx + zz), yz - wx),
            (xz - wy, yz + wx, 1.0 - (xx + yy)))


def _turned_inertia(frame, inertia):
    """Return an inertia in a body's frame in the world's axes."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia
    if not is_zero((xy, xz, yz)):
        columns = product(frame, inertia)
        return symmetric(lambda m, n: dot(columns[m], frame[n]))
    # What two of the principal moments share is a sphere's.
    moments = (xx, yy, zz)
    sphere = next((m for k, m in enumerate(moments) if any(m is n for n in moments[k + 1:])), xx)
    shares = [(axis, scale(axis, moment - sphere))
              for axis, moment in zip(transpose(frame), moments) if moment is not sphere]
    return symmetric(lambda m, n: sum(
        (axis[m] * share[n] for axis, share in shares), sphere if m == n else 0.0))


def aligned(axis):
    """Return the index of the world axis that an axis is; None for another or a symbol."""
    for n in range(6):
        if is_number(axis[n], 1.0) and is_zero(axis[:n] + axis[n + 1:]):
            return n
    return None


def _beyond(wrench, axis, moment):
    """
    Return a wrench without its moment about an axis.

    The angles of parallel axes are counted from the first one's frame: no angle turns the bodies
    beyond the next one.
    """
    alone = aligned(axis)
    if alone is None:
        return subtract(wrench, scale(axis, moment))
    return wrench[:alone] + (0.0,) + wrench[alone + 1:]


def _inverse(pivot, massless):
    """Return one over a pivot, 0 for none where there may be none."""
    if massless:
        return chosen(pivot > 0.0, 1.0 / chosen(pivot > 0.0, pivot, 1.0), 0.0)
    return 1.0 / pivot


def at_parent(wrench, offset):
    """Return a wrench at the parent's origin."""
    return add(wrench[:3], cross(offset, wrench[3:])) + wrench[3:]


def shifted(inertia, offset):
    """Return an inertia at the parent's origin."""
    coupling = [row[3:] for row in inertia[:3]]
    mass = [row[3:] for row in inertia[3:]]
    # [r] M: the vector product with each column.
    more = transpose([cross(offset, column) for column in transpose(mass)])
    shifted = [add(*rows) for rows in zip(coupling, more)]
    before, after = ([cross(offset, row) for row in rows] for rows in (coupling, shifted))
    about = symmetric(lambda m, n: inertia[m][n] + before[n][m] + after[m][n])
    return tuple(one + other for one, other in zip(about, shifted)) + tuple(
        one + tuple(other) for one, other in zip(transpose(shifted), mass))


def _gap(first, second, at_a, at_b):
    """Return from point B to point A, how fast that changes, and Jdot qd of it."""
    return (subtract(add(first.origin, at_a), add(second.origin, at_b)),
            subtract(add(first.velocity, cross(first.spin, at_a)),
                     add(second.velocity, cross(second.spin, at_b))),
            subtract(add(first.acceleration, first.convective_acceleration(at_a)),
                     add(second.acceleration, second.convective_acceleration(at_b))))


def _translations(cut, first, second, at_a, at_b):
    """Yield the equations that keep two points together, in the world's axes or in body B's."""
    apart, rate, bias = gap = _gap(first, second, at_a, at_b)
    if not cut.along:
        return
    axes = transpose(_joint_frame(second, cut.turned_b, cut.angle))
    if len(cut.along) < 3:
        for n in cut.along:
            yield _along(axes[n], gap, second, at_a, at_b)
        return
    # All three hold along any axes, whether these turn or not.
    for axis in axes if cut.carried else IDENTITY:
        yield Closure(dot(axis, apart), dot(axis, rate), dot(axis, bias),
                      cross(at_a, axis) + axis, cross(axis, at_b) + negate(axis))


def _along(axis, gap, second, at_a, at_b):
    """Return the equation that keeps two points together along an axis of body B."""
    (apart, rate, bias), spin = gap, second.spin
    value = dot(axis, apart)
    # The axis turns with body B.
    turning = cross(axis, apart)
    return Closure(
        value, dot(axis, rate) + dot(spin, turning),
        dot(axis, bias) + 2.0 * dot(spin, cross(axis, rate)) + (
            dot(second.spin_rate, turning) + dot(spin, axis) * dot(spin, apart)
            - dot(spin, spin) * value),
        cross(at_a, axis) + axis, cross(axis, add(apart, at_b)) + negate(axis))


def _distance(cut, first, second, at_a, at_b):
    """
    Return the equation that keeps two points at a distance l: (d . d / l - l) / 2.

    Without a root; its multiplier is the force that pushes the points apart.
    """
    apart, rate, bias = _gap(first, second, at_a, at_b)
    inverse = 1.0 / cut.length
    along = scale(apart, inverse)
    return Closure(
        0.5 * (dot(along, apart) - cut.length), dot(along, rate),
        dot(along, bias) + inverse * dot(rate, rate), cross(at_a, along) + along,
        cross(along, at_b) + negate(along))


def _turn(cut, first, second):
    """
    Return the equation that prescribes the angle of body A about Z of body B.

    Its value is the sine of what the angle is off, so that it does not matter how often the joint
    has turned round.
    """
    angle, rate, acceleration = cut.motion
    side = transpose(_joint_frame(first, cut.turned_a, 0.0))[X]
    along, across, axis = transpose(_joint_frame(second, cut.turned_b, 0.0))
    turns = subtract(first.spin, second.spin)
    return Closure(
        dot(side, across) * cosine(angle) - dot(side, along) * sine(angle),
        dot(axis, turns) - rate,
        dot(axis, subtract(first.spin_rate, second.spin_rate))
        + dot(cross(second.spin, axis), turns) - acceleration,
        axis + ZERO, negate(axis) + ZERO)


def _rotations(cut, first, second):
    """Yield the equations that keep axes of body A perpendicular to axes of body B."""
    turns = subtract(first.spin, second.spin)
    for n, m in cut.perpendicular:
        if (n, m) == (X, Y) and first.base is second.base and cut.turned_a is cut.turned_b is None:
            # Where axes are parallel, the angle itself, whatever the number of turns.
            axis = transpose(first.frame)[Z]
            yield Closure(
                first.angle - second.angle - cut.angle, dot(axis, turns),
                dot(axis, subtract(first.spin_rate, second.spin_rate)), axis + ZERO,
                negate(axis) + ZERO)
            continue
        yield _perpendicular(
            transpose(_joint_frame(first, cut.turned_a, 0.0))[n],
            transpose(_joint_frame(second, cut.turned_b, cut.angle))[m], first, second, turns)


def _perpendicular(one, other, first, second, turns):
    """Return the equation that keeps an axis of body A perpendicular to one of body B."""
    lever, off = cross(one, other), dot(one, other)
    # How fast the lever turns with both axes, along the difference of the spins.
    turning = (dot(first.spin, other) * dot(one, turns) - dot(second.spin, one) * dot(other, turns)
               - off * dot(turns, turns))
    return Closure(
        off, dot(lever, turns),
        dot(lever, subtract(first.spin_rate, second.spin_rate)) + turning,
        lever + ZERO, negate(lever) + ZERO)


def _screw(cut, first, second, at_a, at_b):
    """
    Return the equation of a thread: X of body A lies across Y of body B, turned by slide / lead.

    That holds however many turns there are. Times the lead: an error in metres.
    """
    x, y, z = transpose(_joint_frame(second, cut.turned_b, cut.angle))
    own = transpose(_joint_frame(first, cut.turned_a, 0.0))[X]
    slide = _along(z, _gap(first, second, at_a, at_b), second, at_a, at_b)
    turned = slide.value / cut.lead
    cos, sin = cosine(turned), sine(turned)
    turns = subtract(first.spin, second.spin)
    across = _perpendicular(
        own, subtract(scale(y, cos), scale(x, sin)), first, second, turns)
    beside = _perpendicular(own, add(scale(x, cos), scale(y, sin)), first, second, turns)

    def of(one, other):
        return subtract(scale(one, cut.lead), scale(other, beside.value))

    return Closure(
        cut.lead * across.value, cut.lead * across.rate - beside.value * slide.rate,
        cut.lead * across.bias - 2.0 * slide.rate * beside.rate - beside.value * slide.bias
        - across.value * slide.rate * (slide.rate / cut.lead),
        of(across.on_a, slide.on_a), of(across.on_b, slide.on_b))


def _joint_frame(motion, turned, angle):
    """Return the axes of a cut joint on one of its bodies."""
    if turned is None:
        return motion.frame if is_zero((angle,)) else turned_frame(
            motion.base, motion.angle + angle)
    return turned_frame(product(motion.frame, turned), angle)
