// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

// The engine in Python: the table of its functions. Nothing is computed here.

#include <string_view>

#include "arguments.hpp"
#include "batch.hpp"
#include "build_info.hpp"
#include "callable_dynamics.hpp"
#include "callable_steps.hpp"
#include "correction.hpp"
#include "curve.hpp"
#include "cut_coordinates.hpp"
#include "dispatch.hpp"
#include "driven.hpp"
#include "elimination.hpp"
#include "evaluation.hpp"
#include "forward_dynamics.hpp"
#include "inverse_dynamics.hpp"
#include "joint_reaction.hpp"
#include "laws.hpp"
#include "left_out.hpp"
#include "library.hpp"
#include "loop_closure.hpp"
#include "loop_solver.hpp"
#include "manifold.hpp"
#include "null_space.hpp"
#include "profile.hpp"
#include "preconditions.hpp"
#include "projection.hpp"
#include "recursion.hpp"
#include "requests.hpp"
#include "rollout.hpp"
#include "routines.hpp"
#include "state_steps.hpp"
#include "static_friction.hpp"
#include "stiffness.hpp"
#include "stop_flag.hpp"

namespace closedloop
{
namespace
{
/// Nothing: what another thread computes with is refused where arguments are read.
void require_free(const System &) {}

/// Nothing, but that constants or effects were changed from outside.
void touch(const System &) {}

double factorize_constraints(const Model & model, const Workspace & work)
{
  return factorize(model, work);
}

void move_coordinates(const Manifold & manifold, Values q, Values change, double share)
{
  move(manifold, q, change, share);
}

Vector3 curve_distance(Values pieces, bool closed, Values memory, double x, double y)
{
  const CurveDistance found = distance_from_curve(pieces, {x, y}, closed, memory.data);
  return {found.normal.x, found.normal.y, found.distance};
}
}  // namespace

template<>
inline constexpr auto precondition<curve_distance> =
  [](Values pieces, bool, Values memory, double, double) {
    return expected::unless(
      pieces.size > 0 && pieces.size % curve::COLUMNS == 0 &&
      memory.size >= present::PRESENT_COLUMNS);
  };

namespace
{
std::pair<double, double> nearest_to_path(
  Values pieces, double start_x, double start_y, double end_x, double end_y)
{
  const ChordDistance found = nearest_to_chord(pieces, {start_x, start_y}, {end_x, end_y});
  return {found.distance, found.along};
}

std::unique_ptr<RunObject> run(
  const std::shared_ptr<System> & system, const Kept<Values> & state, std::string_view method,
  const MethodOptions & options, const GuardLimits & limits, Indices roles, Indices windings)
{
  if (state.record.size != system->ns()) {
    throw std::invalid_argument("run: expected a state of this system");
  }
  return std::unique_ptr<RunObject>(
    new RunObject{
      system, state.record, state.owner,
      Run(*system, make_stepper(*system, method, options), limits, roles, windings)});
}

void take_method(RunObject & of, const RunObject & other)
{
  of.fitting().take_method(*of.system, other.run);
}

void make_samples(
  RunObject & of, Table start, Cube<double> torque, Index zero_order_hold, Index decimation,
  Index steps, Cube<double> states, Indices status, Table found)
{
  run_samples(
    *of.system, of.fitting(), start, torque, zero_order_hold, decimation, steps, states, status, found);
}

void check_samples(RunObject & of, double tolerance, Table states, Indices fine)
{
  check_starts(*of.system, of.fitting(), tolerance, states, fine);
}

/// Whether this thread is to stop, or a signal such as Ctrl-C has come; Python's error is set then in
/// the main thread, which alone signals reach.
bool is_interrupted()
{
  if (is_stopped()) {
    return true;
  }
  const PyGILState_STATE state = PyGILState_Ensure();
  const bool stops = PyErr_CheckSignals() != 0;
  PyGILState_Release(state);
  return stops;
}

std::pair<double, double> follow(
  const Model & model, const Workspace & work, const Manifold & manifold, Indices drives,
  Indices kept, Values unit, Table anchors, double open, Values begin, Cube<double> values,
  Values q, Table position, Table velocity, Table acceleration)
{
  return follow_drives(
    model, work, manifold, drives, kept, unit, anchors, open, begin, values, q, position, velocity,
    acceleration, is_interrupted);
}

bool close(
  const Model & model, const Workspace & work, const Manifold & manifold, Table q, Table qd,
  const Loops & loops, double closed, Indices status)
{
  return close_states(
    model, work, manifold, q, qd, loops, closed, status, is_interrupted);
}

}  // namespace

template<>
inline constexpr auto precondition<close> =
  [](const Model & model, const Workspace &, const Manifold & manifold, Table q, Table qd,
    const Loops & loops, double, Indices status) {
    return expected::first_of(
      expected::loops(model, manifold, q.columns, loops),
      expected::unless(qd.columns == model.joints() && qd.rows == q.rows && status.size == q.rows));
  };

template<>
inline constexpr auto precondition<&In<&Run::write_whole>::call> =
  [](RunObject & of, Values whole) {
    return expected::unless(whole.size == of.run.whole_length(*of.system));
  };

template<>
inline constexpr auto precondition<&In<&Run::recall>::call> =
  precondition<&In<&Run::write_whole>::call>;

template<>
inline constexpr auto precondition<&On<&Run::accuracy_in>::call> =
  precondition<&In<&Run::write_whole>::call>;

template<>
inline constexpr auto precondition<&On<&Run::try_step>::call> =
  [](RunObject & of, Values state, double size) {
    return expected::first_of(
      expected::unless(state.size == of.state.size),
      expected::unless(std::isfinite(size) && size > 0.0, expected::sizes));
  };

template<>
inline constexpr auto precondition<&In<&Run::make>::call> =
  [](RunObject &, double size) {
    return expected::unless(std::isfinite(size) && size > 0.0, expected::sizes);
  };

template<>
inline constexpr auto precondition<&In<&Run::command>::call> =
  [](RunObject & of, Vector<const double> torque) {
    return expected::unless(torque.size == of.system->tau.size);
  };

template<>
inline constexpr auto precondition<make_samples> =
  [](RunObject & of, Table start) {
    return expected::unless(start.columns == of.state.size);
  };

template<>
inline constexpr auto precondition<move_coordinates> =
  [](const Manifold & manifold, Values q, Values change) {
    return expected::unless(manifold.fits(q.size, change.size));
  };

namespace expected
{
/// Check the arguments of driven kinematics, and a further condition.
template<class Condition>
const char * driven(
  const Model & model, const Manifold & manifold, Indices drives, Indices kept, Values unit,
  Table anchors, Condition && condition)
{
  const Index nv = model.joints(), nc = model.equations();
  return unless(
    nv > 0 && unit.size == nv && drives.size <= nc && are_places(drives, 0, model.cut.rows) &&
    model.cut_point.columns >= cut::MOTION_COLUMNS && are_places(kept, 0, nc) &&
    has_shape(anchors, nv - kept.size, nv) && manifold.fits(model.coordinates(), nv) &&
    condition());
}

/// A grid of so many nodes, and the part of it that may be written.
inline bool is_grid(Indexes grid, Index nodes)
{
  bool good = grid.rows == 3 && grid.columns > 0;
  Index count = 1;
  for (Index axis = 0; good && axis < grid.columns; ++axis) {
    const Index along = grid(0, axis);
    good = along > 0 && along <= nodes && grid(1, axis) >= 0 && grid(2, axis) <= along;
    count *= good ? along : 0;
    good = good && count <= nodes;
  }
  return good && count == nodes;
}
}  // namespace expected

template<>
inline constexpr auto precondition<follow> =
  [](const Model & model, const Workspace &, const Manifold & manifold, Indices drives,
    Indices kept, Values unit, Table anchors, double, Values begin, Cube<double> values, Values q,
    Table position, Table velocity, Table acceleration) {
    return expected::driven(
      model, manifold, drives, kept, unit, anchors, [&] {
        const Index nv = model.joints(), poses = values.pages;
        return begin.size == drives.size && values.rows == drives.size &&
               values.columns == cut::MOTION_COLUMNS && q.size == model.coordinates() &&
               has_shape(position, poses, q.size) &&
               has_shape(velocity, poses, nv) &&
               has_shape(acceleration, poses, nv);
      });
  };

template<>
inline constexpr auto precondition<reach_poses> =
  [](const Model & model, const Workspace &, const Manifold & manifold, Indices drives,
    Indices kept, Values unit, Table anchors, double, Indexes grid, Indices seeds, Table values,
    Indices actuated, Indices reached, Table position, Table rates) {
    return expected::driven(
      model, manifold, drives, kept, unit, anchors, [&] {
        const Index nodes = reached.size;
        return expected::is_grid(grid, nodes) && are_places(seeds, 0, nodes) &&
               are_places(actuated, 0, model.joints()) &&
               has_shape(values, nodes, drives.size) &&
               has_shape(position, nodes, model.coordinates()) &&
               has_shape(rates, nodes, actuated.size * drives.size);
      });
  };

namespace
{
// Handles come with views of their arrays.
Model make_model(
  Matrix<const Index> tree, Matrix<const double> body, Vector<const double> gravity,
  Matrix<const Index> cut, Matrix<const double> cut_point, Vector<const Index> path_body)
{
  return Model(tree, body, gravity, cut, cut_point, path_body);
}

Model model_with_equations(const Model & like, Matrix<const Index> cut) {return Model(like, cut);}

Manifold make_manifold(const Model & model) {return Manifold(model);}

Workspace make_workspace(const Model & model) {return Workspace(model);}

Data make_system(
  const Model & model, const Model & all, const EffectTable & effects, Indices row,
  Indexes body, Table point, double baumgarte, double size, double opening, bool independent,
  Indices code)
{
  Data made(
    model, all, Settings(baumgarte, size, opening),
    JointPlaces(model, row, body, point), effects, code);
  made.use_independent(independent);
  made.interrupted = is_interrupted;
  return made;
}

Data with_equations(const Data & like, const Model & model, const Model & all, Indices code)
{
  return Data(like, model, all, code);
}

Data with_independent(const Data & like, bool used)
{
  Data made(like);
  made.use_independent(used);
  return made;
}

void use_equations(Data & data, const Model & model, const Model & all, Indices code)
{
  data.use_equations(model, all, code);
}

void use_independent(Data & data, bool used) {data.use_independent(used);}

ViewsOf views(Data & data) {return {&data};}

void take_run(RunObject & of, const RunObject & other)
{
  if (&of != &other) {
    of.run = other.run;
  }
}

Data copy_system(const Data & from) {return from.copy();}

EffectTable make_effects(
  const Model & model, const Model & all, const std::vector<EffectElement> & elements,
  Indexes cut_index, Table cut_values)
{
  return EffectTable(model, all, elements, cut_index, cut_values);
}

void put_effect(EffectTable & effects, Index row, const EffectElement & element)
{
  effects.put(row, element);
}

EffectTable effects_of(const Data & data) {return EffectTable(data.effects);}

std::unique_ptr<Snapshot> take_snapshot(const Data & data)
{
  return std::make_unique<Snapshot>(data);
}

void restore_snapshot(const Snapshot & snapshot) {snapshot.restore();}

void take_numbers(Data & data, const Data & from) {data.take(from);}

void use_derivatives(Data & data, const Kept<AccelerationDerivatives> & derivatives)
{
  data.use_derivatives(derivatives.record, derivatives.owner);
}

void forget(Data & data) {data.forget();}

Model model_of(const Data & data) {return data.model;}

Workspace workspace_of(const Data & data) {return data.work;}

}  // namespace

template<>
inline constexpr bool keeps_evaluation<require_free> = true;
template<>
inline constexpr bool keeps_evaluation<evaluate_present> = true;
template<>
inline constexpr bool keeps_evaluation<find_multipliers> = true;
template<>
inline constexpr bool keeps_evaluation<points_in_state> = true;
template<>
inline constexpr bool keeps_evaluation<find_joint_forces> = true;
template<>
inline constexpr bool keeps_evaluation<views> = true;
template<>
inline constexpr bool keeps_evaluation<workspace_of> = true;
template<>
inline constexpr bool keeps_evaluation<&On<&Run::whole_length>::call> = true;
template<>
inline constexpr bool only_reads<&Of<&Run::time>::call> = true;
template<>
inline constexpr bool only_reads<&Of<&Run::base>::call> = true;
template<>
inline constexpr bool only_reads<&Of<&Run::report>::call> = true;
template<>
inline constexpr bool only_reads<&Of<&Run::steps>::call> = true;
template<>
inline constexpr bool keeps_evaluation<&In<&Run::write_whole>::call> = true;

namespace
{
const Entry entries[] = {
  entry<make_model>(
    "model(tree, body, gravity, cut, cut_point, path_body): a handle; what else follows from "
    "them"),
  entry<model_with_equations>("model_with_equations(model, cut): of the same memory otherwise"),
  entry<make_manifold>("manifold(model): where quaternions are among the coordinates"),
  entry<make_workspace>("workspace(model): memory of its evaluations"),
  entry<make_system>(
    "system(model, all, effects, row, body, point, baumgarte, size, opening, independent, code):"
    " a handle; effects, and what code reads of them, are kept"),
  entry<with_equations>("with_equations(system, model, all, code): of the same state and effects"),
  entry<with_independent>("with_independent(system, used): of the same memory otherwise"),
  entry<make_effects>(
    "effects(model, all, elements, cut_index, cut_values): a handle of what effects say"),
  entry<put_effect>("put_effect(effects, row, element): what the effect of a row says now"),
  entry<effects_of>("effects_of(system): a handle of its own effects"),
  entry<take_snapshot>(
    "snapshot(system): of all numbers that computations write, of effects, too"),
  entry<restore_snapshot>("restore(): put them back"),
  entry<use_equations>(
    "use_equations(system, model, all, code): from now on, of its state and effects"),
  entry<use_independent>("use_independent(system, used): coordinates, none chosen yet, or none"),
  entry<views>("views(system): of its arrays, by name"),
  entry<take_run>("take_run(other): become a copy of another one"),
  entry<copy_system>("copy_system(system): with memory of its own"),
  entry<take_numbers>("take_numbers(system, other): those that it is a copy of"),
  entry<use_derivatives>("use_derivatives(system, derivatives): for stiff steps"),
  entry<forget>("forget(system): the motion so far"),
  entry<model_of>("model_of(system): a handle of its own model"),
  entry<workspace_of>("workspace_of(system): a handle of its own workspace"),
  entry<outward, Length::Q, Length::QD>(
    "outward(model, q, qd, work): poses, velocities and inertias of all bodies"),
  entry<inward, Length::QD>(
    "inward(model, tau, work, massless): articulated-body inertias and bias forces"),
  entry<update>("update(model, work, responses): closure errors, their rates and biases"),
  entry<largest>("largest(values): largest absolute value"),
  entry<assemble>("assemble(model, work): entries of the constraint matrix"),
  entry<factorize_constraints>(
    "factorize(model, work): factors of the constraint matrix; smallest pivot"),
  entry<close_loops, Length::ANY, Length::ANY, Length::Q>(
    "close_loops(model, work, manifold, q, loops, closed, enough): what had a part in it"),
  entry<close_rates, Length::ANY, Length::ANY, Length::Q, Length::QD>(
    "close_rates(model, work, manifold, q, qd, loops, wanted): likewise"),
  entry<search_loops, Length::ANY, Length::ANY, Length::Q>(
    "search_loops(model, work, manifold, q, loops, far, goal, most): likewise"),
  entry<loop_residuals, Length::ANY, Length::ANY, Length::Q>(
    "loop_residuals(model, work, manifold, q, loops, far, residuals, slopes): of such a search"),
  released<close>(
    "close_states(model, work, manifold, q, qd, loops, closed, status): whether all were seen"),
  released<first_open>("first_open(model, work, manifold, q, qd, limit): the first open state"),
  entry<energies, Length::ANY, Length::QD, Length::PAIR>(
    "energies(model, work, qd, out): kinetic and potential energy"),
  entry<constraint_jacobian, Length::ANY, Length::JACOBIAN>(
    "constraint_jacobian(model, work, jac)"),
  entry<loop_units, Length::ANY, Length::JACOBIAN, Length::MULTIPLIERS, Length::QD>(
    "loop_units(model, places, jac, rows, columns): what each is counted in"),
  entry<generalized_inertia_matrix, Length::ANY, Length::INERTIA>(
    "generalized_inertia_matrix(model, work, gim)"),
  entry<cut_wrenches>("cut_wrenches(model, body, lam, share, out)"),
  entry<bias_forces>("bias_forces(work, out)"),
  entry<joint_wrenches, Length::ANY, Length::QD, Length::MULTIPLIERS, Length::WRENCHES>(
    "joint_wrenches(model, work, qdd, lam, wrench)"),
  entry<tree_torque, Length::ANY, Length::QD, Length::QD>("tree_torque(model, work, qdd, out)"),
  entry<to_user_order, Length::MULTIPLIERS, Length::MULTIPLIERS>(
    "to_user_order(model, ordered, out)"),
  entry<forward_dynamics, Length::ANY, Length::Q,
    Length::QD, Length::QD, Length::QD, Length::MULTIPLIERS>(
    "forward_dynamics(model, work, q, qd, tau, qdd, lam)"),
  entry<fill_quaternions>("fill_quaternions(matrices, out)"),
  entry<rates_of_coordinates>(
    "rates_of_coordinates(manifold, state, nv, out, lanes): of quaternions from spins"),
  entry<move_coordinates>("move(manifold, q, change, share)"),
  entry<evaluate, Length::Q, Length::QD>("evaluate(system, q, qd): accelerations and multipliers"),
  entry<evaluate_with_poses, Length::STATE>("evaluate_with_poses(system, state)"),
  entry<evaluate_present, Length::STATE>(
    "evaluate_present(system, state): unless that was done last"),
  entry<is_regular, Length::Q, Length::QD>(
    "is_regular(system, q, qd): whether elimination will do"),
  entry<evaluate_state, Length::STATE>("evaluate_state(system, state)"),
  released<evaluate_again, Length::STATE>("evaluate_again(system, state, count)"),
  entry<derivative, Length::STATE, Length::STATE>("derivative(system, state, out)"),
  released<fastest_rate, Length::STATE, Length::STATE>(
    "fastest_rate(system, state, start): of the motion in a state"),
  entry<stabilise, Length::ANY, Length::STATE>("stabilise(system, stabilisation, state)"),
  entry<equations_suffice, Length::ANY, Length::STATE>(
    "equations_suffice(system, stabilisation, state): after a step"),
  entry<apply_effects>("apply_effects(effects, body, q, qd, tau)"),
  entry<expression_value>("expression_value(data, at, time)"),
  entry<keep_law>(
    "keep_law(address, joints, bodies, states, numbers, listed, spatial): what a row must have "
    "for a routine"),
  entry<library_function>("library_function(which): address of a function for generated code"),
  entry<curve_distance>(
    "curve_distance(pieces, closed, memory, x, y): normal to the free side, and the distance"),
  entry<nearest_to_path>(
    "nearest_to_path(pieces, start_x, start_y, end_x, end_y): distance from a curve, and where"),
  entry<feel_loads>("feel_loads(system, states, share): whether loads are those felt before"),
  entry<begin_loads, Length::STATE>("begin_loads(system, state)"),
  entry<load_joints>("load_joints(system, model, work, qd, qdd, lam)"),
  entry<measure_cut_coordinates>(
    "measure_cut_coordinates(effects, body, position, velocity): the last places of these"),
  entry<accelerations>("cut_accelerations(effects, model, work, qdd, whole, out)"),
  entry<cut_direction>("cut_direction(body, row, planar, values, k, first): axis in the world"),
  entry<minimise_in_box>("minimise_in_box(effects, count, out)"),
  entry<touch>("touch(system): constants or effects were changed"),
  entry<require_free>("require_free(system): refuses what another thread computes with"),
  entry<stop_flag>("stop_flag(stops): a request to stop, set or not"),
  entry<set_stop>(
    "set_stop(flag, stops): whether the threads that heed a flag are to stop, 1 or 0"),
  entry<heed>("heed(flag): from now on in this thread; returns the flag heeded before"),
  entry<run>("run(system, state, method, options, limits, roles, windings): a run that is checked"),
  entry<&On<&Run::set_guard_limits>::call>("set_guard_limits(limits, windings)"),
  entry<take_method>("take_method(other): and the limits of that run"),
  entry<&On<&Run::restart>::call>("restart(moved): torques, effects or the state have changed"),
  entry<&On<&Run::rewind>::call>("rewind(): the method, as a new one"),
  entry<&Of<&Run::aim>::call>("aim(accuracy): keep another one"),
  entry<&Of<&Run::steps>::call>("steps(): what the method knows of them by name"),
  released<&On<&Run::try_step>::call>(
    "try_step(state, size): its status; all else stays as it is"),
  entry<&On<&Run::whole_length>::call>("whole_length(): of a state"),
  entry<&In<&Run::write_whole>::call>("write_whole(out): with the memory of the method"),
  entry<&In<&Run::recall>::call>("recall(whole)"),
  entry<&On<&Run::accuracy_in>::call>("accuracy_in(whole): of the default method"),
  entry<&In<&Run::begin>::call>("begin(): begin there"),
  entry<&Of<&Run::time>::call>("time(): of its state [s]"),
  entry<&Of<&Run::base>::call>("base(): a time [s], and the steps since then"),
  entry<&Of<&Run::set_time>::call>("set_time(base, steps): so many after that"),
  entry<&Of<&Run::report>::call>("run_report(): what is known of it by name"),
  entry<&Of<&Run::clear_cost>::call>("clear_cost(): count from here on"),
  entry<&Of<&Run::sample>::call>("sample(wanted): errors of fixed steps"),
  released<&In<&Run::advance>::call>("advance_run(tau, steps): its outcome, 0 where all are made"),
  released<&In<&Run::make>::call>("make_steps(size, steps, call): as of advance_run"),
  released<&In<&Run::resume>::call>("resume_run(goes_on): as of advance_run"),
  entry<&In<&Run::command>::call>("command(tau): apply torques"),
  entry<&In<&Run::add_work>::call>("add_work(): of the torques held up to there"),
  entry<&On<&Run::find_start>::call>("find_start(): the energy there"),
  entry<&In<&Run::balance>::call>("balance(): of energy"),
  entry<&In<&Run::record_energy>::call>(
    "record_energy(): the balance, compared without a finding"),
  entry<&Of<&Run::record_loss>::call>("record_loss(lost, energy, rounding, time)"),
  entry<&In<&Run::check_energy>::call>("check_energy(): as of advance_run"),
  entry<&Of<&Run::jump>::call>("jump(): the state or an effect has been changed"),
  entry<&In<&Run::jump_balance>::call>("jump_balance(energy): changed from outside"),
  entry<&Of<&Run::restart_guards>::call>("restart_guards()"),
  entry<&Of<&Run::write_kept>::call>("write_kept(of_cables, out): the latest state that was good"),
  released<make_samples>(
    "run_samples(start, torque, zero_order_hold, decimation, steps, states, status, found)"),
  released<check_samples>("check_starts(tolerance, states, fine)"),
  released<record_steps>("record_steps(system, run, scratch, tape): status, steps completed"),
  released<change_of_steps>(
    "change_of_steps(system, run, scratch, tape, routines, change, out): status, step"),
  released<gradient_of_steps>(
    "gradient_of_steps(system, run, scratch, tape, routines, weight, gradient): status, step"),
  released<step_states>(
    "step_states(system, run, scratch, tape, routines, beside, chart, steps): status, states "
    "done"),
  entry<callable_dynamics>(
    "callable_dynamics(system, state, actuated, table, qdd, lam, columns, found): a handle"),
  entry<fill_dynamics_addresses>(
    "fill_dynamics_addresses(dynamics, out): of them, and of three functions of rows"),
  entry<callable_steps>(
    "callable_steps(system, run, scratch, tape, routines, actuated, instants, inputs): a handle"),
  entry<fill_addresses>("fill_addresses(steps, out): of them, and of three functions of rows"),
  entry<fill_basis>("fill_basis(system, routines, chart, q, qd, basis): status"),
  released<move_along>(
    "move_along(system, routines, chart, from_q, from_qd, basis, changes, displacement, q, qd): "
    "status, states"),
  entry<correct_errors>(
    "correct_errors(covariance, slope, residual, noise, first, gate, spread, factors, squares, "
    "whitened, white, others, change, after): whether S is positive definite"),
  released<annotate>("annotate(system, torque, zero_order_hold, decimation, buffer)"),
  released<fill_joint_forces>(
    "fill_joint_forces(system, torque, zero_order_hold, decimation, state, qdd, lam, scratch, "
    "out)"),
  entry<evaluate_given>("evaluate_given(system, request, q, qd, torque): whether it was done"),
  entry<evaluate_request>("evaluate_request(system, whole, request): whether it was done"),
  entry<spread_torques>("spread_torques(actuated, tau, given): whether it was done"),
  entry<sum_of_sizes>("sum_of_sizes(values)"),
  entry<call>("call(table, which, q, qd): a generated routine; whether its results are good"),
  entry<call_for_columns>(
    "call_for_columns(table, q, qd, columns, results): whether the results are good"),
  entry<find_torques>(
    "find_torques(system, actuated, passive, loops, own, out, q, qd, qdd): whether it was done"),
  entry<find_all_multipliers, Length::Q, Length::QD>(
    "find_all_multipliers(system, q, qd, lam): whether accelerations fulfil all equations"),
  entry<find_multipliers, Length::STATE>(
    "find_multipliers(system, state, lam): of all equations in a state"),
  entry<place_points>("place_points(body, row, point, out)"),
  entry<points_in_state, Length::STATE>("points_in_state(system, state, row, point, out)"),
  entry<find_joint_forces, Length::STATE>(
    "find_joint_forces(system, state, lam, row, point, scratch, out)"),
  released<follow>(
    "follow_drives(model, work, manifold, drives, kept, unit, anchors, open, begin, values, q, "
    "position, velocity, acceleration): poses reached, share of the way to the next one"),
  released<reach_poses>(
    "reach_poses(model, work, manifold, drives, kept, unit, anchors, open, grid, seeds, values, "
    "actuated, reached, position, rates): how many nodes of a grid are reached"),
  released<run_batch>(
    "run_batch(batch, lanes, state, torque, zero_order_hold, decimation, steps, position, "
    "velocity, status, found)"),
};

constexpr char bound_name[] = "closedloop_dynamics.engine.bound";

PyObject * call_bound(PyObject * capsule, PyObject * const * from, Py_ssize_t count)
{
  return guarded(
    [&] {
      return static_cast<Bound *>(PyCapsule_GetPointer(capsule, bound_name))->run(from, count);
    });
}

/// The void pointer that Python's tables hold, and the type that they declare.
template<class Function>
PyCFunction as_method(Function * function)
{
  return reinterpret_cast<PyCFunction>(reinterpret_cast<void *>(function));
}

PyMethodDef bound_method = {
  "bound", as_method(call_bound), METH_FASTCALL,
  "Call a function of the engine with its bound arguments and those that are left."};

PyObject * bind(PyObject *, PyObject * const * from, Py_ssize_t count)
{
  return guarded(
    [&]() -> PyObject * {
      const char * name = count > 0 ? PyUnicode_AsUTF8AndSize(from[0], nullptr) : nullptr;
      if (name == nullptr) {
        PyErr_SetString(PyExc_TypeError, "bind: expected the name of a function");
        throw PythonError();
      }
      for (const Entry & each : entries) {
        if (std::string_view(each.name) == name) {
          std::unique_ptr<Bound> bound = each.bind(from + 1, count - 1, each.name);
          for (Py_ssize_t n = 1; n < count; ++n) {
            bound->keep(from[n]);
          }
          Owned capsule(
            PyCapsule_New(
              bound.get(), bound_name, [](PyObject * object) {
                delete static_cast<Bound *>(PyCapsule_GetPointer(object, bound_name));
              }));
          bound.release();
          return PyCMethod_New(&bound_method, capsule.get(), nullptr, nullptr);
        }
      }
      PyErr_Format(PyExc_ValueError, "bind: there is no function '%s'", name);
      throw PythonError();
    });
}

/// The table of the methods of a type, or of the functions of the module, for Python.
std::vector<PyMethodDef> methods_of(PyObject ** owner)
{
  std::vector<PyMethodDef> found;
  for (const Entry & each : entries) {
    if (each.owner == owner) {
      found.push_back({each.name, as_method(each.call), METH_FASTCALL, each.doc});
    }
  }
  found.push_back(
    owner != nullptr ? PyMethodDef{} : PyMethodDef{
      "bind", as_method(bind), METH_FASTCALL,
      "bind(name, *arguments): a function of the arguments left; these are read once and kept"});
  return found;
}

/// Add the type of objects that have methods.
template<class Type>
bool add_type(PyObject * module, const char * name, const char * full)
{
  static std::vector<PyMethodDef> methods = methods_of(&type_of<Type>);
  return (type_of<Type> != nullptr || make_type<Type>(full, methods.data()) != nullptr) &&
         PyModule_AddObjectRef(module, name, type_of<Type>) == 0;
}

int fill_module(PyObject * module)
{
  if (memory_type == nullptr && (memory_type = make_memory_type()) == nullptr) {
    return -1;
  }
  if (!add_type<RunObject>(module, "Run", "closedloop_dynamics.engine.native.Run") ||
    !add_type<Snapshot>(module, "Snapshot", "closedloop_dynamics.engine.native.Snapshot") ||
    !add_type<SharedStop>(module, "StopFlag", "closedloop_dynamics.engine.native.StopFlag"))
  {
    return -1;
  }
  static std::vector<PyMethodDef> methods = methods_of(nullptr);
  for (PyMethodDef & method : methods) {
    PyObject * function = PyCMethod_New(&method, nullptr, nullptr, nullptr);
    if (function == nullptr || PyModule_AddObjectRef(module, method.ml_name, function) < 0) {
      return -1;
    }
    Py_DecRef(function);
  }
  return PyModule_AddStringConstant(module, "sources", sources) == 0 &&
         PyModule_AddStringConstant(module, "compiler", compiler) == 0 &&
         PyModule_AddStringConstant(module, "flags", flags) == 0 ? 0 : -1;
}

PyModuleDef_Slot module_slots[] = {
  {Py_mod_exec, reinterpret_cast<void *>(fill_module)}, {0, nullptr}};

PyModuleDef module_definition = {
  {{1, nullptr}, nullptr, 0, nullptr},
  "closedloop_dynamics.engine.native",
  "Compiled kernels of the package.",
  0,
  nullptr,
  module_slots,
  nullptr,
  nullptr,
  nullptr};

}  // namespace
}  // namespace closedloop

extern "C" __attribute__((visibility("default"))) PyObject * PyInit_native()
{
  return PyModuleDef_Init(&closedloop::module_definition);
}
