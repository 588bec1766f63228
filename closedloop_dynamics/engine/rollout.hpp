// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ROLLOUT_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ROLLOUT_HPP_

#include <utility>

#include "runge_kutta.hpp"

// Whole runs under a sequence of torques, recorded at even intervals.

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
  Values work;  ///< Shape (1,): of the torques over the whole run [J]
  Values since;  ///< Shape (ns,): state since which it is still to be added

  template<class Visitor>
  void fields(Visitor && visit)
  {
    visit(state, qdd, lam, scalars, output, wrench, body, point, place, work, since);
  }
};

/// Make a whole run of fixed steps under joint torques, shape (rows, nv), each acting for
/// `zero_order_hold` steps; record an instant after every `decimation` steps. Returns the status
/// and the steps completed.
std::pair<Status, Index> run_fixed(
  const System &, const Tableau &, Stabilisation, Values state, double step_size, Table torque,
  Index zero_order_hold, Index decimation, Index steps, Table scratch, const RunBuffer &);

/// Fill in a buffer of which only the states are known.
void annotate(
  const System &, Table torque, Index zero_order_hold, Index decimation, const RunBuffer &);

/// Wrenches in the joints of the tree at the instants of a known motion, shape (instants, nv, 3 or
/// 6); `scratch` is of shape (nb + 1, 6 or 12).
void fill_joint_forces(
  const System &, Table torque, Index zero_order_hold, Index decimation, Table state, Table qdd,
  Table lam, Table scratch, Cube<double> out);

/// Kinetic and potential energy of states, shapes (n, ns) and (n, 2).
void energies_of_states(const System &, Table state, Table out);

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ROLLOUT_HPP_
