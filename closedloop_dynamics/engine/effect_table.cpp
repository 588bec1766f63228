// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "effect_table.hpp"

#include <algorithm>
#include <cmath>
#include <limits>
#include <stdexcept>
#include <utility>

#include "bounds.hpp"
#include "curve.hpp"
#include "laws.hpp"
#include "profile.hpp"

namespace closedloop
{

namespace
{
constexpr Index VALUE_COLUMNS = 13, OUTPUT_COLUMNS = 5;
// Operations of an expression: those without a number to work on, and those on two.
constexpr double LAST_CONSTANT = 1, FIRST_OF_TWO = 15, LAST_OPERATION = 23;

/// Sum over elements.
template<class Size>
Index sum_over(const std::vector<EffectElement> & elements, Size && size)
{
  Index total = 0;
  for (const EffectElement & each : elements) {
    total += size(each);
  }
  return total;
}

Index count_places(const EffectElement & element)
{
  return element.joints.size + element.bodies.size + element.equation.size;
}

bool sticks(Index role) {return role == effect::FRICTION || role == effect::INERTIA;}

/// Copy to where there is room for no less.
template<class Number>
void put_in(Vector<Number> from, Vector<Number> to) {std::copy_n(from.data, from.size, to.data);}

/// A number as an index below `size`; negative if it is not one.
Index as_place(double number, Index size)
{
  return number >= 0.0 && number < static_cast<double>(size) ? static_cast<Index>(number) : -1;
}

}  // namespace

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

namespace
{
/// Whether an effect over time has its profile: pieces, or expressions.
bool has_profile(const EffectTable & effects, Index row)
{
  const Index at = effects.first_number[row], entries = effects.entries[row];
  const Index left = effects.data.size - at;
  const Values values = effects.values[row];
  if (values[1] != 1.0) {
    return entries >= 1 && entries <= left / profile::COLUMNS;
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
  const Index begin = effects.first_place[row];
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
      return {1, effects.feels[row] == 1 ? 1 : 0, 3, 0, 0, !planar};
    case effect::PROFILE:
    case effect::MOTION:
      return {0, 0, 3, 0, 0, !planar};
    case effect::DRIVE: return {1, 0, 2, 0, 0, !planar};
    default: return {};
  }
}

bool has(const EffectTable & effects, Index row, const Needs & needs, bool planar)
{
  const Index state = effects.first_state[row], at = effects.first_number[row];
  if (!is_place(at, effects.data.size + 1) || effects.entries[row] < 0) {
    return false;
  }
  const bool summed = effects.summed[row] == 1;
  const Index arms = summed ? effects.joints[row] : 0, left = effects.data.size - at - arms;
  const Index entries = effects.entries[row] - (summed ? 1 : 0);
  return needs.joints <= (summed ? 1 : effects.joints[row]) &&
         needs.bodies <= effects.bodies[row] &&
         (needs.bodies == 0 || needs.spatial != planar) &&
         is_range(state, state + needs.states, effects.states.size) &&
         left >= needs.numbers && entries >= 0 &&
         (needs.listed == 0 || (entries >= 1 && entries <= left / needs.listed));
}
}  // namespace

StaticFriction::StaticFriction(Index effects, Index most, Index width)
: rows(most + 1), hold(effects), response(most + 1, width), matrix(most, most), right(most),
  bound(most), move(most), factor(most, most), free(most), share(most), holds(effects),
  load(2), impulse(most), kept(most + 2), kept_limit(most) {}

Contacts::Contacts(Index effects, Array<Indices> rows)
: rows(std::move(rows)), mode(effects), now(effects, contact::NODE_COLUMNS),
  start(effects, contact::NODE_COLUMNS), trial(effects, contact::TRIAL_COLUMNS),
  nodes(contact::LEVELS + 3, effects, contact::NODE_COLUMNS), search(contact::SEARCH_LENGTH),
  passed(1) {}

CutCoordinates::CutCoordinates(const Model & model, Indexes given, Table numbers, Index states)
: index(Array<Indexes>::copy_of(given)), values(Array<Table>::copy_of(numbers)),
  q(model.joints() + given.rows), qd(q.size), before(q.size), qdd(q.size),
  scratch(model.tree.rows, 2 * model.size())
{
  using namespace cut_coordinate;  // NOLINT: columns of one table
  const Index bodies = model.tree.rows;
  if (!(index.rows == 0 || index.columns == CUT_INDEX_COLUMNS) ||
    !(index.rows == values.rows && (index.rows == 0 || values.columns == CUT_VALUE_COLUMNS)) ||
    !within(index, ROW_A, 0, 0, bodies - 1) || !within(index, ROW_B, 0, 0, bodies - 1) ||
    !within(index, FOLLOWED, 0, -1, states - 1) ||
    !within(index, CUT, 0, 0, model.cut.rows - 1) ||
    !within(index, IN_PLANE, 0, model.planar() ? 1 : 0, model.planar() ? 1 : 0))
  {
    throw std::invalid_argument("coordinates of cut joints: expected rows of the model");
  }
}

EffectTable::EffectTable(
  const Model & model, const Model & all, const std::vector<EffectElement> & elements,
  Indexes cut_index, Table cut_values)
{
  const Index count = static_cast<Index>(elements.size());
  for (Array<Indices> * each : {
      &role, &routine, &enabled, &first_state, &first_place, &joints, &bodies, &summed, &feels,
      &first_number, &entries, &gap})
  {
    *each = Array<Indices>(count);
    each->is_constant = each != &enabled;
  }
  Index own = sum_over(elements, [](const EffectElement & each) {return each.scale.size;});
  Index most_bodies = 0, contacts_listed = 0;
  for (const EffectElement & each : elements) {
    most_bodies = std::max(most_bodies, each.bodies.size);
    contacts_listed += each.gap != effect::NO_GAP ? 1 : 0;
    if (each.role == effect::MOTION) {
      motions = Array<Table>(model.cut_point);
    }
  }
  for (Index k = 0; cut_index.columns > cut_coordinate::FOLLOWED && k < cut_index.rows; ++k) {
    own += cut_index(k, cut_coordinate::FOLLOWED) >= 0 ? 1 : 0;
  }
  places = Array<Indices>(sum_over(elements, count_places));
  calls = Array<Indices>(law_routine::LAW_COLUMNS + most_bodies);
  values = Array<Table>(count, VALUE_COLUMNS);
  output = Array<Table>(count, OUTPUT_COLUMNS);
  states = Array<Values>(own);
  rates = Array<Values>(own);
  scale = Array<Values>(own);
  scale.fill(1.0);
  loaded = Array<Indices>(1);
  applied = Array<Values>(model.joints() + cut_index.rows);
  reaction = Array<Table>(model.tree.rows, 2 * model.size());
  data = Array<Values>(
    sum_over(elements, [](const EffectElement & each) {return each.numbers.size;}));
  for (Array<Indices> * each : {&places, &calls, &loaded}) {
    each->is_constant = true;
  }
  values.is_constant = data.is_constant = true;
  static_friction = StaticFriction(
    count, sum_over(elements, [](const EffectElement & each) {return sticks(each.role) ? 1 : 0;}),
    applied.size + all.equations());
  cuts = CutCoordinates(model, cut_index, cut_values, own);
  cuts.index.is_constant = cuts.values.is_constant = true;
  code.fits = Array<Indices>(1);
  code.present = Array<Table>(count, present::PRESENT_COLUMNS);
  code.present.fill(std::numeric_limits<double>::quiet_NaN());
  code.sides = Array<Values>(count);
  Array<Indices> gaps(contacts_listed);
  Index state = 0, place = 0, number = 0, listed = 0;
  for (Index row = 0; row < count; ++row) {
    const EffectElement & element = elements[static_cast<std::size_t>(row)];
    first_state[row] = state;
    first_place[row] = place;
    first_number[row] = number;
    if (element.values.size > VALUE_COLUMNS || element.initial.size != element.scale.size) {
      throw std::invalid_argument("effects: more parameters than there is room for");
    }
    put_in(element.initial, states.from(state));
    write(row, element);
    state += element.scale.size;
    place += count_places(element);
    number += element.numbers.size;
    if (element.gap != effect::NO_GAP) {
      gaps[listed++] = row;
    }
  }
  contacts = Contacts(count, std::move(gaps));
  contacts.rows.is_constant = true;
  for (Index row = 0; row < count; ++row) {
    if (const char * missing = lacks(row)) {
      throw std::invalid_argument(missing);
    }
  }
}

void EffectTable::write(Index row, const EffectElement & element)
{
  role[row] = element.role;
  routine[row] = element.routine;
  enabled[row] = element.enabled ? 1 : 0;
  joints[row] = element.joints.size;
  bodies[row] = element.bodies.size;
  summed[row] = element.summed ? 1 : 0;
  // What does not act feels nothing.
  feels[row] = element.loaded && element.enabled ? 1 : 0;
  entries[row] = element.entries;
  gap[row] = element.gap;
  loaded[0] = std::count(feels.begin(), feels.end(), 1);
  const Index place = first_place[row];
  put_in(element.joints, places.from(place));
  put_in(element.bodies, places.from(place + element.joints.size));
  put_in(element.equation, places.from(place + element.joints.size + element.bodies.size));
  values[row].fill(0.0);
  put_in(element.values, values[row]);
  put_in(element.numbers, data.from(first_number[row]));
  put_in(element.scale, scale.from(first_state[row]));
  code.present(row, present::NUMBER) = std::numeric_limits<double>::quiet_NaN();
  if (!element.enabled) {
    output[row].fill(0.0);
  }
}

void EffectTable::put(Index row, const EffectElement & element)
{
  const auto room = [&](const Array<Indices> & first, Index total) {
      return (row + 1 < count() ? first[row + 1] : total) - first[row];
    };
  Index followed = 0;
  for (Index k = 0; k < cuts.index.rows; ++k) {
    followed += cuts.index(k, cut_coordinate::FOLLOWED) >= 0 ? 1 : 0;
  }
  if (!is_place(row, count()) || element.values.size > VALUE_COLUMNS ||
    count_places(element) > room(first_place, places.size) ||
    element.numbers.size > room(first_number, data.size) ||
    element.scale.size != room(first_state, states.size - followed))
  {
    throw std::invalid_argument("effect: expected one with no more places, numbers and states");
  }
  // On a copy, so that nothing is written that cannot be read.
  EffectTable tried(*this);
  Copies separate;
  tried.arrays(separate);
  tried.write(row, element);
  const char * missing = tried.lacks(row);
  if (missing == nullptr &&
    std::count_if(tried.role.begin(), tried.role.end(), sticks) >= static_friction.rows.size)
  {
    missing = "effects: expected no more that may stick than at first";
  }
  if (missing != nullptr) {
    throw std::invalid_argument(missing);
  }
  write(row, element);
}

const char * EffectTable::lacks(Index row) const
{
  const EffectTable & effects = *this;
  const Index begin = first_place[row], most = places.size, reads = joints[row];
  const bool alone = role[row] == effect::INERTIA, is_sum = summed[row] == 1;
  const bool planar = reaction.columns == 6;
  const Needs * needs = alone ? nullptr : needs_of(routine[row]);
  const Indices own = places.from(begin);
  const bool good =
    entries[row] >= 0 && (is_sum ? reads >= 1 && reads <= data.size : reads <= MOST_COORDINATES) &&
    is_range(begin, begin + reads + bodies[row], most) && (alone || needs != nullptr) &&
    law_routine::LAW_COLUMNS + bodies[row] <= calls.size &&
    within(own.part(0, reads), 0, applied.size - 1) &&
    within(own.part(reads, bodies[row]), 0, reaction.rows - 1) &&
    has(effects, row, needs_of_role(effects, row, planar), planar) &&
    (alone || has(effects, row, *needs, planar)) &&
    (role[row] != effect::DRIVE || !is_sum) &&
    (feels[row] == 0 || (role[row] == effect::FRICTION && !is_sum)) &&
    ((role[row] != effect::PROFILE && role[row] != effect::MOTION) || has_profile(effects, row)) &&
    (role[row] != effect::MOTION || has_equation(effects, row)) &&
    (gap[row] != effect::OUTLINE ||
    has(effects, row, {0, 0, 0, 0, curve::COLUMNS, !planar}, planar));
  return good ? nullptr : "effects: expected all that a law reads, within the mechanism";
}

bool EffectTable::fits(const Model & model, const Model & all) const
{
  bool good = applied.size == model.joints() + cuts.index.rows &&
    has_shape(reaction, model.tree.rows, 2 * model.size()) &&
    static_friction.response.columns >= applied.size + all.equations() &&
    (motions.rows == 0 || motions.data == model.cut_point.data) &&
    within(cuts.index, cut_coordinate::CUT, 0, 0, model.cut.rows - 1);
  for (Index row = 0; good && row < count(); ++row) {
    good = role[row] != effect::MOTION ||
      places_of(row)[effect::MULTIPLIER] < all.equations();
  }
  return good;
}

}  // namespace closedloop
