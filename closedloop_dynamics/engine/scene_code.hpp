// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__SCENE_CODE_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__SCENE_CODE_HPP_

#include "effect_table.hpp"

// Preparation of the code generated for a scene with its effects.

namespace closedloop
{

/// How many joints at rest routine::AT_REST holds, of so many under dry friction: both where these
/// are two (codegen/live_scene.py), else one.
constexpr Index held_at_once(Index frictions) {return frictions == 2 ? 2 : 1;}

/// Index of the routine of that code for the present states of the effects; negative where there is
/// none: effects have other laws, one is disabled, or friction depends on reactions. Finds the
/// segments of profiles and modes of contacts for that code.
Index prepare_code(const EffectTable &);

/// Hand the modes of contacts over to generated code.
void store_sides(const EffectTable &);

/// Bring the present segments of all profiles up to the time.
void take_pieces(const EffectTable &);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__SCENE_CODE_HPP_
