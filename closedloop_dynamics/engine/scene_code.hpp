// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SCENE_CODE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SCENE_CODE_HPP_

#include "effect_table.hpp"

// What the code that was generated for a scene with its effects does not find out itself.

namespace closedloop
{

/// Whether that code evaluates the states of the effects that the table has now: it has the laws of
/// these, all of them are switched on, and no joint under dry friction is at rest. What the laws
/// would search for is found: pieces of courses, modes of contacts.
bool prepare_code(const EffectTable &);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SCENE_CODE_HPP_
