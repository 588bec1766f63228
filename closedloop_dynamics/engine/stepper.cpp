// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "stepper.hpp"

#include <algorithm>

#include "fixed_steps.hpp"

namespace closedloop
{

std::pair<Status, Index> make_steps(
  const System & system, const Stepper & stepper, Values state, double origin, Index done,
  double step_size, Index steps)
{
  const Runs & runs = stepper.runs;
  switch (stepper.kind) {
    case stepper::FIXED:
      return advance_fixed(
        system, stepper.tableau, stepper.stabilisation, runs.scratch[0], state, step_size, steps);
    case stepper::EXPLICIT:
      return {advance_explicit(
          system, stepper.tableau, stepper.stabilisation, runs.control[0], runs.scale[0],
          runs.scratch[0], state, origin, done, step_size, steps), 0};
    case stepper::STIFF_FIXED:
      return advance_stiff_fixed(
        system, stepper.stabilisation, runs.matrix, runs.pivots, runs.stiff_scratch[0], state,
        step_size, steps);
    case stepper::STIFF:
      runs.control(0, control::REACHED) = origin + static_cast<double>(done) * step_size;
      return {advance_stiff(
          system, stepper.stabilisation, runs.control[0], runs.scale[0], runs.matrix, runs.pivots,
          runs.stiff_scratch[0], state, origin, done, step_size, steps), 0};
    default:
      return {advance_switching(
          system, stepper.tableau, stepper.stabilisation, runs, state, origin, done, step_size,
          steps), 0};
  }
}

bool fits(const Tableau & method)
{
  const Index stages = method.a.rows;
  return method.a.columns == stages && method.steps() <= stages && method.error.rows == 2 &&
         method.error.columns == stages && method.dense.rows <= stages;
}

bool fits(const System & system, const Stepper & stepper)
{
  const Runs & runs = stepper.runs;
  const Index ns = system.ns(), count = stepper.kind == stepper::SWITCHING ? 2 : 1;
  if (stepper.kind < stepper::FIXED || stepper.kind > stepper::HOST) {
    return false;
  }
  if (stepper.kind == stepper::HOST) {
    return true;
  }
  const bool is_switching = stepper.kind == stepper::SWITCHING;
  const bool is_stiff = stepper.kind >= stepper::SWITCHING;
  const Tableau & tableau = stepper.tableau;
  // Fixed steps have no control record, by the stiff method neither.
  return ((stepper.is_fixed() && runs.control.rows == 0 && runs.scale.pages == 0) || (
           runs.control.rows == count && runs.control.columns == (
             is_switching ? static_cast<Index>(switching::COLUMNS) :
             static_cast<Index>(control::COLUMNS)) && runs.scale.pages == count &&
           runs.scale.rows == 2 && runs.scale.columns == ns)) &&
         (!is_switching || (
           stepper.unit.rows == 2 && stepper.unit.columns == ns &&
           runs.monitor.size == monitor::COLUMNS && runs.weight.size == system.nq() &&
           fits(runs.short_tableau) && runs.short_tableau.a.rows > 0 &&
           runs.short_tableau.a.rows <= tableau.a.rows)) &&
         (!is_stiff || (runs.stiff_scratch.pages == count &&
         runs.stiff_scratch.rows == STIFF_ROWS && runs.stiff_scratch.columns == ns &&
         runs.matrix.rows == ns && runs.matrix.columns == ns && runs.pivots.size == ns)) &&
         (stepper.kind >= stepper::STIFF_FIXED || (
           fits(tableau) && (stepper.is_fixed() || tableau.steps() > 0) &&
           runs.scratch.pages == count &&
           runs.scratch.rows >= std::max<Index>(tableau.a.rows, 1) + (
             stepper.is_fixed() ? 3 : static_cast<Index>(scratch::FIRST_SLOPE)) &&
           runs.scratch.columns == ns));
}

void restart(const Stepper & stepper, bool moved)
{
  const Runs & runs = stepper.runs;
  if (runs.control.rows > 0) {
    runs.control(
      0, stepper.kind == stepper::STIFF ? control::NEXT_STEP : control::STEP_SIZE) = 0.0;
  }
  if (stepper.kind != stepper::SWITCHING) {
    return;
  }
  if (moved) {
    runs.control(0, switching::STIFF_THRESHOLD) = 0.0;
  }
  for (Index which = 0; which < runs.scale.pages; ++which) {
    const double tolerance = (which == 0 ? 1.0 : LOOSER) * runs.monitor[monitor::TOLERANCE];
    const Values scale = runs.scale[which].all(), unit = stepper.unit.all();
    for (Index i = 0; i < scale.size; ++i) {
      scale[i] = unit[i] * tolerance;
    }
  }
}

}  // namespace closedloop
