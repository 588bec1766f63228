// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

// The engine in Python: the table of its functions. Nothing is computed here.

#include <string_view>

#include "arguments.hpp"
#include "batch.hpp"
#include "bounds.hpp"
#include "build_info.hpp"
#include "callable.hpp"
#include "correction.hpp"
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
#include "projection.hpp"
#include "recursion.hpp"
#include "requests.hpp"
#include "rollout.hpp"
#include "routines.hpp"
#include "state_steps.hpp"
#include "stiffness.hpp"
#include "stop_flag.hpp"

namespace closedloop
{
namespace
{
void require(bool good, const char * expected)
{
  if (!good) {
    throw std::invalid_argument(expected);
  }
}

/// Make an object.
template<class Type, class ... Parameters>
std::shared_ptr<Type> make(Parameters ... parameters)
{
  return std::make_shared<Type>(parameters ...);
}

template<class Type>
ViewsOf<Type> views(Type & object) {return {object};}

// What follows has other arguments in Python, or conditions that no signature says.

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

System make_system(
  const Model & model, const Model & all, const EffectTable & effects, Indices row,
  Indexes body, Table point, double baumgarte, double size, double opening, bool independent,
  Indices code)
{
  System made(
    model, all, Settings(baumgarte, size, opening),
    JointPlaces(model, row, body, point), effects, code);
  made.use_independent(independent);
  made.interrupted = is_interrupted;
  return made;
}

System with_independent(const System & like, bool used)
{
  System made(like);
  made.use_independent(used);
  return made;
}

void use_derivatives(System & system, const Kept<AccelerationDerivatives> & derivatives)
{
  system.use_derivatives(derivatives.record, derivatives.owner);
}

Model model_of(const System & system) {return Model(system.model);}

Workspace workspace_of(const System & system) {return Workspace(system.work);}

EffectTable effects_of(const System & system) {return EffectTable(system.effects);}

System copy_system(const System & from) {return from.copy();}

void restore_snapshot(const Snapshot & snapshot) {snapshot.restore();}

/// Nothing: what another thread computes with is refused where arguments are read.
void require_free(const System &) {}

/// Nothing, but that constants or effects were changed from outside.
void touch(const System &) {}

double factorize_constraints(const Model & model, const Workspace & work)
{
  return factorize(model, work);
}

void rates(const Manifold & manifold, Values state, Values out)
{
  rates_of_coordinates(manifold, state, manifold.place.size, out);
}

void move_coordinates(const Manifold & manifold, Values q, Values change, double share)
{
  require(manifold.fits(q.size, change.size), "move: expected coordinates and displacements");
  move(manifold, q, change, share);
}

void place(const Workspace & work, Indices row, Table point, Table out)
{
  place_points(work.body, row, point, out);
}

void cut_accelerations(
  const EffectTable & effects, const Model & model, const Workspace & work, Values qdd, bool whole,
  Values out)
{
  require(
    has_shape(effects.cuts.scratch, model.tree.rows, 2 * work.size()) &&
    qdd.size == model.joints(), "cut_accelerations: expected the model of the effects");
  accelerations(effects, model, work, qdd, whole, out);
}

Vector3 cut_axis(const EffectTable & effects, Table body, Index k)
{
  const CutCoordinates & cuts = effects.cuts;
  return cut_direction(
    body, cuts.index(k, cut_coordinate::ROW_B), cuts.index(k, cut_coordinate::IN_PLANE) == 1,
    cuts.values, k, cut_coordinate::AXIS);
}

void load_joints_of(
  const System & system, const Model & model, const Workspace & work, Values qd, Values qdd,
  Values lam)
{
  require(
    model.joints() == system.nv() && work.size() == system.work.size() &&
    lam.size == model.equations() &&
    has_shape(system.effects.reaction, model.tree.rows, 2 * work.size()),
    "load_joints: expected a model of the system, and its multipliers");
  load_joints(system, model, work, qd, qdd, lam);
}

bool evaluate_on(const System & system, const System & whole, const Request & request)
{
  require(
    system.whole.empty() || (whole.ns() == system.ns() && whole.nv() == system.nv() &&
    whole.lam.size == system.whole.lam.size), "evaluate_request: expected systems of one mechanism");
  return evaluate_request(system, whole, request);
}

bool find_all(const System & system, Values q, Values qd, Values lam)
{
  require(!system.whole.empty(), "find_all_multipliers: expected equations that are left out");
  return find_all_multipliers(system, q, qd, lam);
}

bool spread(Values tau, Indices actuated, const OptionalVector & given)
{
  return spread_torques(actuated, tau, given);
}

double value_of_expression(Values data, Index at, double time)
{
  require(is_expression(data, at), "expression_value: expected an expression");
  return expression_value(data, at, time);
}

bool call_routine(Indices table, Index which, Values q, Values qd)
{
  require_routines(table, which, 1);
  return call(table, which, q, qd);
}

bool call_both(Indices table, Values q, Values qd, Table columns, Table results)
{
  require_routines(table, 0, 2);
  return call_for_columns(table, q, qd, columns, results);
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

/// Whether a grid has so many nodes, and its part that may be written is within it.
bool is_grid(Indexes grid, Index nodes)
{
  bool good = true;
  Index count = 1;
  for (Index axis = 0; good && axis < grid.columns; ++axis) {
    const Index along = grid(0, axis);
    good = along > 0 && along <= nodes && grid(1, axis) >= 0 && grid(2, axis) <= along;
    count *= good ? along : 0;
    good = good && count <= nodes;
  }
  return good && count == nodes;
}

Index reach(
  const Model & model, const Workspace & work, const Manifold & manifold, Indices drives,
  Indices kept, Values unit, Table anchors, double open, Indexes grid, Indices seeds, Table values,
  Indices actuated, Indices reached, Table position, Table rates)
{
  require(
    is_grid(grid, reached.size) && are_places(seeds, 0, reached.size),
    "reach_poses: expected a grid of these nodes");
  return reach_poses(
    model, work, manifold, drives, kept, unit, anchors, open, grid, seeds, values, actuated, reached,
    position, rates);
}

bool close(
  const Model & model, const Workspace & work, const Manifold & manifold, Table q, Table qd,
  const Loops & loops, double closed, Indices status)
{
  return close_states(
    model, work, manifold, q, qd, loops, closed, status, is_interrupted);
}

std::shared_ptr<RunObject> make_run(
  const std::shared_ptr<System> & system, const Kept<Values> & state, std::string_view method,
  const MethodOptions & options, const GuardLimits & limits, Indices roles, Indices windings)
{
  return std::shared_ptr<RunObject>(
    new RunObject{
      system, state.record, state.owner,
      Run(*system, make_stepper(*system, method, options), limits, roles, windings)});
}

void take_run(RunObject & of, const RunObject & other)
{
  if (&of != &other) {
    of.run = other.run;
  }
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

// What signatures say in numbers.
static_assert(
  cut::MOTION_COLUMNS == 3 && MOST_COORDINATES == 16 && LANES == 8);

const Entry entries[] = {
  entry<make<
      Model, Matrix<const Index>, Matrix<const double>, Vector<const double>, Matrix<const Index>,
      Matrix<const double>, Vector<const Index>>>(
    "model(tree, body, gravity, cut, cut_point, path_body): what else follows from them"),
  entry<views<Model>>("views(): of its arrays, by name"),
  entry<make<Model, const Model &, Matrix<const Index>>>("with_cut(cut): on other equations, of the same memory otherwise"),
  entry<make<Manifold, const Model &>>("manifold(): where quaternions are among the coordinates"),
  entry<make<Workspace, const Model &>>("workspace(): memory of its evaluations"),
  entry<make<
      EffectTable, const Model &, const Model &, const std::vector<EffectElement> &, Indexes,
      Table>>(
    "effects(all, elements, cut_index, cut_values): a table of what effects say"),
  entry<make_system>(
    "system(all, effects, row, body, point, baumgarte, size, opening, independent, code): effects, "
    "and what code reads of them, are kept"),
  entry<outward>("outward(q[Q], qd[V], work): poses, velocities and inertias of all bodies"),
  entry<inward>("inward(tau[V], work, massless): articulated-body inertias and bias forces"),
  entry<update>("update(work, responses): closure errors, their rates and biases"),
  entry<assemble>("assemble(work): entries of the constraint matrix"),
  entry<factorize_constraints>(
    "factorize(work): factors of the constraint matrix; smallest pivot"),
  entry<close_loops>(
    "close_loops(work, manifold, q[Q], loops, closed, enough): what had a part in it"),
  entry<close_rates>("close_rates(work, manifold, q[Q], qd[V], loops, wanted[r]): likewise"),
  entry<search_loops>(
    "search_loops(work, manifold, q[Q], loops, far, goal, most): likewise"),
  entry<loop_residuals>(
    "loop_residuals(work, manifold, q[Q], loops, far, residuals[C+K+l], slopes[C+K+l,V]): of such a "
    "search"),
  entry<close, RELEASES>(
    "close_states(work, manifold, q[n,Q], qd[n,V], loops, closed, status[n]): whether all were seen"),
  entry<first_open, RELEASES>(
    "first_open(work, manifold, q[n,Q], qd[n,V], limit): the first open state"),
  entry<follow, RELEASES>(
    "follow_drives(work, manifold, drives<K[d<=C], kept<C[k], unit[V>=1], anchors[V-k,V], open, "
    "begin[d], values[n,d,3], q[Q], position[n,Q], velocity[n,V], acceleration[n,V]): poses reached, "
    "share of the way to the next one"),
  entry<reach, RELEASES>(
    "reach_poses(work, manifold, drives<K[d<=C], kept<C[k], unit[V>=1], anchors[V-k,V], open, "
    "grid[3,axes>=1], seeds, values[n,d], actuated<V[a], reached[n], position[n,Q], rates[n,a*d]): "
    "how many nodes of a grid are reached"),
  entry<energies>("energies(work, qd[V], out[2]): kinetic and potential energy"),
  entry<constraint_jacobian>("constraint_jacobian(work, jac[C,V])"),
  entry<loop_units>("loop_units(places[C], jac[C,V], rows[C], columns[V]): what each is counted in"),
  entry<generalized_inertia_matrix>("generalized_inertia_matrix(work, gim[V,V])"),
  entry<cut_wrenches>("cut_wrenches(work, body[B,>=D], lam[C], out[K,W])"),
  entry<tree_torque>("tree_torque(work, qdd[V], out[V])"),
  entry<to_user_order>("to_user_order(ordered[C], out[C])"),
  entry<forward_dynamics>("forward_dynamics(work, q[Q], qd[V], tau[V], qdd[V], lam[C])"),

  entry<views<Workspace>>("views(): of its arrays, by name"),
  entry<bias_forces>("bias_forces(out[<=B,>=W])"),
  entry<place>("place_points(row<B[n], point[>=n,P], out[>=n,P]): in the world"),

  entry<views<Manifold>>("views(): of its arrays, by name"),
  entry<rates>("rates(state[>=Q+V], out[>=Q]): of coordinates, of quaternions from spins"),
  entry<move_coordinates>("move(q, change, share)"),

  entry<views<EffectTable>>("views(): of its arrays, by name"),
  entry<&Of<&EffectTable::put>::call>("put_effect(row, element): what the effect of a row says now"),
  entry<apply_effects>("apply_effects(body[B,>=D], q[>=V], qd[V], tau[>=T])"),
  entry<measure_cut_coordinates>(
    "measure_cut_coordinates(body[B,>=D], position[n>=G], velocity[n]): the last places of these"),
  entry<cut_accelerations>("cut_accelerations(model, work, qdd, whole, out[>=T])"),
  entry<cut_axis>("cut_axis(body[B,>=D], k<G): in the world"),

  entry<views<System>, KEEPS>("views(): of its arrays, by name"),
  entry<make<System, const System &, const Model &, const Model &, Indices>>("with_equations(model, all, code): of the same state and effects"),
  entry<with_independent>("with_independent(used): of the same memory otherwise"),
  entry<&Of<&System::use_equations>::call>("use_equations(model, all, code): from now on, of its state and effects"),
  entry<&Of<&System::use_independent>::call>("use_independent(used): coordinates, none chosen yet, or none"),
  entry<use_derivatives>("use_derivatives(derivatives): for stiff steps"),
  entry<copy_system>("copy(): with memory of its own"),
  entry<model_of>("own_model(): of the same memory"),
  entry<workspace_of, KEEPS>("own_workspace(): of the same memory"),
  entry<effects_of>("own_effects(): of the same memory"),
  entry<&Of<&System::take>::call>("take_numbers(other): those that it is a copy of"),
  entry<&Of<&System::forget>::call>("forget(): the motion so far"),
  entry<touch>("touch(): constants or effects were changed"),
  entry<require_free, KEEPS>("require_free(): refuses what another thread computes with"),
  entry<make<Snapshot, const System &>>("snapshot(): of all numbers that computations write, of effects, too"),
  entry<restore_snapshot>("restore(): put them back"),
  entry<evaluate>("evaluate(q[Q], qd[V]): accelerations and multipliers"),
  entry<evaluate_with_poses>("evaluate_with_poses(state[S])"),
  entry<evaluate_present, KEEPS>("evaluate_present(state[S]): unless that was done last"),
  entry<evaluate_state>("evaluate_state(state[S])"),
  entry<evaluate_again, RELEASES>("evaluate_again(state[S], count)"),
  entry<evaluate_given>("evaluate_given(request, q, qd, torque): whether it was done"),
  entry<evaluate_on>("evaluate_request(whole, request): whether it was done"),
  entry<is_regular>("is_regular(q[Q], qd[V]): whether elimination will do"),
  entry<derivative>("derivative(state[S], out[S])"),
  entry<fastest_rate, RELEASES>("fastest_rate(state[S], start[S]): of the motion in a state"),
  entry<stabilise>("stabilise(stabilisation, state[S])"),
  entry<feel_loads>("feel_loads(states[Z], share): whether loads are those felt before"),
  entry<begin_loads>("begin_loads(state[S])"),
  entry<load_joints_of>("load_joints(model, work, qd[V], qdd[V], lam)"),
  entry<find_torques>(
    "find_torques(actuated<V[a], passive<V[V-a], loops<=A, own[Z], out[a+A], q, qd, qdd): whether it "
    "was done"),
  entry<find_all>(
    "find_all_multipliers(q[Q], qd[V], lam[A]): whether accelerations fulfil all equations"),
  entry<find_multipliers, KEEPS>(
    "find_multipliers(state[S], lam[A]): of all equations in a state"),
  entry<points_in_state, KEEPS>("points_in_state(state[S], row<B[n], point[>=n,P], out[>=n,P])"),
  entry<find_joint_forces, KEEPS>(
    "find_joint_forces(state[S], lam[A], row<B[n], point[n,3], scratch[B,2*W], out[n,W])"),
  entry<annotate, RELEASES>(
    "annotate(torque[rows>=1,T], 1<=zero_order_hold<100000000000, 1<=decimation<100000000000, "
    "buffer)"),
  entry<fill_joint_forces, RELEASES>(
    "fill_joint_forces(torque[rows>=1,T], 1<=zero_order_hold<100000000000, "
    "1<=decimation<100000000000, state[n<=rows*zero_order_hold/decimation+1,S], qdd[n,V], lam[n,C], "
    "scratch[B,2*W], out[n,V,W])"),
  entry<record_steps, RELEASES>(
    "record_steps(run, scratch[scratch_rows,S], tape): status, steps completed"),
  entry<change_of_steps, RELEASES>(
    "change_of_steps(run, scratch[scratch_rows,S], tape, routines, change, "
    "out[(instants-1)/decimation+1,Q+V]): status, step"),
  entry<gradient_of_steps, RELEASES>(
    "gradient_of_steps(run, scratch[scratch_rows,S], tape, routines, "
    "weight[(instants-1)/decimation+1,Q+V], gradient): status, step"),
  entry<step_states, RELEASES>(
    "step_states(run, scratch[scratch_rows,S], tape, routines, beside, chart, steps): status, states "
    "done"),
  entry<fill_basis>("fill_basis(routines, chart, q[Q], qd[V], basis[2*V,2*k+p]): status"),
  entry<move_along, RELEASES>(
    "move_along(routines, chart, from_q[Q], from_qd[V], basis[2*V,2*k+p], changes[n,2*k], "
    "displacement[V], q[n,Q], qd[n,V]): status, states"),
  entry<callable_steps, KEEPS>(
    "callable_steps(run, scratch[scratch_rows,S], tape, routines, actuated<V, "
    "ends[2=rows+1=(instants-1)/decimation+1,Q+V], inputs)"),
  entry<callable_dynamics, KEEPS>(
    "callable_dynamics(state[S], actuated<V, table[>=2], qdd[V], lam[C], "
    "columns[n>=(3*V+7)/8,8*(V+C)], found[n,8*(V+C)])"),
  entry<&Of<&Callable::addresses>::call>("addresses(): its own, and of three functions of rows"),

  entry<make_run, KEEPS>(
    "run(state[S], method, options, limits, roles, windings): a run that is checked"),
  entry<take_run>("take_run(other): become a copy of another one"),
  entry<take_method>("take_method(other): and the limits of that run"),
  entry<&On<&Run::set_guard_limits>::call>("set_guard_limits(limits, windings)"),
  entry<&On<&Run::restart>::call>("restart(moved): torques, effects or the state have changed"),
  entry<&On<&Run::rewind>::call>("rewind(): the method, as a new one"),
  entry<&Of<&Run::aim>::call>("aim(accuracy): keep another one"),
  entry<&Of<&Run::steps>::call, READS>("steps(): what the method knows of them by name"),
  entry<&On<&Run::try_step>::call, RELEASES>(
    "try_step(state[S], size>0): its status; all else stays as it is"),
  entry<&On<&Run::whole_length>::call, KEEPS>("whole_length(): of a state"),
  entry<&In<&Run::write_whole>::call, KEEPS>("write_whole(out[L]): with the memory of the method"),
  entry<&In<&Run::recall>::call>("recall(whole[L])"),
  entry<&On<&Run::accuracy_in>::call>("accuracy_in(whole[L]): of the default method"),
  entry<&In<&Run::begin>::call>("begin(): begin there"),
  entry<&Of<&Run::time>::call, READS>("time(): of its state [s]"),
  entry<&Of<&Run::base>::call, READS>("base(): a time [s], and the steps since then"),
  entry<&Of<&Run::set_time>::call>("set_time(base, steps): so many after that"),
  entry<&Of<&Run::report>::call, READS>("run_report(): what is known of it by name"),
  entry<&Of<&Run::clear_cost>::call>("clear_cost(): count from here on"),
  entry<&Of<&Run::sample>::call>("sample(wanted): errors of fixed steps"),
  entry<&In<&Run::advance>::call, RELEASES>(
    "advance_run(tau, steps): its outcome, 0 where all are made"),
  entry<&In<&Run::make>::call, RELEASES>("make_steps(size>0, steps, call): as of advance_run"),
  entry<&In<&Run::resume>::call, RELEASES>("resume_run(goes_on): as of advance_run"),
  entry<&In<&Run::command>::call>("command(tau[T]): apply torques"),
  entry<&In<&Run::add_work>::call>("add_work(): of the torques held up to there"),
  entry<&On<&Run::find_start>::call>("find_start(): the energy there"),
  entry<&In<&Run::balance>::call>("balance(): of energy"),
  entry<&In<&Run::record_energy>::call>(
    "record_energy(): the balance, compared without a finding"),
  entry<&In<&Run::check_energy>::call>("check_energy(): as of advance_run"),
  entry<&Of<&Run::jump>::call>("jump(): the state or an effect has been changed"),
  entry<&In<&Run::jump_balance>::call>("jump_balance(energy): changed from outside"),
  entry<&Of<&Run::restart_guards>::call>("restart_guards()"),
  entry<&Of<&Run::write_kept>::call>("write_kept(of_cables, out): the latest state that was good"),
  entry<make_samples, RELEASES>(
    "run_samples(start[n,S], torque, zero_order_hold, decimation, steps, states, status, found)"),
  entry<check_samples, RELEASES>("check_starts(tolerance, states, fine)"),

  entry<stop_flag>("stop_flag(stops): a request to stop, set or not"),
  entry<set_stop>("set_stop(0<=stops<=1): whether the threads that heed it are to stop"),
  entry<heed>("heed(flag): from now on in this thread; returns the flag heeded before"),
  entry<largest>("largest(values): largest absolute value"),
  entry<fill_quaternions>("fill_quaternions(matrices[n,3,3], out[n,4])"),
  entry<value_of_expression>("expression_value(data, at, time)"),
  entry<keep_law>(
    "keep_law(address>=1, joints<=16, bodies>=0, states>=0, numbers>=0, listed>=0, spatial): what a "
    "row must have for the law at an address"),
  entry<library_function>("library_function(which): address of a function for generated code"),
  entry<correct_errors>(
    "correct_errors(covariance[n,n], slope[m,n], residual[m], noise[m], first<=m[sensors>=1], "
    "gate[sensors-1], spread[m,m], factors[m,m], squares[sensors-1], whitened[m,n], white[m], "
    "others[m,any], change[n], after[n,n]): whether S is positive definite"),
  entry<spread>("spread_torques(tau[n], -1<=actuated<n, given): whether it was done"),
  entry<call_routine>(
    "call(table[n], which<n, q, qd): a generated routine; whether its results are good"),
  entry<call_both>(
    "call_for_columns(table[>=2], q, qd, columns[n,m], results[n,m]): whether the results are good"),
  entry<run_batch, RELEASES>(
    "run_batch(batch, lanes, state, torque, zero_order_hold, decimation, steps, position, "
    "velocity, status, found)"),
};

PyObject * call_bound(PyObject * object, PyObject * const * from, Py_ssize_t count)
{
  return guarded([&] {return held_by<Bound>(object)->run(from, count);});
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
    [&] {
      const char * name = count > 0 ? PyUnicode_AsUTF8AndSize(from[0], nullptr) : nullptr;
      if (name == nullptr) {
        refuse(PyExc_TypeError, "bind: expected the name of a function");
      }
      const Entry * found = std::find_if(
        std::begin(entries), std::end(entries), [&](const Entry & each) {return each.name == name;});
      if (found == std::end(entries)) {
        refuse(PyExc_ValueError, "bind: there is no function '" + std::string(name) + "'");
      }
      const Owned bound(to_python(found->bind(from + 1, count - 1)));
      return PyCMethod_New(&bound_method, bound.get(), nullptr, nullptr);
    });
}

/// The table of the methods of a type, or of the functions of the module (`void`), for Python.
template<class Type>
PyMethodDef * methods_of()
{
  static std::vector<PyMethodDef> found;
  for (const Entry & each : entries) {
    if (each.owner == (std::is_void_v<Type> ? nullptr : &type_of<Type>)) {
      found.push_back({each.name.c_str(), as_method(each.call), METH_FASTCALL, each.text});
    }
  }
  found.push_back(
    !std::is_void_v<Type> ? PyMethodDef{} : PyMethodDef{
      "bind", as_method(bind), METH_FASTCALL,
      "bind(name, *arguments): a function of the arguments left; these are read once and kept"});
  found.push_back({});
  return found.data();
}

/// Add types to the module, made with the first one.
template<class ... Type>
void add_types(PyObject * module)
{
  const auto add = [&](PyObject * type, const char * name) {
      if (PyModule_AddObjectRef(module, name + std::string_view(name).rfind('.') + 1, type) < 0) {
        throw PythonError();
      }
    };
  ((type_of<Type> == nullptr ? make_type<Type>({Py_tp_methods, methods_of<Type>()}) : void(),
  add(type_of<Type>, type_name<Type>)), ...);
}

int fill_module(PyObject * module)
{
  PyObject * const done = guarded(
    [&] {
      if (type_of<Memory> == nullptr) {
        make_type<Memory>({Py_bf_getbuffer, reinterpret_cast<void *>(fill_buffer)});
        make_type<Bound>({0, nullptr});
      }
      add_types<
        Model, Manifold, Workspace, EffectTable, System, RunObject, Snapshot, StopFlag, Callable>(
        module);
      return none();
    });
  Py_DecRef(done);
  return done != nullptr && PyModule_AddStringConstant(module, "sources", sources) == 0 &&
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
  closedloop::module_definition.m_methods = closedloop::methods_of<void>();
  return PyModuleDef_Init(&closedloop::module_definition);
}
