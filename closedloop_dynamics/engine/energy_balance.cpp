// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "energy_balance.hpp"

#include <stdexcept>

#include "arms.hpp"
#include "evaluation.hpp"
#include "manifold.hpp"
#include "recursion.hpp"

namespace closedloop
{

namespace
{
// Roles of the effects' states (effects/table.py).
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

/// Add the work up to a state; with cut joints that anything acts in, an evaluated one.
void add_work_up_to(const System & system, const EnergyAccount & account, Values state)
{
  Values tree = system.q(state);
  if (!system.manifold.empty()) {
    fill_numbers(system.manifold, tree);
    tree = system.manifold.number;
  }
  double work = 0.0;
  for (Index i = 0; i < account.since.size; ++i) {
    const double now = i < tree.size ? tree[i] : system.effects.cuts.q[i];
    if (!is_driven(system.effects, i)) {
      work += system.tau[i] * (now - account.since[i]);
    }
    account.since[i] = now;
  }
  account.numbers[account::HELD_WORK] += work;
}

void require_fitting(const System & system, const EnergyAccount & account, Values state)
{
  if (state.size != system.ns() || account.roles.size != system.effects.states.size ||
    account.since.size != system.tau.size || account.numbers.size != account::COLUMNS)
  {
    throw std::invalid_argument("an energy account: arrays that do not fit the system");
  }
}
}  // namespace

void add_held_work(const System & system, const EnergyAccount & account, Values state)
{
  require_fitting(system, account, state);
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
  for (Index place = 0; place < account.roles.size; ++place) {
    const double value = state[system.own() + place];
    present.dissipated += account.roles[place] == DISSIPATED ? value : 0.0;
    done += account.roles[place] == WORK ? value : 0.0;
  }
  // Of torques on rotations, which the state has behind all others.
  const double turned = system.manifold.empty() ? 0.0 : state[state.size - 1];
  present.work = account.numbers[account::HELD_WORK] + done + turned;
  present.residual = present.kinetic + present.stored + present.dissipated - present.work -
    account.numbers[account::REFERENCE];
  return present;
}

namespace
{
/// Draw the balance of a state that was measured.
Energies draw(const System & system, const EnergyAccount & account, Values state)
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

Energies draw_balance(const System & system, const EnergyAccount & account, Values state)
{
  measure(system, state);
  return draw(system, account, state);
}

void fill_balance(
  const System & system, const EnergyAccount & account, Values state, Values out)
{
  require_fitting(system, account, state);
  if (out.size != 5) {
    throw std::invalid_argument("fill_balance: expected room for 5 numbers");
  }
  evaluate_with_poses(system, state);
  write(draw(system, account, state), out);
}

void write(const Energies & from, Values out)
{
  out[0] = from.kinetic;
  out[1] = from.stored;
  out[2] = from.dissipated;
  out[3] = from.work;
  out[4] = from.residual;
}

}  // namespace closedloop
