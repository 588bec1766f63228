# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Data of the kernels: the constant Model and the mutable Workspace.

Both are NamedTuples of C-contiguous arrays. Per body there is one row; the
columns are the constants below, so that what belongs to one body lies in one
piece of memory. Row 0 is the ground: recursions need no special case for it.
Bodies are numbered so that a parent comes before its children, subsystem by
subsystem; ``q``, ``qd``, ``tau`` and the multipliers of the interface keep the
user's order (columns ``DOF`` and ``CUT_ROW``).

A planar vector is ordered (angular, x, y), in world axes, at the body's own
origin (the place of its joint). What ``body``, ``cut_point`` and ``Workspace.body``
hold of a mechanism in space: ``codegen.space``.
"""

from typing import NamedTuple

import numpy as np

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

# Workspace.kernel, one row a body: addresses of what the loops call (``codegen.joint_kernels``).
# Motion and rigid body; elimination of the joint, and where joints may carry no inertia;
# acceleration; a wrench carried inward, less what joints give way to, by levers, or as it is;
# inertia of the composite body; energy; Newton's and Euler's equations, inward, joint torque; the
# first of the wrenches where a force acts in the joint itself.
(MOVE, ELIMINATE, ELIMINATE_MASSLESS, ACCELERATE, REDUCE, LEVER, CARRY, COMPOSE, MEASURE, NEWTON,
 SHIFT, TORQUE, REDUCE_COUPLED) = range(13)
BODY_KERNELS = 13
# Workspace.cut_kernel, one row a cut joint: its equations; the wrenches of its multipliers.
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


class Model(NamedTuple):
    """Constant description of one mechanism; built by ``modeling.build_model``."""

    tree: np.ndarray  # Int, shape (nb + 1, TREE_COLUMNS)
    body: np.ndarray  # Shape (nb + 1, BODY_COLUMNS)
    gravity: np.ndarray  # Shape (2,), in space (3,): [m/s^2]
    cut: np.ndarray  # Int, shape (number of cuts, CUT_COLUMNS)
    cut_point: np.ndarray  # Shape (number of cuts, CUT_POINT_COLUMNS or more)
    #: The body of every path entry (a place on the path of a cut force) (ndarray of int).
    path_body: np.ndarray
    #: Int, shape (pairs, 2): Off-diagonal blocks: (path entry of the later cut, that of the
    #: earlier) that share a body, with the rows of both cuts packed in ``block``.
    pair: np.ndarray
    #: Int, shape (blocks, 4): (later cut, earlier cut, first pair, last pair + 1) of every block
    #: of the constraint matrix below the diagonal.
    block: np.ndarray
    #: Int, shape (nc + 1,): First entry of each column of the factor L, which includes its
    #: diagonal.
    column: np.ndarray
    row: np.ndarray  # Row of each entry of L, in elimination order (ndarray of int)
    #: Int, shape (blocks, 3): Place in L of the first entry of every block, for each of the
    #: earlier cut's columns.
    entry: np.ndarray
    dependency: np.ndarray  # Int, shape (nc + 1,): First entry in ``dependency_place`` of each row
    #: Int, shape (entries, 2): (earlier column k, place of the row in column k), left of each
    #: diagonal.
    dependency_place: np.ndarray


class Workspace(NamedTuple):
    """All that one evaluation writes; allocated once."""

    body: np.ndarray  # Shape (nb + 1, WORK_COLUMNS)
    #: Shape (path entries, 3 or 6): Reduced force u = S^T w of each row of a cut at each path
    #: entry.
    response: np.ndarray
    response_scaled: np.ndarray  # Shape (path entries, 3 or 6): The same times 1/D
    factor: np.ndarray  # Entries of the constraint matrix, then of its factor L
    scale: np.ndarray  # Shape (nc,): What the pivots are compared with
    #: Shape (path entries, 3 or 6): Of each row of a cut, the levers on the bodies' angles, and on
    #: the slides.
    lever: np.ndarray
    joint: np.ndarray  # Shape (nb + 1, JOINT_COLUMNS): What ``refinement`` keeps of every joint
    change: np.ndarray  # Shape (nv,): Of the accelerations, the latest
    pivot_inverse: np.ndarray  # Shape (nc,)
    right: np.ndarray  # Shape (nc,): Right-hand side, then solution, in elimination order
    scatter: np.ndarray  # Shape (nc,)
    #: ``closure``, ``closure_rate``, ``bias``: Shape (nc,): psi, J qd and Jdot qd, in elimination
    #: order.
    closure: np.ndarray
    closure_rate: np.ndarray
    bias: np.ndarray
    equation: np.ndarray  # Of one cut joint, as ``engine/loop_closure.cpp`` leaves it
    wrench: np.ndarray  # Shape (2, 3 or 6): On their way inward
    share: np.ndarray  # Shape (9 or 18,): Output of a joint kernel
    torque: np.ndarray  # Shape (nv,): In the world's axes
    force: np.ndarray  # Shape (nb + 1, 6 or 12): Wrenches, and accelerations, of inverse dynamics
    kernel: np.ndarray  # Int, shape (nb + 1, BODY_KERNELS)
    cut_kernel: np.ndarray  # Int, shape (number of cuts, 2)
    health: np.ndarray  # Shape (HEALTH_COLUMNS,)


def number_of_coordinates(model):
    """Return nq: the length of q; nv, and one more for each spherical joint."""
    return len(model.tree) - 1 + int(np.count_nonzero(model.tree[:, TYPE] == BALL)) // 3
