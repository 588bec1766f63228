// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__INTERRUPT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__INTERRUPT_HPP_

#include <chrono>

#include "array.hpp"

namespace closedloop
{

/// Tells a computation that takes long whether its caller wants it to stop.
class Interrupt
{
public:
  /// `asked` returns whether to stop; none: never.
  explicit Interrupt(bool (* asked)())
  : asked_(asked), pace_(pace_of_thread()) {}

  /// Ask after so many more evaluations, but no more than some twenty times a second.
  bool after(Index evaluations)
  {
    pace_.left -= evaluations;
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
  // Evaluations between looks at the clock: of the fastest mechanisms 10 us.
  static constexpr Index BETWEEN_LOOKS = 100;

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
  Pace & pace_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__INTERRUPT_HPP_
