# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The arrays of the engine's objects in Python, and their columns.

Per body there is one row; the columns are the constants below. Row 0 is the
ground: recursions need no special case for it. Bodies are numbered so that a
parent comes before its children, subsystem by subsystem; ``q``, ``qd``, ``tau``
and the multipliers of the interface keep the user's order (columns ``DOF`` and
``CUT_ROW``).

A planar vector is ordered (angular, x, y), in world axes, at the body's own
origin (the place of its joint). What ``body``, ``cut_point`` and ``Workspace.body``
hold of a mechanism in space: ``codegen.space``.
"""

from types import SimpleNamespace

import numpy as np

from . import native

# Model.tree, one row a body: topology. In space, joints of several freedoms are several rows, all
# but the last of them bodies without mass. DOF: place in qd and tau; COORDINATE: first place in q;
# AXIS: the column of the body's frame along or about which it moves, in space; in the plane READ:
# whether a coupling reads the joint's coordinate. VARIES: in space, bits of the columns of
# Model.body that effects may change while code runs, which loads them even where they are zero.
PARENT, DOF, TYPE, SUBSYSTEM, COORDINATE, AXIS, VARIES = range(7)
READ = AXIS
TREE_COLUMNS = 7
# Values of the column TYPE. HELICAL and BALL, one of the three rows of a spherical joint, are
# in space.
REVOLUTE, PRISMATIC, REVOLUTE_ARMATURE, HELICAL, BALL = range(5)

# Model.body, one row a body: constants.
# MASS; first moments MASS_X, MASS_Y in body axes; inertia about the body's
# origin; the joint's place in the parent's frame; angle of the child's frame
# at q = 0; rotor inertia seen at the joint.
MASS, MASS_X, MASS_Y, INERTIA, JOINT_X, JOINT_Y, ANGLE, ARMATURE = range(8)
BODY_COLUMNS = 8

# Workspace.body, one row a body. Common to the plane and space:
# the factor 1/D, the reduced right-hand side, and how fast the angle that refinement counts by (of
# the body in the plane, of the joint in space, the slide of a prismatic joint) accelerates.
DINV, RHS, DZ = range(3)
# In the plane. Set by the outward recursion: absolute angle, its cosine and sine, origin,
# offset from the parent's origin, velocity, velocity-product acceleration of
# the origin (its angular part is zero in the plane).
ALPHA, COS, SIN, PX, PY, RX, RY, OMEGA, VX, VY, AX, AY = range(3, 15)
# Articulated-body inertia [[IZZ, HX, HY], [HX, MXX, MXY], [HY, MXY, MYY]] and bias force:
# set to the rigid body's own by the outward recursion, completed by the inward one.
IZZ, HX, HY, MXX, MXY, MYY, FZ, FX, FY = range(15, 24)
# U = IA S; joint axis S (x and y; its angular part is 1 for a revolute joint, 0 for a prismatic
# one); with DZ the acceleration beyond the velocity-product one.
UZ, UX, UY, SX, SY, DX, DY = range(24, 31)
WORK_COLUMNS = 31
# After these, where couplings read any: the joint's coordinate and rate.
POSITION, RATE = 31, 32
COUPLED_WORK_COLUMNS = 33

# Model.kernel, one row a body: addresses of what the loops call (``codegen.joint_kernels``).
# Motion and rigid body; elimination of the joint, and where joints may carry no inertia;
# acceleration; a wrench carried inward, less what joints give way to, by levers, or as it is;
# inertia of the composite body; energy; Newton's and Euler's equations, inward, joint torque; the
# first of the wrenches where a force acts in the joint itself.
(MOVE, ELIMINATE, ELIMINATE_MASSLESS, ACCELERATE, REDUCE, LEVER, CARRY, COMPOSE, MEASURE, NEWTON,
 SHIFT, TORQUE, REDUCE_COUPLED) = range(13)
BODY_KERNELS = 13
# Model.cut_kernel, one row a cut joint: its equations; the wrenches of its multipliers.
EQUATIONS, WRENCH = range(2)

# What ``Recursion.update`` computes of the unit cut forces: nothing, their shares at the joints
# of trees that give way, their levers on the bodies' angles and on the slides (J^T for these), or
# on the joints' coordinates (J^T).
NO_RESPONSES, REDUCED, LEVERS, CARRIED = range(4)

# Workspace.joint, one row a body: square of the lever that its joint is compared by (1 for a
# slide), the inertia that stands in for none, and the acceleration: of the slide, or of the body's
# angle.
SQUARE, STAND_IN, TOTAL = range(3)
JOINT_COLUMNS = 3

# Model.cut, one row a cut joint: topology. CUT_ROW: first multiplier in the user's
# order; ROW: first one in elimination order; path entries PATH_A..PATH_B-1 are the bodies
# from body A inward, PATH_B..PATH_COMMON-1 those from body B, PATH_COMMON..PATH_END-1
# the ones that both paths share; CUT_NUMBER: its place in the user's order;
# POSSIBLE: the bits of the equations of its type that do not always hold; KEPT: of those
# among them that the elimination works on, as others repeat them. LENGTHS: how many of the first
# equations hold points, in metres; one at least, but in the plane none of a coupling, of a
# joint's prescribed motion, or where only the angle is left.
(CUT_TYPE, BODY_A, BODY_B, ROWS, CUT_ROW, ROW, PATH_A, PATH_B, PATH_COMMON, PATH_END,
 CUT_NUMBER, KEPT, POSSIBLE, LENGTHS) = range(14)
CUT_COLUMNS = 14
# Values of CUT_TYPE; the numbers are those of ``space.CUT_TYPES``.
CUT_REVOLUTE, CUT_PRISMATIC, CUT_FIXED = range(3)
CUT_DISTANCE, CUT_POINT_ON_LINE, CUT_COUPLING = 8, 9, 11
# Prescribed motions: a joint's coordinate, like a coupling with one factor; the place of a
# point of body A along an axis of body B, which is the ground but for a joint that slides; the
# angle of body A in body B. Couplings of such a place or angle with joints of the tree.
PRESCRIBED_JOINT, PRESCRIBED_PLACE, PRESCRIBED_TURN, COUPLED_PLACE, COUPLED_TURN = range(12, 17)
# Model.cut_point, one row a cut joint: the cut point in both bodies' frames, the angle, or the
# length of a rod. Of a coupling, in the plane and in space, the sum that it holds, and from
# FACTORS on the factor of each path entry's coordinate: there may be more columns; where a place
# or angle of two bodies is coupled, too, both behind its own columns. Where motions are prescribed
# the last three are what their position, rate and acceleration are to be, where a place or angle
# is coupled what the joints of the tree ask of it.
A_X, A_Y, B_X, B_Y, CUT_ANGLE = range(5)
CUT_LENGTH = CUT_ANGLE
CUT_POINT_COLUMNS = 5
HELD_SUM, FACTORS = 0, 1
MOTION_COLUMNS = 3

# Workspace.health.
# The smallest pivot relative to the largest diagonal entry of its cut point (the squared sine of
# the angle between one closure equation and those before it) of the latest factorization and
# of all since the last reset; the rank of the latest; evaluations, and uses of the rank-revealing
# path, since the last reset; position corrections of the latest projection and the largest
# closure error it left; evaluations next to a singular configuration since the last reset; the
# most closure equations that were ever distinct, and whether that was looked for beside a place
# where some were not; whether the rows of the bodies have the motion and forces of the latest
# evaluation, as routines leave them.
(SMALLEST_PIVOT, SMALLEST_PIVOT_EVER, RANK, EVALUATIONS, RANK_REVEALING_COUNT,
 PROJECTION_ITERATIONS, CLOSURE, SINGULAR_COUNT, MOST_DISTINCT, LOOKED_BESIDE,
 WRITTEN) = range(11)
HEALTH_COLUMNS = 11


class Arrays(SimpleNamespace):
    """Arrays by name, and records of them within."""

    def replaced(self, **changes):
        """Return the same with other arrays, symbols among them, for generating code."""
        return Arrays(**{**vars(self), **changes})


class Handle(Arrays):
    """
    An object of the engine, its attribute ``native``, with its methods, and its arrays.

    These are views, of the names that they have there, and keep the memory that they are of.
    """

    def __init__(self, native, **attributes):
        """``native``: an object of the engine; further attributes by name."""
        super().__init__(native=native)
        self.see()
        vars(self).update(attributes)

    def __getattr__(self, name):
        """Return a method of the object."""
        if name.startswith('__') or name == 'native':
            raise AttributeError(name)
        return getattr(self.native, name)

    def see(self):
        """See the arrays of the object, by their names."""
        for name, array in self.native.views().items():
            *path, last = name.split('.')
            record = self
            for part in path:
                record = vars(record).setdefault(part, Arrays())
            setattr(record, last, np.asarray(array))


class Model(Handle):
    """Constant description of one mechanism, of which ``engine/model.hpp`` says what it holds."""

    def __init__(self, native):
        super().__init__(native, whole=None)

    @property
    def origin(self):
        """Return the model of the engine whose arrays, or others of their shapes, these are."""
        return self

    def replaced(self, **changes):
        """As of ``Arrays``; the engine does not take it."""
        return super().replaced(native=None, whole=None, origin=self, **changes)

    @classmethod
    def of(cls, tree, body, gravity, cut, cut_point, path_body):
        """Return a model of a topology and constants, which are copied."""
        return cls(native.model(tree, body, gravity, cut, cut_point, path_body))

    def with_cut(self, cut):
        """Return one on other equations, by columns of ``cut``; effects change it with this."""
        return Model(self.native.with_cut(cut))

    def __reduce__(self):
        """Copy and pickle as what all of it follows from."""
        return Model.of, (self.tree, self.body, self.gravity, self.cut, self.cut_point,
                          self.path_body)


def number_of_coordinates(model):
    """Return nq: the length of q; nv, and one more for each spherical joint."""
    return len(model.tree) - 1 + int(np.count_nonzero(model.tree[:, TYPE] == BALL)) // 3
