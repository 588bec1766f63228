// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__EFFECT_TABLE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__EFFECT_TABLE_HPP_

#include "array.hpp"

// The listed effects of a scene as the kernels read them; names and meanings are those of
// effects/table.py.

namespace closedloop
{

/// Columns of EffectTable.index.
namespace effect
{
enum : Index {STATE, FIRST, SECOND, LOADED, DATA, ENTRIES};
/// Column of EffectTable.values where a law is LOADED, and of EffectTable.output.
enum Column : Index {STORED = 0, LOAD_TIME = 11};
/// Values of EffectTable.kind.
enum Kind : Index
{
  JOINT_DAMPING, JOINT_SPRING, END_STOP, JOINT_FRICTION, POINT_SPRING, EXTERNAL_FORCE, CONTACT,
  ACTUATOR, SPATIAL_POINT_SPRING, SPATIAL_FORCE, SPATIAL_CONTACT, PRESCRIBED_TORQUE,
  PRESCRIBED_FORCE, JOINT_FORCE_TABLE, POINT_FORCE_TABLE, BUSHING, CABLE, LINE_CONTACT,
  CIRCLE_CONTACT, CURVE_CONTACT, FACE_CONTACT, SPATIAL_PRESCRIBED_FORCE, SPATIAL_BUSHING,
  SPATIAL_CABLE, PRESCRIBED_MOTION, SPATIAL_BODY_CONTACT, SPATIAL_FORCE_TABLE, REFLECTED_INERTIA,
  TENDON, FLUID_DRAG, SPATIAL_FLUID_DRAG, ORIENTATION_SPRING, TRACED, SPATIAL_TRACED, KINDS
};
}

/// Values of Contacts.mode, and columns of its arrays.
namespace contact
{
enum : Index {UNDECIDED, FREE, TOUCHING};
enum Node : Index {GAP, RATE, PLACE, ERROR = 5, BEND, NODE_COLUMNS};
enum Trial : Index {FASTEST, SPEED, WRONG, LARGEST, CHANGED, LOST, TRIAL_COLUMNS};
enum Search : Index
{
  LOW, HIGH, TOP, SUSPECTED, REFINED, PASSED, SHARES, NODE_LEVELS = 17, SEARCH_LENGTH = 28
};
/// Halvings of a step that is searched for contacts.
constexpr Index LEVELS = 8;
}

/// Columns of CutCoordinates.index and .values.
namespace cut_coordinate
{
enum : Index {SLIDES, IN_PLANE, ROW_A, ROW_B, FOLLOWED, CUT, RATE_ONLY, ACROSS};
enum Value : Index
{
  POINT_A = 0, POINT_B = 3, AXIS = 6, SIDE_A = 9, SIDE_B = 12, ACROSS_B = 15, SCALE = 18, ZERO = 19
};
}

/// Columns of SceneCode.present.
namespace present
{
enum : Index
{
  NUMBER, PERIOD_START, PIECE_START, COEFFICIENTS, PRESENT_COLUMNS = 12
};
}

/// Data of laws that were traced on symbols (effects/traced_effect.py).
namespace traced
{
/// The most coordinates and own states of a law, and readings beside its power.
constexpr Index MOST_COORDINATES = 16, MOST_STATES = 16, READINGS = 3;

/// Numbers of the first entry: number of leading states that are the time; other states; whether
/// the law gives stored and dissipated energy, so that the rest is no external work; whether it has
/// an event, that is, gap and rate behind its other results.
enum Head : Index {CLOCK, OWN, BOOKED, EVENT};
/// Numbers of the other entries: measured quantity, joint or bodies or axis, and points.
enum Entry : Index {MEASURED, FIRST, SECOND, POINT_A, POINT_B = 6, COLUMNS = 9};
/// Measured quantity: coordinate of a joint, distance of two points, component of a point's
/// position.
enum Measured : Index {JOINT, DISTANCE, COMPONENT};
}

/// Joints at rest under dry friction, and their holding forces.
struct Sticking
{
  Indices rows;
  Values hold;
  Table response;
  Table matrix;
  Values right;
  Values bound;
  Values move;
  Table factor;
  Indices free;
  Values share;
  Values impulse;

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(rows, hold, response, matrix, right, bound, move, factor, free, share, impulse);
  }
};

/// Gaps between bodies that may touch, and the decisions about them while a step is made.
struct Contacts
{
  Indices rows;
  Indices mode;
  Table now;
  Table start;
  Table trial;
  Cube<double> nodes;
  Values search;

  template<class Visitor>
  void fields(Visitor && visit) {visit(rows, mode, now, start, trial, nodes, search);}
};

/// Freedoms of cut joints that anything acts in.
struct CutCoordinates
{
  Indexes index;
  Table values;
  Values q;
  Values qd;
  Values before;
  Values qdd;
  Table scratch;

  template<class Visitor>
  void fields(Visitor && visit) {visit(index, values, q, qd, before, qdd, scratch);}
};

/// Inputs of a scene's code beside the table of effects.
struct SceneCode
{
  Indices fits;
  Table present;
  Values sides;

  template<class Visitor>
  void fields(Visitor && visit) {visit(fits, present, sides);}
};

/// The listed effects.
struct EffectTable
{
  Indices kind;
  Indices enabled;
  Indexes index;
  Table values;
  Table output;
  Values states;
  Values rates;
  Values scale;
  Indices loaded;
  Values applied;
  Table reaction;
  Sticking sticking;
  Values data;
  Contacts contacts;
  Table motions;
  CutCoordinates cuts;
  SceneCode code;

  Index count() const {return kind.size;}

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(kind, enabled, index, values, output, states, rates, scale, loaded, applied, reaction,
      sticking, data, contacts, motions, cuts, code);
  }
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__EFFECT_TABLE_HPP_
