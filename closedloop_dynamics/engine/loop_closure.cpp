// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "loop_closure.hpp"

#include <algorithm>
#include <cmath>

#include "routines.hpp"

namespace closedloop
{

/// Transmit a wrench inward along entries of a path; store its component in each joint.
static void carry(
  const Model & model, const Workspace & work, Index which, Index first, Index last,
  double * wrench, Index row)
{
  for (Index entry = first; entry < last; ++entry) {
    const Index i = model.path_body[entry];
    call_joint_kernel(
      model.kernel(i, which), model.body.row(i), work.body.row(i), work.body.row(i), wrench,
      work.share.data);
    work.response(entry, row) = work.share[0];
    work.response_scaled(entry, row) = work.share[1];
  }
}

/// Respond to a coupling of joints, and to the place or angle of two bodies that it may belong to; a
/// path entry's body comes before its parent.
static void respond_with_joints(
  const Model & model, const Workspace & work, Index which, Index a, CutParts parts)
{
  const Indexes & cut = model.cut;
  const Table & arrived = work.force;
  const Values & share = work.share, & equation = work.equation;
  const Index first = cut(a, cut::PATH_A), last = cut(a, cut::PATH_END), size = work.size();
  const bool reduces = which == kernel::REDUCE;
  for (Index entry = first; entry < last; ++entry) {
    const Index i = model.path_body[entry];
    arrived[i].fill(0.0);
    arrived[model.tree(i, tree::PARENT)].fill(0.0);
  }
  for (Index n = 0; parts.bodies && n < size; ++n) {
    arrived(cut(a, cut::BODY_A), n) = equation[3 + n];
  }
  for (Index n = 0; parts.bodies && n < size; ++n) {
    arrived(cut(a, cut::BODY_B), n) += equation[3 + size + n];
  }
  for (Index entry = first; entry < last; ++entry) {
    const Index i = model.path_body[entry], p = model.tree(i, tree::PARENT);
    // That of the joint of a law is its slope.
    const double factor = !parts.bodies && i == cut(a, cut::BODY_A) ? equation[3] :
      model.cut_point(a, parts.sum + cut::FACTORS + entry - first);
    share[0] = factor;
    share[1] = 0.0;
    call_joint_kernel(
      model.kernel(i, reduces ? static_cast<Index>(kernel::REDUCE_COUPLED) : which),
      model.body.row(i), work.body.row(i), work.body.row(i), arrived.row(i), share.data);
    if (!reduces) {
      share[0] += factor;
    }
    for (Index n = 0; n < size; ++n) {
      arrived(p, n) += arrived(i, n);
    }
    if (which == kernel::LEVER && work.planar()) {
      // A joint's angle is its body's less its parent's; a slide turns with its parent. In a column
      // that no planar wrench has.
      if (model.tree(i, tree::TYPE) == tree::PRISMATIC) {
        arrived(p, 3) += arrived(i, 3);
      } else {
        share[0] += arrived(i, 3);
        arrived(p, 3) -= factor;
      }
    }
    work.response(entry, 0) = share[0];
    work.response_scaled(entry, 0) = share[1];
  }
}

void respond(const Model & model, const Workspace & work, Index which, Index a, Index row)
{
  const Indexes & cut = model.cut;
  const Table & wrench = work.wrench;
  const Index size = work.size();
  const CutParts parts = model.parts(a);
  if (parts.joints) {
    respond_with_joints(model, work, which, a, parts);
    return;
  }
  const Index place = row * (3 + 2 * size) + 3;
  for (Index n = 0; n < size; ++n) {
    wrench(0, n) = work.equation[place + n];
    wrench(1, n) = work.equation[place + size + n];
  }
  const Index middle = cut(a, cut::PATH_B), common = cut(a, cut::PATH_COMMON);
  const Index end = cut(a, cut::PATH_END);
  carry(model, work, which, cut(a, cut::PATH_A), middle, wrench.row(0), row);
  if (middle < end) {
    carry(model, work, which, middle, common, wrench.row(1), row);
    if (common < end) {
      for (Index n = 0; n < size; ++n) {
        wrench(0, n) += wrench(1, n);
      }
      carry(model, work, which, common, end, wrench.row(0), row);
    }
  }
}

/// Value and rate of a coupling: its weighted sum of tree joints, less its constant.
static void sum_of_joints(
  const Model & model, const Workspace & work, Index a, Index begin, double & value,
  double & rate)
{
  const Indexes & cut = model.cut;
  const Index position = work.planar() ?
    static_cast<Index>(plane::POSITION) : static_cast<Index>(space::JOINT_POSITION);
  const Index speed = work.planar() ?
    static_cast<Index>(plane::RATE) : static_cast<Index>(space::JOINT_RATE);
  value = -model.cut_point(a, begin + cut::HELD_SUM);
  rate = 0.0;
  for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
    const double factor =
      model.cut_point(a, begin + cut::FACTORS + entry - cut(a, cut::PATH_A));
    if (factor != 0.0) {
      value += factor * work.body(model.path_body[entry], position);
      rate += factor * work.body(model.path_body[entry], speed);
    }
  }
}

