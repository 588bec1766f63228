// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__STEPPER_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__STEPPER_HPP_

#include <utility>

#include "switching.hpp"

// Steps of any method, for runs that the engine makes as a whole.

namespace closedloop
{

/// Values of Stepper.kind; the last one's steps are made by the host.
namespace stepper
{
enum : Index {FIXED, EXPLICIT, SWITCHING, STIFF_FIXED, STIFF, HOST};
}

/// A method with its memory (integration/drivers.py).
struct Stepper
{
  Index kind = 0;
  Stabilisation stabilisation = Stabilisation::NONE;
  Tableau tableau;
  /// Shape (2, ns): tolerances for one of 1; of the default method.
  Table unit;
  /// One row, two for the default method; empty for methods without.
  Runs runs;

  bool is_fixed() const {return kind == stepper::FIXED || kind == stepper::STIFF_FIXED;}

  template<class Visitor>
  void fields(Visitor && visit) {visit(kind, stabilisation, tableau, unit, runs);}
};

/// Whether the arrays of a method fit together.
bool fits(const Tableau &);

/// Whether the memory of a method is that of a system.
bool fits(const System &, const Stepper &);

/// Advance a state by `steps` steps of `step_size` [s], `done` steps after `origin` [s]. Returns the
/// status and, of steps of one size, those completed.
std::pair<Status, Index> make_steps(
  const System &, const Stepper &, Values state, double origin, Index done, double step_size,
  Index steps);

/// Forget the past, as torques have changed, or with `moved` the state.
void restart(const Stepper &, bool moved);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__STEPPER_HPP_
