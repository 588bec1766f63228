// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "contact_events.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "curve.hpp"
#include "evaluation.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
using contact::DEVIATION;
using contact::ERROR;
using contact::GAP;
using contact::PLACE;
using contact::RATE;

constexpr double INFINITE = std::numeric_limits<double>::infinity();
// Gaps below this are zero [m]: a contact begins or ends there.
constexpr double CLOSED = 1e-11;
// Shortest part of a step that is searched if bodies touch at its start, at gaps up to NO_GAP [m].
constexpr double LEAST_PART = 1e-6, NO_GAP = 1e-9;
// Bisections of that part.
constexpr int HALVINGS = 50;
// Relative width at which the bracket of an event is closed.
constexpr double SAME = 1e-12;
// Rates may be this much faster between the evaluations of a step.
constexpr double FASTER = 1.25;
// A path is resolved where it is no longer than the largest gap so far, or than so many chords:
// then a point on a circle cannot approach and turn back undetected.
constexpr double CHORDS = 2.0;
// The error of a smaller interval may be this many times the expected one.
constexpr double SAFER = 2.0;
// Share of the larger gap by which the path may depart from its chord.
constexpr double DEVIATION_SHARE = 0.25;
// Evaluations on the wrong side, relative to the possible change of the gap, that do not count.
constexpr double SLIGHT = 0.01;
// Cuts of one step on suspicion alone, and cuts that refine the end of a step that agrees.
constexpr double MOST_SUSPICIONS = 4.0, MOST_REFINED = 10.0;
// Even parts of an interval between which a cubic is judged, beside its turning points.
constexpr int PLACES = 8;
// How far a touching body is from velocity times time, as a share of the way that it would have
// gone, and relative to its depth: beyond both, a method has stepped over the whole impact.
constexpr double FAR = 0.25, DEPTHS = 10.0;
// Part of a refused trial that is tried next.
constexpr double SHORTER = 0.2;
// Dissipated energy may fall by this share of it, or of the stored energy, by errors of
// integration.
constexpr double FALLS = 1e-3;
// Columns of EffectTable.values of contacts between bodies.
constexpr Index RADIUS = 4, OTHER_RADIUS = 5;

/// Prepare for the evaluations of another trial.
void clear(const Contacts & contacts)
{
  for (Index row : contacts.rows) {
    for (Index column : {contact::FASTEST, contact::SPEED, contact::WRONG}) {
      contacts.trial(row, column) = 0.0;
    }
  }
}

void clear_bracket(Values search)
{
  search[contact::LOW] = 0.0;
  search[contact::HIGH] = INFINITE;
  search[contact::SUSPECTED] = search[contact::REFINED] = 0.0;
}

void forget(const Contacts & contacts)
{
  clear_bracket(contacts.search);
  clear(contacts);
}

/// Store the gaps of the laws as those of the start.
void store_start(const Contacts & contacts, Index row)
{
  for (Index i = 0; i < ERROR; ++i) {
    contacts.start(row, i) = contacts.now(row, i);
  }
}

/// A gap by the share of an interval.
struct Cubic
{
  double start;
  double slope;
  double quadratic;
  double cubic;

  /// Through the gaps and rates of two nodes, `size` apart [s].
  Cubic(const double * left, const double * right, double sign, double size)
  : start(sign * left[GAP]), slope(sign * size * left[RATE])
  {
    const double rise = sign * right[GAP] - start, last = sign * size * right[RATE];
    quadratic = 3.0 * rise - 2.0 * slope - last;
    cubic = slope + last - 2.0 * rise;
  }

  double operator()(double share) const
  {
    return start + share * (slope + share * (quadratic + share * cubic));
  }

  /// Where slope + 2 quadratic x + 3 cubic x^2 = 0, the lesser first; 1 where nowhere.
  std::pair<double, double> turning_points() const
  {
    double one = 1.0, other = 1.0;
    const double root = quadratic * quadratic - 3.0 * cubic * slope;
    if (root >= 0.0) {
      const double sum = -(quadratic + std::copysign(std::sqrt(root), quadratic));
      one = sum != 0.0 ? slope / sum : 1.0;
      other = cubic != 0.0 ? sum / (3.0 * cubic) : 1.0;
    }
    return {std::min(one, other), std::max(one, other)};
  }
};

