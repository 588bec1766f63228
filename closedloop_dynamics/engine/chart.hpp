// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__CHART_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__CHART_HPP_

#include <utility>

#include "sensitivity.hpp"

// States by independent coordinates and rates: the others follow from the loops. Of k independent
// coordinates, changes are k displacements, then k changes of rates; those of orientations are
// rotations about the axes of the child. Filters and optimisers ask for thousands of states; so they
// are found without allocation and by the generated derivatives that a basis needs anyway, which
// loop_solver.hpp does without.

namespace closedloop
{

/// Which coordinates are independent, and scratch (simulation/stepped_run.py).
struct Chart
{
  Indices independent;  ///< Shape (k,)
  Indices dependent;  ///< Shape (nc,)
  Table parameters;  ///< Shape (entries, np): derivatives of the numbers that routines read
  Table closure;  ///< Shape (nv + np, 2 nc): changes of closure errors and of their rates
  Table factors;  ///< Shape (nc, nc)
  Indices pivots;  ///< Shape (nc,)
  Values right;  ///< Shape (nc,)
  Table several;  ///< Shape (nc, k + np): right-hand sides
  Values displacement;  ///< Shape (nv,)
  Values place;  ///< Shape (nq,)
  Values seed;  ///< Shape (LANES (nq + 2 nv + entries),)

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(
      "independent<V[k=V-C], dependent<V[C], parameters[entries<=results/8-Q-2*V,p], "
      "closure[V+p,2*C], factors[C,C], pivots[C], right[C], several[C,k+p], displacement[V], "
      "place[Q], seed[8*(Q+2*V+entries)]", independent, dependent, parameters, closure, factors,
      pivots, right, several, displacement, place, seed);
  }
};

/// The change of coordinates with a turn, or a displacement, of one joint alone: into the chart's
/// `place`, of which no other number is left.
void place_change(const System &, const Chart &, Values q, Index joint, double size);

/// Changes of all displacements and rates that keep the loops closed, with those of the independent
/// ones and with parameters, shape (2 nv, 2 k + np). SINGULAR where the independent coordinates do
/// not determine all others.
Status fill_basis(
  const System &, const LaneRoutines &, const Chart &, Values q, Values qd, Table basis);

/// Move from a state by changes, shape (n, 2 k), to states whose loops are closed by the dependent
/// coordinates: into q and qd, n rows each. `basis` is that of the state; scratch: `displacement`,
/// shape (nv,). Returns how it ended, and the states that are reached: OPEN_LOOP where
/// the loops cannot be closed at the next one.
std::pair<Status, Index> move_along(
  const System &, const LaneRoutines &, const Chart &, Values from_q, Values from_qd, Table basis,
  Table changes, Values displacement, Table q, Table qd);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__CHART_HPP_
