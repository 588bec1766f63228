// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "validation.hpp"

#include <algorithm>
#include <cmath>

#include "bounds.hpp"
#include "dispatch.hpp"

namespace closedloop
{

namespace
{
constexpr Index INDEX_COLUMNS = 6, VALUE_COLUMNS = 13, OUTPUT_COLUMNS = 5;
constexpr Index CUT_INDEX_COLUMNS = 8, CUT_VALUE_COLUMNS = 20;
// Among the values of a cable in space: the row of the body that the axis turns with.
constexpr Index CARRIER = 3;
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

/// Whether an expression is whole: it has a result, and every operation has its operands.
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

/// How many entries of a kind are data, and numbers each; laws with a fixed number have one.
Index numbers_of_entry(Index kind, bool planar)
{
  switch (kind) {
    case effect::PRESCRIBED_TORQUE:
    case effect::PRESCRIBED_FORCE:
    case effect::SPATIAL_PRESCRIBED_FORCE:
    case effect::PRESCRIBED_MOTION:
      return 10;
    case effect::JOINT_FORCE_TABLE:
    case effect::POINT_FORCE_TABLE:
    case effect::SPATIAL_FORCE_TABLE:
      return 6;
    case effect::CABLE:
    case effect::SPATIAL_CABLE:
      return planar ? 5 : 6;
    case effect::CURVE_CONTACT:
    case effect::FACE_CONTACT:
      return 8;
    default:
      return 0;
  }
}

/// Numbers of a law with a fixed number of them.
Index fixed_numbers(Index kind)
{
  return kind == effect::BUSHING ? 8 : kind == effect::SPATIAL_BUSHING ? 30 :
    kind == effect::SPATIAL_BODY_CONTACT ? 11 : kind == effect::SPATIAL_FLUID_DRAG ? 21 :
    kind == effect::ORIENTATION_SPRING ? 18 : 0;
}

/// Whether the joints that an effect has with moment arms are there.
bool has_arms(Values data, Index count, Index joints)
{
  if (count < 0 || count > data.size / 2) {
    return false;
  }
  for (Index k = 0; k < count; ++k) {
    if (as_place(data[2 * k], joints) < 0) {
      return false;
    }
  }
  return true;
}

/// Whether the joints of a tendon are there, and its coefficients behind them.
bool is_tendon(Values data, Index entries, Values values, Index joints)
{
  const Index springs = as_place(values[0], data.size), dampers = as_place(values[1], data.size);
  return springs >= 0 && dampers >= 0 && springs + dampers <= data.size &&
    has_arms(data.part(0, data.size - springs - dampers), entries - 2, joints);
}

bool is_traced(Index kind) {return kind == effect::TRACED || kind == effect::SPATIAL_TRACED;}

/// Number of states of a traced law: time, its own, and dissipation or work; negative where an
/// entry is invalid, or a measured coordinate does not exist.
Index states_of_traced(Values data, Index count, Index joints, Index bodies, bool planar)
{
  if (count < 0 || count > traced::MOST_COORDINATES ||
    data.size < (count + 1) * traced::COLUMNS)
  {
    return -1;
  }
  const Index clock = as_place(data[traced::CLOCK], 2);
  const Index own = as_place(data[traced::OWN], traced::MOST_STATES + 1);
  for (Index k = 1; k <= count; ++k) {
    const Values entry = data.part(k * traced::COLUMNS, traced::COLUMNS);
    const Index kind = as_place(entry[traced::MEASURED], traced::COMPONENT + 1);
    const Index first = as_place(entry[traced::FIRST], kind == traced::JOINT ? joints : bodies);
    const Index second = as_place(
      entry[traced::SECOND], kind == traced::COMPONENT ? (planar ? 2 : 3) : bodies);
    if (kind < 0 || first < 0 || second < 0) {
      return -1;
    }
  }
  return clock < 0 || own < 0 ? -1 : clock + own + 1;
}

bool is_course(Index kind) {return numbers_of_entry(kind, true) == 10;}

bool has_data(const EffectTable & effects, Index row, Index joints, Index bodies, bool planar)
{
  const Index kind = effects.kind[row], at = effects.index(row, effect::DATA);
  const Index entries = effects.index(row, effect::ENTRIES), left = effects.data.size - at;
  const Values values = effects.values[row];
  if (at < 0 || left < fixed_numbers(kind)) {
    return false;
  }
  if (kind == effect::TENDON) {
    return is_tendon(effects.data.from(at), entries, values, joints);
  }
  if (kind == effect::JOINT_FRICTION || kind == effect::REFLECTED_INERTIA) {
    return has_arms(effects.data.from(at), entries, joints);
  }
  if (is_course(kind) && values[1] == 1.0) {
    if (kind != effect::PRESCRIBED_MOTION) {
      return is_expression(effects.data, at);
    }
    const Index rate = as_place(values[4], left), change = as_place(values[5], left);
    return rate >= 0 && change >= 0 && is_expression(effects.data, at) &&
      is_expression(effects.data, at + rate) && is_expression(effects.data, at + change);
  }
  const Index each = numbers_of_entry(kind, planar);
  if (each > 0 && (entries < 1 || entries > left / each)) {
    return false;
  }
  if (kind == effect::CABLE || kind == effect::SPATIAL_CABLE) {
    for (Index k = 0; k < entries; ++k) {
      if (as_place(effects.data[at + each * k], bodies) < 0) {
        return false;
      }
    }
    // Less than zero where no pulley has a radius.
    return planar || !(values[CARRIER] >= 0.0) || as_place(values[CARRIER], bodies) >= 0;
  }
  return true;
}

/// States that a law reads or writes.
Index states_of(Index kind, bool loaded)
{
  switch (kind) {
    case effect::JOINT_SPRING:
    case effect::ORIENTATION_SPRING:
    case effect::REFLECTED_INERTIA:
      return loaded ? 2 : 0;
    case effect::JOINT_FRICTION:
    case effect::PRESCRIBED_TORQUE:
    case effect::PRESCRIBED_FORCE:
    case effect::SPATIAL_PRESCRIBED_FORCE:
    case effect::PRESCRIBED_MOTION:
      return 3;
    case effect::ACTUATOR:
    case effect::FLUID_DRAG:
    case effect::SPATIAL_FLUID_DRAG:
      return 2;
    default:
      return loaded ? 2 : 1;
  }
}

bool acts_in_joint(Index kind)
{
  switch (kind) {
    case effect::JOINT_DAMPING:
    case effect::JOINT_SPRING:
    case effect::END_STOP:
    case effect::JOINT_FRICTION:
    case effect::ACTUATOR:
    case effect::PRESCRIBED_TORQUE:
    case effect::JOINT_FORCE_TABLE:
    case effect::REFLECTED_INERTIA:
      return true;
    default:
      return false;
  }
}

/// Whether a law finds all that it reads.
bool fits(const EffectTable & effects, Index row, Index nv, Index bodies, bool planar)
{
  const Index kind = effects.kind[row], * index = effects.index.row(row);
  const Index joints = nv + effects.cuts.index.rows, first = index[effect::FIRST];
  const bool loaded = index[effect::LOADED] == 1;
  if (is_traced(kind)) {
    const Index at = index[effect::DATA];
    const Index states = is_range(at, at, effects.data.size) ?
      states_of_traced(effects.data.from(at), first, joints, bodies, planar) : -1;
    return states >= 0 && index[effect::SECOND] != 0 && planar == (kind == effect::TRACED) &&
           is_range(index[effect::STATE], index[effect::STATE] + states, effects.states.size);
  }
  if (!is_place(kind, effect::KINDS) || law_of(kind) == nullptr || !is_range(
      index[effect::STATE], index[effect::STATE] + states_of(kind, loaded), effects.states.size) ||
    !has_data(effects, row, joints, bodies, planar))
  {
    return false;
  }
  if (kind == effect::PRESCRIBED_MOTION) {
    const Index last = effects.motions.columns - cut::MOTION_COLUMNS;
    return is_place(first, effects.motions.rows) && index[effect::SECOND] >= 0 &&
      as_place(effects.values(row, 3), last + 1) >= 0;
  }
  return is_place(first, acts_in_joint(kind) ? joints : bodies) &&
    is_place(index[effect::SECOND], bodies);
}

const char * misfit(const EffectTable & effects, Index nv, Index bodies, bool planar)
{
  const Index count = effects.count(), most = effects.sticking.rows.size - 1;
  const bool arrays =
    effects.enabled.size == count && effects.index.rows == count &&
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
    sticks += effects.kind[row] == effect::JOINT_FRICTION ||
      effects.kind[row] == effect::REFLECTED_INERTIA ? 1 : 0;
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
    if (effects.kind[row] == effect::PRESCRIBED_MOTION &&
      effects.index(row, effect::SECOND) >= all)
    {
      found = "effects: multiplier of a motion";
    }
  }
  return found;
}

}  // namespace closedloop
