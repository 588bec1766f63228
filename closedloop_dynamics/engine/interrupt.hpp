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
  : asked_(asked) {}

  /// Ask after so many more evaluations, but no more than some twenty times a second.
  bool after(Index evaluations)
  {
    left_ -= evaluations;
    if (left_ > 0 || asked_ == nullptr) {
      return false;
    }
    left_ = BETWEEN_LOOKS;
    const auto now = Clock::now();
    if (now < next_) {
      return false;
    }
    next_ = now + std::chrono::milliseconds(50);
    return asked_();
  }

private:
  using Clock = std::chrono::steady_clock;
  // Evaluations between looks at the clock: of the fastest mechanisms 10 us.
  static constexpr Index BETWEEN_LOOKS = 100;

  bool (* asked_)();
  Index left_ = BETWEEN_LOOKS;
  Clock::time_point next_ = Clock::now() + std::chrono::milliseconds(50);
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__INTERRUPT_HPP_
