// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__STOP_FLAG_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__STOP_FLAG_HPP_

#include <atomic>
#include <memory>
#include <utility>

#include "array.hpp"

namespace closedloop
{

/// A request to the threads that heed it to end their long computations.
struct StopFlag
{
  std::atomic<bool> stops{false};
  /// Heeded where this one was made: its request counts, too.
  std::shared_ptr<const StopFlag> outer;
};

using SharedStop = std::shared_ptr<StopFlag>;

/// The flag that this thread heeds; empty: none.
inline SharedStop & heeded_stop()
{
  static thread_local SharedStop flag;
  return flag;
}

/// Whether this thread is to stop.
inline bool is_stopped()
{
  for (const StopFlag * flag = heeded_stop().get(); flag != nullptr; flag = flag->outer.get()) {
    if (flag->stops) {
      return true;
    }
  }
  return false;
}

inline void set_stop(StopFlag & flag, Index stops) {flag.stops = stops == 1;}

inline SharedStop stop_flag(Index stops)
{
  auto made = std::make_shared<StopFlag>();
  made->outer = heeded_stop();
  set_stop(*made, stops);
  return made;
}

/// Make this thread heed a flag, or none, from now on; returns what it heeded before.
inline SharedStop heed(const SharedStop & flag) {return std::exchange(heeded_stop(), flag);}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__STOP_FLAG_HPP_
