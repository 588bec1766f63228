// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__COLUMNS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__COLUMNS_HPP_

#include "array.hpp"

// Columns of the arrays. The names and meanings are those of engine/types.py, codegen/space.py,
// codegen/function_table.py; a test compares them.

namespace closedloop
{

/// Model.tree, a row for each body.
namespace tree
{
enum : Index {PARENT, DOF, TYPE, SUBSYSTEM, COORDINATE, AXIS, VARIES};
enum Type : Index {REVOLUTE, PRISMATIC, REVOLUTE_ARMATURE, HELICAL, BALL};
}

/// Workspace.body, a row for each body: in the plane and in space.
namespace work
{
enum : Index {DINV, RHS, DZ};
}

/// Workspace.body in the plane, and places in Model.body and Model.cut_point.
namespace plane
{
enum : Index
{
  ALPHA = 3, COS, SIN, PX, PY, RX, RY, OMEGA, VX, VY, AX, AY,
  IZZ, HX, HY, MXX, MXY, MYY, FZ, FX, FY, UZ, UX, UY, SX, SY, DX, DY,
  POSITION, RATE, JOINT_X = 4, JOINT_Y, A_X = 0, A_Y, B_X, B_Y, CUT_POINT_COLUMNS = 5
};
}

/// The same in space.
namespace space
{
enum : Index
{
  ORIGIN = 3, FRAME = 6, SPIN = 15, VELOCITY = 18, FORCE = 21, OFFSET = 27, SPIN_RATE = 30,
  ACCELERATION = 33, JOINT_AXIS = 36, JOINT_POSITION = 75, JOINT_RATE = 76, PLACE = 10,
  POINT_A = 0, POINT_B = 3, TURNED_A = 6, TURNED_B = 15, LENGTH = 24, CUT_POINT_COLUMNS = 25
};
}

/// Model.kernel and Model.cut_kernel: addresses of the code generated for each joint type.
namespace kernel
{
enum : Index
{
  MOVE, ELIMINATE, ELIMINATE_MASSLESS, ACCELERATE, REDUCE, LEVER, CARRY, COMPOSE, MEASURE, NEWTON,
  SHIFT, TORQUE, REDUCE_COUPLED
};
enum Cut : Index {EQUATIONS, WRENCH};
}

/// Workspace.joint, a row for each body.
namespace joint
{
enum : Index {SQUARE, STAND_IN, TOTAL};
}

/// Model.cut, a row for each cut joint.
namespace cut
{
enum Column : Index
{
  TYPE, BODY_A, BODY_B, ROWS, CUT_ROW, ROW, PATH_A, PATH_B, PATH_COMMON, PATH_END, NUMBER, KEPT,
  POSSIBLE, LENGTHS
};
enum Type : Index {PRISMATIC = 1, COUPLING = 11, PRESCRIBED_JOINT = 12, COUPLED_PLACE = 15};
/// Columns of Model.cut_point for couplings, and the number of prescribed motions at the end.
enum Point : Index {HELD_SUM = 0, FACTORS = 1, MOTION_COLUMNS = 3};
}

/// Workspace.health.
namespace health
{
enum : Index
{
  SMALLEST_PIVOT, SMALLEST_PIVOT_EVER, RANK, EVALUATIONS, RANK_REVEALING_COUNT,
  PROJECTION_ITERATIONS, CLOSURE, SINGULAR_COUNT, MOST_DISTINCT, LOOKED_BESIDE,
  WRITTEN
};
}

/// The function table: addresses of the routines generated for one mechanism, then of the arrays
/// that they work on, functions of the engine (library.hpp) among them.
namespace routine
{
enum : Index
{
  EVALUATION, OUTWARD, ACCELERATION, CORRECTION, REFINED_ACCELERATION, REFINED_CORRECTION,
  REACTIONS, WRENCHES, LEAST_FORCES, AT_REST, RESPONSES, LOOP_EQUATIONS, LEFT_OUT, ENERGIES,
  TORQUE_RESPONSE, EQUATIONS_OF_MOTION, MOTION,
  BODY, GRAVITY, CUT_POINT, TAU, BAUMGARTE, QDD, LAM, HEALTH, WORK_BODY, CLOSURE,
  CLOSURE_RATE, CORRECTIONS, REACTION, COMMAND, VALUES, ENTRIES, CUT_VALUES, PRESENT, SIDES, GAPS,
  TRIALS, RATES, PIECE, NEAREST, FURTHEST, WRENCH, JOINT_POINT, LAM_OF_ALL, BIAS, JACOBIAN,
  INERTIA_MATRIX, JOINT_FORCE, ADDED_FORCE, ENERGY, RESPONSE, LIMIT, FACTORS, TABLE_COLUMNS
};
}

/// Columns that the table of a law's row has beside those of a mechanism's.
namespace law_routine
{
enum : Index {STATES = routine::TABLE_COLUMNS, OUTPUT, COUNT, RIGHT_SIDE, LAW_COLUMNS};
}

/// Responses to unit cut forces that `update` computes.
enum class Responses {NONE, REDUCED, LEVERS, CARRIED};

/// Unknowns of a rank-revealing solution.
enum class Level : Index {POSITION, VELOCITY, ACCELERATION};

/// How a state is corrected after a step.
enum class Stabilisation : Index {NONE, BAUMGARTE, VELOCITY, PROJECTION, INDEPENDENT};

/// How an advance ended.
enum class Status : Index
{
  DONE, NOT_FINITE, OPEN_LOOP, STEP_TOO_SMALL, TOO_MUCH_WORK, INTERRUPTED, POOR_EQUATIONS,
  CONTACT_PASSED, NO_PROGRESS, SINGULAR, DOUBTFUL
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__COLUMNS_HPP_
