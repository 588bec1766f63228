// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "forces.hpp"

#include <algorithm>
#include <cmath>

namespace closedloop
{

bool update_contact(const Contacts & contacts, Index row, double gap, double rate)
{
  double * now = contacts.now.row(row), * trial = contacts.trial.row(row);
  const Index mode = contacts.mode[row];
  now[contact::GAP] = gap;
  now[contact::RATE] = rate;
  trial[contact::FASTEST] = std::max(trial[contact::FASTEST], std::abs(rate));
  trial[contact::WRONG] =
    std::max(trial[contact::WRONG], mode == contact::TOUCHING ? gap : -gap);
  return mode == contact::TOUCHING || (mode == contact::UNDECIDED && gap < 0.0);
}

void store_path(const Contacts & contacts, Index row, Vector3 place, double speed)
{
  double * now = contacts.now.row(row), * trial = contacts.trial.row(row);
  now[contact::PLACE] = place.x;
  now[contact::PLACE + 1] = place.y;
  now[contact::PLACE + 2] = place.z;
  trial[contact::SPEED] = std::max(trial[contact::SPEED], speed);
}

double elastic_force(double stiffness, double exponent, double gap)
{
  const double depth = std::fabs(gap);
  double force;
  // `pow` costs more than all the rest of a contact.
  if (exponent == 1.0) {
    force = stiffness * depth;
  } else if (exponent == 1.5) {
    force = stiffness * (depth * std::sqrt(depth));
  } else {
    force = stiffness * std::pow(depth, exponent);
  }
  return gap > 0.0 ? -force : force;
}

}  // namespace closedloop
