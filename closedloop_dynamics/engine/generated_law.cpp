// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <map>
#include <mutex>

#include "arms.hpp"
#include "columns.hpp"
#include "laws.hpp"
#include "library.hpp"
#include "routines.hpp"

namespace closedloop
{

namespace
{
/// Routines of this process by their addresses, which runs of other threads may look up while one
/// is added.
std::map<Index, Needs> & routines()
{
  static std::map<Index, Needs> found;
  return found;
}

std::mutex & lock()
{
  static std::mutex one;
  return one;
}

/// What a law has of its joints: coordinates, rates, commands, and its efforts.
struct Joints
{
  double * position;
  double * rate;
  double * command;
  double * effort;
};

/// Address of a number of an array. What a law has no use for is not read, and need not be there.
Index address(const double * first, Index place = 0)
{
  return reinterpret_cast<Index>(first) + place * static_cast<Index>(sizeof(double));
}
}  // namespace

void keep_law(
  Index address, Index joints, Index bodies, Index states, Index numbers, Index listed,
  bool spatial)
{
  const std::lock_guard<std::mutex> locked(lock());
  routines()[address] = {joints, bodies, states, numbers, listed, spatial};
}

const Needs * needs_of(Index address)
{
  const std::lock_guard<std::mutex> locked(lock());
  const auto found = routines().find(address);
  // Places in a map remain when others are added.
  return found == routines().end() ? nullptr : &found->second;
}

void apply_generated(
  const EffectTable & table, Index row, Table body, Values q, Values qd, Values tau)
{
  using namespace routine;  // NOLINT: places of one table
  const Index * joints = table.places_of(row), * bodies = joints + table.joints[row];
  const Index state = table.first_state[row], entries = table.entries[row];
  const bool summed = table.summed[row] == 1;
  const Index coordinates = summed ? 1 : table.joints[row];
  const double count = static_cast<double>(entries - (summed ? 1 : 0));
  double position[MOST_COORDINATES], rate[MOST_COORDINATES], command[MOST_COORDINATES];
  double effort[MOST_COORDINATES];
  double nowhere[cut::MOTION_COLUMNS];
  Joints found = {position, rate, command, effort};
  if (summed) {
    position[0] = along(table, row, q);
    rate[0] = along(table, row, qd);
    effort[0] = 0.0;
  } else if (coordinates == 1) {
    // The one joint where it is.
    const Index joint = joints[0];
    found = {q.data + joint, qd.data + joint, tau.data + joint, table.applied.data + joint};
  } else {
    for (Index k = 0; k < coordinates; ++k) {
      position[k] = q[joints[k]];
      rate[k] = qd[joints[k]];
      command[k] = tau[joints[k]];
      effort[k] = 0.0;
    }
  }
  Index * places = table.calls.data;
  places[EVALUATION] = table.routine[row];
  places[TAU] = address(found.effort);
  places[COMMAND] = address(found.command);
  places[VALUES] = address(table.values.row(row));
  places[ENTRIES] = address(table.numbers_of(row));
  places[law_routine::STATES] = address(table.states.data, state);
  places[RATES] = address(table.rates.data, state);
  places[law_routine::OUTPUT] = address(table.output.row(row));
  places[law_routine::COUNT] = address(&count);
  // A row that does not say that it is a motion has no equation.
  places[law_routine::RIGHT_SIDE] =
    address(table.role[row] == effect::MOTION ? right_side(table, row) : nowhere);
  places[SIDES] = address(&table.code.sides[row]);
  places[GAPS] = address(table.contacts.now.row(row));
  places[TRIALS] = address(table.contacts.trial.row(row));
  if (entries > 0) {
    places[PRESENT] = address(table.code.present.row(row));
    for (Index which : {PIECE, NEAREST, FURTHEST}) {
      places[which] = library_function(which);
    }
  }
  for (Index k = 0; k < table.bodies[row]; ++k) {
    places[law_routine::LAW_COLUMNS + k] = address(body.data, bodies[k] * body.columns);
  }
  call(table.calls, EVALUATION, {found.position, coordinates}, {found.rate, coordinates});
  if (summed) {
    exert_along(table, row, effort[0]);
  } else if (coordinates > 1) {
    for (Index k = 0; k < coordinates; ++k) {
      table.applied[joints[k]] += effort[k];
    }
  }
}

}  // namespace closedloop