/// Generated code computes all equations of a cut joint: move the kept ones to the front.
static void move_kept_to_front(Index possible, Index kept, Index size, double * equation)
{
  double * next = equation;
  for (; possible != 0; possible >>= 1, kept >>= 1) {
    if ((possible & 1) == 0) {
      continue;
    }
    if ((kept & 1) != 0) {
      if (next != equation) {
        std::copy(equation, equation + size, next);
      }
      next += size;
    }
    equation += size;
  }
}

void measure(const Model & model, const Workspace & work, Index a)
{
  const Indexes & cut = model.cut;
  const Table & point = model.cut_point;
  const CutParts parts = model.parts(a);
  const Index last = point.columns - cut::MOTION_COLUMNS;
  double value = 0.0, rate = 0.0;
  if (parts.joints) {
    sum_of_joints(model, work, a, parts.sum, value, rate);
  }
  if (!parts.bodies) {
    work.equation[0] = work.equation[1] = work.equation[2] = 0.0;
    if (cut(a, cut::BODY_A) != 0) {
      // The law of a coupling, and its slope behind it.
      call_joint_kernel(
        model.cut_kernel(a, kernel::EQUATIONS), point.row(a), work.body.row(cut(a, cut::BODY_A)),
        work.body.row(cut(a, cut::BODY_B)), work.equation.data, work.share.data);
    }
    work.equation[0] += value;
    work.equation[1] += rate;
    for (Index n = 0; parts.moves && n < cut::MOTION_COLUMNS; ++n) {
      work.equation[n] -= point(a, last + n);
    }
    return;
  }
  if (parts.joints) {
    point(a, last) = -value;
    point(a, last + 1) = -rate;
    point(a, last + 2) = 0.0;
  }
  call_joint_kernel(
    model.cut_kernel(a, kernel::EQUATIONS), point.row(a), work.body.row(cut(a, cut::BODY_A)),
    work.body.row(cut(a, cut::BODY_B)), work.equation.data, work.share.data);
  if (cut(a, cut::KEPT) != cut(a, cut::POSSIBLE)) {
    move_kept_to_front(
      cut(a, cut::POSSIBLE), cut(a, cut::KEPT), 3 + 2 * work.size(), work.equation.data);
  }
}

void update(const Model & model, const Workspace & work, Responses responses)
{
  const Indexes & cut = model.cut;
  const Values & equation = work.equation;
  const Index size = 3 + 2 * work.size();
  const Index piece = responses == Responses::REDUCED ? kernel::REDUCE :
    responses == Responses::LEVERS ? kernel::LEVER : kernel::CARRY;
  for (Index a = 0; a < cut.rows; ++a) {
    measure(model, work, a);
    for (Index k = 0; k < cut(a, cut::ROWS); ++k) {
      const Index row = cut(a, cut::ROW) + k;
      work.closure[row] = equation[k * size];
      work.closure_rate[row] = equation[k * size + 1];
      work.bias[row] = equation[k * size + 2];
      if (responses != Responses::NONE) {
        respond(model, work, piece, a, k);
      }
    }
  }
}

double largest(Values values)
{
  double most = 0.0;
  for (double value : values) {
    if (!(std::abs(value) <= most)) {
      most = std::abs(value);
    }
  }
  return most;
}

double rate_scale(Values qd) {return std::max(1.0, largest(qd));}

void free_acceleration(const Model & model, const Workspace & work, Values out)
{
  const Indexes & cut = model.cut;
  for (Index a = 0; a < cut.rows; ++a) {
    for (Index k = 0; k < cut(a, cut::ROWS); ++k) {
      double total = 0.0;
      for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
        total += work.response_scaled(entry, k) * work.body(model.path_body[entry], work::RHS);
      }
      out[cut(a, cut::ROW) + k] = total;
    }
  }
}

void apply(const Model & model, const Workspace & work, Values lam)
{
  const Indexes & cut = model.cut;
  for (Index a = 0; a < cut.rows; ++a) {
    for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
      double & total = work.body(model.path_body[entry], work::RHS);
      for (Index k = 0; k < cut(a, cut::ROWS); ++k) {
        total += work.response(entry, k) * lam[cut(a, cut::ROW) + k];
      }
    }
  }
}

void to_user_order(const Model & model, Values ordered, Values out)
{
  const Indexes & cut = model.cut;
  for (Index a = 0; a < cut.rows; ++a) {
    for (Index k = 0; k < cut(a, cut::ROWS); ++k) {
      out[cut(a, cut::CUT_ROW) + k] = ordered[cut(a, cut::ROW) + k];
    }
  }
}

}  // namespace closedloop
