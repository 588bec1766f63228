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

std::shared_ptr<const Tableau> keep(const Tableau & from)
{
  struct Kept
  {
    std::vector<double> numbers;
    Tableau view;
  };
  if (!fits(from)) {
    throw std::invalid_argument("a tableau: arrays that do not fit together");
  }
  const auto kept = std::make_shared<Kept>();
  kept->view = from;
  for (Values part : {from.a.all(), from.b, from.error.all(), from.dense.all()}) {
    kept->numbers.insert(kept->numbers.end(), part.begin(), part.end());
  }
  double * next = kept->numbers.data();
  const auto take = [&](double * & data, Index count) {data = next; next += count;};
  take(kept->view.a.data, from.a.all().size);
  take(kept->view.b.data, from.b.size);
  take(kept->view.error.data, from.error.all().size);
  take(kept->view.dense.data, from.dense.all().size);
  return {kept, &kept->view};
}

void combine(
  const double * weights, Index count, Values state, double step_size, Table slopes, Values out)
{
  out.fill(0.0);
  for (Index k = 0; k < count; ++k) {
    const double weight = weights[k];
    if (weight != 0.0) {
      const double * slope = slopes.row(k);
      for (Index i = 0; i < state.size; ++i) {
        out[i] += weight * slope[i];
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
  const Index steps = tableau.steps();
  for (Index k = 1; k < steps; ++k) {
    combine(tableau.a.row(k), k, state, step_size, slopes, stage);
    derivative(system, stage, slopes[k]);
  }
  combine(tableau.b.data, steps, state, step_size, slopes, out);
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
