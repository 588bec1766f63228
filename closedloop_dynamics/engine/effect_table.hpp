// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__EFFECT_TABLE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__EFFECT_TABLE_HPP_

#include <vector>

#include "model.hpp"

// The listed effects of a scene as the kernels read them: one row for each, built from what the
// effect says of itself. Each row obeys a law, whose routine it has the address of.

namespace closedloop
{

namespace effect
{
/// Column of EffectTable.output with the stored energy [J], and of EffectTable.values where a law
/// reads the reaction in its joint, with the time constant of its load [s].
enum Column : Index {STORED = 0, LOAD_TIME = 11};
/// Roles of laws: a force; one in the place of a command; force or motion over time; dry friction;
/// inertia whose force follows from accelerations.
enum Role : Index {FORCE, DRIVE, PROFILE, MOTION, FRICTION, INERTIA};
/// Gap: none; from a boundary without end; from a body that may be passed, about its point or as a
/// curve; of a user's law.
enum Gap : Index {NO_GAP, BOUNDARY, ROUND, OUTLINE, EVENT};
/// Places of a prescribed motion: row of Model.cut, multiplier, column of Model.cut_point.
enum Equation : Index {CUT_ROW, MULTIPLIER, COLUMN, EQUATION_PLACES};
}
namespace contact
{
/// Values of Contacts.mode: whether a contact is there while a step is made; undecided, the gap decides.
enum : Index {UNDECIDED, FREE, TOUCHING};
/// Columns of Contacts.now, .start and .nodes: gap [m; rad], its rate, and the place of the roller
/// as the other body sees it [m], three numbers; of nodes alone the error of a cubic through gaps
/// and rates, and how far the path departs from its chord [m], both up to the node.
enum Node : Index {GAP, RATE, PLACE, ERROR = 5, DEVIATION, NODE_COLUMNS};
/// Columns of Contacts.trial, over all evaluations of a step: the fastest rate of the gap; the
/// fastest motion of the roller; the largest gap on the wrong side; the largest gap of any node;
/// whether the mode has been changed; dissipated energy at the start [J].
enum Trial : Index {FASTEST, SPEED, WRONG, LARGEST, CHANGED, LOST, TRIAL_COLUMNS};
/// Halvings of a step that is searched for contacts.
constexpr Index LEVELS = 8;
/// Places in Contacts.search: the longest part of a step known to agree with the modes, and the
/// shortest that does not [s]; nodes on the stack; cuts on suspicion, and for the sake of the last
/// digits; share and level of each node.
enum Search : Index
{
  LOW, HIGH, TOP, SUSPECTED, REFINED, SHARES, NODE_LEVELS = 16, SEARCH_LENGTH = 27
};
static_assert(NODE_LEVELS == SHARES + LEVELS + 3 && SEARCH_LENGTH == NODE_LEVELS + LEVELS + 3);
}

namespace cut_coordinate
{
/// Columns of CutCoordinates.index: whether it slides; whether it is one in the plane; the rows of
/// bodies A and B; where among the effects' states its angle is followed, less than zero where it
/// is not: in space, angles are found within a turn; its row of Model.cut; whether it has a rate
/// alone, whose integral is followed in the place of a coordinate; whether of the force in its
/// joint the part across the axis is what friction feels.
enum : Index {SLIDES, IN_PLANE, ROW_A, ROW_B, FOLLOWED, CUT, RATE_ONLY, ACROSS, CUT_INDEX_COLUMNS};
/// Columns of CutCoordinates.values, in the frames of the rows: the cut point in A and in B; the
/// axis in B; a direction of A across it, and where that is in B at zero; what follows this in the
/// sense of the turn; coordinates per metre of a slide; the angle at zero, in the plane.
enum Value : Index
{
  POINT_A = 0, POINT_B = 3, AXIS = 6, SIDE_A = 9, SIDE_B = 12, ACROSS_B = 15, SCALE = 18, ZERO = 19,
  CUT_VALUE_COLUMNS
};
}

/// Columns of SceneCode.present: the number of the piece of a profile that it holds, NaN where none
/// is known; when the present period and, in it, the piece began [s]; its coefficients c0 to c5, a,
/// w and p, of an expression its value and its derivatives. Of a curve: curve.hpp.
namespace present
{
enum : Index
{
  NUMBER, PERIOD_START, PIECE_START, COEFFICIENTS, PRESENT_COLUMNS = 12
};
}

/// Joints stuck under dry friction in the latest evaluation, their holding forces; inertia.
struct StaticFriction
{
  /// Shape (nf + 1,): how many joints and tendons stick, and the rows of their effects; nf effects
  /// may stick. Reflected inertia always does so: its force, too, follows from accelerations.
  Array<Indices> rows;
  /// Shape (ne,): friction that dispatch.cpp gives to a joint that sticks [N m; N]: zero but while
  /// responses are computed.
  Array<Values> hold;
  /// Shape (nf + 1, nv + nk + nc): what the limit of each friction changes of accelerations, those
  /// of cut joints behind, and multipliers; last, these without the friction of any joint at rest.
  Array<Table> response;
  /// Shape (nf, nf), (nf,).
  Array<Table> matrix;
  Array<Values> right;
  Array<Values> bound;
  Array<Values> move;
  Array<Table> factor;
  /// The active set.
  Array<Indices> free;
  /// Friction relative to its limit.
  Array<Values> share;
  /// Shape (ne,): whether a friction holds its joint whatever the load; shape (2,): the largest share
  /// of these, in the latest evaluation and in any of a step.
  Array<Indices> holds;
  Array<Values> load;
  Array<Values> impulse;
  /// Shape (nf + 2,): whether responses are kept for later evaluations of a step, how many are, and
  /// their rows; shape (nf,): the limits that they are responses to.
  Array<Indices> kept;
  Array<Values> kept_limit;

