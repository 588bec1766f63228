// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__RUNGE_KUTTA_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__RUNGE_KUTTA_HPP_

#include <memory>

#include "data.hpp"

// One step of any explicit Runge-Kutta method, and its dense output.

namespace closedloop
{

/// An explicit Runge-Kutta method (integration/tableau.py).
struct Tableau
{
  Table a;
  Values b;
  Table error;
  Table dense;
  Index order = 0;
  Index error_order = 0;

  Index steps() const {return b.size;}

  template<class Visitor>
  void fields(Visitor && visit) {visit(a, b, error, dense, order, error_order);}
};

/// A copy of a tableau; that steppers share, as its numbers never change. Refuses arrays that do not
/// fit together, as std::invalid_argument.
std::shared_ptr<const Tableau> keep(const Tableau &);

/// Whether the arrays of a method fit together.
bool fits(const Tableau &);

/// `state` + `step_size` times the first `count` slopes, weighted.
void combine(
  const double * weights, Index count, Values state, double step_size, Table slopes, Values out);

/// One step; `slopes` is of shape (>= stages, ns), its first row the slope at `state`.
void step(
  const System &, const Tableau &, Values state, double step_size, Table slopes, Values stage,
  Values out);

/// One step of semi-implicit Euler: rates first, then coordinates with the new rates.
void semi_implicit_step(
  const Manifold &, Values state, Index nv, double step_size, Values slope, Values out,
  Index lanes = 1);

/// Slopes from number `first` on, which only dense output needs.
void extend(
  const System &, const Tableau &, Values state, double step_size, Table slopes, Values stage,
  Index first);

/// State at a share of the step: 0 at its start, 1 at its end.
void interpolate(
  const Tableau &, Values state, double step_size, Table slopes, double share, Values out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__RUNGE_KUTTA_HPP_
