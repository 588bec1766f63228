// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__CONTACT_EVENTS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__CONTACT_EVENTS_HPP_

#include "data.hpp"

// The instants at which bodies begin to touch and part.
//
// Within a step a contact is there or not, whatever the sign of the gap, so that the motion is
// smooth and the gap at its end is right to its last digits. A step at whose end a gap contradicts
// its mode is never accepted: it is cut where the gap changes its sign, by a cubic through gap and
// rate at both ends, then by Newton's method within the bracket of the longest part that agrees and
// the shortest that does not. The next step begins at once with the size that suits the new motion.
//
// A step whose ends agree may have passed through a contact in between. This is excluded where the
// gaps of both ends together exceed the largest possible change of the gap: the step's size times
// the fastest rate in all its evaluations. Otherwise dense output is evaluated, and the step halved
// until every interval is clear:
//
// - Where the gap is smooth (lines, planes, stops, cables), a cubic through gaps and rates less its
//   error stays on the right side; the error is estimated from the middle of the interval before,
//   and falls with the fourth power.
// - Beside a body of finite extent the nearest place jumps from one side to another, and no cubic
//   is valid. There the chord of the path, in the frame of that body, comes nowhere nearer than the
//   path departs from it; only places between the ends count, not the ends themselves.
//
// Where that is not clear at the finest level, the step ends there.

namespace closedloop
{

/// Whether a roller may pass a body within a step without any sign at its ends.
bool is_finite(const EffectTable &, Index row);

/// Whether an undetected contact may lie within a step of a size [s], by the gaps at its start and
/// end [m], the largest gap of the wrong sign, and the fastest rate.
bool may_miss_contact(double gap, double other, double wrong, double fastest, double size);

/// Freeze the modes of contacts, after the evaluation at which a step begins; return whether any
/// begin or cease just here.
bool freeze_modes(const System &);

/// Release the modes after a step: gaps decide again.
void release_modes(const System &);

/// Clear the bracket and the rates of former trials: a failure for another reason than contacts
/// does not bear on them.
void forget_trials(const System &);

/// Clear the rates alone, before another trial.
void forget_rates(const System &);

/// The search for the instant at which a contact begins or ends within a step.
struct ContactSearch
{
  /// Row of the contact at whose change the step is to end; -1: none; -2: the step is to be
  /// repeated.
  Index sought = -1;

  /// The part of a step on which no contact begins or ends [s]: `size` where the step to `out` may
  /// be taken. Another one is to be tried. `state_at(share)` returns a state of dense output.
  template<class StateAt>
  double part(const System & system, Values out, double size, StateAt && state_at)
  {
    double found = size;
    if (system.effects.contacts.rows.size > 0) {
      double share = 1.0;
      found = examine(system, out, size, share);
      while (share >= 0.0) {
        found = examine(system, state_at(share), size, share);
      }
    }
    return found;
  }

private:
  /// The same from the state at a share of the step, 1 at its end, which comes first; the share
  /// becomes the next at which a state is needed, negative where none is.
  double examine(const System &, Values state, double size, double & share);
};

/// Guard of a step of fixed size, which does not end at contacts: detects a contact that begins and
/// ends between evaluations. Construct before the evaluation at the start.
class ContactGuard
{
public:
  explicit ContactGuard(const System &);

  /// Store the gaps of the evaluation at the start.
  void begin() const;

  /// Whether the step to `out`, `size` long [s], misses a contact; its row is stored in
  /// Contacts.search. `state_at(share)` returns a state between.
  template<class StateAt>
  bool is_passed(Values out, double size, StateAt && state_at) const
  {
    if (!is_near(size)) {
      return false;
    }
    bool passed = false;
    double share = examine_end(out, size, passed);
    while (share >= 0.0) {
      share = examine_inside(state_at(share), size, share, passed);
    }
    release_modes(system_);
    return passed;
  }

private:
  bool is_near(double size) const;
  double examine_end(Values out, double size, bool & passed) const;
  double examine_inside(Values state, double size, double share, bool & passed) const;
  double next_share(double size, bool & passed) const;

  const System & system_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__CONTACT_EVENTS_HPP_