  StaticFriction() = default;
  /// `most`: nf; `width`: of a response.
  StaticFriction(Index effects, Index most, Index width);

  CLOSEDLOOP_ARRAYS(
    rows, hold, response, matrix, right, bound, move, factor, free, share, holds, load, impulse,
    kept, kept_limit)
};

/// Gaps of possible contacts, and the decisions about them while a step is made.
struct Contacts
{
  /// Rows of the effects that are contacts.
  Array<Indices> rows;
  /// Shape (ne,).
  Array<Indices> mode;
  /// Shape (ne, NODE_COLUMNS): written by the law; the same at the start of a step.
  Array<Table> now;
  Array<Table> start;
  /// Shape (ne, TRIAL_COLUMNS): written by the law.
  Array<Table> trial;
  /// Shape (LEVELS + 3, ne, NODE_COLUMNS): where a step is looked into. The first is the left end of
  /// the interval in question, the last on the stack its right end.
  Array<Cube<double>> nodes;
  Array<Values> search;
  /// Shape (1,): row of the contact that a step of one size has passed.
  Array<Indices> passed;

  Contacts() = default;
  Contacts(Index effects, Array<Indices> rows);

  CLOSEDLOOP_ARRAYS(rows, mode, now, start, trial, nodes, search, passed)
};

/// Degrees of freedom of cut joints, nk of them, and the joint values that laws read.
struct CutCoordinates
{
  Array<Indexes> index;
  Array<Table> values;
  /// Shape (nv + nk,): coordinates and rates of the tree, then of these joints, in the latest
  /// evaluation; rates before a step; accelerations.
  Array<Values> q;
  Array<Values> qd;
  Array<Values> before;
  Array<Values> qdd;
  /// Shape (nb + 1, 6 or 12).
  Array<Table> scratch;

  CutCoordinates() = default;
  /// `states` of the effects; throws std::invalid_argument.
  CutCoordinates(const Model &, Indexes index, Table values, Index states);

  CLOSEDLOOP_ARRAYS(index, values, q, qd, before, qdd, scratch)
};

/// Inputs of a scene's code beside the table of effects.
struct SceneCode
{
  /// Shape (1,): whether the evaluation that was generated has the laws of all effects, as they are
  /// but for numbers that it reads.
  Array<Indices> fits;
  /// Shape (ne, PRESENT_COLUMNS): pieces of profiles that are in force.
  Array<Table> present;
  /// Shape (ne,): modes of contacts.
  Array<Values> sides;

