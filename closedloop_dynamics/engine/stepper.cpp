// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "stepper.hpp"

#include "fixed_steps.hpp"

namespace closedloop
{

Status make_steps(
  const System & system, const Stepper & stepper, Values state, Index done, double step_size,
  Index steps)
{
  const Runs & runs = stepper.runs;
  switch (stepper.kind) {
    case stepper::FIXED:
      return advance_fixed(
        system, stepper.tableau, stepper.stabilisation, runs.scratch[0], state, step_size,
        steps).first;
    case stepper::EXPLICIT:
      return advance_explicit(
        system, stepper.tableau, stepper.stabilisation, runs.control[0], runs.scale[0],
        runs.scratch[0], state, 0.0, done, step_size, steps);
    case stepper::STIFF_FIXED:
      return advance_stiff_fixed(
        system, stepper.stabilisation, runs.matrix, runs.pivots, runs.stiff_scratch[0], state,
        step_size, steps).first;
    case stepper::STIFF:
      runs.control(0, control::REACHED) = static_cast<double>(done) * step_size;
      return advance_stiff(
        system, stepper.stabilisation, runs.control[0], runs.scale[0], runs.matrix, runs.pivots,
        runs.stiff_scratch[0], state, static_cast<double>(done + steps) * step_size);
    default:
      return advance_switching(
        system, stepper.tableau, stepper.stabilisation, runs, state, 0.0, done, step_size, steps);
  }
}

void restart(const Stepper & stepper)
{
  const Runs & runs = stepper.runs;
  if (runs.control.rows > 0) {
    runs.control(
      0, stepper.kind == stepper::STIFF ? control::NEXT_STEP : control::STEP_SIZE) = 0.0;
  }
  if (stepper.kind != stepper::SWITCHING) {
    return;
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
