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

void combine(
  const double * weights, Index count, Values state, double step_size, Table slopes, Values out)
{
  // Slopes that count, up to four in a pass over the components.
  constexpr Index AT_ONCE = 4;
  const double * slope[AT_ONCE] = {};
  double weight[AT_ONCE] = {};
  out.fill(0.0);
  for (Index k = 0; k < count; ) {
    Index found = 0;
    for (; k < count && found < AT_ONCE; ++k) {
      if (weights[k] != 0.0) {
        weight[found] = weights[k];
        slope[found++] = slopes.row(k);
      }
    }
    if (found == AT_ONCE) {
      for (Index i = 0; i < state.size; ++i) {
        out[i] = out[i] + weight[0] * slope[0][i] + weight[1] * slope[1][i] +
          weight[2] * slope[2][i] + weight[3] * slope[3][i];
      }
      continue;
    }
    for (Index n = 0; n < found; ++n) {
      for (Index i = 0; i < state.size; ++i) {
        out[i] += weight[n] * slope[n][i];
      }
    }
  }
  for (Index i = 0; i < state.size; ++i) {
    out[i] = state[i] + step_size * out[i];
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
