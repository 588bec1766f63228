// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "lane_events.hpp"

#include <algorithm>
#include <cmath>

#include "arms.hpp"
#include "contact_events.hpp"
#include "scene_code.hpp"
#include "static_friction.hpp"

namespace closedloop
{

LaneEvents::LaneEvents(const Batch & batch, const std::vector<Lane> & lanes)
: batch_(batch), lanes_(lanes), effects_(lanes[0].system->effects), routine_(batch.evaluation())
{
  for (Index row = 0; row < effects_.count(); ++row) {
    if (effects_.role[row] == effect::FRICTION) {
      frictions_.push_back(row);
    }
  }
  parked_.resize(static_cast<std::size_t>(LANES * lanes[0].system->ns()));
  start_.resize(static_cast<std::size_t>(batch.gaps.size));
  own_.resize(static_cast<std::size_t>(lanes[0].system->ns()));
  for (const Lane & lane : lanes) {
    steppers_.push_back(lane.run->stepper().clone());
  }
}

Index LaneEvents::resting(Values state, std::size_t lane) const
{
  const Index own = batch_.nq() + batch_.nv();
  return std::count_if(
    frictions_.begin(), frictions_.end(), [&](Index row) {
      return std::abs(state[LANES * (own + effects_.first_state[row]) + lane]) < 0.5;
    });
}

Values LaneEvents::begin(Values state)
{
  for (Index row : effects_.contacts.rows) {
    const Index first = LANES * contact::TRIAL_COLUMNS * row;
    batch_.trials.part(first, LANES * (contact::WRONG + 1)).fill(0.0);
  }
  const Index at_once = held_at_once(static_cast<Index>(frictions_.size()));
  Index count[LANES], few = 0, several = 0;
  for (Index lane = 0; lane < LANES; ++lane) {
    count[lane] = resting(state, static_cast<std::size_t>(lane));
    few += count[lane] > 0 && count[lane] <= at_once ? 1 : 0;
    several += count[lane] > at_once ? 1 : 0;
  }
  // Joints are held by the same arithmetic as in a run alone.
  const bool responds = several > 0 && several >= few && batch_.table[routine::RESPONSES] != 0;
  routine_ = responds ? routine::RESPONSES : few > 0 ? routine::AT_REST : batch_.evaluation();
  bool any = false;
  Index ready = LANES;
  for (Index lane = LANES - 1; lane >= 0; --lane) {
    alone_[lane] = responds ? count[lane] == 1 : count[lane] > at_once;
    any = any || alone_[lane];
    ready = alone_[lane] ? ready : lane;
  }
  if (!any) {
    return state;
  }
  if (ready == LANES) {
    return state.part(0, 0);
  }
  const Values parked{parked_.data(), state.size};
  for (Index k = 0; k < state.size; k += LANES) {
    for (Index lane = 0; lane < LANES; ++lane) {
      parked[k + lane] = state[k + (alone_[lane] ? ready : lane)];
    }
  }
  return parked;
}

void LaneEvents::hold_joints()
{
  if (routine_ != routine::RESPONSES) {
    return;
  }
  const Index nv = batch_.nv(), count = batch_.friction.size / LANES;
  const Index width = batch_.response.size / batch_.friction.size;
  const Values qdd{own_.data(), nv};
  for (Index lane = 0; lane < LANES; ++lane) {
    const std::size_t last = lanes_.size() - 1;
    const EffectTable & effects =
      lanes_[std::min(static_cast<std::size_t>(lane), last)].system->effects;
    for (Index k = 0; k < count; ++k) {
      effects.static_friction.right[k] = batch_.friction[LANES * k + lane];
      for (Index i = 0; i < nv; ++i) {
        effects.static_friction.response(k, i) = batch_.response[LANES * (k * width + i) + lane];
      }
    }
    for (Index i = 0; i < nv; ++i) {
      qdd[i] = batch_.qdd[LANES * i + lane];
    }
    // No step asks for the multipliers.
    hold_by_responses(effects, qdd, Values{});
    for (Index i = 0; i < nv; ++i) {
      batch_.qdd[LANES * i + lane] = qdd[i];
    }
  }
}

void LaneEvents::store_start()
{
  std::copy(batch_.gaps.begin(), batch_.gaps.end(), start_.begin());
}

double LaneEvents::along(Index row, Values out, std::size_t lane) const
{
  const Values rates = out.from(LANES * batch_.nq());
  const Index * places = effects_.places_of(row);
  if (!has_arms(effects_, row)) {
    return rates[LANES * places[0] + lane];
  }
  const double * arms = lanes_[std::min(lane, lanes_.size() - 1)].system->effects.data.data +
    effects_.first_number[row];
  double sum = 0.0;
  for (Index k = 0; k < effects_.joints[row]; ++k) {
    sum += arms[k] * rates[LANES * places[k] + lane];
  }
  return sum;
}

bool LaneEvents::creeps(Index row, Values out, std::size_t lane) const
{
  const double rate = along(row, out, lane);
  if (std::abs(rate) > REST) {
    const Index own = batch_.nq() + batch_.nv();
    out[LANES * (own + effects_.first_state[row]) + lane] = std::copysign(1.0, rate);
    return false;
  }
  if (!(std::abs(rate) <= RATE_ROUNDING)) {
    return true;
  }
  if (!has_arms(effects_, row)) {
    out[LANES * (batch_.nq() + joint_of(effects_, row)) + lane] = 0.0;
  }
  return false;
}

void LaneEvents::find(Values state, Values out, double size)
{
  const Index own = batch_.nq() + batch_.nv();
  for (Index row : frictions_) {
    const Index mode = LANES * (own + effects_.first_state[row]);
    for (Index lane = 0; lane < LANES; ++lane) {
      const std::size_t place = static_cast<std::size_t>(lane);
      const double direction = state[mode + lane];
      // Written so that a NaN is one, too.
      alone_[lane] = alone_[lane] || (
        std::abs(direction) < 0.5 ? creeps(row, out, place) :
        !(direction * along(row, out, place) > REST));
    }
  }
  for (Index row : effects_.contacts.rows) {
    const double * gap = start_.data() + LANES * contact::NODE_COLUMNS * row;
    const double * trial = batch_.trials.data + LANES * contact::TRIAL_COLUMNS * row;
    const double * fastest = trial + LANES * (
      is_finite(effects_, row) ? contact::SPEED : contact::FASTEST);
    const double * wrong = trial + LANES * contact::WRONG;
    for (Index lane = 0; lane < LANES; ++lane) {
      alone_[lane] = alone_[lane] ||
        may_miss_contact(gap[lane], 0.0, wrong[lane], fastest[lane], size);
    }
  }
}

Status LaneEvents::make(Values state, Values out, double size)
{
  const std::size_t last = lanes_.size() - 1;
  for (std::size_t lane = 0; lane <= last; ++lane) {
    if (!alone_[lane]) {
      continue;
    }
    const System & system = *lanes_[lane].system;
    const Values own{own_.data(), system.ns()};
    for (Index k = 0; k < own.size; ++k) {
      own[k] = state[LANES * k + static_cast<Index>(lane)];
    }
    for (Index i = 0; i < batch_.nv(); ++i) {
      system.tau[i] = batch_.tau[LANES * i + static_cast<Index>(lane)];
    }
    const Status status =
      steppers_[lane]->advance(system, own, {0.0, 0, size, 1}).status;
    // Guards compute the work of torques themselves.
    system.tau.fill(0.0);
    if (status != Status::DONE) {
      return status;
    }
    // Behind the last one are copies of it.
    const Index begin = static_cast<Index>(lane), end = lane == last ? LANES : begin + 1;
    for (Index k = 0; k < own.size; ++k) {
      std::fill(&out[LANES * k + begin], &out[LANES * k] + end, own[k]);
    }
  }
  return Status::DONE;
}

}  // namespace closedloop
