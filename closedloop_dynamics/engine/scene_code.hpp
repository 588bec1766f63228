// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SCENE_CODE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SCENE_CODE_HPP_

#include "effect_table.hpp"

// What the code that was generated for a scene with its effects does not find out itself.

namespace closedloop
{

/// The routine of that code that evaluates the states of the effects that the table has now; less
/// than zero where there is none: effects have other laws, one of them is switched off, friction
/// feels reactions, or several joints under dry friction are at rest. What the laws would search for
/// is found: pieces of courses, modes of contacts.
Index prepare_code(const EffectTable &);

/// Hand the modes of contacts over to generated code.
void store_sides(const EffectTable &);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SCENE_CODE_HPP_
