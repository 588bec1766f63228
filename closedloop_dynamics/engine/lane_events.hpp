// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LANE_EVENTS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LANE_EVENTS_HPP_

#include <vector>

#include "batch.hpp"

// Steps in which something happens to the effects of one lane. The lanes of a vector make whole
// steps alike; a lane in which a joint under dry friction is at rest or comes to rest, or a contact
// may be passed unfelt, makes that step alone, as a single run does, and goes on with the others.

namespace closedloop
{

class LaneEvents
{
public:
  LaneEvents(const Batch & batch, const std::vector<Lane> & lanes);

  /// Begin a step from a state: find the lanes that cannot make it with the others. Returns the
  /// state that the vector is to begin with, in which these repeat another one; of no length where
  /// there is no lane that can.
  Values begin(Values state);

  /// Take note of the gaps at the start of a step, after the evaluation there.
  void store_start();

  /// Find the lanes to whose effects something has happened within a step to `out`.
  void find(Values state, Values out, double size);

  /// Make the steps of lanes that are alone, of one size [s], into `out`.
  Status make(Values state, Values out, double size);

private:
  bool rests(Values state, std::size_t lane) const;
  double along(Index row, Values out, std::size_t lane) const;

  const Batch & batch_;
  const std::vector<Lane> & lanes_;
  const EffectTable & effects_;
  bool alone_[LANES] = {};
  /// Rows of effects that are dry friction.
  std::vector<Index> frictions_;
  std::vector<double> parked_;
  std::vector<double> start_;
  std::vector<double> own_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LANE_EVENTS_HPP_
