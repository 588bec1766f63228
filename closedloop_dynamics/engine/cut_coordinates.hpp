// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__CUT_COORDINATES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__CUT_COORDINATES_HPP_

#include "effect_table.hpp"
#include "forces.hpp"
#include "workspace.hpp"

// Coordinates of cut joints: the angle of body A in body B about an axis, or how far the point of
// A is from that of B along it. Laws see them behind those of the tree. `index` and `values` are
// those of CutCoordinates; bodies are rows of Workspace.body after `outward`.

namespace closedloop
{

/// A direction in row `k` of the values, from column `first` on, in world axes; `row`: of the body
/// that it is fixed in.
Vector3 cut_direction(
  Table body, Index row, bool planar, Table values, Index k, Index first);

/// Coordinates [rad, m] and their rates, written to the last nk places. Angles in space are within
/// half a turn of the integrated one among the states of the effects, or of zero; integrals of rates
/// without a state are zero.
void measure_cut_coordinates(const EffectTable &, Table body, Values position, Values velocity);

/// Apply efforts along the coordinates [N m; N], from place `first` on: bias forces are reduced.
void apply_cut_efforts(
  Indexes index, Table values, Table body, Values efforts, Index first);

/// Accelerations of the coordinates [rad/s^2, m/s^2] for those of the tree, `qdd`, shape (nv,),
/// written to the last nk of `out`. `whole`: with the velocity-product terms; without, this is J
/// qdd, J being the derivatives of the coordinates by those of the tree.
void accelerations(
  const EffectTable &, const Model &, const Workspace &, Values qdd, bool whole, Values out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__CUT_COORDINATES_HPP_
