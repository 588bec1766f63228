// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__STEPPER_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__STEPPER_HPP_

#include "switching.hpp"

// Steps of any method, for runs that the engine makes as a whole.

namespace closedloop
{

/// Values of Stepper.kind.
namespace stepper
{
enum : Index {FIXED, EXPLICIT, SWITCHING, STIFF_FIXED, STIFF};
}

/// A method with its memory (integration/drivers.py).
struct Stepper
{
  Index kind = 0;
  Stabilisation stabilisation = Stabilisation::NONE;
  Tableau tableau;
  /// Shape (2, ns): tolerances for one of 1; of the default method.
  Table unit;
  /// With a row for the run alone but of the default method, empty where a method has none.
  Runs runs;

  template<class Visitor>
  void fields(Visitor && visit) {visit(kind, stabilisation, tableau, unit, runs);}
};

/// Advance a state by `steps` steps of `step_size` [s], `done` steps after time zero.
Status make_steps(
  const System &, const Stepper &, Values state, Index done, double step_size, Index steps);

/// Forget the past, as torques have changed.
void restart(const Stepper &);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__STEPPER_HPP_
