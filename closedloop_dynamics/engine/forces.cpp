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

}  // namespace closedloop