/// Share of an interval at which a gap first has the sign that ends it, by the cubic between its
/// turning points; 1 if none.
double crossing(const double * left, const double * right, double sign, double size)
{
  const Cubic cubic(left, right, sign, size);
  const auto [one, other] = cubic.turning_points();
  double before = 0.0;
  for (double after : {one, other, 1.0}) {
    if (before < after && after <= 1.0) {
      if (cubic(after) > CLOSED) {
        for (int n = 0; n < HALVINGS; ++n) {
          const double middle = 0.5 * (before + after);
          (cubic(middle) > 0.0 ? after : before) = middle;
        }
        return after;
      }
      before = after;
    }
  }
  return 1.0;
}

/// The sign by which a gap contradicts its mode.
double wrong_sign(const Contacts & contacts, Index row)
{
  return contacts.mode[row] == contact::TOUCHING ? 1.0 : -1.0;
}

/// Whether the mode of a contact is fixed, whatever its gap.
bool is_judged(const EffectTable & effects, Index row)
{
  return effects.enabled[row] == 1 && effects.contacts.mode[row] != contact::UNDECIDED;
}

/// Whether a contact has less dissipated energy than before a step, by more than errors of
/// integration: no law does that, except laws that account for it otherwise.
bool has_gained(const EffectTable & effects, Index row)
{
  const double lost = effects.states[effects.first_state[row]];
  const double before = effects.contacts.trial(row, contact::LOST);
  return effects.gap[row] != effect::EVENT &&
         lost < before - FALLS * (std::abs(before) + effects.output(row, effect::STORED)) - CLOSED;
}

/// Whether a gap has changed otherwise than by its rates.
bool is_far(const double * start, const double * now, double size)
{
  const double way = size * std::max(std::abs(start[RATE]), std::abs(now[RATE]));
  const double missed =
    std::abs(now[GAP] - start[GAP] - 0.5 * size * (start[RATE] + now[RATE]));
  return missed > FAR * way &&
         missed > DEPTHS * std::max(std::abs(start[GAP]), std::abs(now[GAP]));
}

/// Lower the upper end of the bracket to a part [s] that contradicts the modes.
void reject_part(Values search, double size)
{
  search[contact::HIGH] = std::min(search[contact::HIGH], size);
  if (search[contact::LOW] >= search[contact::HIGH]) {
    search[contact::LOW] = 0.0;
  }
}

/// A part of a step to be tried [s], and the contact that is sought.
struct Trial
{
  double part;
  Index sought;
};

/// Change a mode that ends as soon as it begins; where it was changed before, the gap decides in
/// each evaluation.
Trial change(const Contacts & contacts, Index row, double size)
{
  if (contacts.trial(row, contact::CHANGED) == 0.0) {
    contacts.mode[row] =
      contacts.mode[row] == contact::TOUCHING ? contact::FREE : contact::TOUCHING;
  } else {
    // It bounces too fast to be followed.
    contacts.mode[row] = contact::UNDECIDED;
  }
  contacts.trial(row, contact::CHANGED) = 1.0;
  contacts.search[contact::HIGH] = INFINITE;
  return {2.0 * size, -2};
}

/// Put both ends of a trial on the stack.
void begin_look(const Contacts & contacts)
{
  const Values & search = contacts.search;
  const Table first = contacts.nodes[0], last = contacts.nodes[1];
  search[contact::TOP] = 1.0;
  search[contact::SHARES] = 0.0;
  search[contact::SHARES + 1] = 1.0;
  search[contact::NODE_LEVELS + 1] = 0.0;
  for (Index row : contacts.rows) {
    for (Index i = 0; i < ERROR; ++i) {
      first(row, i) = contacts.start(row, i);
      last(row, i) = contacts.now(row, i);
    }
    last(row, ERROR) = last(row, DEVIATION) = INFINITE;
    contacts.trial(row, contact::LARGEST) =
      std::max(std::abs(first(row, GAP)), std::abs(last(row, GAP)));
  }
}

