// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "runge_kutta.hpp"

#include <stdexcept>
#include <vector>

#include "evaluation.hpp"
#include "manifold.hpp"

namespace closedloop
{

bool fits(const Tableau & method)
{
  const Index stages = method.a.rows;
  return method.a.columns == stages && method.steps() <= stages && method.error.rows == 2 &&
         method.error.columns == stages && method.dense.rows <= stages;
}

OwnedTableau::OwnedTableau(const Tableau & from)
: a_(from.a), error_(from.error), dense_(from.dense), b_(from.b.begin(), from.b.end()),
  order_(from.order), error_order_(from.error_order)
{
  if (!fits(from)) {
    throw std::invalid_argument("a tableau: arrays that do not fit together");
  }
}

namespace
{
/// Slopes that count, in a pass over the components.
struct Weighted
{
  static constexpr Index AT_ONCE = 4;
  const double * slope[AT_ONCE];
  double weight[AT_ONCE];

  /// Add the first ones to a sum, which is zero at `begins`; at `ends` it becomes a step from a state.
  template<Index Count>
  void add(Values state, double step_size, bool begins, bool ends, Values out) const
  {
    for (Index i = 0; i < state.size; ++i) {
      double total = begins ? 0.0 : out[i];
      for (Index n = 0; n < Count; ++n) {
        total += weight[n] * slope[n][i];
      }
      out[i] = ends ? state[i] + step_size * total : total;
    }
  }
};
}  // namespace

void combine(
  const double * weights, Index count, Values state, double step_size, Table slopes, Values out)
{
  constexpr void (Weighted::* ADD[])(Values, double, bool, bool, Values) const = {
    &Weighted::add<0>, &Weighted::add<1>, &Weighted::add<2>, &Weighted::add<3>, &Weighted::add<4>};
  Weighted some;
  Index k = 0;
  for (bool begins = true; begins || k < count; begins = false) {
    Index found = 0;
    for (; k < count && found < Weighted::AT_ONCE; ++k) {
      if (weights[k] != 0.0) {
        some.weight[found] = weights[k];
        some.slope[found++] = slopes.row(k);
      }
    }
    (some.*ADD[found])(state, step_size, begins, k == count, out);
  }
}

void step(
  const System & system, const Tableau & tableau, Values state, double step_size, Table slopes,
  Values stage, Values out)
{
  step(
    tableau, system.manifold, system.nv(), state, step_size, slopes, stage, out,
    [&](Index k, Values at, Values slope) {
      if (k > 0) {
        derivative(system, at, slope);
      }
      return true;
    });
}

void semi_implicit_step(
  const Manifold & manifold, Values state, Index nv, double step_size, Values slope, Values out,
  Index lanes)
{
  const Index first = lanes * (nv + manifold.balls.rows);
  copy(state, out.part(0, first));
  for (Index k = first; k < state.size; ++k) {
    out[k] = state[k] + step_size * slope[k];
  }
  move(manifold, out.part(0, first), out.from(first), step_size, lanes);
}

void extend(
  const System & system, const Tableau & tableau, Values state, double step_size, Table slopes,
  Values stage, Index first)
{
  for (Index k = first; k < tableau.a.rows; ++k) {
    combine(tableau.a.row(k), k, state, step_size, slopes, stage);
    derivative(system, stage, slopes[k]);
  }
}

void interpolate(
  const Tableau & tableau, Values state, double step_size, Table slopes, double share, Values out)
{
  copy(state, out);
  for (Index k = 0; k < tableau.dense.rows; ++k) {
    double weight = 0.0;
    for (Index power = tableau.dense.columns - 1; power >= 0; --power) {
      weight = share * (tableau.dense(k, power) + weight);
    }
    weight *= step_size;
    if (weight != 0.0) {
      const double * slope = slopes.row(k);
      for (Index i = 0; i < state.size; ++i) {
        out[i] += weight * slope[i];
      }
    }
  }
}

}  // namespace closedloop
