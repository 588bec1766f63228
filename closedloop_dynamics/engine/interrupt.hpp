// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__INTERRUPT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__INTERRUPT_HPP_

#include <chrono>

#include "array.hpp"

namespace closedloop
{

/// Polls, in a long computation, whether its caller wants it to stop.
class Interrupt
{
public:
  /// `asked` returns whether to stop; none: never. `joints`: of the mechanism, for one evaluation
  /// of a large one takes as long as many of a small one.
  Interrupt(bool (* asked)(), Index joints)
  : asked_(asked), joints_(joints), pace_(pace_of_thread()) {}

  /// Ask after so many more evaluations, but no more than some twenty times a second.
  bool after(Index evaluations)
  {
    pace_.left -= evaluations * joints_;
    if (pace_.left > 0 || asked_ == nullptr) {
      return false;
    }
    pace_.left = BETWEEN_LOOKS;
    const auto now = Clock::now();
    if (now < pace_.next) {
      return false;
    }
    pace_.next = now + std::chrono::milliseconds(50);
    return asked_();
  }

private:
  using Clock = std::chrono::steady_clock;
  // Evaluations, each times the joints, between looks at the clock: some 20 us.
  static constexpr Index BETWEEN_LOOKS = 1000;

  struct Pace
  {
    Index left;
    Clock::time_point next;
  };

  /// One for all computations of a thread: many short ones are heard as one long one is.
  static Pace & pace_of_thread()
  {
    static thread_local Pace pace = {BETWEEN_LOOKS, {}};
    return pace;
  }

  bool (* asked_)();
  Index joints_;
  Pace & pace_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__INTERRUPT_HPP_
