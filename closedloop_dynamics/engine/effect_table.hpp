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
enum : Index {STATE, PLACES, JOINTS, BODIES, SUMMED, LOADED, DATA, ENTRIES, GAP_OF};
/// Column of EffectTable.values where a law is LOADED, and of EffectTable.output.
enum Column : Index {STORED = 0, LOAD_TIME = 11};
/// Roles of laws: a force; one in the place of a command; force or motion over time; dry friction;
/// inertia whose force follows from accelerations.
enum Role : Index {FORCE, DRIVE, COURSE, MOTION, FRICTION, INERTIA};
/// Gap: none; from a boundary without end; from a body that may be passed, about its point or as a
/// curve; of a user's law.
enum Gap : Index {NO_GAP, BOUNDARY, ROUND, OUTLINE, EVENT};
/// Places of a prescribed motion: row of Model.cut, multiplier, column of Model.cut_point.
enum Equation : Index {CUT_ROW, MULTIPLIER, COLUMN, EQUATION_PLACES};
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

/// A field of a named tuple that the engine has no use for.
struct Unread {};

/// The listed effects.
struct EffectTable
{
  Unread laws;
  Indices role;
  Indices routine;
  Indices enabled;
  Indexes index;
  Indices places;
  Indices calls;
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

  Index count() const {return role.size;}
  /// Places of the joints of a law, behind them rows of its bodies; or those of an equation.
  const Index * places_of(Index row) const
  {
    return places.data + index(row, effect::PLACES);
  }
  /// Numbers of a law behind the arms of a sum.
  const double * numbers_of(Index row) const
  {
    return data.data + index(row, effect::DATA) +
           (index(row, effect::SUMMED) == 1 ? index(row, effect::JOINTS) : 0);
  }

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      laws, role, routine, enabled, index, places, calls, values, output, states, rates, scale,
      loaded, applied, reaction, sticking, data, contacts, motions, cuts, code);
  }
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__EFFECT_TABLE_HPP_
