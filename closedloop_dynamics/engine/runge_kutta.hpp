// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__RUNGE_KUTTA_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__RUNGE_KUTTA_HPP_

#include <vector>

#include "data.hpp"
#include "scratch.hpp"

// One step of any explicit Runge-Kutta method, and its dense output.

namespace closedloop
{

/// An explicit Runge-Kutta method (scene/tableau.py).
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
  void fields(Visitor && visit) {visit("a, b, error, dense, order, error_order", a, b, error, dense, order, error_order);}
};

/// A tableau that owns its numbers; refuses arrays that do not fit together, as
/// std::invalid_argument.
class OwnedTableau
{
public:
  explicit OwnedTableau(const Tableau &);
  Tableau view() const
  {
    return {a_.view(), closedloop::view(b_), error_.view(), dense_.view(), order_, error_order_};
  }

private:
  OwnedTable a_, error_, dense_;
  mutable std::vector<double> b_;
  Index order_, error_order_;
};

/// Whether the arrays of a method fit together.
bool fits(const Tableau &);

/// `state` + `step_size` times the first `count` slopes, weighted.
void combine(
  const double * weights, Index count, Values state, double step_size, Table slopes, Values out);

/// One step of semi-implicit Euler: rates first, then coordinates with the new rates.
void semi_implicit_step(
  const Manifold &, Values state, Index nv, double step_size, Values slope, Values out,
  Index lanes);

/// One step of a tableau, of semi-implicit Euler where it has no weights, in so many lanes.
/// `evaluate(k, state, slope)` finds slope k, of shape (ns,), and returns whether it is good.
template<class Evaluate>
bool step(
  const Tableau & tableau, const Manifold & manifold, Index nv, Values state, double step_size,
  Table slopes, Values stage, Values out, Evaluate && evaluate, Index lanes = 1)
{
  if (!evaluate(0, state, slopes[0])) {
    return false;
  }
  if (tableau.steps() == 0) {
    semi_implicit_step(manifold, state, nv, step_size, slopes[0], out, lanes);
    return true;
  }
  for (Index k = 1; k < tableau.steps(); ++k) {
    combine(tableau.a.row(k), k, state, step_size, slopes, stage);
    if (!evaluate(k, stage, slopes[k])) {
      return false;
    }
  }
  combine(tableau.b.data, tableau.steps(), state, step_size, slopes, out);
  return true;
}

/// The same of a system, from a state whose slope is the first of them.
void step(
  const System &, const Tableau &, Values state, double step_size, Table slopes, Values stage,
  Values out);

/// Slopes from number `first` on, which only dense output needs.
void extend(
  const System &, const Tableau &, Values state, double step_size, Table slopes, Values stage,
  Index first);

/// State at a share of the step: 0 at its start, 1 at its end.
void interpolate(
  const Tableau &, Values state, double step_size, Table slopes, double share, Values out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__RUNGE_KUTTA_HPP_
