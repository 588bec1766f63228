// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ROLLOUT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ROLLOUT_HPP_

#include "stepper.hpp"

// Whole runs under sequences of torques, recorded at even intervals.

namespace closedloop
{

/// Results of a run at its instants; arrays that are not wanted have no length.
struct RunBuffer
{
  Table state;  ///< Shape (instants, ns)
  Table qdd;  ///< Shape (instants, nv)
  Table lam;  ///< Shape (instants, nc)
  Table scalars;  ///< Shape (instants, 3): closure error, kinetic and potential energy
  Cube<double> output;  ///< Shape (instants, ne, 2): stored energy, first reading of each effect
  Cube<double> wrench;  ///< Shape (instants, number of cuts, 3) [N m, N]
  Indices body;  ///< Shape (n,): of the named points
  Table point;  ///< Shape (n, 2): in that body's frame [m]
  Cube<double> place;  ///< Shape (instants, n, 2): in the world [m]

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(state, qdd, lam, scalars, output, wrench, body, point, place);
  }
};

/// When a run is looked at, and what must hold then: the guards of simulation/guards.py, in the
/// numbers that they look by (simulation/rollout_run.py).
struct Watch
{
  /// Steps before the energy balance is looked at first, and the most between two looks.
  Index first = 0;
  Index rarely = 0;
  /// Steps that must be made at once so that it is looked at after them.
  Index call = 0;
  /// Whether nothing is looked at before all steps are made that are made at once.
  bool whole = false;
  /// Steps after which what is made at once is divided: in all, and at once.
  Index cycle = 0;
  Index most = 0;
  /// Closure error at which loops count as open; infinite where the method closes them.
  double closure = 0.0;
  /// Whether a singular position ends the run.
  bool regular = false;
  /// Energy that counts as none [J].
  double nothing = 0.0;
  /// Kinetic and stored energy where the runs start [J].
  double kinetic = 0.0;
  double stored = 0.0;
  /// Shape (nz,): what the effects' states are (effects/table.py).
  Indices roles;
  /// Shape (nv,): 1 for torques that pass unchanged, 0 for those of drives.
  Values direct;

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(first, rarely, call, whole, cycle, most, closure, regular, nothing, kinetic, stored,
      roles, direct);
  }
};

/// Columns of the findings: the largest error of the energy balance relative to the energy that had
/// moved by then; that error and that energy [J]; steps up to then.
namespace finding
{
enum : Index {SHARE, LOST, MOVED, STEPS, COLUMNS};
}

/// Make whole runs, n of them, of a system and a stepper at the start of a run. `start` has a state
/// for each, shape (n, ns), or one for all; `torque` joint torques, shape (n or 1, rows, nv), each
/// row acting for `zero_order_hold` steps. States after every `decimation` steps, the start first,
/// are written to `states`, shape (n, instants, ns), how the runs ended to `status`, shape (n,),
/// and what is known of their energy to `found`, shape (n, finding::COLUMNS). DOUBTFUL: a guard may
/// end the run, or not: steps made one by one decide. The system and the stepper are left as they
/// were.
void run_samples(
  const System &, const Stepper &, const Watch &, double step_size, Table start,
  Cube<double> torque, Index zero_order_hold, Index decimation, Index steps, Cube<double> states,
  Indices status, Table found);

/// Fill in a buffer of which only the states are known.
void annotate(
  const System &, Table torque, Index zero_order_hold, Index decimation, const RunBuffer &);

/// Wrenches in the joints of the tree at the instants of a known motion, shape (instants, nv, 3 or
/// 6); `scratch` is of shape (nb + 1, 6 or 12).
void fill_joint_forces(
  const System &, Table torque, Index zero_order_hold, Index decimation, Table state, Table qdd,
  Table lam, Table scratch, Cube<double> out);

/// Judge a run made elsewhere, without effects, by its states after `looks` steps, shapes (n, ns)
/// and (n,), the start first, and the work of the torques up to these, shape (n,): the loops at all
/// of them, energy where `balanced` is not zero. DONE or DOUBTFUL, and the findings, as of
/// `run_samples`.
Status judge(
  const System &, const Watch &, Table seen, Values work, Indices looks, Indices balanced,
  Values found);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ROLLOUT_HPP_
