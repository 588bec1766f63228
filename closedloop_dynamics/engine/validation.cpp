// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "validation.hpp"

#include <algorithm>
#include <bitset>
#include <cmath>
#include <iterator>

#include "batch.hpp"
#include "dispatch.hpp"

namespace closedloop
{

namespace
{
constexpr Index TREE_COLUMNS = 7, CUT_COLUMNS = 14, HEALTH_COLUMNS = 11;
constexpr Index BODY_KERNELS = 13;
constexpr Index INDEX_COLUMNS = 6, VALUE_COLUMNS = 13, OUTPUT_COLUMNS = 5;
constexpr Index CUT_INDEX_COLUMNS = 8, CUT_VALUE_COLUMNS = 20;
// Among the values of a cable in space: the row of the body that the axis turns with.
constexpr Index CARRIER = 3;
// Operations of an expression: those without a number to work on, and those on two.
constexpr double LAST_CONSTANT = 1, FIRST_OF_TWO = 15, LAST_OPERATION = 23;
// Model.body and Workspace.body, in the plane and in space; with couplings in the plane.
constexpr Index BODY_COLUMNS = 8, SPATIAL_BODY_COLUMNS = 28;
constexpr Index WORK_COLUMNS = 31, COUPLED_WORK_COLUMNS = 33, SPATIAL_WORK_COLUMNS = 81;

bool is_place(Index place, Index size) {return place >= 0 && place < size;}

/// Whether rows `first` to `last` are among so many.
bool is_range(Index first, Index last, Index size)
{
  return first >= 0 && first <= last && last <= size;
}

/// How many equations of a cut joint these are, as bits.
Index count(Index equations) {return static_cast<Index>(std::bitset<6>(equations).count());}

/// Whether the kept equations of a cut joint are valid for its type.
bool are_kept(const Index * cut)
{
  const Index possible = cut[cut::POSSIBLE], kept = cut[cut::KEPT];
  return possible >= 0 && possible < 64 && (kept & ~possible) == 0 &&
         count(kept) == cut[cut::ROWS];
}

/// Whether all entries of a column are within bounds.
bool within(Indexes table, Index column, Index first, Index low, Index high)
{
  for (Index i = first; i < table.rows; ++i) {
    if (table(i, column) < low || table(i, column) > high) {
      return false;
    }
  }
  return true;
}

bool within(Indices values, Index low, Index high)
{
  return std::all_of(
    values.begin(), values.end(), [=](Index each) {return each >= low && each <= high;});
}

/// Whether entries are places in an array, each at most the next, from its begin to its end.
bool divides(Indices values, Index size)
{
  return values.size > 0 && values[0] == 0 && values[values.size - 1] == size &&
         std::is_sorted(values.begin(), values.end());
}

bool has_shape(Table table, Index rows, Index columns)
{
  return table.rows == rows && table.columns == columns;
}

const char * misfit_of_tree(const Model & model, Index nq)
{
  const Index bodies = model.tree.rows, nv = bodies - 1;
  const bool planar = model.gravity.size == 2;
  if (bodies < 1 || model.tree.columns != TREE_COLUMNS || !has_shape(
      model.body, bodies, planar ? BODY_COLUMNS : SPATIAL_BODY_COLUMNS))
  {
    return "model.tree and model.body";
  }
  if (!planar && model.gravity.size != 3) {
    return "model.gravity";
  }
  for (Index i = 1; i < bodies; ++i) {
    if (!is_place(model.tree(i, tree::PARENT), i)) {
      return "model.tree: parents come before their children";
    }
    const bool ball = model.tree(i, tree::TYPE) == tree::BALL;
    // A spherical joint has a row for each of three rates; the last row is checked for all.
    const Index before = ball && model.tree(i, tree::AXIS) == 2 ? 2 : 0;
    if (!is_place(model.tree(i, tree::DOF) - before, nv - before) ||
      !is_place(model.tree(i, tree::COORDINATE), nq - (ball ? 3 : 0)) ||
      !is_place(model.tree(i, tree::AXIS), 3))
    {
      return "model.tree: places of coordinates";
    }
  }
  return nullptr;
}

const char * misfit_of_cuts(const Model & model)
{
  const Index nv = model.joints(), cuts = model.cut.rows, nc = model.equations();
  const Index least = model.gravity.size == 2 ?
    static_cast<Index>(plane::CUT_POINT_COLUMNS) : static_cast<Index>(space::CUT_POINT_COLUMNS);
  if (
    model.cut.columns != CUT_COLUMNS || model.cut_point.rows != cuts ||
    (cuts > 0 && model.cut_point.columns < least))
  {
    return "model.cut and model.cut_point";
  }
  Index equations = 0;
  for (Index a = 0; a < cuts; ++a) {
    const Index * cut = model.cut.row(a), rows = cut[cut::ROWS];
    equations += rows;
    if (!is_range(cut[cut::ROW], cut[cut::ROW] + rows, nc) ||
      !is_range(cut[cut::CUT_ROW], cut[cut::CUT_ROW] + rows, nc) ||
      !is_place(cut[cut::NUMBER], cuts) || (cut[cut::LENGTHS] > 1 && rows < 2) ||
      !are_kept(cut))
    {
      return "model.cut: places of equations";
    }
    if (!is_range(cut[cut::PATH_A], cut[cut::PATH_B], model.path_body.size) ||
      !is_range(cut[cut::PATH_B], cut[cut::PATH_COMMON], model.path_body.size) ||
      !is_range(cut[cut::PATH_COMMON], cut[cut::PATH_END], model.path_body.size))
    {
      return "model.cut: paths";
    }
    const Index type = cut[cut::TYPE];
    const bool both = type >= cut::COUPLED_PLACE;
    const Index factors = type == cut::COUPLING || type == cut::PRESCRIBED_JOINT || both ?
      cut::FACTORS + cut[cut::PATH_END] - cut[cut::PATH_A] : 0;
    const Index motion = type >= cut::PRESCRIBED_JOINT ? static_cast<Index>(cut::MOTION_COLUMNS) : 0;
    if (model.cut_point.columns < (both ? least : 0) + factors + motion) {
      return "model.cut_point: factors of couplings";
    }
  }
  if (equations != nc) {
    return "model.cut: number of equations";
  }
  if (!within(model.cut, cut::BODY_A, 0, 0, nv) || !within(model.cut, cut::BODY_B, 0, 0, nv) ||
    !within(model.path_body, 1, nv))
  {
    return "model.cut and model.path_body: bodies";
  }
  return nullptr;
}

}  // namespace

Index coordinates_of(const Model & model)
{
  Index count = model.joints();
  for (Index i = 1; i < model.tree.rows; ++i) {
    // The last of the three rows of a spherical joint.
    count += model.tree(i, tree::TYPE) == tree::BALL && model.tree(i, tree::AXIS) == 2 ? 1 : 0;
  }
  return count;
}

const char * misfit(const Model & model)
{
  if (model.tree.rows < 1 || model.tree.columns != TREE_COLUMNS || model.column.size < 1) {
    return "model";
  }
  const char * found = misfit_of_tree(model, coordinates_of(model));
  return found != nullptr ? found : misfit_of_cuts(model);
}

const char * misfit_of_pattern(const Model & model)
{
  const Index nc = model.equations(), cuts = model.cut.rows;
  const Index entries = model.row.size, paths = model.path_body.size;
  if (
    !divides(model.column, entries) || !within(model.row, 0, nc - 1) ||
    model.dependency.size != nc + 1 || model.dependency_place.columns != 2 ||
    !divides(model.dependency, model.dependency_place.rows) ||
    !within(model.dependency_place, 0, 0, 0, nc - 1) ||
    !within(model.dependency_place, 1, 0, 0, entries - 1))
  {
    return "model.column, model.row and model.dependency";
  }
  for (Index j = 0; j < nc; ++j) {
    if (model.column[j] == model.column[j + 1]) {
      return "model.column: diagonal";
    }
  }
  for (Index a = 0; a < cuts; ++a) {
    for (Index c = 0; c < model.cut(a, cut::ROWS); ++c) {
      const Index place = model.column[model.cut(a, cut::ROW) + c];
      if (place + model.cut(a, cut::ROWS) - c > entries) {
        return "model.column: blocks of the diagonal";
      }
    }
  }
  if (
    model.pair.columns != 2 || model.block.columns != 4 ||
    model.entry.rows != model.block.rows || !within(model.pair, 0, 0, 0, paths - 1) ||
    !within(model.pair, 1, 0, 0, paths - 1))
  {
    return "model.pair, model.block and model.entry";
  }
  for (Index n = 0; n < model.block.rows; ++n) {
    const Index * block = model.block.row(n);
    if (!is_place(block[0], cuts) || !is_place(block[1], cuts) ||
      !is_range(block[2], block[3], model.pair.rows) ||
      model.cut(block[1], cut::ROWS) > model.entry.columns)
    {
      return "model.block";
    }
    const Index later = model.cut(block[0], cut::ROWS);
    for (Index c = 0; c < model.cut(block[1], cut::ROWS); ++c) {
      if (!is_range(model.entry(n, c), model.entry(n, c) + later, entries)) {
        return "model.entry";
      }
    }
  }
  return nullptr;
}

const char * misfit(const Workspace & work, const Model & model)
{
  const Index bodies = model.tree.rows, nv = bodies - 1, nc = model.equations();
  const bool planar = model.gravity.size == 2;
  const Index size = planar ? 3 : 6, entries = model.path_body.size;
  Index most = 3, possible = 3;
  for (Index a = 0; a < model.cut.rows; ++a) {
    most = std::max(most, model.cut(a, cut::ROWS));
    possible = std::max(possible, count(model.cut(a, cut::POSSIBLE)));
  }
  bool reads = false;
  for (Index i = 1; planar && i < bodies; ++i) {
    // In the plane: whether a coupling reads the joint.
    reads = reads || model.tree(i, tree::AXIS) != 0;
  }
  const bool fits =
    work.body.rows == bodies && (planar ?
    (work.body.columns == COUPLED_WORK_COLUMNS || (!reads && work.body.columns == WORK_COLUMNS)) :
    work.body.columns == SPATIAL_WORK_COLUMNS) &&
    work.response.columns >= most && has_shape(work.response, entries, work.response.columns) &&
    has_shape(work.response_scaled, entries, work.response.columns) &&
    has_shape(work.lever, entries, work.response.columns) && work.scale.size == nc &&
    work.factor.size == model.row.size && has_shape(work.joint, bodies, 3) &&
    work.change.size == nv && work.pivot_inverse.size == nc && work.right.size == nc &&
    work.scatter.size == nc && work.closure.size == nc && work.closure_rate.size == nc &&
    work.bias.size == nc && work.equation.size >= possible * (3 + 2 * size) &&
    has_shape(work.wrench, 2, size) && work.share.size == 3 * size && work.torque.size == nv &&
    has_shape(work.force, bodies, 2 * size) && work.kernel.rows == bodies &&
    work.kernel.columns == BODY_KERNELS && work.cut_kernel.rows == model.cut.rows &&
    work.cut_kernel.columns == 2 && work.health.size == HEALTH_COLUMNS;
  return fits ? nullptr : "workspace";
}

namespace
{
bool fits(const Contacts & contacts, Index count)
{
  const Cube<double> & nodes = contacts.nodes;
  return within(contacts.rows, 0, count - 1) && contacts.mode.size == count &&
         has_shape(contacts.now, count, contact::NODE_COLUMNS) &&
         has_shape(contacts.start, count, contact::NODE_COLUMNS) &&
         has_shape(contacts.trial, count, contact::TRIAL_COLUMNS) &&
         nodes.pages == contact::LEVELS + 3 && nodes.rows == count &&
         nodes.columns == contact::NODE_COLUMNS && contacts.search.size == contact::SEARCH_LENGTH;
}

/// `most`: of the joints that may stick; `length`: of a response.
bool fits(const Sticking & sticking, Index count, Index length)
{
  const Index most = sticking.rows.size - 1;
  return most >= 0 && sticking.rows[0] >= 0 && sticking.rows[0] <= most &&
         sticking.hold.size == count && has_shape(sticking.matrix, most, most) &&
         has_shape(sticking.factor, most, most) && sticking.response.rows == most + 1 &&
         sticking.response.columns >= length && sticking.right.size == most &&
         sticking.bound.size == most && sticking.move.size == most &&
         sticking.free.size == most && sticking.share.size == most &&
         sticking.impulse.size == most;
}
}  // namespace

const char * misfit(
  const CutCoordinates & cuts, Index nv, Index bodies, bool planar, Index states)
{
  const Index total = nv + cuts.index.rows;
  const bool good =
    has_shape(cuts.values, cuts.index.rows, CUT_VALUE_COLUMNS) &&
    cuts.index.columns == CUT_INDEX_COLUMNS && cuts.q.size == total &&
    cuts.qd.size == total && cuts.before.size == total && cuts.qdd.size == total &&
    cuts.scratch.rows == bodies &&
    (cuts.index.rows == 0 || cuts.scratch.columns >= (planar ? 6 : 12)) &&
    within(cuts.index, cut_coordinate::ROW_A, 0, 0, bodies - 1) &&
    within(cuts.index, cut_coordinate::ROW_B, 0, 0, bodies - 1) &&
    within(cuts.index, cut_coordinate::FOLLOWED, 0, -1, states - 1) &&
    within(cuts.index, cut_coordinate::IN_PLANE, 0, planar ? 1 : 0, planar ? 1 : 0);
  return good ? nullptr : "coordinates of cut joints";
}

bool has_cuts(const CutCoordinates & cuts, Index count)
{
  return within(cuts.index, cut_coordinate::CUT, 0, 0, count - 1);
}

/// A number as an index below `size`; negative if it is not one.
Index as_place(double number, Index size)
{
  return number >= 0.0 && number < static_cast<double>(size) ? static_cast<Index>(number) : -1;
}

/// Whether an expression is whole: it has a result, and every operation has its operands.
bool is_expression(Values data, Index at)
{
  const Index count = is_place(at, data.size) ? as_place(data[at], data.size) : -1;
  if (count < 1 || 1 + 2 * count > data.size - at) {
    return false;
  }
  // Behind the operations is room for the numbers that wait, from the place after next on.
  Index waiting = 0;
  for (Index k = 0; k < count; ++k) {
    const double operation = std::trunc(data[at + 1 + 2 * k]);
    waiting += operation <= LAST_CONSTANT ? 1 : operation >= FIRST_OF_TWO ? -1 : 0;
    if (!(operation >= 0.0 && operation <= LAST_OPERATION) || waiting < 1 ||
      at + 2 * count + waiting >= data.size)
    {
      return false;
    }
  }
  return true;
}

/// How many entries of a kind are data, and numbers each; laws with a fixed number have one.
Index numbers_of_entry(Index kind, bool planar)
{
  switch (kind) {
    case effect::PRESCRIBED_TORQUE:
    case effect::PRESCRIBED_FORCE:
    case effect::SPATIAL_PRESCRIBED_FORCE:
    case effect::PRESCRIBED_MOTION:
      return 10;
    case effect::JOINT_FORCE_TABLE:
    case effect::POINT_FORCE_TABLE:
    case effect::SPATIAL_FORCE_TABLE:
      return 6;
    case effect::CABLE:
    case effect::SPATIAL_CABLE:
      return planar ? 5 : 6;
    case effect::CURVE_CONTACT:
    case effect::FACE_CONTACT:
      return 8;
    default:
      return 0;
  }
}

/// Numbers of a law with a fixed number of them.
Index fixed_numbers(Index kind)
{
  return kind == effect::BUSHING ? 8 : kind == effect::SPATIAL_BUSHING ? 30 :
    kind == effect::SPATIAL_BODY_CONTACT ? 11 : kind == effect::SPATIAL_FLUID_DRAG ? 21 :
    kind == effect::ORIENTATION_SPRING ? 18 : 0;
}

/// Whether the joints that an effect has with moment arms are there.
bool has_arms(Values data, Index count, Index joints)
{
  if (count < 0 || count > data.size / 2) {
    return false;
  }
  for (Index k = 0; k < count; ++k) {
    if (as_place(data[2 * k], joints) < 0) {
      return false;
    }
  }
  return true;
}

/// Whether the joints of a tendon are there, and its coefficients behind them.
bool is_tendon(Values data, Index entries, Values values, Index joints)
{
  const Index springs = as_place(values[0], data.size), dampers = as_place(values[1], data.size);
  return springs >= 0 && dampers >= 0 && springs + dampers <= data.size &&
    has_arms(data.part(0, data.size - springs - dampers), entries - 2, joints);
}

bool is_traced(Index kind) {return kind == effect::TRACED || kind == effect::SPATIAL_TRACED;}

/// Number of states of a traced law: time, its own, and dissipation or work; negative where an
/// entry is invalid, or a measured coordinate does not exist.
Index states_of_traced(Values data, Index count, Index joints, Index bodies, bool planar)
{
  if (count < 0 || count > traced::MOST_COORDINATES ||
    data.size < (count + 1) * traced::COLUMNS)
  {
    return -1;
  }
  const Index clock = as_place(data[traced::CLOCK], 2);
  const Index own = as_place(data[traced::OWN], traced::MOST_STATES + 1);
  for (Index k = 1; k <= count; ++k) {
    const Values entry = data.part(k * traced::COLUMNS, traced::COLUMNS);
    const Index kind = as_place(entry[traced::MEASURED], traced::COMPONENT + 1);
    const Index first = as_place(entry[traced::FIRST], kind == traced::JOINT ? joints : bodies);
    const Index second = as_place(
      entry[traced::SECOND], kind == traced::COMPONENT ? (planar ? 2 : 3) : bodies);
    if (kind < 0 || first < 0 || second < 0) {
      return -1;
    }
  }
  return clock < 0 || own < 0 ? -1 : clock + own + 1;
}

bool is_course(Index kind) {return numbers_of_entry(kind, true) == 10;}

bool has_data(const EffectTable & effects, Index row, Index joints, Index bodies, bool planar)
{
  const Index kind = effects.kind[row], at = effects.index(row, effect::DATA);
  const Index entries = effects.index(row, effect::ENTRIES), left = effects.data.size - at;
  const Values values = effects.values[row];
  if (at < 0 || left < fixed_numbers(kind)) {
    return false;
  }
  if (kind == effect::TENDON) {
    return is_tendon(effects.data.from(at), entries, values, joints);
  }
  if (kind == effect::JOINT_FRICTION || kind == effect::REFLECTED_INERTIA) {
    return has_arms(effects.data.from(at), entries, joints);
  }
  if (is_course(kind) && values[1] == 1.0) {
    if (kind != effect::PRESCRIBED_MOTION) {
      return is_expression(effects.data, at);
    }
    const Index rate = as_place(values[4], left), change = as_place(values[5], left);
    return rate >= 0 && change >= 0 && is_expression(effects.data, at) &&
      is_expression(effects.data, at + rate) && is_expression(effects.data, at + change);
  }
  const Index each = numbers_of_entry(kind, planar);
  if (each > 0 && (entries < 1 || entries > left / each)) {
    return false;
  }
  if (kind == effect::CABLE || kind == effect::SPATIAL_CABLE) {
    for (Index k = 0; k < entries; ++k) {
      if (as_place(effects.data[at + each * k], bodies) < 0) {
        return false;
      }
    }
    // Less than zero where no pulley has a radius.
    return planar || !(values[CARRIER] >= 0.0) || as_place(values[CARRIER], bodies) >= 0;
  }
  return true;
}

/// States that a law reads or writes.
Index states_of(Index kind, bool loaded)
{
  switch (kind) {
    case effect::JOINT_SPRING:
    case effect::ORIENTATION_SPRING:
    case effect::REFLECTED_INERTIA:
      return loaded ? 2 : 0;
    case effect::JOINT_FRICTION:
    case effect::PRESCRIBED_TORQUE:
    case effect::PRESCRIBED_FORCE:
    case effect::SPATIAL_PRESCRIBED_FORCE:
    case effect::PRESCRIBED_MOTION:
      return 3;
    case effect::ACTUATOR:
    case effect::FLUID_DRAG:
    case effect::SPATIAL_FLUID_DRAG:
      return 2;
    default:
      return loaded ? 2 : 1;
  }
}

bool acts_in_joint(Index kind)
{
  switch (kind) {
    case effect::JOINT_DAMPING:
    case effect::JOINT_SPRING:
    case effect::END_STOP:
    case effect::JOINT_FRICTION:
    case effect::ACTUATOR:
    case effect::PRESCRIBED_TORQUE:
    case effect::JOINT_FORCE_TABLE:
    case effect::REFLECTED_INERTIA:
      return true;
    default:
      return false;
  }
}

/// Whether a law finds all that it reads.
bool fits(const EffectTable & effects, Index row, Index nv, Index bodies, bool planar)
{
  const Index kind = effects.kind[row], * index = effects.index.row(row);
  const Index joints = nv + effects.cuts.index.rows, first = index[effect::FIRST];
  const bool loaded = index[effect::LOADED] == 1;
  if (is_traced(kind)) {
    const Index at = index[effect::DATA];
    const Index states = is_range(at, at, effects.data.size) ?
      states_of_traced(effects.data.from(at), first, joints, bodies, planar) : -1;
    return states >= 0 && index[effect::SECOND] != 0 && planar == (kind == effect::TRACED) &&
           is_range(index[effect::STATE], index[effect::STATE] + states, effects.states.size);
  }
  if (!is_place(kind, effect::KINDS) || law_of(kind) == nullptr || !is_range(
      index[effect::STATE], index[effect::STATE] + states_of(kind, loaded), effects.states.size) ||
    !has_data(effects, row, joints, bodies, planar))
  {
    return false;
  }
  if (kind == effect::PRESCRIBED_MOTION) {
    const Index last = effects.motions.columns - cut::MOTION_COLUMNS;
    return is_place(first, effects.motions.rows) && index[effect::SECOND] >= 0 &&
      as_place(effects.values(row, 3), last + 1) >= 0;
  }
  return is_place(first, acts_in_joint(kind) ? joints : bodies) &&
    is_place(index[effect::SECOND], bodies);
}

const char * misfit(const EffectTable & effects, Index nv, Index bodies, bool planar)
{
  const Index count = effects.count(), most = effects.sticking.rows.size - 1;
  const bool arrays =
    effects.enabled.size == count && effects.index.rows == count &&
    effects.index.columns == INDEX_COLUMNS && has_shape(effects.values, count, VALUE_COLUMNS) &&
    has_shape(effects.output, count, OUTPUT_COLUMNS) && effects.loaded.size == 1 &&
    effects.rates.size == effects.states.size && effects.scale.size == effects.states.size &&
    effects.applied.size == nv + effects.cuts.index.rows &&
    misfit(effects.cuts, nv, bodies, planar, effects.states.size) == nullptr &&
    fits(effects.sticking, count, effects.applied.size) && fits(effects.contacts, count) &&
    effects.code.fits.size == 1 && effects.code.sides.size == count &&
    has_shape(effects.code.present, count, present::PRESENT_COLUMNS) &&
    (effects.reaction.rows == 0 || has_shape(effects.reaction, bodies, planar ? 6 : 12));
  if (!arrays) {
    return "effects";
  }
  if (effects.reaction.rows == 0 && count > 0) {
    return "effects.reaction";
  }
  Index sticks = 0;
  for (Index row = 0; row < count; ++row) {
    if (!fits(effects, row, nv, bodies, planar)) {
      return "effects: what a law reads";
    }
    sticks += effects.kind[row] == effect::JOINT_FRICTION ||
      effects.kind[row] == effect::REFLECTED_INERTIA ? 1 : 0;
  }
  return sticks <= most ? nullptr : "effects.sticking";
}

const char * misfit(const Manifold & manifold, Index nq, Index nv)
{
  const bool good = manifold.empty() ? nq == nv :
    manifold.balls.columns == 2 && manifold.place.size == nv && manifold.number.size == nv &&
    nq == nv + manifold.balls.rows && within(manifold.place, -1, nq - 1) &&
    within(manifold.balls, 0, 0, 0, nq - 4) && within(manifold.balls, 1, 0, 0, nv - 3);
  return good ? nullptr : "manifold";
}

namespace
{
bool fits(const DenseWorkspace & dense, Index formulation, Index nv, Index nc)
{
  const bool is_system = formulation == setting::SYSTEM;
  const bool is_augmented = formulation == setting::AUGMENTED;
  const Index both = nv + nc;
  return formulation == setting::SUBSYSTEM ? dense.gim.rows == 0 :
         (is_system || is_augmented) && has_shape(dense.gim, nv, nv) &&
         has_shape(dense.jac, nc, nv) && dense.free.size == nv && dense.right.size == nc &&
         (!is_system || has_shape(dense.schur, nc, nc)) &&
         (!is_augmented || (has_shape(dense.kkt, both, both) && dense.pivots.size == both &&
         dense.solution.size == both));
}

bool fits(const Partition & partition, Index nv, Index nc)
{
  return partition.order.size == nv && within(partition.order, 0, nv - 1) &&
         has_shape(partition.jac, nc, nv) && has_shape(partition.scaled, nc, nv) &&
         has_shape(partition.matrix, nc, nc) && partition.pivots.size == nc &&
         partition.right.size == nc && partition.change.size == nv && partition.record.size == 3;
}

const char * misfit(const AllEquations & all, const System & system)
{
  const char * found = misfit(all.model);
  found = found != nullptr ? found : misfit(all.work, all.model);
  found = found != nullptr ? found : misfit(all.own, all.model);
  if (found != nullptr) {
    return found;
  }
  if (all.numbers.size != 4 || all.energy.size != 2) {
    return "numbers of all equations";
  }
  const bool good =
    all.model.tree.rows == system.model.tree.rows &&
    all.model.gravity.size == system.model.gravity.size &&
    all.lam.size == all.model.equations() && all.kept.size == all.lam.size &&
    std::count_if(
    all.kept.begin(), all.kept.end(), [](Index each) {return each != 0;}) == system.lam.size;
  return good ? nullptr : "all equations";
}

/// Whether the generated routines are there and work on these very arrays.
bool is_linked(const System & system)
{
  const struct {Index place; const double * array; Index size;} arrays[] = {
    {routine::BODY, system.model.body.data, 1},
    {routine::GRAVITY, system.model.gravity.data, 1},
    {routine::CUT_POINT, system.model.cut_point.data, system.model.cut_point.rows},
    {routine::TAU, system.applied.data, system.applied.size},
    {routine::BAUMGARTE, system.settings.data + setting::BAUMGARTE_GAIN, 1},
    {routine::QDD, system.qdd.data, system.qdd.size},
    {routine::LAM, system.lam.data, system.lam.size},
    {routine::HEALTH, system.work.health.data, 1},
    {routine::WORK_BODY, system.work.body.data, 1},
    {routine::CLOSURE, system.work.closure.data, system.lam.size},
    {routine::CLOSURE_RATE, system.work.closure_rate.data, system.lam.size},
    {routine::CORRECTIONS, system.corrections.data, system.corrections.columns},
    {routine::REACTION, system.effects.reaction.data, system.effects.reaction.rows},
    {routine::COMMAND, system.tau.data, system.has_effects() ? system.tau.size : 0},
    {routine::VALUES, system.effects.values.data, system.effects.count()},
    {routine::ENTRIES, system.effects.data.data, system.effects.data.size},
    {routine::CUT_VALUES, system.effects.cuts.values.data, system.effects.cuts.values.rows},
    {routine::PRESENT, system.effects.code.present.data, system.effects.count()},
    {routine::SIDES, system.effects.code.sides.data, system.effects.count()},
    {routine::GAPS, system.effects.contacts.now.data, system.effects.count()},
    {routine::TRIALS, system.effects.contacts.trial.data, system.effects.count()},
    {routine::RATES, system.effects.rates.data, system.effects.rates.size},
    {routine::RESPONSE, system.effects.sticking.response.data,
      system.effects.sticking.right.size},
    {routine::LIMIT, system.effects.sticking.right.data, system.effects.sticking.right.size},
    {routine::WRENCH, system.work.force.data, 1},
    {routine::JOINT_POINT, system.joints.point.data, system.joints.point.rows},
    {routine::LAM_OF_ALL, system.whole.lam.data, system.whole.lam.size}};
  const Index * routines = system.table.data;
  const bool feels = system.has_effects() && system.effects.loaded[0] != 0;
  const bool whole = !system.has_effects() || system.effects.code.fits[0] != 0;
  if (system.is_unrolled() && (!std::all_of(
      routines + (whole ? routine::EVALUATION : routine::OUTWARD),
      routines + routine::CORRECTION + 1, [](Index address) {return address != 0;}) ||
    (feels && system.whole.empty() && routines[routine::REACTIONS] == 0)))
  {
    return false;
  }
  // Arrays of no length are anywhere.
  return std::all_of(
    std::begin(arrays), std::end(arrays), [&](const auto & each) {
      return each.size == 0 || system.table[each.place] == reinterpret_cast<Index>(each.array);
    });
}
}  // namespace

const char * misfit(const System & system)
{
  const char * found = misfit(system.model);
  found = found != nullptr ? found : misfit_of_pattern(system.model);
  found = found != nullptr ? found : misfit(system.work, system.model);
  if (found != nullptr) {
    return found;
  }
  const Index nv = system.model.joints(), nc = system.model.equations();
  if (system.qdd.size != nv || system.tau.size < nv || system.applied.size != nv ||
    system.lam.size != nc)
  {
    return "tau, qdd, applied and lam";
  }
  if (system.settings.size != setting::OPENING + 1 || system.table.size != routine::TABLE_COLUMNS) {
    return "settings and table";
  }
  if (system.corrections.rows != 2 || (system.is_unrolled() && system.corrections.columns != nv)) {
    return "corrections";
  }
  if (!is_linked(system)) {
    return "table: addresses of other arrays";
  }
  if (const char * other = misfit(system.manifold, coordinates_of(system.model), nv)) {
    return other;
  }
  if (system.passage.size != 1 + system.nq()) {
    return "passage";
  }
  const Index formulation = as_place(system.settings[setting::FORMULATION], 3);
  if (!fits(system.dense, formulation, nv, nc)) {
    return "settings and dense";
  }
  if (system.is_independent() && !fits(system.partition, nv, nc)) {
    return "partition";
  }
  if (!system.whole.empty()) {
    if (const char * other = misfit(system.whole, system)) {
      return other;
    }
  }
  const JointPlaces & joints = system.joints;
  if (joints.point.rows != 2 * joints.body.rows || joints.row.size > joints.body.rows ||
    (joints.body.rows > 0 && (joints.body.columns != 2 || joints.point.columns !=
    (system.work.planar() ? 2 : 3))) || !within(joints.row, 1, nv) ||
    !within(joints.body, 0, 0, 0, nv) || !within(joints.body, 1, 0, 0, nv))
  {
    return "joints";
  }
  const AccelerationDerivatives & derivatives = system.derivatives;
  if (derivatives.table.size > 0 && (
      derivatives.table.size < 2 || derivatives.table[1] == 0 ||
      derivatives.columns.rows * LANES < 2 * nv ||
      !has_shape(derivatives.columns, derivatives.columns.rows, LANES * (nv + nc)) ||
      !has_shape(derivatives.found, derivatives.columns.rows, LANES * (nv + nc)) ||
      !has_shape(derivatives.flows, 2 * nv, system.effects.states.size)))
  {
    return "derivatives";
  }
  if (!system.has_effects()) {
    return system.tau.size == nv ? nullptr : "tau";
  }
  const EffectTable & effects = system.effects;
  const Index all = system.whole.empty() ? nc : system.whole.lam.size;
  if (effects.applied.size != system.tau.size || effects.applied.data != system.applied.data ||
    effects.sticking.response.columns < system.tau.size + all ||
    !has_cuts(effects.cuts, system.model.cut.rows))
  {
    return "effects and tau";
  }
  for (Index row = 0; row < effects.count(); ++row) {
    if (effects.kind[row] == effect::PRESCRIBED_MOTION &&
      effects.index(row, effect::SECOND) >= all)
    {
      return "effects: multiplier of a motion";
    }
  }
  return misfit(effects, nv, system.model.tree.rows, system.work.planar());
}

}  // namespace closedloop
