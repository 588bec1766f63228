// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "left_out.hpp"

#include <algorithm>
#include <cmath>

#include "loop_closure.hpp"
#include "recursion.hpp"

namespace closedloop
{

using namespace left_out;

namespace
{
// Kinetic energy that the projection may discard after a step, of the most that there was: more is
// no error of the step, but equations that hinder the motion.
constexpr double DISCARDED = 1e-6;
// Changes of rates below this share of them, or of 1, are rounding: at rest there is no energy that
// they could be measured by.
constexpr double ROUNDING = 1e-13;
// Sufficient pivot; ratio to the reference pivot below which equations are poor; and growth of that
// reference per step.
constexpr double GOOD_PIVOT = 0.02, SMALLER = 0.25, GROWTH = 1.1;

/// Kinetic energy of a state [J].
double kinetic_energy(const AllEquations & all, Values q, Values qd)
{
  outward(all.model, q, qd, all.own);
  energies(all.model, all.own, qd, all.energy);
  return all.energy[0];
}
}  // namespace

bool equations_suffice(const System & system, Stabilisation stabilisation, Values state)
{
  const AllEquations & all = system.whole;
  if (all.empty() || stabilisation < Stabilisation::PROJECTION) {
    return true;
  }
  const Values q = system.q(state), qd = system.qd(state);
  const Settings & settings = *system.settings;
  const Values & numbers = all.numbers;
  // The projection has left in `qdd` its change of the rates.
  const bool corrected = stabilisation == Stabilisation::PROJECTION &&
    largest(system.qdd) > ROUNDING * rate_scale(qd);
  const double discarded = corrected ? kinetic_energy(all, q, system.qdd) : 0.0;
  numbers[KINETIC] = std::max(numbers[KINETIC], kinetic_energy(all, q, qd));
  update(all.model, all.own, Responses::NONE);
  const double error = largest(all.own.closure), opening = settings.opening;
  const bool hold = error <= opening && largest(all.own.closure_rate) <= opening * rate_scale(qd);
  const bool strict = hold && discarded <= DISCARDED * numbers[KINETIC];
  const double pivot = system.work.health[health::SMALLEST_PIVOT];
  const bool worn = pivot < numbers[PIVOT];
  if ((numbers[LENIENT] == 0.0 && (worn || !strict)) ||
    !(error <= settings.closure_limit))
  {
    numbers[OPENED] = hold ? 0.0 : 1.0;
    return false;
  }
  if (strict && numbers[STAYS_LENIENT] == 0.0) {
    numbers[LENIENT] = 0.0;
  }
  const double limit = std::min(GOOD_PIVOT, SMALLER * pivot);
  if (worn || numbers[PIVOT] == 0.0) {
    numbers[PIVOT] = limit;
  } else {
    numbers[PIVOT] = std::max(numbers[PIVOT], std::min(limit, GROWTH * numbers[PIVOT]));
  }
  return true;
}

}  // namespace closedloop
