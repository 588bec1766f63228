// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__PRECONDITIONS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__PRECONDITIONS_HPP_

#include <algorithm>
#include <limits>

#include "arguments.hpp"
#include "bounds.hpp"
#include "correction.hpp"
#include "cut_coordinates.hpp"
#include "dispatch.hpp"
#include "elimination.hpp"
#include "evaluation.hpp"
#include "forward_dynamics.hpp"
#include "inverse_dynamics.hpp"
#include "joint_reaction.hpp"
#include "laws.hpp"
#include "loop_closure.hpp"
#include "loop_solver.hpp"
#include "manifold.hpp"
#include "null_space.hpp"
#include "recursion.hpp"
#include "requests.hpp"
#include "rollout.hpp"
#include "routines.hpp"
#include "state_steps.hpp"
#include "static_friction.hpp"

// Preconditions on the arguments of functions that Python calls, beside the lengths that
// bindings.cpp names: kernels index blindly. Each returns a message, or nullptr. Those of the first
// parameters alone are checked when these are bound, not at each call.

namespace closedloop
{

inline bool has_shape(Cube<double> cube, Index pages, Index rows, Index columns)
{
  return cube.pages == pages && cube.rows == rows && cube.columns == columns;
}

namespace expected
{
constexpr const char * lengths = "arrays that do not fit together";
constexpr const char * sizes = "expected finite times, and positive sizes";
constexpr const char * places = "places beyond the end";

inline const char * unless(bool good, const char * otherwise = lengths)
{
  return good ? nullptr : otherwise;
}

inline const char * first_of(const char * one, const char * other)
{
  return one != nullptr ? one : other;
}

/// Whether rows are long enough to be those of Workspace.body, in the plane or in space.
inline bool are_bodies(Table body, bool planar) {return body.columns >= (planar ? 31 : 81);}

/// Whether there are torques up to the last of so many instants.
inline bool lasts(Table torque, Index instants, Index zero_order_hold, Index decimation)
{
  if (zero_order_hold < 1 || decimation < 1 || instants <= 1) {
    return zero_order_hold > 0 && decimation > 0 && torque.rows >= instants;
  }
  return decimation <= std::numeric_limits<Index>::max() / instants &&
         ((instants - 1) * decimation - 1) / zero_order_hold < torque.rows;
}

/// A run by steps of one size, its scratch and its tape.
inline bool is_recorded(
  const System & system, const SteppedRun & run, Table scratch, const Tape & tape)
{
  const Index ns = system.ns(), steps = tape.steps(), stages = run.stages();
  bool good = fits(run.tableau) && system.is_unrolled() && !system.is_independent() &&
    (run.stabilisation == Stabilisation::NONE ||
    run.stabilisation == Stabilisation::VELOCITY ||
    run.stabilisation == Stabilisation::PROJECTION) &&
    run.zero_order_hold > 0 && run.decimation > 0 && steps > 0 &&
    run.torque.columns == system.tau.size &&
    run.torque.rows > (steps - 1) / run.zero_order_hold && scratch.columns == ns &&
    scratch.rows >= stages + SCRATCH_ROWS && has_shape(tape.state, steps + 1, ns) &&
    has_shape(tape.raw, steps, ns) && tape.stage.pages == steps && tape.stage.rows == stages &&
    tape.stage.columns == ns + system.nv() + system.lam.size;
  return good && are_places(tape.corrections, 0, MOST_POSITION_CORRECTIONS + 1);
}

/// The same with routines, numbers at its instants, and changes or a gradient.
inline const char * recorded(
  const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
  const StepRoutines & routines, Table instants, const RunInputs & inputs)
{
  const Index nv = system.nv(), nx = system.nq() + nv, inner = nx + nv;
  return unless(
    is_recorded(system, run, scratch, tape) &&
    routines.table.size >= step_routine::TABLE_COLUMNS && routines.qdd.size == nv &&
    routines.lam.size == system.lam.size && routines.seed.size >= inner &&
    routines.result.size >= routines.seed.size &&
    has_shape(instants, tape.steps() / run.decimation + 1, nx) && inputs.start.size == nx &&
    inputs.torque.rows > (tape.steps() - 1) / run.zero_order_hold &&
    inputs.torque.columns == nv && inputs.parameter.size == routines.seed.size - inner);
}

/// A chart of a system with routines in lanes.
inline bool is_chart(const System & system, const LaneRoutines & routines, const Chart & chart)
{
  const Index nq = system.nq(), nv = system.nv(), nc = system.lam.size;
  const Index inputs = LANES * (nq + 2 * nv + chart.parameters.rows);
  return routines.table.size >= step_routine::LANE_COLUMNS &&
         routines.table.size % step_routine::LANE_COLUMNS == 0 &&
         chart.independent.size + nc == nv && are_places(chart.independent, 0, nv) &&
         chart.dependent.size == nc && are_places(chart.dependent, 0, nv) &&
         chart.seed.size == inputs && routines.result.size >= std::max(inputs, LANES * 2 * nc) &&
         has_shape(chart.closure, nv + chart.parameters.columns, 2 * nc) &&
         has_shape(chart.factors, nc, nc) && chart.pivots.size == nc && chart.right.size == nc &&
         has_shape(
    chart.several, nc, chart.independent.size + chart.parameters.columns) &&
         chart.displacement.size == nv && chart.place.size == nq;
}

/// States to be advanced by a run that is recorded, with their Jacobians.
inline bool are_steps(
  const System & system, const SteppedRun & run, const Chart & chart, const StateSteps & steps)
{
  const Index n = steps.states(), nq = system.nq(), nv = system.nv();
  const Index changes = 2 * chart.independent.size, inputs = steps.actuated.size;
  const Index count = chart.parameters.columns, lanes = steps.lanes(), wide = lanes * (nq + nv);
  const RunInputs & gradient = steps.gradient;
  return run.torque.rows == 1 && has_shape(steps.q, n, nq) && has_shape(steps.qd, n, nv) &&
         has_shape(steps.torque, n, inputs) && are_places(steps.actuated, 0, nv) &&
         has_shape(steps.next_q, n, nq) && has_shape(steps.next_qd, n, nv) &&
         (steps.by_state.pages == 0 || (
           has_shape(steps.by_state, n, changes, changes) &&
           has_shape(steps.by_torque, n, changes, inputs) &&
           has_shape(steps.by_parameter, n, changes, count) &&
           has_shape(steps.basis, n, 2 * nv, changes + count) && steps.wide.columns == wide &&
           steps.wide.rows >= run.stages() + 2 && steps.weight.size == wide &&
           gradient.start.size == wide && has_shape(gradient.torque, 1, lanes * nv) &&
           gradient.parameter.size == lanes * chart.parameters.rows));
}

inline const char * request(const System & system, const Request & request)
{
  return unless(
    request.state.size >= system.ns() && request.own.size == system.effects.states.size &&
    are_places(request.actuated, -1, system.tau.size) &&
    request.torque.size == request.actuated.size && request.held.size == system.tau.size &&
    (request.lam.size == 0 ||
    request.lam.size == (system.whole.empty() ? system.lam : system.whole.lam).size));
}

}  // namespace expected

template<>
inline constexpr auto precondition<cut_wrenches> =
  [](const Model & model, Table body, Values lam, Values share, Table out) {
    return expected::unless(
      model.is_connected() && body.rows == model.tree.rows &&
      expected::are_bodies(body, model.planar()) && lam.size >= model.equations() &&
      share.size >= 3 * model.size() && has_shape(out, model.cut.rows, model.size()));
  };

template<>
inline constexpr auto precondition<bias_forces> =
  [](const Workspace & work, Table out) {
    return expected::unless(
      (work.size() == 3 || work.size() == 6) && expected::are_bodies(work.body, work.planar()) &&
      out.rows <= work.body.rows && out.columns >= work.size());
  };

template<>
inline constexpr auto precondition<fill_quaternions> =
  [](Cube<double> matrices, Table out) {
    return expected::unless(
      matrices.rows == 3 && matrices.columns == 3 &&
      has_shape(out, matrices.pages, 4));
  };

template<>
inline constexpr auto precondition<rates_of_coordinates> =
  [](const Manifold & manifold, Values state, Index nv, Values out, Index lanes) {
    if (lanes < 1 || nv < 0 || nv > state.size / lanes) {
      return expected::lengths;
    }
    const Index nq = nv + manifold.balls.rows;
    return expected::first_of(
      expected::unless(manifold.fits(nq, nv)), expected::unless(
        state.size / lanes >= nq + nv && out.size / lanes >= nq));
  };

template<>
inline constexpr auto precondition<apply_effects> =
  [](const EffectTable & effects, Table body, Values q, Values qd, Values tau) {
    return expected::unless(
      body.rows == effects.reaction.rows &&
      expected::are_bodies(body, effects.reaction.columns == 6) &&
      qd.size == effects.applied.size - effects.cuts.index.rows && q.size >= qd.size &&
      tau.size >= effects.applied.size);
  };

template<>
inline constexpr auto precondition<expression_value> =
  [](Values data, Index at, double) {
    return expected::unless(is_expression(data, at));
  };

template<>
inline constexpr auto precondition<feel_loads> =
  [](const System & system, Values states) {
    return expected::unless(states.size == system.effects.states.size);
  };

template<>
inline constexpr auto precondition<load_joints> =
  [](const System & system, const Model & model, const Workspace & work, Values qd, Values qdd,
    Values lam) {
    const Index nv = system.nv(), bodies = system.model.tree.rows;
    return expected::unless(
      model.joints() == nv && qd.size == nv && qdd.size == nv &&
      work.size() == system.work.size() && lam.size == model.equations() &&
      has_shape(system.effects.reaction, bodies, 2 * work.size()));
  };

template<>
inline constexpr auto precondition<measure_cut_coordinates> =
  [](const EffectTable & effects, Table body, Values position, Values velocity) {
    const CutCoordinates & cuts = effects.cuts;
    return expected::unless(
      body.rows == cuts.scratch.rows &&
      expected::are_bodies(body, effects.reaction.columns == 6) &&
      position.size >= cuts.index.rows && velocity.size == position.size);
  };

template<>
inline constexpr auto precondition<accelerations> =
  [](const EffectTable & effects, const Model & model, const Workspace & work, Values qdd, bool,
    Values out) {
    const CutCoordinates & cuts = effects.cuts;
    return expected::unless(
      qdd.size >= model.joints() && out.size >= model.joints() + cuts.index.rows &&
      has_shape(cuts.scratch, model.tree.rows, 2 * work.size()));
  };

template<>
inline constexpr auto precondition<cut_direction> =
  [](Table body, Index row, bool planar, Table values, Index k, Index first) {
    return expected::unless(
      expected::are_bodies(body, planar) && row >= 0 && row < body.rows && k >= 0 &&
      k < values.rows && first >= 0 && first <= values.columns - 3);
  };

template<>
inline constexpr auto precondition<minimise_in_box> =
  [](const EffectTable & effects, Index count, Values out) {
    return expected::unless(
      count >= 0 && count < effects.static_friction.rows.size && count <= out.size);
  };

template<>
inline constexpr auto precondition<record_steps> =
  [](const System & system, const SteppedRun & run, Table scratch, const Tape & tape) {
    return expected::unless(expected::is_recorded(system, run, scratch, tape));
  };

template<>
inline constexpr auto precondition<change_of_steps> =
  [](const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
    const StepRoutines & routines, const RunInputs & change, Table out) {
    return expected::recorded(system, run, scratch, tape, routines, out, change);
  };

template<>
inline constexpr auto precondition<gradient_of_steps> =
  [](const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
    const StepRoutines & routines, Table weight, const RunInputs & gradient) {
    return expected::recorded(system, run, scratch, tape, routines, weight, gradient);
  };

template<>
inline constexpr auto precondition<callable_dynamics> =
  [](const std::shared_ptr<System> & system, Values state, Indices actuated, Indices table,
    Values qdd, Values lam, Table columns, Table found) {
    const Index nv = system->nv(), nc = system->lam.size;
    return expected::first_of(
      expected::unless(table.size > 1 && table[0] != 0 && table[1] != 0, expected::places),
      expected::unless(
        state.size == system->ns() && qdd.size == nv && lam.size == nc &&
        are_places(actuated, 0, nv) && columns.rows * LANES >= 3 * nv &&
        columns.columns == LANES * (nv + nc) &&
        has_shape(found, columns.rows, columns.columns)));
  };

template<>
inline constexpr auto precondition<fill_dynamics_addresses> =
  [](const CallableDynamics &, Indices out) {return expected::unless(out.size == 4);};

template<>
inline constexpr auto precondition<callable_steps> =
  [](const std::shared_ptr<System> & system, const SteppedRun & run, Table scratch,
    const Tape & tape, const StepRoutines & routines, Indices actuated, Table instants,
    const RunInputs & inputs) -> const char * {
    const char * const reason = expected::recorded(
      *system, run, scratch, tape, routines, instants, inputs);
    return reason != nullptr ? reason : expected::unless(
      instants.rows == 2 && run.torque.rows == 1 && inputs.torque.rows == 1 &&
      are_places(actuated, 0, system->nv()));
  };

template<>
inline constexpr auto precondition<fill_addresses> =
  [](const CallableSteps &, Indices out) {return expected::unless(out.size == 4);};

template<>
inline constexpr auto precondition<step_states> =
  [](const System & system, const SteppedRun & run, Table scratch, const Tape & tape,
    const StepRoutines & routines, const LaneRoutines & beside, const Chart & chart,
    const StateSteps & steps) {
    return expected::unless(
      expected::is_recorded(system, run, scratch, tape) && routines.qdd.size == system.nv() &&
      routines.lam.size == system.lam.size && expected::is_chart(system, beside, chart) &&
      expected::are_steps(system, run, chart, steps));
  };

template<>
inline constexpr auto precondition<fill_basis> =
  [](const System & system, const LaneRoutines & routines, const Chart & chart, Values q, Values qd,
    Table basis) {
    return expected::unless(
      expected::is_chart(system, routines, chart) && q.size == system.nq() &&
      qd.size == system.nv() && has_shape(
        basis, 2 * system.nv(), 2 * chart.independent.size + chart.parameters.columns));
  };

template<>
inline constexpr auto precondition<move_along> =
  [](const System & system, const LaneRoutines & routines, const Chart & chart, Values from_q,
    Values from_qd, Table basis, Table changes, Values displacement, Table q, Table qd) {
    return expected::first_of(
      precondition<fill_basis>(system, routines, chart, from_q, from_qd, basis),
      expected::unless(
        changes.columns == 2 * chart.independent.size && displacement.size == system.nv() &&
        has_shape(q, changes.rows, system.nq()) && has_shape(qd, changes.rows, system.nv())));
  };

template<>
inline constexpr auto precondition<correct_errors> =
  [](Table covariance, Table slope, Values residual, Values noise, Indices first, Values gate,
    Table spread, Table factors, Values squares, Table whitened, Values white, Table others,
    Values change, Table after) {
    const Index m = slope.rows, n = slope.columns;
    bool good = has_shape(covariance, n, n) && residual.size == m && noise.size == m &&
      first.size == gate.size + 1 && squares.size == gate.size && has_shape(spread, m, m) &&
      has_shape(factors, m, m) && has_shape(whitened, m, n) && white.size == m &&
      others.rows == m && change.size == n && has_shape(after, n, n) && first[0] == 0 &&
      first[gate.size] == m;
    for (Index sensor = 0; good && sensor < gate.size; ++sensor) {
      good = first[sensor] <= first[sensor + 1];
    }
    return expected::unless(good);
  };

template<>
inline constexpr auto precondition<annotate> =
  [](const System & system, Table torque, Index zero_order_hold, Index decimation,
    const RunBuffer & buffer) {
    const Index instants = buffer.state.rows, count = buffer.qdd.rows;
    const Index cuts = system.model.cut.rows, points = buffer.body.size;
    bool good = buffer.state.columns == system.ns() && torque.columns == system.tau.size &&
      expected::lasts(torque, instants, zero_order_hold, decimation);
    if (good && count > 0) {
      good = system.work.planar() && count == instants && buffer.qdd.columns == system.nv() &&
        has_shape(buffer.lam, instants, system.lam.size) &&
        has_shape(buffer.scalars, instants, 3) && buffer.output.pages == instants &&
        buffer.output.rows == system.effects.count() && buffer.output.columns == 2 &&
        buffer.wrench.pages == instants && buffer.wrench.rows == cuts &&
        buffer.wrench.columns == 3 && are_places(buffer.body, 0, system.model.tree.rows) &&
        has_shape(buffer.point, points, 2) && buffer.place.pages == instants &&
        buffer.place.rows == points && buffer.place.columns == 2;
    }
    return expected::unless(good);
  };

template<>
inline constexpr auto precondition<fill_joint_forces> =
  [](const System & system, Table torque, Index zero_order_hold, Index decimation, Table state,
    Table qdd, Table lam, Table scratch, Cube<double> out) {
    const Index instants = state.rows, size = system.work.size();
    return expected::unless(
      state.columns == system.ns() && torque.columns == system.tau.size &&
      expected::lasts(torque, instants, zero_order_hold, decimation) &&
      has_shape(qdd, instants, system.nv()) &&
      has_shape(lam, instants, system.lam.size) &&
      has_shape(scratch, system.model.tree.rows, 2 * size) && out.pages == instants &&
      out.rows == system.nv() && out.columns == size);
  };

template<>
inline constexpr auto precondition<evaluate_given> =
  [](const System & system, const Request & request) {
    return expected::request(system, request);
  };

template<>
inline constexpr auto precondition<evaluate_request> =
  [](const System & system, const System & whole, const Request & request) {
    return expected::first_of(
      expected::request(system, request), expected::unless(
        system.whole.empty() || (whole.ns() == system.ns() && whole.nv() == system.nv() &&
        whole.lam.size == system.whole.lam.size)));
  };

template<>
inline constexpr auto precondition<spread_torques> =
  [](Indices actuated, Values tau) {
    return expected::unless(are_places(actuated, -1, tau.size), expected::places);
  };

template<>
inline constexpr auto precondition<keep_law> =
  [](
    Index address, Index joints, Index bodies, Index states, Index numbers, Index listed, bool) {
    return expected::unless(
      address != 0 && joints >= 0 && joints <= MOST_COORDINATES && bodies >= 0 && states >= 0 &&
      numbers >= 0 && listed >= 0, expected::places);
  };

template<>
inline constexpr auto precondition<call> =
  [](Indices table, Index which) {
    return expected::unless(
      which >= 0 && which < table.size && table[which] != 0, expected::places);
  };

template<>
inline constexpr auto precondition<call_for_columns> =
  [](Indices table, Values, Values, Table columns, Table results) {
    return expected::first_of(
      expected::unless(table.size > 1 && table[0] != 0 && table[1] != 0, expected::places),
      expected::unless(has_shape(results, columns.rows, columns.columns)));
  };

template<>
inline constexpr auto precondition<find_torques> =
  [](const System & system, Indices actuated, Indices passive, Index loops, Values own,
    Values out) {
    const Index nc = (system.whole.empty() ? system.model : system.whole.model).equations();
    return expected::unless(
      loops >= 0 && loops <= nc && actuated.size + passive.size == system.nv() &&
      are_places(actuated, 0, system.nv()) &&
      are_places(passive, 0, system.nv()) && own.size == system.effects.states.size &&
      out.size == actuated.size + nc);
  };

template<>
inline constexpr auto precondition<find_all_multipliers> =
  [](const System & system, Values, Values, Values lam) {
    return expected::unless(!system.whole.empty() && lam.size == system.whole.lam.size);
  };

template<>
inline constexpr auto precondition<place_points> =
  [](Table body, Indices row, Table point, Table out) {
    return expected::unless(
      (point.columns == 2 || point.columns == 3) && row.size <= point.rows &&
      out.rows >= row.size && out.columns == point.columns &&
      expected::are_bodies(body, point.columns == 2) && are_places(row, 0, body.rows));
  };

template<>
inline constexpr auto precondition<points_in_state> =
  [](const System & system, Values, Indices row, Table point, Table out) {
    return expected::unless(
      point.columns == (system.work.planar() ? 2 : 3) && row.size <= point.rows &&
      out.rows >= row.size && out.columns == point.columns &&
      are_places(row, 0, system.model.tree.rows));
  };

template<>
inline constexpr auto precondition<find_multipliers> =
  [](const System & system, Values, Values lam) {
    return expected::unless(
      lam.size == (system.whole.empty() ? system.lam : system.whole.lam).size);
  };

template<>
inline constexpr auto precondition<find_joint_forces> =
  [](const System & system, Values, Values lam, Indices row, Table point, Table scratch,
    Table out) {
    const Index size = system.work.size(), bodies = system.model.tree.rows;
    const Index all = system.whole.empty() ? system.lam.size : system.whole.lam.size;
    return expected::unless(
      lam.size == all && are_places(row, 0, bodies) &&
      has_shape(point, row.size, 3) &&
      has_shape(scratch, bodies, 2 * size) &&
      has_shape(out, row.size, size));
  };

namespace expected
{
/// Check which loops are closed, by which freedoms, of so many coordinates.
inline const char * loops(
  const Model & model, const Manifold & manifold, Index coordinates, const Loops & given)
{
  return first_of(
    unless(
      given.places.size == model.equations() && coordinates == model.coordinates() &&
      manifold.fits(coordinates, model.joints()) &&
      (given.weight.size == 0 || given.weight.size == model.joints()) &&
      given.values.size == given.measured.size),
    unless(
      are_places(given.rows, 0, model.equations()) && are_places(given.free, 0, model.joints()) &&
      are_places(given.measured, 0, model.joints()) && (manifold.empty() || std::all_of(
        given.measured.begin(), given.measured.end(),
        [&](Index freedom) {return manifold.place[freedom] >= 0;})),
      places));
}

/// Check what is searched from far away, too.
inline const char * far(const Model & model, const Far & given)
{
  bool good = given.unit.size == model.equations() && given.scale.size == model.joints() &&
    given.axes.size == model.cut.rows && given.limits.columns == 4 &&
    are_places(given.axes, 0, axis::THREAD + 1) && (given.target.size == 0 ||
    given.target.size == given.unit.size + given.axes.size + given.limits.rows);
  for (Index a = 0; good && a < given.axes.size; ++a) {
    const Index joint = model.cut(a, cut::NUMBER);
    good = given.axes[joint] == axis::NO_AXIS || (
      model.size() == 6 && model.cut(a, cut::TYPE) < cut::COUPLING);
  }
  for (Index k = 0; good && k < given.limits.rows; ++k) {
    good = given.limits(k, 0) >= 0.0 && given.limits(k, 1) >= 0.0 &&
      given.limits(k, 0) < static_cast<double>(model.coordinates()) &&
      given.limits(k, 1) < static_cast<double>(model.joints()) &&
      given.limits(k, 2) <= given.limits(k, 3);
  }
  return unless(good);
}
}  // namespace expected

template<>
inline constexpr auto precondition<close_loops> =
  [](const Model & model, const Workspace &, const Manifold & manifold, Values q,
    const Loops & loops) {
    return expected::loops(model, manifold, q.size, loops);
  };

template<>
inline constexpr auto precondition<close_rates> =
  [](const Model & model, const Workspace &, const Manifold & manifold, Values q, Values,
    const Loops & loops, Values wanted) {
    return expected::first_of(
      expected::loops(model, manifold, q.size, loops),
      expected::unless(wanted.size == loops.rows.size));
  };

template<>
inline constexpr auto precondition<search_loops> =
  [](const Model & model, const Workspace &, const Manifold & manifold, Values q,
    const Loops & loops, const Far & far) {
    return expected::first_of(
      expected::loops(model, manifold, q.size, loops), expected::far(model, far));
  };

template<>
inline constexpr auto precondition<loop_residuals> =
  [](const Model & model, const Workspace & work, const Manifold & manifold, Values q,
    const Loops & loops, const Far & far, Values residuals, Table slopes) {
    return expected::first_of(
      precondition<search_loops>(model, work, manifold, q, loops, far), expected::unless(
        residuals.size == far.unit.size + far.axes.size + far.limits.rows &&
        has_shape(slopes, residuals.size, model.joints())));
  };

template<>
inline constexpr auto precondition<first_open> =
  [](const Model & model, const Workspace &, const Manifold &, Table q, Table qd) {
    return expected::unless(
      q.columns == model.coordinates() && qd.columns == model.joints() && q.rows == qd.rows);
  };

template<>
inline constexpr auto precondition<loop_units> =
  [](const Model & model, Indices places) {
    return expected::unless(places.size == model.equations());
  };

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__PRECONDITIONS_HPP_
