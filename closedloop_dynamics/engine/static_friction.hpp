// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__STATIC_FRICTION_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__STATIC_FRICTION_HPP_

#include "effect_table.hpp"

// Static friction: joints and tendons at rest, and inertia reflected at cut joints and along
// tendons, whose forces follow from accelerations. Between rigid bodies, friction at rest keeps the
// joint at rest, up to its limit: the complementarity problem
//
//     a = a_0 + W tau,     a_i = 0 with |tau_i| <= F_i,  or  tau_i = -F_i sign(a_i)
//
// for the accelerations a of all joints at rest; a_0 are those without their friction, W is the
// response of the mechanism, its loops closed. These are the conditions of a convex problem, min
// tau W tau / 2 + a_0 tau in a box, so that a is unique, even where several joints share one
// freedom and tau is not. Reflected inertia I at a cut joint, or along a tendon, is one more
// unknown without bounds, tau = -I a: it adds tau^2 / (2 I) to the objective. Along a tendon
// (arms.hpp) the rate, acceleration and force are those of its length.
//
// a_0 and W come from one evaluation without that friction and one with the limit of each:
// `keep_frictionless`, `keep_response`, then `balance_friction`; or W from the factors of the first,
// to `response_to_hold`; or from one routine for all, before `hold_by_responses`. `qdd`, shape (nv,)
// or, where anything acts in cut joints, (nv + nk,); `lam`, shape (nc,).

namespace closedloop
{

/// Rates below this are rest while a step is made [rad/s; m/s]; wide enough for the finite
/// differences that stiff methods and rate estimates take.
constexpr double REST = 1e-6;
/// A cut joint or a tendon at rest, and any after a correction, has rates of rounding [rad/s; m/s].
constexpr double RATE_ROUNDING = 1e-12;

/// Store accelerations and multipliers without the friction of the joints at rest.
void keep_frictionless(const EffectTable &, Values qdd, Values lam);

/// Where they are stored; shape (nv + nc,), or more.
Values free_response(const StaticFriction &);

/// Store the response to the limit of one friction, number `index` of the joints at rest, after an
/// evaluation with that friction in StaticFriction.hold; take it back from there.
void keep_response(const EffectTable &, Index index, Values qdd, Values lam);

/// Where the response to it is stored; shape (nv + nc,).
Values response_to_hold(const EffectTable &, Index index);

/// Find the friction at rest; write the accelerations and multipliers with it, and complete
/// EffectTable.applied and the readings.
void balance_friction(const EffectTable &, Values qdd, Values lam);

/// Keep the responses of the joints at rest for later evaluations; whether those that are kept are of
/// the joints at rest now. See `ResponsesKept`.
void keep_responses(const EffectTable &);
bool are_responses_kept(const EffectTable &);

/// While it lives, the first evaluation keeps the responses to friction at rest, and later ones, of
/// states nearby, begin with them: the evaluations of one step. What follows from a state does not
/// depend on earlier steps then.
class ResponsesKept
{
public:
  explicit ResponsesKept(const EffectTable & effects)
  : effects_(effects) {keep(1);}
  ~ResponsesKept() {keep(0);}
  ResponsesKept(const ResponsesKept &) = delete;
  ResponsesKept & operator=(const ResponsesKept &) = delete;
  /// The next evaluation computes and keeps its own.
  void renew() {keep(1);}

private:
  void keep(Index whether)
  {
    if (effects_.static_friction.kept.size > 0) {
      effects_.static_friction.kept[0] = whether;
      effects_.static_friction.kept[1] = 0;
    }
  }

  const EffectTable & effects_;
};

/// A load that a friction no longer holds, relative to its limit, and by how much it may be missed:
/// a joint that bears it slides in the next evaluation.
constexpr double BREAKAWAY = 1.0 + 1e-6, NEAR_BREAKAWAY = 5e-7;

/// From here to the end of a step, joints that are held are held whatever the load, so that the
/// motion is smooth. The instant at which one of them breaks away is located, as those of contacts.
class HeldJoints
{
public:
  /// After the evaluation at the start.
  explicit HeldJoints(const EffectTable &);
  ~HeldJoints() {release();}
  HeldJoints(const HeldJoints &) = delete;
  HeldJoints & operator=(const HeldJoints &) = delete;
  /// Hold them up to their limits again; returns what is given.
  double release(double size = 0.0);
  /// Before the evaluations of a step.
  void begin_step() const;
  /// Whether any of these loaded one beyond its limit.
  bool is_overloaded() const;
  /// The largest load in the latest evaluation, relative to the limit, and that at the start.
  double load() const;
  double load_at_start() const {return start_;}

private:
  const EffectTable & effects_;
  bool any_ = false;
  double start_ = 0.0;
};

/// Store the largest load of the joints held whatever the load, after friction is balanced.
void store_load(const EffectTable &);

/// Do the same after the routine that writes the response to each friction and its limit, to
/// StaticFriction.response and, in place of the right-hand side, StaticFriction.right.
void hold_by_responses(const EffectTable &, Values qdd, Values lam);

/// Set the remaining rates of the joints at rest to zero, by an impulse; `qd` as `qdd`.
void stop_sticking_joints(const EffectTable &, Values qd);

/// Minimise x matrix x / 2 + right x in a box, with `count` unknowns, by the active-set method.
/// StaticFriction.matrix is symmetric, positive semidefinite; `bound`: the largest magnitude of each
/// unknown, zero leaves it out. Nocedal and Wright, Numerical Optimization, 2nd ed. (2006),
/// section 16.5.
void minimise_in_box(const EffectTable &, Index count, Values out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__STATIC_FRICTION_HPP_
