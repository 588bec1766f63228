// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SCRATCH_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SCRATCH_HPP_

#include <array>
#include <memory>
#include <vector>

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

/// A table that owns its numbers, zero at first; a copy has numbers of its own. As of the views, that
/// it is constant says nothing of its numbers.
class OwnedTable
{
public:
  OwnedTable() = default;
  OwnedTable(Index rows, Index columns)
  : rows_(rows), columns_(columns), numbers_(static_cast<std::size_t>(rows * columns)) {}

  explicit OwnedTable(Table from)
  : rows_(from.rows), columns_(from.columns),
    numbers_(from.data, from.data + from.rows * from.columns) {}

  Table view() const {return {numbers_.data(), rows_, columns_};}
  Values operator[](Index row) const {return view()[row];}
  Values all() const {return view().all();}
  Index columns() const {return columns_;}

private:
  Index rows_ = 0, columns_ = 0;
  mutable std::vector<double> numbers_;
};

/// The numbers of a vector, as a view.
template<class Number>
Vector<Number> view(std::vector<Number> & numbers)
{
  return {numbers.data(), static_cast<Index>(numbers.size())};
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SCRATCH_HPP_
