// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "model.hpp"

#include <initializer_list>
#include <set>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "bounds.hpp"

namespace closedloop
{

namespace
{
constexpr Index TREE_COLUMNS = 7, CUT_COLUMNS = 14, BODY_KERNELS = 13, CUT_KERNELS = 2;
constexpr Index BODY_COLUMNS = 8, SPATIAL_BODY_COLUMNS = 28;

void require(bool good, const char * what)
{
  if (!good) {
    throw std::invalid_argument(std::string("model: ") + what);
  }
}

void check_tree(const Model & model)
{
  const Indexes & tree = model.tree;
  const Index bodies = tree.rows, nv = model.joints();
  require(
    bodies >= 1 && tree.columns == TREE_COLUMNS && (model.planar() || model.gravity.size == 3) &&
    has_shape(model.body, bodies, model.planar() ? BODY_COLUMNS : SPATIAL_BODY_COLUMNS),
    "expected a tree, its bodies and gravity of shapes that belong together");
  const Index nq = model.coordinates();
  for (Index i = 1; i < bodies; ++i) {
    require(is_place(tree(i, tree::PARENT), i), "expected parents before their children");
    const bool ball = tree(i, tree::TYPE) == tree::BALL;
    // A spherical joint has a row for each of three rates; the last row is checked for all.
    const Index before = ball && tree(i, tree::AXIS) == 2 ? 2 : 0;
    require(
      is_place(tree(i, tree::DOF) - before, nv - before) &&
      is_place(tree(i, tree::COORDINATE), nq - (ball ? 3 : 0)) &&
      is_place(tree(i, tree::AXIS), 3), "expected places of coordinates among these");
  }
}

/// Columns of `cut_point` that a cut joint needs.
Index columns_of(const Model & model, Index a)
{
  const CutParts parts = model.parts(a);
  const Index factors = parts.joints ?
    cut::FACTORS + model.cut(a, cut::PATH_END) - model.cut(a, cut::PATH_A) : 0;
  const Index motion = parts.moves ? static_cast<Index>(cut::MOTION_COLUMNS) : 0;
  return std::max(model.between_columns(), parts.sum + factors + motion);
}

/// Returns how many equations are worked on.
Index check_cuts(const Model & model)
{
  const Index nv = model.joints(), cuts = model.cut.rows, entries = model.path_body.size;
  require(
    model.cut.columns == CUT_COLUMNS && model.cut_point.rows == cuts,
    "expected cut joints and their constants, one row each");
  Index nc = 0;
  for (Index a = 0; a < cuts; ++a) {
    const Index possible = model.cut(a, cut::POSSIBLE), kept = model.cut(a, cut::KEPT);
    require(
      is_place(possible, 64) && (kept & ~possible) == 0 &&
      count_equations(kept) == model.cut(a, cut::ROWS),
      "expected equations of a cut joint among those of its type");
    nc += model.cut(a, cut::ROWS);
  }
  for (Index a = 0; a < cuts; ++a) {
    const Index * cut = model.cut.row(a), rows = cut[cut::ROWS];
    require(
      is_range(cut[cut::ROW], cut[cut::ROW] + rows, nc) &&
      is_range(cut[cut::CUT_ROW], cut[cut::CUT_ROW] + rows, nc) &&
      is_place(cut[cut::NUMBER], cuts) && (cut[cut::LENGTHS] <= 1 || rows >= 2),
      "expected places of equations among these");
    require(
      is_range(cut[cut::PATH_A], cut[cut::PATH_B], entries) &&
      is_range(cut[cut::PATH_B], cut[cut::PATH_COMMON], entries) &&
      is_range(cut[cut::PATH_COMMON], cut[cut::PATH_END], entries),
      "expected paths among the entries");
    require(
      model.cut_point.columns >= columns_of(model, a), "expected factors of all that is coupled");
  }
  require(
    within(model.cut, cut::BODY_A, 0, 0, nv) && within(model.cut, cut::BODY_B, 0, 0, nv) &&
    within(model.path_body, 1, nv), "expected cut joints and paths on its bodies");
  return nc;
}

/// For each cut joint, in the order of elimination, the later ones that the factor joins it to:
/// those on the same subsystems, and the fill-in.
std::vector<std::set<Index>> structure_of(const Model & model)
{
  const Index cuts = model.cut.rows;
  std::vector<std::set<Index>> subsystems(static_cast<std::size_t>(cuts)), reach(subsystems);
  for (Index a = 0; a < cuts; ++a) {
    for (Index entry = model.cut(a, cut::PATH_A); entry < model.cut(a, cut::PATH_END); ++entry) {
      subsystems[a].insert(model.tree(model.path_body[entry], tree::SUBSYSTEM));
    }
    for (Index body : {model.cut(a, cut::BODY_A), model.cut(a, cut::BODY_B)}) {
      if (body > 0) {
        subsystems[a].insert(model.tree(body, tree::SUBSYSTEM));
      }
    }
  }
  for (Index a = 0; a < cuts; ++a) {
    for (Index b = a + 1; b < cuts; ++b) {
      if (std::any_of(
          subsystems[a].begin(), subsystems[a].end(),
          [&](Index each) {return subsystems[b].count(each) > 0;}))
      {
        reach[a].insert(b);
      }
    }
  }
  for (std::set<Index> & later : reach) {
    if (!later.empty()) {
      // Eliminating a column passes its fill-in to the first column it reaches.
      std::set<Index> & first = reach[*later.begin()];
      first.insert(std::next(later.begin()), later.end());
    }
  }
  return reach;
}

Array<Indices> array_of(const std::vector<Index> & values)
{
  Array<Indices> made(static_cast<Index>(values.size()));
  std::copy(values.begin(), values.end(), made.begin());
  made.is_constant = true;
  return made;
}

/// Rows of `columns` numbers each.
Array<Indexes> rows_of(const std::vector<Index> & values, Index columns)
{
  Array<Indexes> made(static_cast<Index>(values.size()) / columns, columns);
  std::copy(values.begin(), values.end(), made.data);
  made.is_constant = true;
  return made;
}
}  // namespace

Model::Model(
  Matrix<const Index> tree, Matrix<const double> body, Vector<const double> gravity,
  Matrix<const Index> cut, Matrix<const double> cut_point, Vector<const Index> path_body)
: tree(Array<Indexes>::copy_of(tree)), body(Array<Table>::copy_of(body)),
  gravity(Array<Values>::copy_of(gravity)), cut(Array<Indexes>::copy_of(cut)),
  cut_point(Array<Table>::copy_of(cut_point)), path_body(Array<Indices>::copy_of(path_body)),
  kernel(tree.rows, BODY_KERNELS), cut_kernel(cut.rows, CUT_KERNELS)
{
  check_tree(*this);
  this->path_body.is_constant = this->cut.is_constant = true;
  column = Array<Indices>(check_cuts(*this) + 1);
  find_blocks();
  find_factor();
}

Model::Model(const Model & like, Matrix<const Index> cut)
: Model(like)
{
  require(
    cut.rows == like.cut.rows && cut.columns == like.cut.columns,
    "expected the same cut joints");
  for (Index a = 0; a < cut.rows; ++a) {
    for (Index each : {
        cut::TYPE, cut::BODY_A, cut::BODY_B, cut::PATH_A, cut::PATH_B, cut::PATH_COMMON,
        cut::PATH_END, cut::NUMBER, cut::POSSIBLE})
    {
      require(cut(a, each) == like.cut(a, each), "expected the same cut joints");
    }
  }
  this->cut = Array<Indexes>::copy_of(cut);
  this->cut.is_constant = true;
  column = Array<Indices>(check_cuts(*this) + 1);
  find_factor();
}

Index Model::coordinates() const
{
  Index count = joints();
  for (Index i = 1; i < tree.rows; ++i) {
    // The last of the three rows of a spherical joint.
    count += tree(i, tree::TYPE) == tree::BALL && tree(i, tree::AXIS) == 2 ? 1 : 0;
  }
  return count;
}

void Model::find_blocks()
{
  // Bodies in the order in which paths come to them, and of each the path entries there.
  std::vector<Index> order;
  std::vector<std::vector<std::pair<Index, Index>>> visits(static_cast<std::size_t>(tree.rows));
  for (Index a = 0; a < cut.rows; ++a) {
    for (Index entry = cut(a, cut::PATH_A); entry < cut(a, cut::PATH_END); ++entry) {
      const Index body = path_body[entry];
      if (visits[body].empty()) {
        order.push_back(body);
      }
      visits[body].emplace_back(a, entry);
    }
  }
  std::map<std::pair<Index, Index>, std::vector<Index>> meeting;
  for (Index body : order) {
    const auto & here = visits[body];
    for (auto earlier = here.begin(); earlier != here.end(); ++earlier) {
      for (auto later = std::next(earlier); later != here.end(); ++later) {
        std::vector<Index> & found = meeting[{earlier->first, later->first}];
        found.insert(found.end(), {later->second, earlier->second});
      }
    }
  }
  std::vector<Index> blocks, pairs;
  for (const auto & [cuts, entries] : meeting) {
    const Index first = static_cast<Index>(pairs.size()) / 2;
    pairs.insert(pairs.end(), entries.begin(), entries.end());
    blocks.insert(
      blocks.end(), {cuts.second, cuts.first, first, static_cast<Index>(pairs.size()) / 2});
  }
  pair = rows_of(pairs, 2);
  block = rows_of(blocks, 4);
}

void Model::find_factor()
{
  const Index nc = equations();
  const std::vector<std::set<Index>> structure = structure_of(*this);
  std::vector<Index> rows;
  Index next = 0, most = 3;
  for (Index a = 0; a < cut.rows; ++a) {
    const Index first = cut(a, cut::ROW), count = cut(a, cut::ROWS);
    require(first == next, "expected equations in the order of elimination");
    next += count;
    most = std::max(most, count);
    for (Index c = first; c < first + count; ++c) {
      column[c] = static_cast<Index>(rows.size());
      for (Index below = c; below < first + count; ++below) {
        rows.push_back(below);
      }
      for (Index later : structure[a]) {
        for (Index k = 0; k < cut(later, cut::ROWS); ++k) {
          rows.push_back(cut(later, cut::ROW) + k);
        }
      }
    }
  }
  column[nc] = static_cast<Index>(rows.size());
  row = array_of(rows);
  entry = Array<Indexes>(block.rows, most);
  for (Index n = 0; n < block.rows; ++n) {
    const Index later = block(n, 0), earlier = block(n, 1);
    for (Index c = 0; c < cut(earlier, cut::ROWS); ++c) {
      Index * first = row.data + column[cut(earlier, cut::ROW) + c];
      entry(n, c) = std::find(first, row.end(), cut(later, cut::ROW)) - row.data;
    }
  }
  std::vector<std::vector<Index>> left(static_cast<std::size_t>(nc));
  for (Index c = 0; c < nc; ++c) {
    for (Index place = column[c] + 1; place < column[c + 1]; ++place) {
      left[row[place]].insert(left[row[place]].end(), {c, place});
    }
  }
  std::vector<Index> all;
  dependency = Array<Indices>(nc + 1);
  for (Index c = 0; c < nc; ++c) {
    all.insert(all.end(), left[c].begin(), left[c].end());
    dependency[c + 1] = static_cast<Index>(all.size()) / 2;
  }
  dependency_place = rows_of(all, 2);
  column.is_constant = entry.is_constant = dependency.is_constant = true;
}

Manifold::Manifold(const Model & model)
{
  const Index nv = model.joints(), count = model.coordinates() - nv;
  if (count == 0) {
    return;
  }
  balls = Array<Indexes>(count, 2);
  place = Array<Indices>(nv);
  number = Array<Values>(nv);
  place.fill(-1);
  Index n = 0;
  for (Index i = 1; i < model.tree.rows; ++i) {
    const Index * row = model.tree.row(i);
    if (row[tree::TYPE] != tree::BALL) {
      place[row[tree::DOF]] = row[tree::COORDINATE];
    } else if (row[tree::AXIS] == 2) {
      // The last of three rows, about the third axis, has all.
      balls(n, 0) = row[tree::COORDINATE];
      balls(n++, 1) = row[tree::DOF] - 2;
    }
  }
}

}  // namespace closedloop
