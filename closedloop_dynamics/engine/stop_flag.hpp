// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__STOP_FLAG_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__STOP_FLAG_HPP_

#include <atomic>
#include <memory>
#include <stdexcept>

#include "arguments.hpp"

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

inline void set_stop(const SharedStop & flag, Index stops)
{
  if (flag == nullptr || (stops != 0 && stops != 1)) {
    throw std::invalid_argument("expected a flag, and 0 or 1 as whether to stop");
  }
  flag->stops = stops == 1;
}

inline SharedStop stop_flag(Index stops)
{
  auto made = std::make_shared<StopFlag>();
  made->outer = heeded_stop();
  set_stop(made, stops);
  return made;
}

/// Make this thread heed a flag, or none, from now on; returns what it heeded before.
inline SharedStop heed(const SharedStop & flag) {return std::exchange(heeded_stop(), flag);}

inline void read(PyObject * from, SharedStop & to, Place place)
{
  to = from == &_Py_NoneStruct ? nullptr : object_in<SharedStop>(from, place);
}

inline PyObject * to_python(const SharedStop & flag)
{
  if (flag == nullptr) {
    Py_IncRef(&_Py_NoneStruct);
    return &_Py_NoneStruct;
  }
  return to_python(std::make_unique<SharedStop>(flag));
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__STOP_FLAG_HPP_
