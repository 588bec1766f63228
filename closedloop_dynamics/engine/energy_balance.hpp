// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ENERGY_BALANCE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ENERGY_BALANCE_HPP_

#include <cmath>
#include <limits>
#include <vector>

#include "data.hpp"

// Where the energy of a run is, where it went, and where it came from.

namespace closedloop
{

/// Data of a run for its energy balance.
struct EnergyAccount
{
  /// Shape (nz,): roles of the effects' states (effects/element.py).
  std::vector<Index> roles;
  /// Shape (nv + nk,): coordinate of each freedom when work was added last.
  std::vector<double> since;
  double held_work = 0.0;  ///< Of torques that were held, up to there [J]
  /// Energy at the start, NaN if unknown [J].
  double reference = std::numeric_limits<double>::quiet_NaN();

  bool knows_start() const {return !std::isnan(reference);}
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

  template<class Visitor>
  void names(Visitor && visit) const
  {
    visit(
      "kinetic", kinetic, "stored", stored, "dissipated", dissipated, "work", work, "residual",
      residual);
  }
};

/// Forget the coordinates before a state, shape (ns,).
void mark_coordinates(const System &, EnergyAccount &, Values state);

/// Add the work of the torques held up to a state, shape (ns,). Of a torque that passes unchanged
/// it is tau . (q - q at the hold's start), exactly; drives integrate theirs, and so do torques on
/// spherical joints, whose work is not a function of coordinates.
void add_held_work(const System &, EnergyAccount &, Values state);

/// The balance of a state whose energies are known [J], with the work that was added last.
Energies balance_of(
  const System &, const EnergyAccount &, Values state, double kinetic, double stored);

/// Measure a state, add the work up to it, and draw the balance.
Energies draw_balance(const System &, EnergyAccount &, Values state);

/// The same of a state that is evaluated.
Energies draw_evaluated_balance(const System &, EnergyAccount &, Values state);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ENERGY_BALANCE_HPP_
