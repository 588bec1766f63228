// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "elimination.hpp"

#include <algorithm>

namespace closedloop
{

namespace
{
// A pivot below this is small in the mass metric: next to a singular configuration, but also where
// links differ much in mass. Refinement then judges by the geometry.
constexpr double SMALL_PIVOT = 1e-3;
// In long chains small pivots show the size, not the configuration: the smallest one of a
// regular ladder or chain is 0.3 / nv or 0.9 / nv. From so many joints on the limit falls likewise.
constexpr double MANY_JOINTS = 100.0;
}  // namespace

void assemble(const Model & model, const Workspace & work)
{
  const Table & response = work.response, & scaled = work.response_scaled;
  const Values & factor = work.factor, & scale = work.scale;
  const Indexes & cut = model.cut, & block = model.block, & pair = model.pair;
  factor.fill(0.0);
  for (Index a = 0; a < cut.rows; ++a) {
    for (Index c = 0; c < cut(a, cut::ROWS); ++c) {
      const Index place = model.column[cut(a, cut::ROW) + c];
      for (Index k = c; k < cut(a, cut::ROWS); ++k) {
        double total = 0.0;
        for (Index p = cut(a, cut::PATH_A); p < cut(a, cut::PATH_END); ++p) {
          total += response(p, k) * scaled(p, c);
        }
        factor[place + k - c] = total;
      }
      scale[cut(a, cut::ROW) + c] = factor[place];
    }
    if (cut(a, cut::TYPE) != cut::PRISMATIC && cut(a, cut::LENGTHS) > 1) {
      const Index first = cut(a, cut::ROW);
      const double larger = std::max(scale[first], scale[first + 1]);
      scale[first] = larger;
      scale[first + 1] = larger;
    }
  }
  for (Index n = 0; n < block.rows; ++n) {
    const Index later = block(n, 0), earlier = block(n, 1);
    for (Index c = 0; c < cut(earlier, cut::ROWS); ++c) {
      const Index place = model.entry(n, c);
      for (Index k = 0; k < cut(later, cut::ROWS); ++k) {
        double total = 0.0;
        for (Index m = block(n, 2); m < block(n, 3); ++m) {
          total += response(pair(m, 0), k) * scaled(pair(m, 1), c);
        }
        factor[place + k] = total;
      }
    }
  }
}

double factorize(const Model & model, const Workspace & work)
{
  const Indices & column = model.column, & row = model.row, & dependency = model.dependency;
  const Values & factor = work.factor, & scatter = work.scatter, & inverse = work.pivot_inverse;
  const Indexes & places = model.dependency_place;
  double smallest = 1.0;
  for (Index j = 0; j < column.size - 1; ++j) {
    const Index first = column[j], last = column[j + 1];
    if (dependency[j] < dependency[j + 1]) {
      for (Index t = first; t < last; ++t) {
        scatter[row[t]] = factor[t];
      }
      for (Index d = dependency[j]; d < dependency[j + 1]; ++d) {
        const Index k = places(d, 0), place = places(d, 1);
        const double share = factor[place] * inverse[k];
        for (Index t = place; t < column[k + 1]; ++t) {
          scatter[row[t]] -= factor[t] * share;
        }
      }
      for (Index t = first; t < last; ++t) {
        factor[t] = scatter[row[t]];
      }
    }
    const double ratio = factor[first] / work.scale[j];
    // Written so that a NaN (0/0: an equation no motion can change) counts as poor.
    if (!(ratio >= smallest)) {
      smallest = ratio > 0.0 ? ratio : 0.0;
    }
    inverse[j] = 1.0 / factor[first];
  }
  return smallest;
}

bool good(const Model & model, double smallest, double limit)
{
  return smallest >= limit * std::min(1.0, MANY_JOINTS / static_cast<double>(model.tree.rows));
}

bool factorize_well(const Model & model, const Workspace & work)
{
  const double smallest = factorize(model, work);
  const bool fine = good(model, smallest, SMALL_PIVOT);
  // A small one may be due to the masses alone: refinement then records its own.
  record_pivot(model, work, fine ? smallest : 1.0);
  return fine;
}

void record_pivot(const Model & model, const Workspace & work, double smallest)
{
  const Values & health = work.health;
  health[health::RANK] = static_cast<double>(model.equations());
  health[health::SMALLEST_PIVOT] = smallest;
  const double ever = health[health::SMALLEST_PIVOT_EVER];
  health[health::SMALLEST_PIVOT_EVER] = smallest < ever ? smallest : ever;
}

void solve(const Model & model, const Workspace & work, Values right)
{
  const Indices & column = model.column, & row = model.row;
  const Values & factor = work.factor, & inverse = work.pivot_inverse;
  const Index rows = column.size - 1;
  for (Index k = 0; k < rows; ++k) {
    const double scaled = right[k] * inverse[k];
    right[k] = scaled;
    for (Index t = column[k] + 1; t < column[k + 1]; ++t) {
      right[row[t]] -= factor[t] * scaled;
    }
  }
  for (Index k = rows - 2; k >= 0; --k) {
    double total = 0.0;
    for (Index t = column[k] + 1; t < column[k + 1]; ++t) {
      total += factor[t] * right[row[t]];
    }
    right[k] -= total * inverse[k];
  }
}

}  // namespace closedloop
