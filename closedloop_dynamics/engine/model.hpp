// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__MODEL_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__MODEL_HPP_

#include <bitset>

#include "array.hpp"
#include "columns.hpp"

namespace closedloop
{

/// How many equations of a cut joint are marked by bits.
inline Index count_equations(Index bits)
{
  return static_cast<Index>(std::bitset<6>(static_cast<unsigned long long>(bits)).count());  // NOLINT: of bitset
}

/// What the equations of a cut joint are made of, by its type.
struct CutParts
{
  bool bodies;  ///< The place or direction of two bodies
  bool joints;  ///< A weighted sum of joints of the tree
  bool moves;  ///< A right-hand side that is prescribed
  Index sum;  ///< Column of Model.cut_point where that sum begins
};

/// Constant description of one mechanism. Per body there is one row, so that what belongs to one
/// body lies in one piece of memory; row 0 is the ground: recursions need no special case for it.
/// Bodies are numbered so that a parent comes before its children, subsystem by subsystem;
/// coordinates, rates, torques and multipliers of the interface keep the user's order. Columns are
/// those of engine/types.py.
struct Model
{
  /// Shape (nb + 1, 7): topology.
  Array<Indexes> tree;
  /// Shape (nb + 1, 8 or 28): constants, which effects change.
  Array<Table> body;
  /// Shape (2,), in space (3,): [m/s^2].
  Array<Values> gravity;
  /// Topology of each cut joint, and which of its equations the elimination works on.
  Array<Indexes> cut;
  /// Constants of each cut joint.
  Array<Table> cut_point;
  /// The body of every path entry: a place on the path of a cut force.
  Array<Indices> path_body;
  /// Off-diagonal blocks of the constraint matrix: (path entry of the later cut, that of the
  /// earlier) that share a body, with the rows of both cuts packed in `block`.
  Array<Indexes> pair;
  /// Each block below the diagonal: (later cut, earlier cut, first pair, last pair + 1).
  Array<Indexes> block;
  /// First entry of each column of the factor L, which includes its diagonal; shape (nc + 1,).
  Array<Indices> column;
  /// Row of each entry of L, in elimination order.
  Array<Indices> row;
  /// Index in L of the first entry of each block, for each of the earlier cut's columns.
  Array<Indexes> entry;
  /// First entry in `dependency_place` of each row; shape (nc + 1,).
  Array<Indices> dependency;
  /// (earlier column k, place of the row in column k), left of each diagonal.
  Array<Indexes> dependency_place;
  /// Addresses of the code for the joint of each body, and for each cut joint, which models of one
  /// mechanism share.
  Array<Indexes> kernel;
  Array<Indexes> cut_kernel;

  Model() = default;
  /// Copy the first six; all else follows from them. Throws std::invalid_argument.
  Model(
    Matrix<const Index> tree, Matrix<const double> body, Vector<const double> gravity,
    Matrix<const Index> cut, Matrix<const double> cut_point, Vector<const Index> path_body);
  /// A model of the same memory but for the equations worked on; throws std::invalid_argument.
  Model(const Model & like, Matrix<const Index> cut);

  CutParts parts(Index a) const
  {
    const Index type = cut(a, cut::TYPE);
    const bool tied = type == cut::COUPLING || type == cut::PRESCRIBED_JOINT;
    return {
      !tied, tied || type >= cut::COUPLED_PLACE, type >= cut::PRESCRIBED_JOINT,
      tied ? 0 : between_columns()};
  }
  /// Columns of `cut_point` for what is between two bodies.
  Index between_columns() const
  {
    return planar() ?
           static_cast<Index>(plane::CUT_POINT_COLUMNS) : static_cast<Index>(space::CUT_POINT_COLUMNS);
  }
  Index joints() const {return tree.rows - 1;}
  Index equations() const {return column.size - 1;}
  /// Length of the coordinates.
  Index coordinates() const;
  bool planar() const {return gravity.size == 2;}
  /// Components of a wrench: 3 in the plane, 6 in space.
  Index size() const {return planar() ? 3 : 6;}
  /// Whether the loops over bodies have their code.
  bool is_connected() const
  {
    return joints() == 0 || kernel(joints(), kernel::MOVE) != 0;
  }

  CLOSEDLOOP_ARRAYS(
    tree, body, gravity, cut, cut_point, path_body, pair, block, column, row, entry, dependency,
    dependency_place, kernel, cut_kernel)

private:
  void find_blocks();
  void find_factor();
};

/// Places of quaternions among the coordinates; empty without any. A quaternion x, y, z, w turns
/// the joint's frame into the child's; its rates are the angular velocity about the child's axes.
struct Manifold
{
  /// First coordinate and first rate of each.
  Array<Indexes> balls;
  /// Coordinate of each rate; less than 0 for those of rotations.
  Array<Indices> place;
  /// Scratch: the coordinate of each rate, 0 for those of rotations.
  Array<Values> number;

  Manifold() = default;
  explicit Manifold(const Model &);

  bool empty() const {return balls.rows == 0;}
  /// Whether it is for coordinates and rates of such lengths.
  bool fits(Index nq, Index nv) const
  {
    return nq == nv + balls.rows && (empty() || place.size == nv);
  }

  CLOSEDLOOP_ARRAYS(balls, place, number)
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__MODEL_HPP_
