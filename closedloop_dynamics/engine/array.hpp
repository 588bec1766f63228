// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ARRAY_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ARRAY_HPP_

#include <algorithm>
#include <cassert>
#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <type_traits>
#include <utility>

// Views of arrays, a pointer and the lengths, row by row in memory, and arrays that own what they
// are views of. Places are checked in builds with assertions (scripts/sanitize).

namespace closedloop
{

using Index = std::int64_t;

/// Numbers side by side.
template<class Number>
struct Vector
{
  Number * data = nullptr;
  Index size = 0;

  Number & operator[](Index i) const
  {
    assert(i >= 0 && i < size);
    return data[i];
  }
  Number * begin() const {return data;}
  Number * end() const {return data + size;}
  /// The `count` entries from `first` on.
  Vector part(Index first, Index count) const
  {
    assert(first >= 0 && count >= 0 && first + count <= size);
    return {data + first, count};
  }
  /// The entries from `first` on.
  Vector from(Index first) const {return part(first, size - first);}
  Vector all() const {return *this;}
  void fill(Number value) const {for (Number & each : *this) {each = value;}}
};

/// Rows of the same length, one after the other.
template<class Number>
struct Matrix
{
  Number * data = nullptr;
  Index rows = 0;
  Index columns = 0;

  Number & operator()(Index i, Index j) const
  {
    assert(i >= 0 && i < rows && j >= 0 && j < columns);
    return data[i * columns + j];
  }
  Vector<Number> operator[](Index i) const {return {row(i), columns};}
  /// Where a row begins.
  Number * row(Index i) const
  {
    assert(i >= 0 && i < rows);
    return data + i * columns;
  }
  /// The rows from `first` on.
  Matrix from(Index first) const {return {data + first * columns, rows - first, columns};}
  Vector<Number> all() const {return {data, rows * columns};}
  void fill(Number value) const {all().fill(value);}
};

/// Matrices of the same shape, one after the other.
template<class Number>
struct Cube
{
  Number * data = nullptr;
  Index pages = 0;
  Index rows = 0;
  Index columns = 0;

  Matrix<Number> operator[](Index i) const
  {
    assert(i >= 0 && i < pages);
    return {data + i * rows * columns, rows, columns};
  }
  Vector<Number> all() const {return {data, pages * rows * columns};}
};

using Values = Vector<double>;
using Table = Matrix<double>;
using Indices = Vector<Index>;
using Indexes = Matrix<Index>;

/// A view with the memory that it is of, all zero at first. Copies are of the same memory, which
/// lives as long as any of them; they are explicit, as they count references, which kernels must
/// not. `Copies` makes others.
template<class View>
class Array : public View
{
public:
  using Number = std::remove_reference_t<decltype(*View::data)>;

  Array() = default;
  explicit Array(const Array &) = default;
  Array(Array &&) noexcept = default;
  Array & operator=(const Array &) = default;
  Array & operator=(Array &&) noexcept = default;
  ~Array() = default;
  template<class ... Lengths>
  explicit Array(Index length, Lengths ... lengths)
  : View{nullptr, length, lengths ...},
    memory_(new Number[static_cast<std::size_t>(View::all().size)]())
  {
    View::data = memory_.get();
  }
  /// The same numbers in memory of its own.
  template<class Source>
  static Array copy_of(const Vector<Source> & from)
  {
    return Array(from.size).filled(from.data);
  }
  template<class Source>
  static Array copy_of(const Matrix<Source> & from)
  {
    return Array(from.rows, from.columns).filled(from.data);
  }
  template<class Source>
  static Array copy_of(const Cube<Source> & from)
  {
    return Array(from.pages, from.rows, from.columns).filled(from.data);
  }
  const std::shared_ptr<Number[]> & memory() const {return memory_;}
  void own(std::shared_ptr<Number[]> memory)
  {
    memory_ = std::move(memory);
    View::data = memory_.get();
  }

private:
  Array && filled(const Number * from) &&
  {
    std::copy_n(from, View::all().size, View::data);
    return std::move(*this);
  }

  std::shared_ptr<Number[]> memory_;

public:
  /// Whether whoever sees the memory from outside must not write it.
  bool is_constant = false;
};

/// Gives arrays memory of their own: those that had the same have the same again.
class Copies
{
public:
  template<class ... Field>
  void operator()(const char *, Field & ... field) {(separate(field), ...);}

private:
  template<class View>
  void separate(Array<View> & array)
  {
    using Memory = std::shared_ptr<typename Array<View>::Number[]>;
    const void * before = array.data;
    if (before == nullptr) {
      return;
    }
    const auto found = known_.find(before);
    if (found != known_.end()) {
      array.own(std::static_pointer_cast<typename Memory::element_type[]>(found->second));
    } else {
      const bool is_constant = array.is_constant;
      array = Array<View>::copy_of(array);
      array.is_constant = is_constant;
      known_.emplace(before, array.memory());
    }
  }
  template<class Record>
  auto separate(Record & record)->decltype(record.arrays(*this)) {record.arrays(*this);}
  template<class Record>
  void separate(std::shared_ptr<Record> & record) {record = std::make_shared<Record>(*record);}

  std::map<const void *, std::shared_ptr<void>> known_;
};

/// The arrays of a record, and the records within it, with their names, for a visitor.
#define CLOSEDLOOP_ARRAYS(...) \
  template<class Visitor> \
  void arrays(Visitor && visit) {visit(#__VA_ARGS__, __VA_ARGS__);}

/// An optional argument: an array of numbers, absent, or of a wrong type.
struct OptionalVector
{
  Vector<const double> numbers;
  bool is_array = false;
  bool is_none = false;
};

/// Copy the entries of `from`, as many as `to` has.
template<class Number>
void copy(Vector<Number> from, Vector<Number> to)
{
  assert(from.size >= to.size);
  std::copy_n(from.data, to.size, to.data);
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ARRAY_HPP_
