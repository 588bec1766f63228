// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__MODEL_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__MODEL_HPP_

#include "array.hpp"
#include "columns.hpp"

// Data of the kernels: the constant Model and the mutable Workspace. The fields are those of the
// named tuples of the same names in Python, in the same order; `fields` names them for
// bindings.cpp.

namespace closedloop
{

/// Constant description of one mechanism (core/types.py).
struct Model
{
  Indexes tree;
  Table body;
  Values gravity;
  Indexes cut;
  Table cut_point;
  Indices path_body;
  Indexes pair;
  Indexes block;
  Indices column;
  Indices row;
  Indexes entry;
  Indices dependency;
  Indexes dependency_place;

  Index joints() const {return tree.rows - 1;}
  Index equations() const {return column.size - 1;}

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(tree, body, gravity, cut, cut_point, path_body, pair, block, column, row, entry,
      dependency, dependency_place);
  }
};

/// Results and scratch of one evaluation (core/types.py).
struct Workspace
{
  Table body;
  Table response;
  Table response_scaled;
  Values factor;
  Values scale;
  Table lever;
  Table joint;
  Values change;
  Values pivot_inverse;
  Values right;
  Values scatter;
  Values closure;
  Values closure_rate;
  Values bias;
  Values equation;
  Table wrench;
  Values share;
  Values torque;
  Table force;
  Indexes kernel;
  Indexes cut_kernel;
  Values health;

  bool planar() const {return wrench.columns == 3;}
  /// Components of a wrench: 3 in the plane, 6 in space.
  Index size() const {return wrench.columns;}
  /// First column of the bodies' bias forces.
  Index first_force() const
  {
    return planar() ? static_cast<Index>(plane::FZ) : static_cast<Index>(space::FORCE);
  }

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(body, response, response_scaled, factor, scale, lever, joint, change, pivot_inverse,
      right, scatter, closure, closure_rate, bias, equation, wrench, share, torque, force, kernel,
      cut_kernel, health);
  }
};

/// Places of quaternions among the coordinates (core/manifold.py); empty without any.
struct Manifold
{
  Indexes balls;
  Indices place;
  Values number;

  bool empty() const {return balls.rows == 0;}

  template<class Visitor>
  void fields(Visitor && visit) {visit(balls, place, number);}
};

/// Matrices of the dense formulations (core/formulations.py).
struct DenseWorkspace
{
  Table gim;
  Table jac;
  Values free;
  Values right;
  Table schur;
  Table kkt;
  Indices pivots;
  Values solution;

  template<class Visitor>
  void fields(Visitor && visit) {visit(gim, jac, free, right, schur, kkt, pivots, solution);}
};

/// Which coordinates are independent (core/independent.py).
struct Partition
{
  Indices order;
  Table jac;
  Table scaled;
  Table matrix;
  Indices pivots;
  Values right;
  Values change;
  Values record;

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(order, jac, scaled, matrix, pivots, right, change, record);
  }
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__MODEL_HPP_
