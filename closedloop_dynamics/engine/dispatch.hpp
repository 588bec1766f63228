// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__DISPATCH_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__DISPATCH_HPP_

#include "laws.hpp"

// From a row of the table to its law.

namespace closedloop
{

/// Apply all effects that are switched on to bodies after `outward`: forces at points reduce their
/// bias forces. EffectTable.states is read; `applied` (commands and joint torques), `rates`,
/// `output` and which joints stick are written. `q`, `qd`, shape (nv,); `tau`, shape (nv + nk,):
/// commanded joint torques, those of cut joints behind [N m, N].
void apply_effects(const EffectTable &, Table body, Values q, Values qd, Values tau);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__DISPATCH_HPP_
