// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ENERGY_BALANCE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ENERGY_BALANCE_HPP_

#include <cmath>

#include "data.hpp"

// Where the energy of a run is, where it went, and where it came from.

namespace closedloop
{

/// EnergyAccount.numbers: work of torques that were held, up to EnergyAccount.since, energy at the
/// start, NaN if unknown, and its two parts [J].
namespace account
{
enum : Index {HELD_WORK, REFERENCE, START_KINETIC, START_STORED, COLUMNS};
}

/// Data of a run for its energy balance (effects/energy_balance.py).
struct EnergyAccount
{
  /// Shape (nz,): roles of the effects' states (effects/table.py).
  Indices roles;
  /// Shape (nv + nk,): coordinate of each freedom when work was added last.
  Values since;
  Values numbers;

  template<class Visitor>
  void fields(Visitor && visit) {visit(roles, since, numbers);}
};

/// An energy balance [J].
struct Energies
{
  double kinetic = 0.0;
  double stored = 0.0;
  double dissipated = 0.0;
  double work = 0.0;
  /// Its error.
  double residual = 0.0;

  /// Energy exchanged since another balance, beside the kinetic energy.
  double apart(const Energies & other) const
  {
    return std::abs(stored - other.stored) + std::abs(dissipated - other.dissipated) +
           std::abs(work - other.work);
  }
};

/// Add the work of the torques held up to a state, shape (ns,). Of a torque that passes unchanged
/// it is tau . (q - q at the hold's start), exactly; drives integrate theirs, and so do torques on
/// spherical joints, whose work is no function of coordinates.
void add_held_work(const System &, const EnergyAccount &, Values state);

/// The balance of a state whose energies are known [J], with the work that was added last.
Energies balance_of(
  const System &, const EnergyAccount &, Values state, double kinetic, double stored);

/// Measure a state, add the work up to it, and draw the balance.
Energies draw_balance(const System &, const EnergyAccount &, Values state);

/// The same as numbers, shape (5,), in the order of Energies, of a state that is evaluated.
void fill_balance(const System &, const EnergyAccount &, Values state, Values out);

void write(const Energies &, Values out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ENERGY_BALANCE_HPP_
