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
  /// `requested` returns whether to stop; nullptr: never. `joints`: number of joints, to which the
  /// cost of an evaluation is proportional.
  Interrupt(bool (* requested)(), Index joints)
  : requested_(requested), joints_(joints), pace_(pace_of_thread()) {}

  /// Whether to stop, after some more evaluations; calls `requested` at most some twenty times a
  /// second.
  bool after(Index evaluations)
  {
    pace_.left -= evaluations * joints_;
    if (pace_.left > 0 || requested_ == nullptr) {
      return false;
    }
    pace_.left = BETWEEN_POLLS;
    const auto now = Clock::now();
    if (now < pace_.next) {
      return false;
    }
    pace_.next = now + std::chrono::milliseconds(50);
    return requested_();
  }

private:
  using Clock = std::chrono::steady_clock;
  // Evaluations times joints between readings of the clock: some 20 us.
  static constexpr Index BETWEEN_POLLS = 1000;

  struct Pace
  {
    Index left;
    Clock::time_point next;
  };

  /// One for all computations of a thread: many short ones poll as often as a long one.
  static Pace & pace_of_thread()
  {
    static thread_local Pace pace = {BETWEEN_POLLS, {}};
    return pace;
  }

  bool (* requested_)();
  Index joints_;
  Pace & pace_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__INTERRUPT_HPP_