/// Judge the end of a trial.
Trial judge_end(const EffectTable & effects, double size, Index sought)
{
  const Contacts & contacts = effects.contacts;
  const Values & search = contacts.search;
  double & low = search[contact::LOW], & high = search[contact::HIGH];
  double least = 1.0;
  Index first = -1;
  bool refused = false;
  for (Index row : contacts.rows) {
    if (!is_judged(effects, row)) {
      continue;
    }
    const double * start = contacts.start.row(row), * now = contacts.now.row(row);
    const double sign = wrong_sign(contacts, row);
    // Written so that a NaN contradicts.
    if (!(sign * now[GAP] <= CLOSED)) {
      const double share = crossing(start, now, sign, size);
      if (share < least || first < 0) {
        least = share;
        first = row;
      }
    }
    refused = refused || has_gained(effects, row) || (sign > 0.0 && is_far(start, now, size));
  }
  if (first >= 0) {
    reject_part(search, size);
    if (!(least > LEAST_PART) && std::abs(contacts.start(first, GAP)) <= NO_GAP) {
      return change(contacts, first, size);
    }
    double tried = least * size;
    if (!(low < tried && tried < high)) {
      tried = 0.5 * (low + high);
    }
    if (high - low <= SAME * high) {
      tried = low;
    }
    return {tried, first};
  }
  if (refused) {
    reject_part(search, size);
    low = 0.0;
    return {SHORTER * size, -1};
  }
  if (sought >= 0) {
    const double gap = contacts.now(sought, GAP), rate = contacts.now(sought, RATE);
    low = std::max(low, size);
    search[contact::REFINED] += 1.0;
    if (std::abs(gap) > CLOSED && search[contact::REFINED] <= MOST_REFINED &&
      high - low > SAME * high)
    {
      double tried = size - gap / rate;
      // The rate shows whether the contact lies ahead.
      if (!(size < tried && tried < high)) {
        tried = 0.5 * (low + high);
      }
      return {tried, sought};
    }
  }
  begin_look(contacts);
  return {size, sought};
}

/// Put the state at a share of a trial on the stack; a shorter part where a contact begins or ends
/// there.
Trial push(const EffectTable & effects, double size, double share)
{
  const Contacts & contacts = effects.contacts;
  const Values & search = contacts.search;
  const Index top = static_cast<Index>(search[contact::TOP]);
  const Table lefts = contacts.nodes[0], rights = contacts.nodes[top];
  const Table middles = contacts.nodes[top + 1];
  const double begin_share = search[contact::SHARES];
  const double length = search[contact::SHARES + top] - begin_share;
  const double along = (share - begin_share) / length;
  // Shape of the error within the interval, and how much of it is left in its parts.
  const double shape = along * (1.0 - along), longer = std::max(along, 1.0 - along);
  const double longer_square = longer * longer;
  double earliest = 1.0;
  Index first = -1;
  for (Index row : contacts.rows) {
    if (!is_judged(effects, row)) {
      continue;
    }
    const double * now = contacts.now.row(row);
    const double * left = lefts.row(row), * right = rights.row(row);
    const double sign = wrong_sign(contacts, row);
    if (!(sign * now[GAP] <= CLOSED)) {
      const double found =
        begin_share + along * length * crossing(left, now, sign, along * length * size);
      if (found < earliest) {
        earliest = found;
        first = row;
      }
    }
    const Cubic cubic(left, right, 1.0, length * size);
    double error = std::abs(now[GAP] - cubic(along)) / (16.0 * shape * shape);
    double apart = 0.0;
    for (Index i = PLACE; i < ERROR; ++i) {
      const double departure = now[i] - (left[i] + along * (right[i] - left[i]));
      apart += departure * departure;
    }
    for (Index i = 0; i < ERROR; ++i) {
      middles(row, i) = now[i];
    }
    error = SAFER * error * (longer_square * longer_square);
    apart = SAFER * std::sqrt(apart) / (4.0 * shape) * longer * longer;
    for (const Table & node : {rights, middles}) {
      node(row, ERROR) = error;
      node(row, DEVIATION) = apart;
    }
    contacts.trial(row, contact::LARGEST) =
      std::max(contacts.trial(row, contact::LARGEST), std::abs(now[GAP]));
  }
  if (first >= 0) {
    reject_part(search, size);
    search[contact::LOW] = 0.0;
    if (!(earliest > LEAST_PART) && std::abs(contacts.start(first, GAP)) <= NO_GAP) {
      return change(contacts, first, size);
    }
    return {earliest * size, first};
  }
  search[contact::NODE_LEVELS + top] += 1.0;
  search[contact::NODE_LEVELS + top + 1] = search[contact::NODE_LEVELS + top];
  search[contact::SHARES + top + 1] = share;
  search[contact::TOP] = static_cast<double>(top) + 1.0;
  return {size, -1};
}

