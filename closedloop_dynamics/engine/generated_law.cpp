// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <atomic>

#include "columns.hpp"
#include "laws.hpp"
#include "library.hpp"
#include "routines.hpp"

namespace closedloop
{

namespace
{
/// Addresses of the routines, by kind: those of one process, which runs of other threads may read
/// while one is added.
std::atomic<Index> routines[effect::KINDS];

/// Address of a number of an array. What a law has no joint or body for is not read, and need not
/// be there.
Index address(const double * first, Index place = 0)
{
  return reinterpret_cast<Index>(first) + place * static_cast<Index>(sizeof(double));
}

/// The number at an address, and what is behind it.
Values at(Index address) {return {reinterpret_cast<double *>(address), 1};}
}  // namespace

void keep_law(Index kind, Index address) {routines[kind] = address;}

bool has_generated_law(Index kind) {return routines[kind] != 0;}

void apply_generated(
  const EffectTable & table, Index row, Table body, Values q, Values qd, Values tau)
{
  using namespace routine;  // NOLINT: places of one table
  const Index * index = table.index.row(row);
  const Index joint = index[effect::FIRST], state = index[effect::STATE];
  const double count = static_cast<double>(index[effect::ENTRIES]);
  Index places[law_routine::LAW_COLUMNS];
  places[EVALUATION] = routines[table.kind[row]];
  places[BODY] = address(body.data, index[effect::FIRST] * body.columns);
  places[law_routine::OTHER_BODY] = address(body.data, index[effect::SECOND] * body.columns);
  places[TAU] = address(table.applied.data, joint);
  places[COMMAND] = address(tau.data, joint);
  places[VALUES] = address(table.values.row(row));
  places[law_routine::STATES] = address(table.states.data, state);
  places[RATES] = address(table.rates.data, state);
  places[law_routine::OUTPUT] = address(table.output.row(row));
  places[SIDES] = address(&table.code.sides[row]);
  places[GAPS] = address(table.contacts.now.row(row));
  places[TRIALS] = address(table.contacts.trial.row(row));
  if (index[effect::ENTRIES] > 0) {
    places[ENTRIES] = address(table.data.data, index[effect::DATA]);
    places[law_routine::COUNT] = address(&count);
    places[PRESENT] = address(table.code.present.row(row));
    for (Index which : {library::LOOK_UP, library::NEAREST, library::FURTHEST}) {
      places[which] = library_function(which);
    }
  }
  call({places, law_routine::LAW_COLUMNS}, EVALUATION, at(address(q.data, joint)),
    at(address(qd.data, joint)));
}

}  // namespace closedloop
