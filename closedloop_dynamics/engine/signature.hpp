// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SIGNATURE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SIGNATURE_HPP_

#include <cstddef>
#include <initializer_list>
#include <string>
#include <string_view>
#include <utility>

#include "array.hpp"

// What a function, or a record of arrays, takes, as its text declares it, item by item:
//
//     forward_dynamics(work, q[Q], qd[V], tau[V], qdd[V], lam[C])
//     place(row<B[n], point[n,3], count>=1, out[m=0|n,>=2*n+W])
//
// In brackets is the shape. Capital letters are counts of the object that the function belongs to
// (`count_of` in arguments.hpp); other words are lengths and whole numbers: where a word is first met
// as a length it stands for that from there on. Quotients are rounded down. `row<B`: places among B;
// `-1<=row<B`: or -1 for none; `count>=1`: a finite number. `run?`: or None. Without a condition all
// is taken: kernels index blindly.

namespace closedloop
{

class Signature
{
public:
  /// What is found once of a text: how long the function's name is, before its items in parentheses,
  /// and whether these are names alone.
  struct Head
  {
    const char * text;
    std::size_t length;
    bool is_plain;

    constexpr Head(const char * text)  // NOLINT: a text is one
    : text(text), length(std::string_view(text).find('(')),
      is_plain(std::string_view(text).find_first_of("[<>?:") == std::string_view(text).find(':')) {}
  };

  explicit Signature(const Head & head)
  : function_(head.text, head.length), text_(head.text + head.length + 1),
    is_plain_(head.is_plain) {}

  std::string_view function() const {return function_;}
  /// The name of the present item.
  std::string_view name()
  {
    settle();
    return name_;
  }
  /// Whether the present item, a record, may be missing.
  bool is_optional()
  {
    settle();
    return *at_ == '?';
  }

  /// Take counts from an object, unless there is one.
  template<class Object>
  void count_by(Object & object)
  {
    if (object_ == nullptr) {
      object_ = &object;
      count_ = [](void * from, char letter) {
          return count_of(*static_cast<Object *>(from), letter);
        };
    }
  }

  /// Go to the next item; it is looked at where something is asked of it.
  void next() {++ahead_;}

  /// Read the items of a record in the place of the present one, while it lives.
  class Within
  {
public:
    Within(Signature & of, const char * text)
    : of_(of), is_plain_(std::exchange(of.is_plain_, false))
    {
      of.settle();
      text_ = std::exchange(of.text_, text);
    }
    Within(const Within &) = delete;
    Within & operator=(const Within &) = delete;
    ~Within()
    {
      of_.text_ = text_;
      of_.ahead_ = 0;
      of_.is_plain_ = is_plain_;
    }

private:
    Signature & of_;
    const char * text_;
    const bool is_plain_;
  };

  /// How many words are known; forget the later ones.
  int known() const {return known_;}
  void forget(int known) {known_ = known;}

  /// Remember which items were read; go back to there, with the words known then.
  void keep()
  {
    settle();
    kept_text_ = text_;
    kept_known_ = known_;
  }
  void go_back()
  {
    text_ = kept_text_;
    known_ = kept_known_;
    ahead_ = 0;
  }

  // They check the present item; std::invalid_argument names what is expected and what there is.
  /// Check a number, known by its name from now on.
  void check(Index number)
  {
    if (!is_plain_) {
      know(name(), static_cast<double>(number));
      check_entries(&number, 1);
    }
  }
  void check(double number) {check_entries(&number, 1);}
  /// Check the entries of an array, before its shape.
  template<class Number>
  void check_entries(const Number * numbers, Index count)
  {
    settle();
    if (*at_ == '<' || *at_ == '>') {
      find_bound();
      for (Index n = 0; n < count; ++n) {
        require(static_cast<double>(numbers[n]));
      }
    }
  }
  void check_shape(std::initializer_list<Index> shape);
  [[noreturn]] void refuse(const std::string & got);

private:
  /// Without a constructor: calls read no more than there is.
  struct Known
  {
    const char * word;
    std::size_t length;
    double value;
  };

  /// Look at the items up to the present one.
  void settle()
  {
    for (; ahead_ > 0; --ahead_) {
      read_item();
    }
  }
  void read_item();
  void find_bound();
  void require(double number);
  bool is_fitting(double length);
  double sum();
  double product();
  double factor();
  std::string_view word()
  {
    const char * const begin = at_;
    for (; (*at_ >= 'a' && *at_ <= 'z') || (*at_ >= 'A' && *at_ <= 'Z') || *at_ == '_'; ++at_) {}
    return {begin, static_cast<std::size_t>(at_ - begin)};
  }
  double count(char letter) const {return static_cast<double>(count_(object_, letter));}
  const double * find(std::string_view word) const;
  void know(std::string_view word, double value);

  static constexpr int MOST = 24;

  std::string_view function_, name_;
  /// Behind the present item, within it, and where it begins.
  const char * text_;
  const char * at_ = nullptr;
  const char * item_ = nullptr;
  int ahead_ = 0;
  bool is_plain_;
  void * object_ = nullptr;
  Index (* count_)(void *, char) = nullptr;
  /// Bounds of numbers: at least, or more than, or less than.
  double least_ = 0.0;
  double bound_ = 0.0;
  bool is_least_ = false;
  bool or_equal_ = false;
  int known_ = 0;
  Known words_[MOST];
  const char * kept_text_ = text_;
  int kept_known_ = 0;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SIGNATURE_HPP_
