// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SCRATCH_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SCRATCH_HPP_

#include <array>
#include <memory>

#include "array.hpp"

namespace closedloop
{

/// Arrays that live as long as an evaluation, out of one block: on the stack where they fit there.
template<class Number, Index ROOM>
class Scratch
{
public:
  explicit Scratch(Index count)
  {
    if (count > ROOM) {
      large_ = std::make_unique<Number[]>(static_cast<std::size_t>(count));
      next_ = large_.get();
    }
  }
  Vector<Number> take(Index count)
  {
    next_ += count;
    return {next_ - count, count};
  }
  Vector<Number> copy_of(Vector<Number> values)
  {
    const Vector<Number> found = take(values.size);
    copy(values, found);
    return found;
  }
  Matrix<Number> take(Index rows, Index columns)
  {
    return {take(rows * columns).data, rows, columns};
  }

private:
  std::array<Number, ROOM> numbers_;
  std::unique_ptr<Number[]> large_;
  Number * next_ = numbers_.data();
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SCRATCH_HPP_
