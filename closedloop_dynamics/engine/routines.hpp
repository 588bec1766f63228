// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ROUTINES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ROUTINES_HPP_

#include <stdexcept>

#include "array.hpp"

// The one calling convention to generated code: addresses are numbers in tables.

namespace closedloop
{

/// Call the code generated for a body or a cut joint, on rows that it reads and writes.
inline void call_joint_kernel(
  Index address, const double * constant, double * own, double * other, double * first,
  double * second)
{
  using Kernel = Index (*)(const double *, double *, double *, double *, double *);
  reinterpret_cast<Kernel>(address)(constant, own, other, first, second);
}

/// Throws std::invalid_argument where a table lacks one of some routines.
inline void require_routines(Indices table, Index first, Index count)
{
  for (Index n = first; n < first + count; ++n) {
    if (table[n] == 0) {
      throw std::invalid_argument("expected addresses of routines");
    }
  }
}

/// Call a routine generated for a mechanism; return whether its results are good.
inline bool call(Indices table, Index which, Vector<double> q, Vector<double> qd)
{
  using Routine = Index (*)(const Index *, const double *, const double *);
  return reinterpret_cast<Routine>(table[which])(table.data, q.data, qd.data) != 0;
}

/// Call routine 0 of a table on a state, then routine 1, which uses its results, from each row of
/// columns to the same row of the results; return whether all are good.
inline bool call_for_columns(
  Indices table, Vector<double> q, Vector<double> qd, Matrix<double> columns,
  Matrix<double> results)
{
  bool good = call(table, 0, q, qd);
  for (Index n = 0; good && n < columns.rows; ++n) {
    good = call(table, 1, columns[n], results[n]);
  }
  return good;
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ROUTINES_HPP_
