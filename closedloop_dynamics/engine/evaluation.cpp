// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "evaluation.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

#include "arms.hpp"
#include "branch.hpp"
#include "cut_coordinates.hpp"
#include "dispatch.hpp"
#include "elimination.hpp"
#include "forward_dynamics.hpp"
#include "independent.hpp"
#include "interrupt.hpp"
#include "joint_reaction.hpp"
#include "laws.hpp"
#include "least_forces.hpp"
#include "manifold.hpp"
#include "null_space.hpp"
#include "rank_revealing.hpp"
#include "recursion.hpp"
#include "refinement.hpp"
#include "routines.hpp"
#include "scene_code.hpp"
#include "scratch.hpp"
#include "static_friction.hpp"

namespace closedloop
{

namespace
{
// Numbers of a Jacobian that fit on the stack.
constexpr Index ROOM = 1024;
// Rounds by kept responses; the share of the change before that each may leave; what the next round
// would change, of the accelerations without friction.
constexpr int MOST_ROUNDS = 6;
constexpr double LEFT = 0.1, BALANCED = 1e-13;

/// Kinematics and applied forces, which an elimination overwrites.
void move_bodies(const System & system, Values q, Values qd)
{
  place_bodies(system, q, qd);
  apply_listed(system, q, qd);
  if (system.has_effects() && system.effects.loaded[0] > 0) {
    bias_forces(system.work, system.effects.reaction);
  }
}

/// Replace the multipliers by those of the least joint forces, with the same motion; poses and
/// forces on the bodies are those of the state.
void minimise_multipliers(const System & system)
{
  const Model & model = system.model;
  const Workspace & work = system.work;
  const Index independent = static_cast<Index>(work.health[health::RANK]);
  if (!system.whole.empty() || independent == model.equations() || system.joints.body.rows == 0) {
    return;
  }
  bias_forces(work, work.force);
  joint_wrenches(model, work, system.qdd, system.lam, work.force);
  Scratch<double, ROOM> scratch(model.equations() * model.joints());
  const Table jac = scratch.take(model.equations(), model.joints());
  constraint_jacobian(model, work, jac);
  minimise_joint_wrenches(system, model, work, jac, work.force, system.lam, independent);
}

/// Accelerations with all closure equations, of which some depend on others.
void accelerate_with_all_equations(const System & system, Values q, Values qd)
{
  const AllEquations & all = system.whole;
  const Model & model = all.empty() ? system.model : all.model;
  const Workspace & work = all.empty() ? system.work : all.work;
  const Settings & settings = *system.settings;
  const double before = work.health[health::SINGULAR_COUNT];
  outward(model, q, qd, work);
  apply_listed(system, q, qd);
  accelerate_rank_revealing(
    model, work, system.model.equations(), system.applied, settings.baumgarte_gain,
    settings.aside, system.manifold, q, qd, system.qdd,
    all.empty() ? system.lam : all.lam);
  if (work.health[health::SINGULAR_COUNT] > before && system.passage[0] == 0.0) {
    system.passage[0] = std::numeric_limits<double>::min();
    copy(q, system.passage.from(1));
  }
  if (!all.empty()) {
    DenseMatrix jac(model.equations(), model.joints());
    constraint_jacobian(model, work, view(jac));
    multipliers_of_kept(view(jac), all.lam, all.kept, system.lam);
    return;
  }
  minimise_multipliers(system);
}

/// Accelerations next to a singular position, or with equations that depend on others.
void accelerate_near_singular(const System & system, Values q, Values qd, Outputs outputs)
{
  const double pivot = system.work.health[health::SMALLEST_PIVOT];
  if (good(system.model, pivot, POOR_PIVOT) ||
    !accelerate_on_branch(system, q, qd, true, outputs))
  {
    accelerate_with_all_equations(system, q, qd);
  }
}

/// Accelerations by loops over bodies, without generated code for the mechanism. Return which of
/// their factors are in the workspace.
Factors accelerate_by_loops(const System & system, Values q, Values qd)
{
  const double gain = system.settings->baumgarte_gain;
  move_bodies(system, q, qd);
  if (accelerate(system.model, system.work, system.applied, gain, system.qdd, system.lam)) {
    return Factors::PLAIN;
  }
  move_bodies(system, q, qd);
  if (accelerate_refined(
      system.model, system.work, system.applied, gain, system.qdd, system.lam))
  {
    return Factors::REFINED;
  }
  accelerate_near_singular(system, q, qd, Outputs::POSES);
  return Factors::NONE;
}

/// Bring back the forces on the bodies for joint loads, which loops over bodies overwrite.
void restore_forces(const System & system, Values q, Values qd)
{
  if (system.has_effects() && system.effects.loaded[0] > 0) {
    call(system.table, routine::OUTWARD, q, qd);
    apply_listed(system, q, qd);
  }
}

/// Accelerations where the elimination alone does not suffice: by refinement or decompositions.
void accelerate_beyond_elimination(const System & system, Values q, Values qd, Outputs outputs)
{
  if (system.table[routine::REFINED_ACCELERATION] != 0) {
    if (call(system.table, routine::REFINED_ACCELERATION, q, qd)) {
      return;
    }
  } else if (accelerate_on_branch(system, q, qd, false, outputs)) {
    restore_forces(system, q, qd);
    return;
  } else {
    move_bodies(system, q, qd);
    if (accelerate_refined(
        system.model, system.work, system.applied,
        system.settings->baumgarte_gain, system.qdd, system.lam))
    {
      restore_forces(system, q, qd);
      return;
    }
  }
  accelerate_near_singular(system, q, qd, outputs);
  restore_forces(system, q, qd);
}

/// Accelerations of all joints, those of cut joints behind.
void accelerations_with_cuts(const System & system, Values q, Values qd)
{
  const CutCoordinates & cuts = system.effects.cuts;
  outward(system.model, q, qd, system.work);
  copy(system.qdd, cuts.qdd.part(0, system.nv()));
  accelerations(system.effects, system.model, system.work, system.qdd, true, cuts.qdd);
}

/// Accelerations and multipliers, shape (nv + nc,), that the torques in EffectTable.applied add to
/// those of the others; false where refinement does not converge, or the elimination fails.
bool respond(
  const System & system, Values q, Values qd, Factors factors, Values others, Values frictionless,
  Values out)
{
  const Values applied = system.effects.applied;
  const Values qdd = out.part(0, system.nv()), lam = out.part(system.nv(), system.lam.size);
  if (factors == Factors::CODE && system.table[routine::TORQUE_RESPONSE] != 0) {
    return call(system.table, routine::TORQUE_RESPONSE, applied, out);
  }
  if (factors == Factors::CODE) {
    for (Index i = 0; i < applied.size; ++i) {
      applied[i] += others[i];
    }
    const bool found = call(system.table, routine::ACCELERATION, q, qd);
    for (Index i = 0; i < qdd.size; ++i) {
      qdd[i] = system.qdd[i] - frictionless[i];
    }
    for (Index i = 0; i < lam.size; ++i) {
      lam[i] = system.lam[i] - frictionless[qdd.size + i];
    }
    return found;
  }
  load_torques(system.model, system.work, system.applied);
  if (factors == Factors::REFINED) {
    return accelerate_prepared_refined(system.model, system.work, 0.0, qdd, lam);
  }
  accelerate_prepared(system.model, system.work, 0.0, qdd, lam);
  return true;
}

/// What the limit of a friction at rest adds, as `respond` does.
bool respond_to_hold(
  const System & system, Values q, Values qd, Factors factors, Index row, Values out)
{
  const EffectTable & effects = system.effects;
  Scratch<double, ROOM> scratch(effects.applied.size);
  const Values others = scratch.copy_of(effects.applied);
  effects.applied.fill(0.0);
  exert_along(effects, row, effects.output(row, 3));
  const bool found =
    respond(system, q, qd, factors, others, free_response(effects.static_friction), out);
  copy(others, effects.applied);
  return found;
}

/// Accelerations and multipliers, shape (nv + nc,), with the friction at rest that was found last,
/// `others` are the torques without; false where nothing is found.
bool accelerate_with_friction(
  const System & system, Values q, Values qd, Factors factors, Values others, Values frictionless,
  Values out)
{
  const EffectTable & effects = system.effects;
  const StaticFriction & static_friction = effects.static_friction;
  const auto friction = [&](Index a) {
      return static_friction.share[a] * effects.output(static_friction.rows[a + 1], 3);
    };
  bool found = true;
  if (factors == Factors::NONE) {
    const Index count = static_friction.rows[0];
    for (Index a = 0; a < count; ++a) {
      static_friction.hold[static_friction.rows[a + 1]] = friction(a);
    }
    evaluate_in_parts(system, q, qd);
    for (Index a = 0; a < count; ++a) {
      static_friction.hold[static_friction.rows[a + 1]] = 0.0;
    }
    copy(system.qdd, out);
    copy(system.lam, out.from(system.nv()));
  } else {
    effects.applied.fill(0.0);
    for (Index a = 0; a < static_friction.rows[0]; ++a) {
      exert_along(effects, static_friction.rows[a + 1], friction(a));
    }
    found = respond(system, q, qd, factors, others, frictionless, out);
    for (Index i = 0; i < out.size; ++i) {
      out[i] += frictionless[i];
    }
  }
  copy(others, effects.applied);
  return found;
}

/// Balance friction at rest by the responses that an earlier evaluation has kept. They change little
/// from state to state: the accelerations with the friction that they give correct those without,
/// and each round leaves a small share of what the one before missed. False where that is not so.
bool balance_by_kept(const System & system, Values q, Values qd, Factors factors)
{
  const EffectTable & effects = system.effects;
  const StaticFriction & static_friction = effects.static_friction;
  const Index nv = system.nv(), width = nv + system.lam.size;
  Scratch<double, ROOM> scratch(effects.applied.size + 2 * width);
  const Values others = scratch.copy_of(effects.applied), found = scratch.take(width);
  const Values base = free_response(static_friction).part(0, width);
  const Values frictionless = scratch.copy_of(base);
  double size = 0.0, before = 0.0;
  for (Index i = 0; i < nv; ++i) {
    size = before = std::max(size, std::abs(base[i]));
  }
  for (int round = 0; round <= MOST_ROUNDS; ++round) {
    balance_friction(effects, system.qdd, system.lam);
    if (round > 0) {
      double change = 0.0;
      for (Index i = 0; i < nv; ++i) {
        change = std::max(change, std::abs(system.qdd[i] - found[i]));
      }
      if (change * change <= BALANCED * size * before) {
        return true;
      }
      if (!(change <= LEFT * before)) {
        break;
      }
      before = change;
    }
    if (!accelerate_with_friction(system, q, qd, factors, others, frictionless, found)) {
      break;
    }
    for (Index i = 0; i < width; ++i) {
      base[i] = found[i];
      for (Index a = 0; a < static_friction.rows[0]; ++a) {
        base[i] -= static_friction.share[a] * static_friction.response(a, i);
      }
    }
  }
  copy(others, effects.applied);
  copy(frictionless, base);
  return false;
}

/// Solve the complementarity problem of static friction by the response to that of each joint at
/// rest; `factors` are those in the workspace.
void hold_joints_at_rest(const System & system, Values q, Values qd, Factors factors)
{
  const EffectTable & effects = system.effects;
  const bool with_cuts = system.has_cut_coordinates();
  const Values qdd = with_cuts ? effects.cuts.qdd : system.qdd;
  const Indices & stuck = effects.static_friction.rows;
  const Values & hold = effects.static_friction.hold;
  const Index count = stuck[0];
  if (with_cuts) {
    accelerations_with_cuts(system, q, qd);
  }
  keep_frictionless(effects, qdd, system.lam);
  const bool alone = !with_cuts && effects.loaded[0] == 0;
  if (alone && are_responses_kept(effects) && balance_by_kept(system, q, qd, factors))
  {
    return;
  }
  for (Index place = 0; place < count; ++place) {
    const Index row = stuck[place + 1];
    // Where it acts on joints alone the factors serve: a fraction of an evaluation.
    if (alone && factors != Factors::NONE &&
      respond_to_hold(system, q, qd, factors, row, response_to_hold(effects, place)))
    {
      continue;
    }
    hold[row] = effects.output(row, 3);
    evaluate_in_parts(system, q, qd);
    if (with_cuts) {
      accelerations_with_cuts(system, q, qd);
    }
    keep_response(effects, place, qdd, system.lam);
  }
  balance_friction(effects, qdd, system.lam);
  if (alone) {
    keep_responses(effects);
  }
  if (with_cuts) {
    copy(qdd, system.qdd);
    if (effects.loaded[0] > 0) {
      // Friction at a cut joint acts on bodies: reactions balance it, too.
      for (Index place = 0; place < count; ++place) {
        hold[stuck[place + 1]] = effects.output(stuck[place + 1], 1);
      }
      move_bodies(system, q, qd);
      for (Index place = 0; place < count; ++place) {
        hold[stuck[place + 1]] = 0.0;
      }
    }
  }
}

/// Evaluate the reactions in joints that loaded effects read.
void evaluate_joint_loads(const System & system, Values q, Values qd)
{
  const EffectTable & effects = system.effects;
  const AllEquations & all = system.whole;
  if (!all.empty()) {
    if (system.is_unrolled()) {
      bias_forces(system.work, effects.reaction);
    }
    outward(all.model, q, qd, all.own);
    spread_multipliers(system, all.lam);
    load_joints(system, all.model, all.own, qd, system.qdd, all.lam);
  } else if (system.is_unrolled()) {
    call(system.table, routine::REACTIONS, q, qd);
    update_joint_loads(system.model, system.work, effects, qd, system.lam);
  } else {
    if (!system.work.planar()) {
      // The elimination does not write all quantities that are read here.
      outward(system.model, q, qd, system.work);
    }
    load_joints(system, system.model, system.work, qd, system.qdd, system.lam);
  }
}

/// Evaluate acceleration-dependent forces: static friction, driving forces, joint loads.
void complete(const System & system, Values q, Values qd, Factors factors)
{
  if (!system.has_effects()) {
    return;
  }
  if (system.effects.static_friction.rows[0] > 0) {
    hold_joints_at_rest(system, q, qd, factors);
    store_load(system.effects);
  }
  if (system.effects.motions.rows > 0) {
    output_driving_forces(system.effects, system.lam);
  }
  if (system.effects.loaded[0] > 0) {
    evaluate_joint_loads(system, q, qd);
  }
}
}  // namespace

void load_effect_states(const System & system, Values state)
{
  if (system.has_effects()) {
    copy(state.from(system.own()), system.effects.states);
  }
}

void place_bodies(const System & system, Values q, Values qd)
{
  const Workspace & work = system.work;
  if (!(system.is_unrolled() && work.planar())) {
    outward(system.model, q, qd, work);
    return;
  }
  // The routine stores all that the loop does, but for what couplings read.
  call(system.table, routine::OUTWARD, q, qd);
  for (Index i = 1; work.body.columns > plane::RATE && i < work.body.rows; ++i) {
    work.body(i, plane::POSITION) = q[system.model.tree(i, tree::COORDINATE)];
    work.body(i, plane::RATE) = qd[system.model.tree(i, tree::DOF)];
  }
}

void apply_listed_to(const System & system, Table body, Values q, Values qd)
{
  if (!system.has_effects()) {
    return;
  }
  Values positions = q;
  if (!system.manifold.empty()) {
    fill_numbers(system.manifold, q);
    positions = system.manifold.number;
  }
  apply_effects(system.effects, body, positions, qd, system.tau);
}

void apply_listed(const System & system, Values q, Values qd)
{
  apply_listed_to(system, system.work.body, q, qd);
}

Factors evaluate_in_parts(const System & system, Values q, Values qd, Outputs outputs)
{
  double & written = system.work.health[health::WRITTEN];
  written = 0.0;
  if (!system.is_unrolled()) {
    return accelerate_by_loops(system, q, qd);
  }
  call(system.table, routine::OUTWARD, q, qd);
  apply_listed(system, q, qd);
  if (call(system.table, routine::ACCELERATION, q, qd)) {
    written = system.has_cut_coordinates() ? 0.0 : 1.0;
    return Factors::CODE;
  }
  accelerate_beyond_elimination(
    system, q, qd, system.has_effects() ? Outputs::POSES : outputs);
  return Factors::NONE;
}

void evaluate(const System & system, Values q, Values qd)
{
  complete(system, q, qd, evaluate_in_parts(system, q, qd));
}

void evaluate_with_poses(const System & system, Values state)
{
  load_effect_states(system, state);
  evaluate(system, system.q(state), system.qd(state));
}

void measure(const System & system, Values state)
{
  const Values q = system.q(state), qd = system.qd(state);
  load_effect_states(system, state);
  if (system.is_unrolled()) {
    call(system.table, routine::OUTWARD, q, qd);
  } else {
    outward(system.model, q, qd, system.work);
  }
  apply_listed(system, q, qd);
}

bool is_regular(const System & system, Values q, Values qd)
{
  if (!system.is_unrolled()) {
    move_bodies(system, q, qd);
    return prepare(system.model, system.applied, system.work);
  }
  call(system.table, routine::OUTWARD, q, qd);
  apply_listed(system, q, qd);
  return call(system.table, routine::ACCELERATION, q, qd);
}

/// The routine that evaluates a state at once for some outputs; negative where there is none.
static Index routine_at_once(const System & system, Outputs outputs)
{
  if (!system.is_unrolled()) {
    return -1;
  }
  const bool decays = system.settings->baumgarte_gain != 0.0;
  const bool alone = outputs == Outputs::MOTION && !decays && system.table[routine::MOTION] != 0;
  Index which = alone ? routine::MOTION : routine::EVALUATION;
  if (system.has_effects()) {
    const Index present = decays ? -1 : prepare_code(system.effects);
    if (present != routine::MOTION) {
      which = which == routine::MOTION ? present : -1;
    }
  }
  return which >= 0 && system.table[which] != 0 ? which : -1;
}

void evaluate_for(const System & system, Values state, Outputs outputs)
{
  const Values q = system.q(state), qd = system.qd(state);
  system.work.health[health::WRITTEN] = 0.0;
  load_effect_states(system, state);
  const Index which = routine_at_once(system, outputs);
  if (which >= 0 && call(system.table, which, q, qd)) {
    if (which == routine::RESPONSES) {
      hold_by_responses(system.effects, system.qdd, system.lam);
    }
  } else if (which < 0 || system.has_effects()) {
    complete(system, q, qd, evaluate_in_parts(system, q, qd, outputs));
  } else {
    if (system.table[routine::REFINED_ACCELERATION] != 0) {
      call(system.table, routine::OUTWARD, q, qd);
    }
    accelerate_beyond_elimination(system, q, qd, outputs);
  }
}

void evaluate_state(const System & system, Values state)
{
  evaluate_for(system, state, Outputs::FORCES);
}

void evaluate_again(const System & system, Values state, Index count)
{
  Interrupt interrupt(system.interrupted, system.nv());
  for (Index n = 0; n < count && !interrupt.after(1); ++n) {
    evaluate_for(system, state, Outputs::MOTION);
    for (Index i = 0; i < system.nv(); ++i) {
      state[i] += 0.0 * system.qdd[i];
    }
  }
}

/// As `derivative`, for the outputs asked for.
static void derivative_for(const System & system, Values state, Values out, Outputs outputs)
{
  if (system.is_independent()) {
    close_by_dependent(system, state);
  }
  evaluate_for(system, state, outputs);
  rates_of_coordinates(system.manifold, state, system.nv(), out);
  copy(system.qdd, out.part(system.nq(), system.nv()));
  if (system.has_effects()) {
    copy(system.effects.rates, out.part(system.own(), system.effects.rates.size));
  }
  power_of_turns(system.manifold, system.tau, state, system.nv(), out);
}

void derivative(const System & system, Values state, Values out)
{
  derivative_for(system, state, out, Outputs::MOTION);
}

void derivative_with_multipliers(const System & system, Values state, Values out)
{
  derivative_for(system, state, out, Outputs::FORCES);
}

void rates_with_cuts(const System & system, Values state, Values out)
{
  const CutCoordinates & cuts = system.effects.cuts;
  outward(system.model, system.q(state), system.qd(state), system.work);
  copy(system.qd(state), out.part(0, system.nv()));
  measure_cut_coordinates(system.effects, system.work.body, cuts.q, out);
}

void update_motions(const System & system, Values state)
{
  if (system.has_effects() && system.effects.motions.rows > 0) {
    load_effect_states(system, state);
    update_driven_motions(system.effects);
  }
}

}  // namespace closedloop
