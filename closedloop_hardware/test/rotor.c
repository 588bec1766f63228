/* SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
 * SPDX-License-Identifier: Apache-2.0 */

/* A rotor on a hinge, as closedloop export writes models: a machine of a known answer. */

#include <stddef.h>

/* Moment of inertia [kg m^2], damping [N m s/rad]. */
typedef struct {double inertia, damping;} rotor_model;

const rotor_model rotor_default = {2.0, 0.0};
const double rotor_start[2] = {0.25, 0.0};
const char * const rotor_position_names[] = {"position.hinge", NULL};
const char * const rotor_velocity_names[] = {"velocity.hinge", NULL};
const char * const rotor_joint_names[] = {"hinge", NULL};

const long long int * rotor_sparsity_in(long long int n)
{
  static const long long int one[] = {1, 1};
  (void)n;
  return one;
}

const long long int * rotor_sparsity_out(long long int n)
{
  static const long long int sizes[2][2] = {{1, 1}, {0, 1}};
  return sizes[n];
}

int rotor_evaluate(
  const rotor_model * model, const double * q, const double * qd, const double * tau, double * qdd,
  double * lam)
{
  (void)q;
  (void)lam;
  qdd[0] = (tau[0] - model->damping * qd[0]) / model->inertia;
  return 0;
}

int rotor_correct(const rotor_model * model, double * state)
{
  (void)model;
  (void)state;
  return 0;
}

/* Exact without damping. */
int rotor_step(const rotor_model * model, double * state, const double * tau, double step_size)
{
  double qdd;
  rotor_evaluate(model, state, state + 1, tau, &qdd, NULL);
  state[0] += step_size * (state[1] + 0.5 * step_size * qdd);
  state[1] += step_size * qdd;
  return 0;
}

void rotor_move(double * q, const double * change)
{
  q[0] += change[0];
}

void rotor_closure(const rotor_model * model, const double * q, double * errors, double * jacobian)
{
  (void)model;
  (void)q;
  (void)errors;
  (void)jacobian;
}

/* Moment, then force: what bears the weight of nothing, and passes the torque on. */
void rotor_joint_forces(
  const rotor_model * model, const double * q, const double * qd, const double * qdd,
  const double * lam, double * forces)
{
  (void)q;
  (void)qd;
  (void)lam;
  for (int k = 0; k < 6; ++k) {
    forces[k] = 0.0;
  }
  forces[2] = model->inertia * qdd[0];
}
