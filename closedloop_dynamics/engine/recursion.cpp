// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "recursion.hpp"

#include <algorithm>

#include "loop_closure.hpp"
#include "routines.hpp"

namespace closedloop
{

void outward(const Model & model, Values q, Values qd, const Workspace & work)
{
  const Indexes & tree = model.tree;
  const Table & body = work.body;
  const Index first = model.gravity.size == 2 ?
    static_cast<Index>(plane::AX) : static_cast<Index>(space::ACCELERATION);
  for (Index k = 0; k < model.gravity.size; ++k) {
    body(0, first + k) = -model.gravity[k];
  }
  for (Index i = 1; i < tree.rows; ++i) {
    call_joint_kernel(
      model.kernel(i, kernel::MOVE), model.body.row(i), body.row(i), body.row(tree(i, tree::PARENT)),
      q.data + tree(i, tree::COORDINATE), qd.data + tree(i, tree::DOF));
  }
}

/// Turn the entries of spherical joints in so many rows of numbers, one every `next` numbers, in
/// which the entries are `stride` apart.
static void turn_spherical(
  Indexes tree, Table body, double * values, bool outward, Index rows, Index next, Index stride)
{
  const Index z = 2;
  for (Index i = 1; i < tree.rows; ++i) {
    if (tree(i, tree::TYPE) == tree::BALL && tree(i, tree::AXIS) == z) {
      double * entry = values + stride * (tree(i, tree::DOF) - 2);
      for (Index k = 0; k < rows; ++k, entry += next) {
        const double x[3] = {entry[0], entry[stride], entry[2 * stride]};
        for (Index n = 0; n < 3; ++n) {
          const Index row = outward ? space::FRAME + 3 * n : space::FRAME + n;
          const Index step = outward ? 1 : 3;
          entry[n * stride] =
            body(i, row) * x[0] + body(i, row + step) * x[1] + body(i, row + 2 * step) * x[2];
        }
      }
    }
  }
}

void turn_spherical(Indexes tree, Table body, double * values, bool outward)
{
  turn_spherical(tree, body, values, outward, 1, 0, 1);
}

void inward(const Model & model, Values tau, const Workspace & work, bool massless)
{
  const Indexes & tree = model.tree;
  const Table & body = work.body;
  for (Index i = 0; i < work.torque.size; ++i) {
    work.torque[i] = tau[i];
  }
  turn_spherical(tree, body, work.torque.data, true);
  const Index which = massless ? kernel::ELIMINATE_MASSLESS : kernel::ELIMINATE;
  for (Index i = tree.rows - 1; i > 0; --i) {
    call_joint_kernel(
      model.kernel(i, which), model.body.row(i), body.row(i), body.row(tree(i, tree::PARENT)),
      work.torque.data + tree(i, tree::DOF), work.torque.data);
  }
}

void outward_acceleration(const Model & model, const Workspace & work, Values qdd)
{
  const Indexes & tree = model.tree;
  const Table & body = work.body;
  for (Index i = 1; i < tree.rows; ++i) {
    call_joint_kernel(
      model.kernel(i, kernel::ACCELERATE), model.body.row(i), body.row(i),
      body.row(tree(i, tree::PARENT)), qdd.data + tree(i, tree::DOF), qdd.data);
  }
  turn_spherical(tree, body, qdd.data, false);
}

void energies(const Model & model, const Workspace & work, Values qd, Values out)
{
  const Indexes & tree = model.tree;
  const Table & body = work.body;
  double * moment = work.equation.data;
  out[0] = out[1] = 0.0;
  for (Index i = 1; i < tree.rows; ++i) {
    call_joint_kernel(
      model.kernel(i, kernel::MEASURE), model.body.row(i), body.row(i),
      body.row(tree(i, tree::PARENT)), moment, qd.data + tree(i, tree::DOF));
    out[0] += 0.5 * moment[0];
    for (Index k = 0; k < model.gravity.size; ++k) {
      out[1] -= model.gravity[k] * moment[1 + k];
    }
  }
}

void bias_forces(const Workspace & work, Table out)
{
  const Index size = work.size(), first = work.first_force();
  for (Index i = 0; i < out.rows; ++i) {
    for (Index n = 0; n < size; ++n) {
      out(i, n) = work.body(i, first + n);
    }
  }
}

void add_forces(const Workspace & work, Table forces)
{
  for (Index i = 0; i < forces.rows; ++i) {
    for (Index n = 0; n < forces.columns; ++n) {
      work.body(i, work.first_force() + n) += forces(i, n);
    }
  }
}

void newton(const Model & model, const Workspace & work, Values qdd, Table wrench)
{
  const Indexes & tree = model.tree;
  const Table & body = work.body;
  for (Index i = 0; i < work.torque.size; ++i) {
    work.torque[i] = qdd[i];
  }
  turn_spherical(tree, body, work.torque.data, true);
  for (Index i = 1; i < tree.rows; ++i) {
    call_joint_kernel(
      model.kernel(i, kernel::NEWTON), model.body.row(i), body.row(i),
      wrench.row(tree(i, tree::PARENT)), wrench.row(i), work.torque.data + tree(i, tree::DOF));
  }
}

bool carries(Indexes cut, Values lam, Index a)
{
  const Values own = lam.part(cut(a, cut::CUT_ROW), cut(a, cut::ROWS));
  return std::any_of(own.begin(), own.end(), [](double each) {return each != 0.0;});
}

void wrenches_of_cut(const Model & model, Table body, Values lam, Values share, Index a)
{
  const Indexes & cut = model.cut;
  // Generated code computes all equations of a cut joint: multipliers of omitted ones are zero.
  double with_zeros[6];
  double * multiplier = lam.data + cut(a, cut::CUT_ROW);
  if (cut(a, cut::KEPT) != cut(a, cut::POSSIBLE)) {
    const double * next = multiplier;
    double * last = multiplier = with_zeros;
    for (Index n = 0; n < 6; ++n) {
      if ((cut(a, cut::POSSIBLE) >> n & 1) != 0) {
        *last++ = (cut(a, cut::KEPT) >> n & 1) != 0 ? *next++ : 0.0;
      }
    }
  }
  call_joint_kernel(
    model.cut_kernel(a, kernel::WRENCH), model.cut_point.row(a), body.row(cut(a, cut::BODY_A)),
    body.row(cut(a, cut::BODY_B)), multiplier, share.data);
}

/// Carry the wrench of a body's row to its parent's.
static void shift(const Model & model, const Workspace & work, Table wrench, Index i)
{
  call_joint_kernel(
    model.kernel(i, kernel::SHIFT), model.body.row(i), work.body.row(i),
    wrench.row(model.tree(i, tree::PARENT)), wrench.row(i), work.share.data);
}

/// Wrenches on the bodies become those in the joints that carry them.
static void shift_to_joints(const Model & model, const Workspace & work, Table wrench)
{
  for (Index i = model.tree.rows - 1; i > 0; --i) {
    shift(model, work, wrench, i);
  }
}

/// Subtract the multipliers' wrenches from those of the bodies.
static void subtract_cut_wrenches(
  const Model & model, const Workspace & work, Values lam, Table wrench)
{
  const Indexes & cut = model.cut;
  const Index size = work.size();
  for (Index a = 0; a < cut.rows; ++a) {
    if (!carries(cut, lam, a)) {
      continue;
    }
    wrenches_of_cut(model, work.body, lam, work.share, a);
    for (Index n = 0; n < size; ++n) {
      wrench(cut(a, cut::BODY_A), n) -= work.share[size + n];
      wrench(cut(a, cut::BODY_B), n) -= work.share[2 * size + n];
    }
  }
}

void joint_wrenches(
  const Model & model, const Workspace & work, Values qdd, Values lam, Table wrench)
{
  newton(model, work, qdd, wrench);
  subtract_cut_wrenches(model, work, lam, wrench);
  shift_to_joints(model, work, wrench);
}

void wrenches_of_multipliers(
  const Model & model, const Workspace & work, Values lam, Table wrench)
{
  wrench.fill(0.0);
  subtract_cut_wrenches(model, work, lam, wrench);
  shift_to_joints(model, work, wrench);
}

void cut_wrenches(
  const Model & model, const Workspace & work, Table body, Values lam, Table out)
{
  for (Index a = 0; a < out.rows; ++a) {
    wrenches_of_cut(model, body, lam, work.share, a);
    for (Index n = 0; n < out.columns; ++n) {
      out(model.cut(a, cut::NUMBER), n) = work.share[n];
    }
  }
}

void tree_torque(const Model & model, const Workspace & work, Values qdd, Values out)
{
  const Table & wrench = work.force;
  bias_forces(work, wrench);
  newton(model, work, qdd, wrench);
  for (Index i = model.tree.rows - 1; i > 0; --i) {
    call_joint_kernel(
      model.kernel(i, kernel::TORQUE), model.body.row(i), work.body.row(i), work.body.row(i),
      wrench.row(i), out.data + model.tree(i, tree::DOF));
    shift(model, work, wrench, i);
  }
  turn_spherical(model.tree, work.body, out.data, false);
}

void constraint_jacobian(const Model & model, const Workspace & work, Table jac)
{
  const Indexes & cut = model.cut;
  jac.fill(0.0);
  update(model, work, Responses::CARRIED);
  for (Index a = 0; a < cut.rows; ++a) {
    for (Index k = 0; k < cut(a, cut::ROWS); ++k) {
      double * row = jac.row(cut(a, cut::CUT_ROW) + k);
      for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
        row[model.tree(model.path_body[entry], tree::DOF)] = work.response(entry, k);
      }
    }
  }
  turn_spherical(model.tree, work.body, jac.data, false, jac.rows, jac.columns, 1);
}

void generalized_inertia_matrix(const Model & model, const Workspace & work, Table gim)
{
  const Indexes & tree = model.tree;
  const Table & body = work.body;
  double * wrench = work.wrench.row(0);
  gim.fill(0.0);
  for (Index i = tree.rows - 1; i > 0; --i) {
    // Force of the composite body for a unit acceleration of its joint, then inward.
    call_joint_kernel(
      model.kernel(i, kernel::COMPOSE), model.body.row(i), body.row(i),
      body.row(tree(i, tree::PARENT)), wrench, work.share.data);
    const Index row = tree(i, tree::DOF);
    gim(row, row) = work.share[0];
    for (Index k = tree(i, tree::PARENT); k > 0; k = tree(k, tree::PARENT)) {
      call_joint_kernel(
        model.kernel(k, kernel::CARRY), model.body.row(k), body.row(k), body.row(k), wrench,
        work.share.data);
      gim(row, tree(k, tree::DOF)) = gim(tree(k, tree::DOF), row) = work.share[0];
    }
  }
  turn_spherical(tree, body, gim.data, false, gim.rows, gim.columns, 1);
  turn_spherical(tree, body, gim.data, false, gim.columns, 1, gim.columns);
}

}  // namespace closedloop
