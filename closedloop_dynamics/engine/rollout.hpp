// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ROLLOUT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ROLLOUT_HPP_

#include "run.hpp"

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
    visit(
      "state[instants<=rows*zero_order_hold/decimation+1,S], qdd[count=0|instants,V], lam[count,C], "
      "scalars[count,3], output[count,E,2], wrench[count,K,W], body<B[n], point[n,P], "
      "place[count,n,P]", state, qdd, lam, scalars, output, wrench, body, point, place);
  }
};

/// Make whole runs, n of them, like one at its start. `start` has a state for each, shape (n, ns),
/// or one for all; `torque` joint torques, shape (n or 1, rows, nv), each row acting for
/// `zero_order_hold` steps. States after every `decimation` steps, the start first, are written to
/// `states`, shape (n, instants, ns), how the runs ended to `status`, shape (n,), and findings on
/// their energy to `found`, shape (n, finding::COLUMNS). DOUBTFUL: a guard ends the run, or the
/// host has to act. The system and the run are left as they were.
void run_samples(
  const System &, const Run &, Table start, Cube<double> torque, Index zero_order_hold,
  Index decimation, Index steps, Cube<double> states, Indices status, Table found);

/// Whether states, shape (n, ns), are to start from as they are: loops and their rates closed to
/// `tolerance` [m or rad], far from singular positions, and with a step that can be made; `fine`, of
/// shape (n,), is 1 then, 0 where only an assembly can decide. Friction follows the rates, in place.
/// The system and the run are left as they were.
void check_starts(
  const System &, const Run &, double tolerance, Table states, Indices fine);

/// Compute the remaining quantities of a buffer from its states.
void annotate(
  const System &, Table torque, Index zero_order_hold, Index decimation, const RunBuffer &);

/// Wrenches in the joints of the tree at the instants of a motion, shape (instants, nv, 3 or 6);
/// `scratch` is of shape (nb + 1, 6 or 12).
void fill_joint_forces(
  const System &, Table torque, Index zero_order_hold, Index decimation, Table state, Table qdd,
  Table lam, Table scratch, Cube<double> out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ROLLOUT_HPP_
