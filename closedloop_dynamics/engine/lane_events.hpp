// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__LANE_EVENTS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__LANE_EVENTS_HPP_

#include <memory>
#include <vector>

#include "batch.hpp"

// Steps with an event of an effect in one lane. The lanes of a vector make whole steps alike, with
// one joint under dry friction at rest in each lane, or with several in each; a lane where it is
// otherwise than in most, a joint comes to rest or creeps, or a contact may be missed, makes that
// step alone, as a single run does, and then continues with the others.

namespace closedloop
{

class LaneEvents
{
public:
  LaneEvents(const Batch & batch, const std::vector<Lane> & lanes);

  /// Begin a step from a state: find the lanes that cannot make it with the others. Returns the
  /// start of the vector's step, where those lanes are copies of another one; empty if no lane can.
  Values begin(Values state);

  /// The routine that evaluates the states of the present step.
  Index routine() const {return routine_;}

  /// After an evaluation: hold the joints at rest in each lane where its routine has not done so.
  void hold_joints();

  /// Store the gaps at the start of a step, after the evaluation there.
  void store_start();

  /// Find the lanes with an event within a step to `out`, and whether joints at rest in the others
  /// have broken away.
  void find(Values state, Values out, double size);

  /// Make steps of one size [s] of single lanes, into `out`.
  Status make(Values state, Values out, double size);

private:
  /// How many joints are at rest.
  Index resting(Values state, std::size_t lane) const;
  /// Whether a joint at rest moves slowly at the end of a step.
  bool creeps(Index row, Values out, std::size_t lane) const;
  double along(Index row, Values out, std::size_t lane) const;

  const Batch & batch_;
  const std::vector<Lane> & lanes_;
  const EffectTable & effects_;
  bool alone_[LANES] = {};
  Index routine_;
  /// Rows of effects that are dry friction.
  std::vector<Index> frictions_;
  std::vector<double> parked_;
  std::vector<double> start_;
  std::vector<double> own_;
  std::vector<std::unique_ptr<Stepper>> steppers_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__LANE_EVENTS_HPP_
