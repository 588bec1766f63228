// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "energy_balance.hpp"

#include "arms.hpp"
#include "evaluation.hpp"
#include "manifold.hpp"
#include "recursion.hpp"
#include "scratch.hpp"

namespace closedloop
{

namespace
{
// Roles of the effects' states (effects/element.py).
enum : Index {OWN, DISSIPATED, WORK};

bool is_driven(const EffectTable & effects, Index freedom)
{
  for (Index row = 0; row < effects.count(); ++row) {
    if (effects.role[row] == effect::DRIVE && effects.enabled[row] != 0 &&
      joint_of(effects, row) == freedom)
    {
      return true;
    }
  }
  return false;
}

/// Call with each freedom and its coordinate in a state; that of a cut joint as it was measured.
template<class Visit>
void visit_coordinates(const System & system, Values state, Visit && visit)
{
  Values tree = system.q(state);
  if (!system.manifold.empty()) {
    fill_numbers(system.manifold, tree);
    tree = system.manifold.number;
  }
  for (Index i = 0; i < system.tau.size; ++i) {
    visit(i, i < tree.size ? tree[i] : system.effects.cuts.q[i]);
  }
}

/// Add the work up to a state; with cut joints that anything acts in, an evaluated one.
void add_work_up_to(const System & system, EnergyAccount & account, Values state)
{
  double work = 0.0;
  const Values since = view(account.since);
  visit_coordinates(
    system, state, [&](Index i, double now) {
      if (!is_driven(system.effects, i)) {
        work += system.tau[i] * (now - since[i]);
      }
      since[i] = now;
    });
  account.held_work += work;
}
}  // namespace

void mark_coordinates(const System & system, EnergyAccount & account, Values state)
{
  if (system.has_cut_coordinates()) {
    measure(system, state);
  }
  const Values since = view(account.since);
  visit_coordinates(system, state, [&](Index i, double now) {since[i] = now;});
}

void add_held_work(const System & system, EnergyAccount & account, Values state)
{
  if (system.has_cut_coordinates()) {
    measure(system, state);
  }
  add_work_up_to(system, account, state);
}

Energies balance_of(
  const System & system, const EnergyAccount & account, Values state, double kinetic,
  double stored)
{
  Energies present;
  present.kinetic = kinetic;
  present.stored = stored;
  double done = 0.0;
  Index place = system.own();
  for (Index role : account.roles) {
    const double value = state[place++];
    present.dissipated += role == DISSIPATED ? value : 0.0;
    done += role == WORK ? value : 0.0;
  }
  // Work of torques on rotations, which is the last number of the state.
  const double turned = system.manifold.empty() ? 0.0 : state[state.size - 1];
  present.work = account.held_work + done + turned;
  present.residual = present.kinetic + present.stored + present.dissipated - present.work -
    account.reference;
  return present;
}

namespace
{
/// Draw the balance of a state that was measured.
Energies draw(const System & system, EnergyAccount & account, Values state)
{
  add_work_up_to(system, account, state);
  double found[2];
  energies(system.model, system.work, system.qd(state), {found, 2});
  const EffectTable & effects = system.effects;
  double stored = 0.0, rotors = 0.0;
  for (Index row = 0; row < effects.count(); ++row) {
    stored += effects.output(row, effect::STORED);
    if (effects.role[row] == effect::INERTIA) {
      rotors += effects.output(row, effect::STORED);
    }
  }
  return balance_of(
    system, account, state, found[0] + rotors, found[1] + (stored - rotors));
}
}  // namespace

Energies draw_balance(const System & system, EnergyAccount & account, Values state)
{
  measure(system, state);
  return draw(system, account, state);
}

Energies draw_evaluated_balance(const System & system, EnergyAccount & account, Values state)
{
  evaluate_with_poses(system, state);
  return draw(system, account, state);
}

}  // namespace closedloop