/// How near the chord of a path comes to a body between its ends, as a gap [m]; `along` is within
/// the interval, since it is to be parted there.
ChordDistance nearest_to_body(
  const EffectTable & effects, Index row, const double * left, const double * right)
{
  const double radius = effects.values(row, RADIUS);
  if (effects.gap[row] == effect::OUTLINE) {
    const ChordDistance found = nearest_to_chord(
      pieces_of_curve(effects, row), vector2(left + PLACE), vector2(right + PLACE));
    return {found.distance - radius, found.along};
  }
  double inward = 0.0, square = 0.0;
  for (Index i = PLACE; i < ERROR; ++i) {
    const double move = right[i] - left[i];
    inward -= move * left[i];
    square += move * move;
  }
  if (!(0.0 < inward && inward < square)) {
    return {INFINITE, 0.5};
  }
  const double along = inward / square;
  double between = 0.0, one = 0.0, other = 0.0;
  for (Index i = PLACE; i < ERROR; ++i) {
    const double coordinate = left[i] + along * (right[i] - left[i]);
    between += coordinate * coordinate;
    one += left[i] * left[i];
    other += right[i] * right[i];
  }
  between = std::sqrt(between);
  if (between > std::sqrt(std::min(one, other)) - NO_GAP) {
    return {INFINITE, 0.5};
  }
  return {between - effects.values(row, OTHER_RADIUS) - radius,
    std::min(0.99, std::max(0.01, along))};
}

/// A place within an interval at which a contact may begin or end unseen.
struct Suspicion
{
  double along;  ///< Share of the interval; 1 where it is clear
  bool followed;  ///< Whether the interval is short enough to be judged at all
};

/// Examine an interval between two nodes, `length` long, of a trial of a size [s].
Suspicion suspect(
  const EffectTable & effects, Index row, const double * left, const double * right,
  double length, double size)
{
  const Contacts & contacts = effects.contacts;
  const double * trial = contacts.trial.row(row);
  const double sign = wrong_sign(contacts, row);
  const double one = -sign * left[GAP], other = -sign * right[GAP];
  const bool finite = contacts.mode[row] == contact::FREE && is_finite(effects, row);
  const double fastest = trial[finite ? contact::SPEED : contact::FASTEST];
  const bool slight = trial[contact::WRONG] <= std::max(CLOSED, SLIGHT * size * fastest);
  if (slight && one + other > FASTER * fastest * length) {
    return {1.0, true};
  }
  bool resolved = fastest * length <= trial[contact::LARGEST];
  if (finite) {
    const double deviation = right[DEVIATION];
    double chord = 0.0;
    for (Index i = PLACE; i < ERROR; ++i) {
      const double move = right[i] - left[i];
      chord += move * move;
    }
    resolved = resolved || fastest * length <= CHORDS * std::sqrt(chord);
    const ChordDistance nearest = nearest_to_body(effects, row, left, right);
    if (!(resolved && deviation <= DEVIATION_SHARE * std::max(one, other) + CLOSED)) {
      return {0.5, false};
    }
    return {nearest.distance < deviation ? nearest.along : 1.0, true};
  }
  if (contacts.mode[row] == contact::TOUCHING && slight) {
    // Error control follows a body that touches.
    return {crossing(left, right, sign, length) == 1.0 ? 1.0 : 0.5, true};
  }
  if (!resolved) {
    return {0.5, false};
  }
  const double error = right[ERROR];
  if (!(error < INFINITE)) {
    return {0.5, true};
  }
  const Cubic cubic(left, right, -sign, length);
  const auto [first, second] = cubic.turning_points();
  // A contact that begins or ends just here has such a gap.
  double least = -CLOSED, along = 1.0;
  for (int k = 1; k < PLACES + 2; ++k) {
    const double share =
      k < PLACES ? static_cast<double>(k) / PLACES : k == PLACES ? first : second;
    if (!(0.0 < share && share < 1.0)) {
      continue;
    }
    const double shape = share * (1.0 - share);
    const double margin = cubic(share) - 16.0 * error * (shape * shape);
    if (margin < least) {
      least = margin;
      along = share;
    }
  }
  return {along, true};
}

