// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "validation.hpp"

#include <algorithm>
#include <cmath>

#include "batch.hpp"
#include "bounds.hpp"
#include "columns.hpp"
#include "course.hpp"
#include "curve.hpp"
#include "laws.hpp"

namespace closedloop
{

namespace
{
constexpr Index INDEX_COLUMNS = 9, VALUE_COLUMNS = 13, OUTPUT_COLUMNS = 5;
constexpr Index CUT_INDEX_COLUMNS = 8, CUT_VALUE_COLUMNS = 20;
// Operations of an expression: those without a number to work on, and those on two.
constexpr double LAST_CONSTANT = 1, FIRST_OF_TWO = 15, LAST_OPERATION = 23;

bool fits(const Contacts & contacts, Index count)
{
  const Cube<double> & nodes = contacts.nodes;
  return within(contacts.rows, 0, count - 1) && contacts.mode.size == count &&
         has_shape(contacts.now, count, contact::NODE_COLUMNS) &&
         has_shape(contacts.start, count, contact::NODE_COLUMNS) &&
         has_shape(contacts.trial, count, contact::TRIAL_COLUMNS) &&
         nodes.pages == contact::LEVELS + 3 && nodes.rows == count &&
         nodes.columns == contact::NODE_COLUMNS && contacts.search.size == contact::SEARCH_LENGTH;
}

/// `most`: of the joints that may stick; `length`: of a response.
bool fits(const Sticking & sticking, Index count, Index length)
{
  const Index most = sticking.rows.size - 1;
  return most >= 0 && sticking.rows[0] >= 0 && sticking.rows[0] <= most &&
         sticking.hold.size == count && has_shape(sticking.matrix, most, most) &&
         has_shape(sticking.factor, most, most) && sticking.response.rows == most + 1 &&
         sticking.response.columns >= length && sticking.right.size == most &&
         sticking.bound.size == most && sticking.move.size == most &&
         sticking.free.size == most && sticking.share.size == most &&
         sticking.impulse.size == most;
}
}  // namespace

const char * misfit(
  const CutCoordinates & cuts, Index nv, Index bodies, bool planar, Index states)
{
  const Index total = nv + cuts.index.rows;
  const bool good =
    has_shape(cuts.values, cuts.index.rows, CUT_VALUE_COLUMNS) &&
    cuts.index.columns == CUT_INDEX_COLUMNS && cuts.q.size == total &&
    cuts.qd.size == total && cuts.before.size == total && cuts.qdd.size == total &&
    cuts.scratch.rows == bodies &&
    (cuts.index.rows == 0 || cuts.scratch.columns >= (planar ? 6 : 12)) &&
    within(cuts.index, cut_coordinate::ROW_A, 0, 0, bodies - 1) &&
    within(cuts.index, cut_coordinate::ROW_B, 0, 0, bodies - 1) &&
    within(cuts.index, cut_coordinate::FOLLOWED, 0, -1, states - 1) &&
    within(cuts.index, cut_coordinate::IN_PLANE, 0, planar ? 1 : 0, planar ? 1 : 0);
  return good ? nullptr : "coordinates of cut joints";
}

bool has_cuts(const CutCoordinates & cuts, Index count)
{
  return within(cuts.index, cut_coordinate::CUT, 0, 0, count - 1);
}

/// A number as an index below `size`; negative if it is not one.
Index as_place(double number, Index size)
{
  return number >= 0.0 && number < static_cast<double>(size) ? static_cast<Index>(number) : -1;
}

bool is_expression(Values data, Index at)
{
  const Index count = is_place(at, data.size) ? as_place(data[at], data.size) : -1;
  if (count < 1 || 1 + 2 * count > data.size - at) {
    return false;
  }
  // Behind the operations is room for the numbers that wait, from the place after next on.
  Index waiting = 0;
  for (Index k = 0; k < count; ++k) {
    const double operation = std::trunc(data[at + 1 + 2 * k]);
    waiting += operation <= LAST_CONSTANT ? 1 : operation >= FIRST_OF_TWO ? -1 : 0;
    if (!(operation >= 0.0 && operation <= LAST_OPERATION) || waiting < 1 ||
      at + 2 * count + waiting >= data.size)
    {
      return false;
    }
  }
  return true;
}

/// Whether an effect over time has its course: pieces, or expressions.
bool has_course(const EffectTable & effects, Index row)
{
  const Index at = effects.index(row, effect::DATA), entries = effects.index(row, effect::ENTRIES);
  const Index left = effects.data.size - at;
  const Values values = effects.values[row];
  if (values[1] != 1.0) {
    return entries >= 1 && entries <= left / course::COLUMNS;
  }
  if (effects.role[row] != effect::MOTION) {
    return is_expression(effects.data, at);
  }
  const Index rate = as_place(values[3], left), change = as_place(values[4], left);
  return rate >= 0 && change >= 0 && is_expression(effects.data, at) &&
         is_expression(effects.data, at + rate) && is_expression(effects.data, at + change);
}

bool has_equation(const EffectTable & effects, Index row)
{
  const Index begin = effects.index(row, effect::PLACES);
  if (!is_range(begin, begin + effect::EQUATION_PLACES, effects.places.size)) {
    return false;
  }
  const Index * places = effects.places_of(row);
  return is_place(places[effect::CUT_ROW], effects.motions.rows) &&
         places[effect::MULTIPLIER] >= 0 &&
         is_place(places[effect::COLUMN], effects.motions.columns - cut::MOTION_COLUMNS + 1);
}

/// What laws need that the engine has itself, or applies a part of.
Needs needs_of_role(const EffectTable & effects, Index row, bool planar)
{
  switch (effects.role[row]) {
    case effect::INERTIA: return {1, 0, 0, 0, 0, !planar};
    case effect::FRICTION:
      return {1, effects.index(row, effect::LOADED) == 1 ? 1 : 0, 3, 0, 0, !planar};
    case effect::COURSE:
    case effect::MOTION:
      return {0, 0, 3, 0, 0, !planar};
    case effect::DRIVE: return {1, 0, 2, 0, 0, !planar};
    default: return {};
  }
}

bool has(const EffectTable & effects, Index row, const Needs & needs, bool planar)
{
  const Index * index = effects.index.row(row);
  const Index state = index[effect::STATE], at = index[effect::DATA];
  if (!is_place(at, effects.data.size + 1) || index[effect::ENTRIES] < 0) {
    return false;
  }
  const bool summed = index[effect::SUMMED] == 1;
  const Index arms = summed ? index[effect::JOINTS] : 0, left = effects.data.size - at - arms;
  const Index entries = index[effect::ENTRIES] - (summed ? 1 : 0);
  return needs.joints <= (summed ? 1 : index[effect::JOINTS]) &&
         needs.bodies <= index[effect::BODIES] &&
         (needs.bodies == 0 || needs.spatial != planar) &&
         is_range(state, state + needs.states, effects.states.size) &&
         left >= needs.numbers && entries >= 0 &&
         (needs.listed == 0 || (entries >= 1 && entries <= left / needs.listed));
}

/// Whether a law finds all that it reads, and so does the engine of its row.
bool fits(const EffectTable & effects, Index row, Index nv, Index bodies, bool planar)
{
  const Index * index = effects.index.row(row), role = effects.role[row];
  const Index begin = index[effect::PLACES], joints = index[effect::JOINTS];
  const bool alone = role == effect::INERTIA;
  const bool summed = index[effect::SUMMED] == 1;
  if (!is_place(role, effect::INERTIA + 1) || joints < 0 || index[effect::BODIES] < 0 ||
    joints > effects.places.size || index[effect::BODIES] > effects.places.size ||
    (summed && (joints < 1 || joints > effects.data.size)) ||
    (!summed && joints > MOST_COORDINATES) ||
    !is_range(begin, begin + joints + index[effect::BODIES], effects.places.size) ||
    !is_place(index[effect::GAP_OF], effect::EVENT + 1))
  {
    return false;
  }
  const Needs * needs = alone ? nullptr : needs_of(effects.routine[row]);
  const Indices places = effects.places.from(begin);
  return (alone || needs != nullptr) &&
         law_routine::LAW_COLUMNS + index[effect::BODIES] <= effects.calls.size &&
         within(places.part(0, joints), 0, nv + effects.cuts.index.rows - 1) &&
         within(places.part(joints, index[effect::BODIES]), 0, bodies - 1) &&
         has(effects, row, needs_of_role(effects, row, planar), planar) &&
         (alone || has(effects, row, *needs, planar)) &&
         (role != effect::DRIVE || !summed) &&
         (index[effect::LOADED] == 0 || (role == effect::FRICTION && !summed)) &&
         ((role != effect::COURSE && role != effect::MOTION) || has_course(effects, row)) &&
         (role != effect::MOTION || has_equation(effects, row)) &&
         (index[effect::GAP_OF] != effect::OUTLINE ||
         has(effects, row, {0, 0, 0, 0, curve::COLUMNS, !planar}, planar));
}

const char * misfit(const EffectTable & effects, Index nv, Index bodies, bool planar)
{
  const Index count = effects.count(), most = effects.sticking.rows.size - 1;
  const bool arrays =
    effects.enabled.size == count && effects.index.rows == count &&
    effects.routine.size == count &&
    effects.index.columns == INDEX_COLUMNS && has_shape(effects.values, count, VALUE_COLUMNS) &&
    has_shape(effects.output, count, OUTPUT_COLUMNS) && effects.loaded.size == 1 &&
    effects.rates.size == effects.states.size && effects.scale.size == effects.states.size &&
    effects.applied.size == nv + effects.cuts.index.rows &&
    misfit(effects.cuts, nv, bodies, planar, effects.states.size) == nullptr &&
    fits(effects.sticking, count, effects.applied.size) && fits(effects.contacts, count) &&
    effects.code.fits.size == 1 && effects.code.sides.size == count &&
    has_shape(effects.code.present, count, present::PRESENT_COLUMNS) &&
    (effects.reaction.rows == 0 || has_shape(effects.reaction, bodies, planar ? 6 : 12));
  if (!arrays) {
    return "effects";
  }
  if (effects.reaction.rows == 0 && count > 0) {
    return "effects.reaction";
  }
  Index sticks = 0;
  for (Index row = 0; row < count; ++row) {
    if (!fits(effects, row, nv, bodies, planar)) {
      return "effects: what a law reads";
    }
    sticks += effects.role[row] == effect::FRICTION || effects.role[row] == effect::INERTIA ? 1 : 0;
  }
  return sticks <= most ? nullptr : "effects.sticking";
}

const char * misfit(const EffectTable & effects, const Data & data)
{
  const Model & model = data.model;
  const Index all = data.whole.empty() ? data.lam.size : data.whole.lam.size;
  if (effects.applied.size != data.tau.size ||
    effects.sticking.response.columns < data.tau.size + all ||
    !has_cuts(effects.cuts, model.cut.rows))
  {
    return "effects and tau";
  }
  const char * found = misfit(effects, model.joints(), model.tree.rows, model.planar());
  for (Index row = 0; found == nullptr && row < effects.count(); ++row) {
    if (effects.role[row] == effect::MOTION &&
      effects.places_of(row)[effect::MULTIPLIER] >= all)
    {
      found = "effects: multiplier of a motion";
    }
  }
  return found;
}

}  // namespace closedloop