  CLOSEDLOOP_ARRAYS(fits, present, sides)
};

/// What an effect says of itself.
struct EffectElement
{
  effect::Role role;
  /// Address of the law's routine; 0: the engine has the law.
  Index routine;
  /// Places of its joints in q, of cut joints behind those of the tree; rows of its bodies; of a
  /// motion its row of Model.cut, multiplier, column of Model.cut_point.
  Indices joints;
  Indices bodies;
  Indices equation;
  /// Parameters, and numbers of entries such as pieces of a profile, in the order the law reads them.
  Values values;
  Values numbers;
  Index entries;
  /// The states that it adds: sizes for error control, and their start.
  Values scale;
  Values initial;
  /// Whether the law acts along the sum of its joints, whose arms are the first entry.
  bool summed;
  /// Whether it wants the reaction in its joint, as its second state.
  bool loaded;
  effect::Gap gap;
  bool enabled;

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "role, routine, joints, bodies, equation, values, numbers, entries, scale, initial, summed, "
      "loaded, gap, enabled", role, routine, joints, bodies, equation, values, numbers, entries, scale, initial, summed,
      loaded, gap, enabled);
  }
};

/// The listed effects, ne of them, with nz states.
struct EffectTable
{
  /// Shape (ne,).
  Array<Indices> role;
  Array<Indices> routine;
  Array<Indices> enabled;
  /// Each effect: first own state; where its places begin among those of all; how many joints and
  /// bodies; whether it is summed and wants the reaction; where its numbers begin among those of
  /// all, and how many entries they are; what its gap is.
  Array<Indices> first_state;
  Array<Indices> first_place;
  Array<Indices> joints;
  Array<Indices> bodies;
  Array<Indices> summed;
  Array<Indices> feels;
  Array<Indices> first_number;
  Array<Indices> entries;
  Array<Indices> gap;
  Array<Indices> places;
  /// Shape (LAW_COLUMNS + nb,): of a routine; nb bodies at most for one law.
  Array<Indices> calls;
  /// Shape (ne, 13), (ne, 5): parameters; written by the laws.
  Array<Table> values;
  Array<Table> output;
  /// Shape (nz,): of the latest evaluation.
  Array<Values> states;
  Array<Values> rates;
  Array<Values> scale;
  /// Shape (1,): how many effects want the reaction in their joint.
  Array<Indices> loaded;
  /// Shape (nv + nk,): joint torques, of cut joints behind: commands and effects.
  Array<Values> applied;
  /// Shape (nb + 1, 6 or 12): wrenches in the joints, then scratch.
  Array<Table> reaction;
  /// Numbers of all effects.
  Array<Values> data;
  StaticFriction static_friction;
  Contacts contacts;
  /// Model.cut_point, whose rows the prescribed motions are set in; of no length where there are
  /// none.
  Array<Table> motions;
  CutCoordinates cuts;
  SceneCode code;

  EffectTable() = default;
  /// `all`: with the equations, too, that `model` leaves out; index and values of CutCoordinates are
  /// of the freedoms of cut joints that anything acts in. Throws std::invalid_argument.
  EffectTable(
    const Model & model, const Model & all, const std::vector<EffectElement> &, Indexes cut_index,
    Table cut_values);

  /// Have a row say what an effect says now, with room for no more than at first. Throws
  /// std::invalid_argument, the row as it was.
  void put(Index row, const EffectElement &);
  /// Whether it was made for such a mechanism, with so many equations at most.
  bool fits(const Model & model, const Model & all) const;

  bool empty() const {return loaded.size == 0;}
  Index count() const {return role.size;}
  /// Places of the joints of a law, behind them rows of its bodies; or those of an equation.
  const Index * places_of(Index row) const {return places.data + first_place[row];}
  /// Numbers of a law behind the arms of a sum.
  const double * numbers_of(Index row) const
  {
    return data.data + first_number[row] + (summed[row] == 1 ? joints[row] : 0);
  }

  CLOSEDLOOP_ARRAYS(
    role, routine, enabled, first_state, first_place, joints, bodies, summed, feels, first_number,
    entries, gap, places, calls, values, output, states, rates, scale, loaded, applied, reaction,
    data, static_friction, contacts, motions, cuts, code)

private:
  void write(Index row, const EffectElement &);
  /// Message of what the law or the engine would not find in a row; nullptr where all is there.
  const char * lacks(Index row) const;
};

/// Whether an expression (profile.hpp) has a result, and every operation its operands.
bool is_expression(Values data, Index at);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__EFFECT_TABLE_HPP_