/// Continue from the right end of an interval.
void start_next_interval(const Contacts & contacts, Index top)
{
  for (Index row : contacts.rows) {
    copy(contacts.nodes[top][row], contacts.nodes[0][row]);
  }
  contacts.search[contact::SHARES] = contacts.search[contact::SHARES + top];
}

/// Go from interval to interval as long as they are clear. `share`: where dense output is needed
/// next; less than zero where it is not.
Trial examine_interval(const EffectTable & effects, double size, Index sought, double & share)
{
  const Contacts & contacts = effects.contacts;
  const Values & search = contacts.search;
  Index top = static_cast<Index>(search[contact::TOP]);
  for (; top > 0; --top) {
    const Table left = contacts.nodes[0], right = contacts.nodes[top];
    const double length = search[contact::SHARES + top] - search[contact::SHARES];
    double along = 1.0;
    bool followed = true;
    for (Index row : contacts.rows) {
      if (is_judged(effects, row)) {
        const Suspicion found =
          suspect(effects, row, left.row(row), right.row(row), length * size, size);
        along = std::min(along, found.along);
        followed = followed && found.followed;
      }
    }
    if (along < 1.0) {
      const double place = search[contact::SHARES] + along * length;
      search[contact::TOP] = static_cast<double>(top);
      if (search[contact::NODE_LEVELS + top] < contact::LEVELS) {
        share = place;
        return {size, sought};
      }
      if (!followed || search[contact::SUSPECTED] < MOST_SUSPICIONS) {
        // Only a step to this point can decide.
        search[contact::SUSPECTED] += 1.0;
        search[contact::LOW] = 0.0;
        return {place * size, -1};
      }
    }
    start_next_interval(contacts, top);
  }
  return {size, sought};
}

/// Whether an undetected contact may lie within a step; `other`: the gap at its end [m].
bool may_miss_contact(const EffectTable & effects, Index row, double size, double other)
{
  const Contacts & contacts = effects.contacts;
  const double * trial = contacts.trial.row(row);
  return effects.enabled[row] == 1 && closedloop::may_miss_contact(
    contacts.start(row, GAP), other, trial[contact::WRONG],
    trial[is_finite(effects, row) ? contact::SPEED : contact::FASTEST], size);
}

/// Whether a smooth gap is negative within a step, by more than steps of one size resolve.
bool penetrates(const Contacts & contacts, Index row, double size)
{
  const Cubic cubic(contacts.start.row(row), contacts.now.row(row), 1.0, size);
  const auto [one, other] = cubic.turning_points();
  const double slight =
    std::max(CLOSED, SLIGHT * size * contacts.trial(row, contact::FASTEST));
  return (0.0 < one && one < 1.0 && cubic(one) < -slight) ||
         (0.0 < other && other < 1.0 && cubic(other) < -slight);
}

/// Evaluate the gaps of a state, which need no accelerations.
void update_gaps(const System & system, Values state)
{
  load_effect_states(system, state);
  outward(system.model, system.q(state), system.qd(state), system.work);
  apply_listed(system, system.q(state), system.qd(state));
}
}  // namespace

bool is_finite(const EffectTable & effects, Index row)
{
  const Index gap = effects.gap[row];
  return gap == effect::ROUND || gap == effect::OUTLINE;
}

bool may_miss_contact(double gap, double other, double wrong, double fastest, double size)
{
  // Written so that a NaN may.
  return !(gap < 0.0) && !(other < 0.0) && !(wrong > 0.0) &&
         !(gap + other > FASTER * fastest * size);
}

