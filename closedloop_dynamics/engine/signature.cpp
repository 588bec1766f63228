// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "signature.hpp"

#include <cctype>
#include <cmath>
#include <cstdlib>
#include <stdexcept>

namespace closedloop
{

void Signature::read_item()
{
  for (; *text_ == ',' || *text_ == ' '; ++text_) {}
  at_ = item_ = text_;
  for (int depth = 0; *text_ != '\0' && (depth > 0 || (*text_ != ',' && *text_ != ')')); ++text_) {
    depth += *text_ == '[' || *text_ == '(' ? 1 : *text_ == ']' || *text_ == ')' ? -1 : 0;
  }
  least_ = 0.0;
  if (std::isalpha(*at_) == 0) {
    least_ = sum();
    at_ += 2;
  }
  name_ = word();
}

void Signature::find_bound()
{
  is_least_ = *at_ == '>';
  or_equal_ = at_[1] == '=';
  at_ += or_equal_ ? 2 : 1;
  bound_ = sum();
}

void Signature::require(double number)
{
  if (!(std::isfinite(number) && (number == bound_ ? or_equal_ :
    is_least_ ? number > bound_ : number >= least_ && number < bound_)))
  {
    refuse(std::to_string(number));
  }
}

void Signature::check_shape(std::initializer_list<Index> shape)
{
  if (*at_ != '[') {
    return;
  }
  bool good = true;
  for (Index length : shape) {
    ++at_;
    good = is_fitting(static_cast<double>(length)) && good;
  }
  if (*at_ != ']') {
    throw std::logic_error("signature: " + std::string(item_, text_));
  }
  if (!good) {
    std::string got;
    for (Index length : shape) {
      got += (got.empty() ? "[" : ",") + std::to_string(length);
    }
    refuse(got + "]");
  }
}

void Signature::refuse(const std::string & got)
{
  settle();
  std::string known;
  const std::string item(item_, text_);
  for (at_ = item_; at_ < text_; ++at_) {
    if (std::isalpha(*at_) != 0) {
      const std::string_view each = word();
      const double * value = find(each);
      if (value != nullptr || (each.size() == 1 && std::isupper(each[0]) != 0)) {
        known += (known.empty() ? ", where " : ", ") + std::string(each) + " = " +
          std::to_string(std::llround(value != nullptr ? *value : count(each[0])));
      }
    }
  }
  throw std::invalid_argument(
          std::string(function_) + ": expected " + item + known + ", got " + got);
}

/// Whether a length meets all that is said of it at this place.
bool Signature::is_fitting(double length)
{
  for (; *at_ == ' '; ++at_) {}
  const char * const before = at_;
  if (std::islower(*at_) != 0 && find(word()) == nullptr) {
    know({before, static_cast<std::size_t>(at_ - before)}, length);
  } else {
    at_ = before;
  }
  bool good = true;
  while (*at_ != ',' && *at_ != ']') {
    const char sign = *at_;
    at_ += sign == '<' || sign == '>' ? 2 : sign == '=' ? 1 : 0;
    const double bound = sum();
    bool one = sign == '<' ? length <= bound : sign == '>' ? length >= bound : length == bound;
    for (; *at_ == '|'; one = length == sum() || one) {
      ++at_;
    }
    good = good && one;
  }
  return good;
}

double Signature::sum()
{
  double value = product();
  while (*at_ == '+' || *at_ == '-') {
    const double sign = *at_++ == '+' ? 1.0 : -1.0;
    value += sign * product();
  }
  return value;
}

double Signature::product()
{
  double value = factor();
  while (*at_ == '*' || *at_ == '/') {
    const bool divides = *at_++ == '/';
    const double other = factor();
    value = divides ? std::floor(value / other) : value * other;
  }
  return value;
}

double Signature::factor()
{
  if (*at_ == '(') {
    ++at_;
    const double value = sum();
    ++at_;
    return value;
  }
  if (std::isalpha(*at_) == 0) {
    char * end = nullptr;
    const double value = static_cast<double>(std::strtol(at_, &end, 10));
    at_ = end;
    return value;
  }
  const std::string_view each = word();
  if (std::isupper(each[0]) != 0) {
    return count(each[0]);
  }
  const double * known = find(each);
  if (known == nullptr) {
    throw std::logic_error("signature: " + std::string(item_, text_));
  }
  return *known;
}

const double * Signature::find(std::string_view word) const
{
  for (int n = 0; n < known_; ++n) {
    if (std::string_view(words_[n].word, words_[n].length) == word) {
      return &words_[n].value;
    }
  }
  return nullptr;
}

void Signature::know(std::string_view word, double value)
{
  if (known_ == MOST) {
    throw std::logic_error("signature: too many words");
  }
  words_[known_++] = {word.data(), word.size(), value};
}

}  // namespace closedloop