bool freeze_modes(const System & system)
{
  const EffectTable & effects = system.effects;
  const Contacts & contacts = effects.contacts;
  if (contacts.rows.size == 0) {
    return false;
  }
  bool changed = false;
  for (Index row : contacts.rows) {
    if (effects.enabled[row] == 1) {
      const double gap = contacts.now(row, GAP), rate = contacts.now(row, RATE);
      bool touches = gap < 0.0;
      if (std::abs(gap) <= 2.0 * CLOSED) {
        changed = true;
        touches = rate < 0.0;
      }
      contacts.mode[row] = touches ? contact::TOUCHING : contact::FREE;
      store_start(contacts, row);
      contacts.trial(row, contact::CHANGED) = 0.0;
      contacts.trial(row, contact::LOST) = effects.states[effects.first_state[row]];
    }
  }
  forget(contacts);
  return changed;
}

void release_modes(const System & system)
{
  const Contacts & contacts = system.effects.contacts;
  for (Index row : contacts.rows) {
    contacts.mode[row] = contact::UNDECIDED;
  }
}

void forget_trials(const System & system)
{
  if (system.effects.contacts.rows.size > 0) {
    forget(system.effects.contacts);
  }
}

void forget_rates(const System & system)
{
  clear(system.effects.contacts);
}

double ContactSearch::examine(const System & system, Values state, double size, double & share)
{
  const EffectTable & effects = system.effects;
  update_gaps(system, state);
  Trial found = share == 1.0 ? judge_end(effects, size, sought) : push(effects, size, share);
  if (share != 1.0 && found.part == size) {
    found.sought = sought;
  }
  share = -1.0;
  if (found.part == size) {
    found = examine_interval(effects, size, found.sought, share);
  }
  sought = found.sought;
  return found.part;
}

ContactGuard::ContactGuard(const System & system)
: system_(system)
{
  clear(system.effects.contacts);
}

void ContactGuard::begin() const
{
  for (Index row : system_.effects.contacts.rows) {
    store_start(system_.effects.contacts, row);
  }
}

bool ContactGuard::is_near(double size) const
{
  const EffectTable & effects = system_.effects;
  return std::any_of(
    effects.contacts.rows.begin(), effects.contacts.rows.end(),
    [&](Index row) {return may_miss_contact(effects, row, size, 0.0);});
}

double ContactGuard::examine_end(Values out, double size, bool & passed) const
{
  const EffectTable & effects = system_.effects;
  const Contacts & contacts = effects.contacts;
  update_gaps(system_, out);
  bool doubtful = false;
  for (Index row : contacts.rows) {
    if (!may_miss_contact(effects, row, size, contacts.now(row, GAP))) {
      continue;
    }
    if (is_finite(effects, row)) {
      contacts.mode[row] = contact::FREE;
      doubtful = true;
    } else if (penetrates(contacts, row, size)) {
      contacts.passed[0] = row;
      passed = true;
      return -1.0;
    }
  }
  if (!doubtful) {
    return -1.0;
  }
  clear_bracket(contacts.search);
  begin_look(contacts);
  return next_share(size, passed);
}

double ContactGuard::examine_inside(Values state, double size, double share, bool & passed) const
{
  update_gaps(system_, state);
  const Trial found = push(system_.effects, size, share);
  if (found.part != size) {
    system_.effects.contacts.passed[0] = found.sought;
    passed = true;
    return -1.0;
  }
  return next_share(size, passed);
}

double ContactGuard::next_share(double size, bool & passed) const
{
  const EffectTable & effects = system_.effects;
  const Contacts & contacts = effects.contacts;
  double share = -1.0;
  while (examine_interval(effects, size, -1, share).part != size) {
    // The finest interval: only a path that enters the body counts.
    const Index top = static_cast<Index>(contacts.search[contact::TOP]);
    const Table left = contacts.nodes[0], right = contacts.nodes[top];
    for (Index row : contacts.rows) {
      if (is_judged(effects, row) &&
        nearest_to_body(effects, row, left.row(row), right.row(row)).distance < -CLOSED)
      {
        contacts.passed[0] = row;
        passed = true;
        return -1.0;
      }
    }
    start_next_interval(contacts, top);
    contacts.search[contact::TOP] -= 1.0;
    contacts.search[contact::SUSPECTED] = 0.0;
  }
  return share;
}

}  // namespace closedloop
