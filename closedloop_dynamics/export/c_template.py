# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The C that is the same for all mechanisms; ``c_source`` fills in the rest.

It closes loops by the generated correction, as ``engine/projection.cpp`` does in a step: the
engine's loop solver needs Eigen and memory.
"""

HEADER = """\
/* @TITLE@
 *
 * Written by closedloop_dynamics. C99 and the C library, nothing else; no memory is allocated, no
 * state is kept: functions may be called from several threads.
 *
 * Build with cc -std=c99 -O3 -ffp-contract=fast @NAME@.c -lm, and -march=native where the program
 * stays on the machine; never with -ffast-math. -D@UPPER@_MAIN adds a main function. The source
 * includes itself: keep its name. With -D@UPPER@_ONE_VERSION it does not.
 *
@COSTS@
 *
 * SI units and radians throughout. */
#ifndef @UPPER@_H_
#define @UPPER@_H_

#ifdef __cplusplus
extern "C" {
#endif

/* Numbers of coordinates, of rates and torques, of multipliers, of named points and of numbers of
 * each, of independent freedoms, and of actuated joints. */
enum {
  @UPPER@_NQ = @NQ@, @UPPER@_NV = @NV@, @UPPER@_NC = @NC@, @UPPER@_POINTS = @NP@,
  @UPPER@_SPACE = @SIZE@, @UPPER@_NI = @NI@, @UPPER@_NA = @NA@
};

/* What functions return. Where it is not OK, nothing that they were given has changed. */
enum {
  @UPPER@_OK = 0,
  /* Closure equations depend on one another there, or nearly: a singular position. */
  @UPPER@_SINGULAR = 1,
  /* The loops cannot be closed: the step is too large. */
  @UPPER@_OPEN = 2,
  /* The state, or a result, left the finite numbers. */
  @UPPER@_NOT_FINITE = 3
};

/* The numbers of the model, which may be changed, but for those that are exactly 0, and in space 1
 * or -1: the code was made for these.
@COLUMNS@ */
typedef struct {
@MEMBERS@
  /* Largest closure error that a correction leaves, and at which it gives up [m, rad]. */
  double closure_tolerance, closure_limit;
} @NAME@_model;

/* A state. Places in q:
@COORDINATES@
 * and in qd, as in torques and accelerations:
@RATES@ */
typedef struct {
  double q[@UPPER@_NQ];
  double qd[@UPPER@_NV];
} @NAME@_state;

extern const @NAME@_model @NAME@_default;
/* Where the scene starts. */
extern const @NAME@_state @NAME@_start;

/* Accelerations qdd[NV] and multipliers lam[NC], the forces of the closure equations on body A of
 * each cut joint [N; N m], of coordinates q[NQ], rates qd[NV] and torques tau[NV]. Multipliers by
 * joint:
@MULTIPLIERS@ */
int @NAME@_evaluate(
  const @NAME@_model *model, const double *q, const double *qd, const double *tau, double *qdd,
  double *lam);

/* Close the loops by the least change in the metric of the masses: of coordinates by Newton's
 * method, then of rates. Quaternions get the norm 1. */
int @NAME@_correct(const @NAME@_model *model, @NAME@_state *state);

/* Move coordinates q[NQ] by finite changes[NV] along the rates: orientations are turned. */
void @NAME@_move(double *q, const double *change);

/* A step of the classical Runge-Kutta method under constant torques tau[NV], and a correction. */
int @NAME@_step(
  const @NAME@_model *model, @NAME@_state *state, const double *tau, double step_size);

/* What the size of a step costs, and the energy balance of the step. */
typedef struct {
  /* Largest difference of a joint coordinate [rad, m], of orientations by the turn between them,
   * and of a rate [rad/s, m/s] to two steps of half the size. */
  double position, velocity;
  /* Kinetic energy after the step, change of that in gravity and springs, energy that effects
   * dissipate, work of torques and external forces, and the error of the energy balance: changes
   * of both energies and what is dissipated, less the work [J]. */
  double kinetic, stored, dissipated, work, residual;
} @NAME@_cost;

/* A step as _step makes it, and what its size costs: takes the time of three steps. */
int @NAME@_step_cost(
  const @NAME@_model *model, @NAME@_state *state, const double *tau, double step_size,
  @NAME@_cost *cost);

/* Assembly from drives: close the loops around the independent coordinates and rates of a state,
 * which stay as they are (rotations of orientations: to first order), by Newton's method from
 * where the others are. Independent are, by their places in qd:
@INDEPENDENT@ */
int @NAME@_assemble(const @NAME@_model *model, @NAME@_state *state);
@DECLARED@
/* Places in qd of the independent freedoms, then of the actuated joints; each table ends by -1. */
extern const int @NAME@_independent[], @NAME@_actuated[];

/* Kinetic energy, that in gravity, and that stored in springs [J]. */
void @NAME@_energies(const @NAME@_model *model, const @NAME@_state *state, double energies[3]);

/* Places of the named points in the world [m], SPACE numbers each:
@POINTS@ */
void @NAME@_points(const @NAME@_model *model, const double *q, double *places);

/* Their velocities [m/s]. */
void @NAME@_velocities(
  const @NAME@_model *model, const double *q, const double *qd, double *velocities);

/* Their accelerations [m/s^2]. */
void @NAME@_accelerations(
  const @NAME@_model *model, const double *q, const double *qd, const double *qdd,
  double *accelerations);
@TASKS@
/* Errors of the closure equations, errors[NC] [m, rad], and their Jacobian, NC rows of NV numbers,
 * in the order of the multipliers. */
void @NAME@_closure(
  const @NAME@_model *model, const double *q, double *errors, double *jacobian);
@FORCES@@DIFFERENTIATE@
/* Names, for programs that load this code as a library: of q and of qd, each table ended by 0. */
extern const char *const @NAME@_position_names[];
extern const char *const @NAME@_velocity_names[];

@CASADI@#ifdef __cplusplus
}
#endif

#endif
"""

SOURCE = """\
/* @TITLE@: see @HEADER@. */
#ifndef VERSION
#include "@HEADER@"

#include <float.h>
#include <math.h>
#include <string.h>

enum {
  NQ = @UPPER@_NQ, NV = @UPPER@_NV, NC = @UPPER@_NC, NI = @UPPER@_NI, NA = @UPPER@_NA,
  SPACE = @UPPER@_SPACE, PLACES = @UPPER@_POINTS * SPACE
};
/* Arrays have a length. */
enum { NC1 = NC > 0 ? NC : 1, NI1 = NI > 0 ? NI : 1 };

const @NAME@_model @NAME@_default = {
@DEFAULT@
};

const @NAME@_state @NAME@_start = {
@START@
};

const int @NAME@_independent[] = {@CHOICE@};
const int @NAME@_actuated[] = {@DRIVES@};

/* What takes the time is compiled for newer processors, too, where GCC is to make code for any x86
 * processor: this file includes itself. */
#if defined(__GNUC__) && !defined(__clang__) && defined(__x86_64__) && defined(__OPTIMIZE__) && \
  !defined(__FMA__) && !defined(@UPPER@_ONE_VERSION)
#pragma GCC push_options
#pragma GCC target("avx2,fma")
#define VERSION(name) name##_256
#include "@NAME@.c"
#undef VERSION
#pragma GCC target("avx512f,avx512vl,avx512dq,avx512bw")
#define VERSION(name) name##_512
#include "@NAME@.c"
#undef VERSION
#pragma GCC pop_options
#define BEST(name, arguments) \
  (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma") ? name##_any arguments : \
   !__builtin_cpu_supports("avx512vl") || !__builtin_cpu_supports("avx512dq") || \
   !__builtin_cpu_supports("avx512bw") ? name##_256 arguments : name##_512 arguments)
#else
#define BEST(name, arguments) name##_any arguments
#endif
#define VERSION(name) name##_any
#define LAST_VERSION
#endif

#define sines_and_cosines VERSION(sines_and_cosines)
@VECTORS@@SINES@
@VERSIONS@
#ifdef LAST_VERSION
static int evaluation(
  const @NAME@_model *model, const double *q, const double *qd, const double *tau, double *qdd,
  double *lam)
{
  return BEST(evaluation, (model, q, qd, tau, qdd, lam));
}

static int correction(
  const @NAME@_model *model, const double *q, const double *qd, double *change, double *closure)
{
  return BEST(correction, (model, q, qd, change, closure));
}

@ROUTINES@
@MANIFOLD@
int @NAME@_evaluate(
  const @NAME@_model *model, const double *q, const double *qd, const double *tau, double *qdd,
  double *lam)
{
  double found[NV], multipliers[NC1];
  if (!evaluation(model, q, qd, tau, found, multipliers)) {
    return @UPPER@_SINGULAR;
  }
  memcpy(qdd, found, sizeof found);
  memcpy(lam, multipliers, NC * sizeof(double));
  return @UPPER@_OK;
}

static double largest(const double *values, int count)
{
  double found = 0.0;
  for (int n = 0; n < count; ++n) {
    found = fabs(values[n]) > found ? fabs(values[n]) : found;
  }
  return found;
}

static int close_loops(const @NAME@_model *model, double *q, double *qd)
{
  enum { MOST = @MOST@ };
  double change[2 * NV], closure[NC1] = {0.0};
  normalise(q);
  int good = correction(model, q, qd, change, closure);
  double error = largest(closure, NC);
  for (int n = 0; good && n < MOST && error > model->closure_tolerance; ++n) {
    move(q, change);
    good = correction(model, q, qd, change, closure);
    const double before = error;
    error = largest(closure, NC);
    if (!(error < 0.5 * before)) {
      break;
    }
  }
  if (!good) {
    return @UPPER@_SINGULAR;
  }
  for (int i = 0; i < NV; ++i) {
    qd[i] += change[NV + i];
  }
  return error <= model->closure_limit ? @UPPER@_OK : @UPPER@_OPEN;
}

int @NAME@_correct(const @NAME@_model *model, @NAME@_state *state)
{
  @NAME@_state corrected = *state;
  const int status = close_loops(model, corrected.q, corrected.qd);
  if (status == @UPPER@_OK) {
    *state = corrected;
  }
  return status;
}

void @NAME@_move(double *q, const double *change)
{
  move(q, change);
}

/* Solve a x = b of some rows, b of some columns, both overwritten; returns the absolute value of
 * the determinant. */
static double solve(int rows, int columns, double *a, double *b)
{
  double determinant = 1.0;
  for (int k = 0; k < rows; ++k) {
    int best = k;
    for (int i = k + 1; i < rows; ++i) {
      best = fabs(a[i * rows + k]) > fabs(a[best * rows + k]) ? i : best;
    }
    for (int j = 0; j < rows; ++j) {
      const double kept = a[k * rows + j];
      a[k * rows + j] = a[best * rows + j];
      a[best * rows + j] = kept;
    }
    for (int n = 0; n < columns; ++n) {
      const double kept = b[k * columns + n];
      b[k * columns + n] = b[best * columns + n];
      b[best * columns + n] = kept;
    }
    determinant *= fabs(a[k * rows + k]);
    for (int i = k + 1; i < rows; ++i) {
      const double factor = a[i * rows + k] / a[k * rows + k];
      for (int j = k; j < rows; ++j) {
        a[i * rows + j] -= factor * a[k * rows + j];
      }
      for (int n = 0; n < columns; ++n) {
        b[i * columns + n] -= factor * b[k * columns + n];
      }
    }
  }
  for (int k = rows - 1; k >= 0; --k) {
    for (int n = 0; n < columns; ++n) {
      for (int j = k + 1; j < rows; ++j) {
        b[k * columns + n] -= a[k * rows + j] * b[j * columns + n];
      }
      b[k * columns + n] /= a[k * rows + k];
    }
  }
  return determinant;
}

static int is_chosen(const int *choice, int count, int freedom)
{
  for (int n = 0; n < count; ++n) {
    if (choice[n] == freedom) {
      return 1;
    }
  }
  return 0;
}

/* Complete some changes of the chosen freedoms, NV numbers each and at most NI1, so that
 * J change = -right; returns as solve. */
static double complete(
  const int *choice, int count, double jacobian[NC1][NV], const double *right, int changes,
  double *change)
{
  double a[NC1 * NC1] = {0.0}, b[NC1 * NI1] = {0.0};
  int place = 0;
  for (int i = 0; i < NC * changes; ++i) {
    b[i] = -right[i / changes];
  }
  for (int j = 0; j < NV; ++j) {
    const int own = is_chosen(choice, count, j);
    for (int i = 0; i < NC; ++i) {
      for (int n = 0; own && n < changes; ++n) {
        b[i * changes + n] -= jacobian[i][j] * change[n * NV + j];
      }
      if (!own && place < NC) {
        a[i * NC + place] = jacobian[i][j];
      }
    }
    place += !own;
  }
  const double determinant = solve(NC, changes, a, b);
  place = 0;
  for (int j = 0; j < NV; ++j) {
    if (!is_chosen(choice, count, j) && place < NC) {
      for (int n = 0; n < changes; ++n) {
        change[n * NV + j] = b[place * changes + n];
      }
      ++place;
    }
  }
  return determinant;
}

/* Close the loops, the chosen coordinates and rates as they are. */
static int close_around(
  const @NAME@_model *model, const int *choice, int count, @NAME@_state *state)
{
  enum { MOST = 30 };
  static const double none[NC1] = {0.0};
  @NAME@_state closed = *state;
  double error[NC1], jacobian[NC1][NV], change[NV];
  int good = NC == 0;
  normalise(closed.q);
  for (int n = 0; NC > 0 && n < MOST; ++n) {
    @NAME@_closure(model, closed.q, error, jacobian[0]);
    memset(change, 0, sizeof change);
    complete(choice, count, jacobian, error, 1, change);
    const double size = largest(change, NV);
    if (!(size < 1.0)) {
      return @UPPER@_OPEN;
    }
    move(closed.q, change);
    /* Newton's method: what is left is the square of the last change. */
    if (size < @NEWTON@) {
      good = 1;
      break;
    }
  }
  @NAME@_closure(model, closed.q, error, jacobian[0]);
  if (!good || !(largest(error, NC) <= model->closure_limit)) {
    return @UPPER@_OPEN;
  }
  complete(choice, count, jacobian, none, 1, closed.qd);
  for (int i = 0; i < NV; ++i) {
    if (!isfinite(closed.qd[i])) {
      return @UPPER@_SINGULAR;
    }
  }
  *state = closed;
  return @UPPER@_OK;
}

int @NAME@_assemble(const @NAME@_model *model, @NAME@_state *state)
{
  return close_around(model, @NAME@_independent, NI, state);
}
@DECISION@@CONTROL@
/* What to step along: rates of coordinates, then accelerations. Where they are asked for, add to
 * the energies exchanged what effects dissipate in a time, and the work of external forces and of
 * torques on orientations. */
static int slope_at(
  const @NAME@_model *model, const double *state, const double *tau, double *slope, double time,
  double *exchanged)
{
  double lam[NC1];
  rates(state, state + NQ, slope);
  if (exchanged) {
    double powers[2];
    powers_of(model, state, state + NQ, powers);
    for (int i = 0; i < NV; ++i) {
      powers[1] += is_number(i) ? 0.0 : tau[i] * state[NQ + i];
    }
    exchanged[0] += time * powers[0];
    exchanged[1] += time * powers[1];
  }
  return evaluation(model, state, state + NQ, tau, slope + NQ, lam);
}

static int advance(
  const @NAME@_model *model, @NAME@_state *state, const double *tau, double step_size,
  double *exchanged)
{
  enum { STATES = NQ + NV };
  static const double share[3] = {0.5, 0.5, 1.0};
  static const double weight[4] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
  double start[STATES], stage[STATES], slope[4][STATES];
  memcpy(start, state->q, sizeof state->q);
  memcpy(start + NQ, state->qd, sizeof state->qd);
  if (!slope_at(model, start, tau, slope[0], step_size * weight[0], exchanged)) {
    return @UPPER@_SINGULAR;
  }
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < STATES; ++i) {
      stage[i] = start[i] + step_size * (share[k] * slope[k][i]);
    }
    if (!slope_at(model, stage, tau, slope[k + 1], step_size * weight[k + 1], exchanged)) {
      return @UPPER@_SINGULAR;
    }
  }
  for (int i = 0; i < STATES; ++i) {
    double sum = 0.0;
    for (int k = 0; k < 4; ++k) {
      sum += weight[k] * slope[k][i];
    }
    stage[i] = start[i] + step_size * sum;
    if (!isfinite(stage[i])) {
      return @UPPER@_NOT_FINITE;
    }
  }
  const int status = close_loops(model, stage, stage + NQ);
  if (status == @UPPER@_OK) {
    memcpy(state->q, stage, sizeof state->q);
    memcpy(state->qd, stage + NQ, sizeof state->qd);
  }
  return status;
}

int @NAME@_step(
  const @NAME@_model *model, @NAME@_state *state, const double *tau, double step_size)
{
  return advance(model, state, tau, step_size, 0);
}

int @NAME@_step_cost(
  const @NAME@_model *model, @NAME@_state *state, const double *tau, double step_size,
  @NAME@_cost *cost)
{
  @NAME@_state whole = *state, half = *state;
  double change[NV], before[3], after[3], exchanged[2] = {0.0, 0.0};
  int status = advance(model, &whole, tau, step_size, exchanged);
  for (int n = 0; n < 2 && status == @UPPER@_OK; ++n) {
    status = advance(model, &half, tau, 0.5 * step_size, 0);
  }
  if (status != @UPPER@_OK) {
    return status;
  }
  /* Work of torques in coordinates that are numbers needs no integral. */
  apart(whole.q, state->q, change);
  for (int i = 0; i < NV; ++i) {
    exchanged[1] += is_number(i) ? tau[i] * change[i] : 0.0;
  }
  energies_of(model, state->q, state->qd, before);
  energies_of(model, whole.q, whole.qd, after);
  apart(whole.q, half.q, change);
  cost->position = largest(change, NV);
  for (int i = 0; i < NV; ++i) {
    change[i] = whole.qd[i] - half.qd[i];
  }
  cost->velocity = largest(change, NV);
  cost->kinetic = after[0];
  cost->stored = after[1] - before[1] + (after[2] - before[2]);
  cost->dissipated = exchanged[0];
  cost->work = exchanged[1];
  cost->residual = after[0] - before[0] + cost->stored + cost->dissipated - cost->work;
  *state = whole;
  return @UPPER@_OK;
}

void @NAME@_energies(const @NAME@_model *model, const @NAME@_state *state, double energies[3])
{
  energies_of(model, state->q, state->qd, energies);
}

void @NAME@_points(const @NAME@_model *model, const double *q, double *places)
{
  places_of(model, q, places);
}

void @NAME@_velocities(
  const @NAME@_model *model, const double *q, const double *qd, double *velocities)
{
  velocities_of(model, q, qd, velocities);
}

void @NAME@_accelerations(
  const @NAME@_model *model, const double *q, const double *qd, const double *qdd,
  double *accelerations)
{
  double without[PLACES + 1];
  biases_of(model, q, qd, without);
  velocities_of(model, q, qdd, accelerations);
  for (int i = 0; i < PLACES; ++i) {
    accelerations[i] += without[i];
  }
}

void @NAME@_closure(
  const @NAME@_model *model, const double *q, double *errors, double *jacobian)
{
  closures_of(model, q, errors, jacobian);
}
@VELOCITY@@OPERATIONAL@@WRENCHES@
const char *const @NAME@_position_names[] = {@POSITIONS@};
const char *const @NAME@_velocity_names[] = {@VELOCITIES@};

@CALLED@@JACOBIANS@
#ifdef @UPPER@_MAIN
#include <stdio.h>
#include <stdlib.h>

/* STEPS STEP_SIZE EVERY [TORQUE ...]: coordinates and rates after every so many steps, in lines of
 * their time, q, qd and the three energies. */
int main(int count, char **text)
{
  double tau[NV] = {0.0};
  if (count < 4 || count > 4 + NV) {
    fprintf(stderr, "%s: expected STEPS STEP_SIZE EVERY [TORQUE ...]\\n", text[0]);
    return 64;
  }
  const long steps = atol(text[1]), every = atol(text[3]);
  const double step_size = atof(text[2]);
  if (steps < 0 || every < 1 || !(step_size > 0.0)) {
    fprintf(stderr, "%s: expected STEPS >= 0, STEP_SIZE > 0, EVERY >= 1\\n", text[0]);
    return 64;
  }
  for (int i = 4; i < count; ++i) {
    tau[i - 4] = atof(text[i]);
  }
  @NAME@_state state = @NAME@_start;
  for (long step = 0; step <= steps; ++step) {
    if (step > 0) {
      const int status = @NAME@_step(&@NAME@_default, &state, tau, step_size);
      if (status != @UPPER@_OK) {
        fprintf(stderr, "%s: step %ld returned %d\\n", text[0], step, status);
        return status;
      }
    }
    if (step % every == 0) {
      double energies[3];
      @NAME@_energies(&@NAME@_default, &state, energies);
      printf("%.17g", (double)step * step_size);
      for (int i = 0; i < NQ; ++i) {printf(" %.17g", state.q[i]);}
      for (int i = 0; i < NV; ++i) {printf(" %.17g", state.qd[i]);}
      for (int i = 0; i < 3; ++i) {printf(" %.17g", energies[i]);}
      printf("\\n");
    }
  }
  return 0;
}
#endif
#endif
"""

# Where joint forces are unique: in the header, and behind the closure equations.
FORCES = """
/* Wrenches in joints, of accelerations and multipliers as _evaluate finds them: what the parent
 * exerts on the child, at the child's origin and in its axes, moment x, y, z [N m] and force x, y,
 * z [N] of each; then in cut joints, by body B on body A, at the cut point of A in its axes:
@JOINTS@ */
void @NAME@_joint_forces(
  const @NAME@_model *model, const double *q, const double *qd, const double *qdd,
  const double *lam, double *forces);
/* Their names, ended by 0. */
extern const char *const @NAME@_joint_names[];
"""

WRENCHES = """
void @NAME@_joint_forces(
  const @NAME@_model *model, const double *q, const double *qd, const double *qdd,
  const double *lam, double *forces)
{
  joint_forces_of(model, q, qd, qdd, lam, forces);
}

const char *const @NAME@_joint_names[] = {@NAMED@};
"""

# Numbers of double precision alone: in the header, and in the source.
CASADI = """\
/* CasADi's calling convention: casadi.external('@NAME@', './@NAME@.so') is the evaluation of the
 * default model as a function (q, qd, tau) -> (qdd, lam). */
int @NAME@(const double **arg, double **res, long long int *iw, double *w, int mem);

"""

CALLED = """\
/* CasADi's calling convention. */

enum { ARGUMENTS = 3, RESULTS = 2 };

int @NAME@(const double **arg, double **res, long long int *iw, double *w, int mem)
{
  static const double zero[NQ + NV] = {0.0};
  double qdd[NV], lam[NC1];
  (void)iw;
  (void)w;
  (void)mem;
  if (!evaluation(
      &@NAME@_default, arg[0] ? arg[0] : zero, arg[1] ? arg[1] : zero, arg[2] ? arg[2] : zero,
      qdd, lam))
  {
    return @UPPER@_SINGULAR;
  }
  if (res[0]) {
    memcpy(res[0], qdd, sizeof qdd);
  }
  if (res[1]) {
    memcpy(res[1], lam, NC * sizeof(double));
  }
  return 0;
}

long long int @NAME@_n_in(void) {return ARGUMENTS;}
long long int @NAME@_n_out(void) {return RESULTS;}

const char *@NAME@_name_in(long long int place)
{
  static const char *const names[] = {"q", "qd", "tau"};
  return place >= 0 && place < ARGUMENTS ? names[place] : 0;
}

const char *@NAME@_name_out(long long int place)
{
  static const char *const names[] = {"qdd", "lam"};
  return place >= 0 && place < RESULTS ? names[place] : 0;
}

/* Columns, compressed: rows, columns, begin and end of the one column, row of each number. */
@SPARSITIES@

const long long int *@NAME@_sparsity_in(long long int place)
{
  return place == 0 ? column_nq : place > 0 && place < ARGUMENTS ? column_nv : 0;
}

const long long int *@NAME@_sparsity_out(long long int place)
{
  return place == 0 ? column_nv : place == 1 ? column_nc : 0;
}

int @NAME@_work(
  long long int *sz_arg, long long int *sz_res, long long int *sz_iw, long long int *sz_w)
{
  if (sz_arg) {*sz_arg = ARGUMENTS;}
  if (sz_res) {*sz_res = RESULTS;}
  if (sz_iw) {*sz_iw = 0;}
  if (sz_w) {*sz_w = 0;}
  return 0;
}
"""

# For the Jacobian of points and computed torque, where there is a degree of freedom.
DECISION = """
/* Rates of all joints by those of the freedoms of a table; returns whether these do. */
static int determines(
  const @NAME@_model *model, const double *q, const int *table, double along[NI][NV])
{
  static const double none[NC1] = {0.0};
  double error[NC1], jacobian[NC1][NV];
  int count = 0;
  while (table[count] >= 0) {
    ++count;
  }
  if (count != NI) {
    return 0;
  }
  memset(along, 0, NI * NV * sizeof(double));
  for (int n = 0; n < NI; ++n) {
    along[n][table[n]] = 1.0;
  }
  @NAME@_closure(model, q, error, jacobian[0]);
  complete(table, NI, jacobian, none, NI, along[0]);
  for (int i = 0; i < NI * NV; ++i) {
    if (!(fabs(along[0][i]) < @RATIO@)) {
      return 0;
    }
  }
  return 1;
}
"""

# Where as many joints are actuated as there are degrees of freedom: in the header, and behind the
# assembly.
INVERSE = """
/* Torques tau[NV] of the actuated joints, zero in others, that accelerate the independent freedoms
 * by acceleration[NI]: computed torque. They take NI + 1 evaluations. */
int @NAME@_inverse(
  const @NAME@_model *model, const @NAME@_state *state, const double *acceleration, double *tau);

/* Those that hold the position at rest, against gravity and springs. */
int @NAME@_gravity_compensation(
  const @NAME@_model *model, const @NAME@_state *state, double *tau);
@FEEDBACK@"""

# Beside them, where no orientation is independent.
FEEDBACK = """
/* Those of a computed-torque controller: of acceleration[NI], stiffness[NI] [1/s^2] times the
 * errors of the independent coordinates and damping[NI] [1/s] times those of their rates. */
int @NAME@_computed_torque(
  const @NAME@_model *model, const @NAME@_state *state, const @NAME@_state *wanted,
  const double *acceleration, const double *stiffness, const double *damping, double *tau);
"""

CONTROLLER = """
int @NAME@_computed_torque(
  const @NAME@_model *model, const @NAME@_state *state, const @NAME@_state *wanted,
  const double *acceleration, const double *stiffness, const double *damping, double *tau)
{
  static const int coordinate[] = {@OWN@};
  double total[NI];
  for (int n = 0; n < NI; ++n) {
    const int i = coordinate[n], j = @NAME@_independent[n];
    total[n] = acceleration[n] + stiffness[n] * (wanted->q[i] - state->q[i]) +
      damping[n] * (wanted->qd[j] - state->qd[j]);
  }
  return @NAME@_inverse(model, state, total, tau);
}
"""

COMPUTED_TORQUE = """
int @NAME@_inverse(
  const @NAME@_model *model, const @NAME@_state *state, const double *acceleration, double *tau)
{
  /* Accelerations are those without torques, and in proportion to these. */
  double unit[NV] = {0.0}, qdd[NV], lam[NC1], without[NI], by_torque[NI * NI], found[NI];
  double along[NI][NV];
  if (!determines(model, state->q, @NAME@_actuated, along)) {
    return @UPPER@_SINGULAR;
  }
  for (int n = -1; n < NI; ++n) {
    if (n >= 0) {
      unit[@NAME@_actuated[n]] = 1.0;
    }
    if (!evaluation(model, state->q, state->qd, unit, qdd, lam)) {
      return @UPPER@_SINGULAR;
    }
    for (int i = 0; i < NI; ++i) {
      const double one = qdd[@NAME@_independent[i]];
      if (n < 0) {
        without[i] = one;
        found[i] = acceleration[i] - one;
      } else {
        by_torque[i * NI + n] = one - without[i];
      }
    }
    if (n >= 0) {
      unit[@NAME@_actuated[n]] = 0.0;
    }
  }
  solve(NI, 1, by_torque, found);
  for (int i = 0; i < NI; ++i) {
    if (!isfinite(found[i])) {
      return @UPPER@_SINGULAR;
    }
  }
  memset(tau, 0, NV * sizeof(double));
  for (int i = 0; i < NI; ++i) {
    tau[@NAME@_actuated[i]] = found[i];
  }
  return @UPPER@_OK;
}

int @NAME@_gravity_compensation(
  const @NAME@_model *model, const @NAME@_state *state, double *tau)
{
  static const double none[NI] = {0.0};
  @NAME@_state rest = *state;
  memset(rest.qd, 0, sizeof rest.qd);
  return @NAME@_inverse(model, &rest, none, tau);
}
@CONTROLLER@"""

# Where there are named points: in the header, and behind the closure equations.
TASKS = """@MOVING@
/* Operational-space dynamics of a named point, by its number: force = inertia acceleration + bias,
 * inertia[SPACE][SPACE] [kg], bias[SPACE] [N]. SINGULAR where it cannot move in all directions, or
 * hardly in one. It takes SPACE + 1 evaluations. */
int @NAME@_operational_space(
  const @NAME@_model *model, const @NAME@_state *state, int point, double *inertia, double *bias);
"""

OPERATIONAL = """
int @NAME@_operational_space(
  const @NAME@_model *model, const @NAME@_state *state, int point, double *inertia, double *bias)
{
  const double *q = state->q, *qd = state->qd;
  const int first = point * SPACE;
  double unit[NV] = {0.0}, tau[NV] = {0.0}, along[NV][PLACES], qdd[NV], lam[NC1];
  double without[PLACES], pushed[PLACES];
  double response[SPACE * SPACE], found[SPACE * SPACE] = {0.0};
  for (int j = 0; j < NV; ++j) {
    unit[j] = 1.0;
    velocities_of(model, q, unit, along[j]);
    unit[j] = 0.0;
  }
  /* Accelerations without a force on the point, then with one along each axis. */
  for (int axis = -1; axis < SPACE; ++axis) {
    for (int j = 0; axis >= 0 && j < NV; ++j) {
      tau[j] = along[j][first + axis];
    }
    if (!evaluation(model, q, qd, tau, qdd, lam)) {
      return @UPPER@_SINGULAR;
    }
    @NAME@_accelerations(model, q, qd, qdd, axis < 0 ? without : pushed);
    for (int k = 0; axis >= 0 && k < SPACE; ++k) {
      response[k * SPACE + axis] = pushed[first + k] - without[first + k];
    }
  }
  const double size = largest(response, SPACE * SPACE);
  for (int k = 0; k < SPACE; ++k) {
    found[k * SPACE + k] = 1.0;
  }
  solve(SPACE, SPACE, response, found);
  for (int i = 0; i < SPACE * SPACE; ++i) {
    if (!(fabs(found[i]) * size < @RATIO@)) {
      return @UPPER@_SINGULAR;
    }
  }
  memcpy(inertia, found, sizeof found);
  for (int k = 0; k < SPACE; ++k) {
    bias[k] = 0.0;
    for (int axis = 0; axis < SPACE; ++axis) {
      bias[k] -= found[k * SPACE + axis] * without[first + axis];
    }
  }
  return @UPPER@_OK;
}
"""

# Beside them, where there is a degree of freedom.
MOVING = """
/* Jacobian of the named points, POINTS SPACE rows of NI numbers: their velocities by the rates of
 * the freedoms of a table, such as _independent and _actuated, of as many as there are degrees of
 * freedom. SINGULAR where these do not determine the motion, or hardly. */
int @NAME@_jacobian(
  const @NAME@_model *model, const double *q, const int *by, double *jacobian);
"""

VELOCITY = """
int @NAME@_jacobian(
  const @NAME@_model *model, const double *q, const int *by, double *jacobian)
{
  double along[NI][NV], velocities[PLACES];
  if (!determines(model, q, by, along)) {
    return @UPPER@_SINGULAR;
  }
  for (int n = 0; n < NI; ++n) {
    velocities_of(model, q, along[n], velocities);
    for (int row = 0; row < PLACES; ++row) {
      jacobian[row * NI + n] = velocities[row];
    }
  }
  return @UPPER@_OK;
}
"""

# Where derivatives are asked for: in the header, and behind the functions of CasADi.
DIFFERENTIATE = """
/* Accelerations, multipliers and derivatives of both, of coordinates that close the loops: NV
 * columns by coordinates, NV by rates, NV by torques, each of NV + NC numbers, those of the
 * accelerations first. Each coordinate of the tree is changed alone; orientations are turned about
 * the child's axes. */
int @NAME@_differentiate(
  const @NAME@_model *model, const double *q, const double *qd, const double *tau, double *qdd,
  double *lam, double *derivatives);
@LINEARISE@"""

# Beside them, where there is a degree of freedom.
LINEARISE = """
/* Derivatives of a step: a[2 NI][2 NI] of the displacements and rates of the independent freedoms
 * after it by those before it, b[2 NI][NA] by the torques of the actuated joints. The equations of
 * small changes are integrated as _step integrates the motion: to its order, the fifth power of
 * the step size. */
int @NAME@_linearise(
  const @NAME@_model *model, const @NAME@_state *state, const double *tau, double step_size,
  double *a, double *b);
"""

LINEAR_STEP = """
int @NAME@_linearise(
  const @NAME@_model *model, const @NAME@_state *state, const double *tau, double step_size,
  double *a, double *b)
{
  /* By columns, changes of all displacements, then rates. */
  enum { CHANGES = 2 * NI + NA, BOTH = 2 * NV, STATES = NQ + NV };
  static const double none[NC1] = {0.0};
  static const double share[4] = {0.0, 0.5, 0.5, 1.0};
  static const double weight[4] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
  double before[CHANGES][BOTH] = {{0.0}}, along[CHANGES][BOTH] = {{0.0}};
  double after[CHANGES][BOTH], start[STATES], stage[STATES], slope[STATES] = {0.0}, now[BOTH];
  double lam[NC1], by[3][NV][NV + NC], rates_by[2 * NV * NC1], jacobian[NC1][NV], right[NC1];
  memcpy(start, state->q, sizeof state->q);
  memcpy(start + NQ, state->qd, sizeof state->qd);
  for (int k = 0; k < 4; ++k) {
    for (int i = 0; i < STATES; ++i) {
      stage[i] = start[i] + step_size * (share[k] * slope[i]);
    }
    rates(stage, stage + NQ, slope);
    if (@NAME@_evaluate(model, stage, stage + NQ, tau, slope + NQ, lam) != @UPPER@_OK ||
      !derivatives_of(model, stage, stage + NQ, slope + NQ, lam, by[0][0], rates_by))
    {
      return @UPPER@_SINGULAR;
    }
    if (k == 0) {
      @NAME@_closure(model, stage, right, jacobian[0]);
      for (int n = 0; n < NI; ++n) {
        const int own = @NAME@_independent[n];
        before[n][own] = before[NI + n][NV + own] = 1.0;
        complete(@NAME@_independent, NI, jacobian, none, 1, before[n]);
        change_of_rates(rates_by, before[n], right);
        complete(@NAME@_independent, NI, jacobian, right, 1, before[n] + NV);
        complete(@NAME@_independent, NI, jacobian, none, 1, before[NI + n] + NV);
      }
      memcpy(after, before, sizeof after);
    }
    for (int n = 0; n < CHANGES; ++n) {
      for (int i = 0; i < BOTH; ++i) {
        now[i] = before[n][i] + step_size * (share[k] * along[n][i]);
      }
      memcpy(along[n], now + NV, NV * sizeof(double));
      turn_changes(stage + NQ, now, along[n]);
      for (int row = 0; row < NV; ++row) {
        double sum = n < 2 * NI ? 0.0 : by[2][@NAME@_actuated[n - 2 * NI]][row];
        for (int j = 0; j < NV; ++j) {
          sum += by[0][j][row] * now[j] + by[1][j][row] * now[NV + j];
        }
        along[n][NV + row] = sum;
      }
      for (int i = 0; i < BOTH; ++i) {
        after[n][i] += step_size * (weight[k] * along[n][i]);
      }
    }
  }
  for (int row = 0; row < 2 * NI; ++row) {
    const int place = row < NI ? @NAME@_independent[row] : NV + @NAME@_independent[row - NI];
    for (int n = 0; n < CHANGES; ++n) {
      if (!isfinite(after[n][place])) {
        return @UPPER@_NOT_FINITE;
      }
    }
  }
  for (int row = 0; row < 2 * NI; ++row) {
    const int place = row < NI ? @NAME@_independent[row] : NV + @NAME@_independent[row - NI];
    for (int n = 0; n < CHANGES; ++n) {
      if (n < 2 * NI) {
        a[row * 2 * NI + n] = after[n][place];
      } else {
        b[row * NA + n - 2 * NI] = after[n][place];
      }
    }
  }
  return @UPPER@_OK;
}
"""

JACOBIANS = """
/* Columns of the derivatives, eight at a time: by changes of the equations, with factors that all
 * columns have in common. Derivatives of J qd are in rates. */
static int derivatives_of(
  const @NAME@_model *model, const double *q, const double *qd, const double *qdd,
  const double *lam, double *derivatives, double *rates)
{
  enum { COLUMNS = 3 * NV, BLOCKS = (COLUMNS + 7) / 8, ROWS = NV + NC };
  double columns[BLOCKS][8 * ROWS], found[8 * ROWS], factors[@FACTORS@];
  memset(columns, 0, sizeof columns);
  const int good = BEST(columns_of, (model, q, qd, qdd, lam, columns[0], factors, rates));
  if (!good && !@FACTORISE@) {
    return 0;
  }
  for (int block = 0; block < BLOCKS; ++block) {
    if (good) {
      BEST(solve, (columns[block], factors, found));
    } else {
      BEST(@ASIDE@, (columns[block], factors, found));
    }
    for (int n = 0; n < 8 && 8 * block + n < COLUMNS; ++n) {
      for (int row = 0; row < ROWS; ++row) {
        *derivatives++ = found[8 * row + n];
      }
    }
  }
  return 1;
}

/* Changes of J qd with coordinates. */
static inline void change_of_rates(const double *rates_by, const double *dq, double *change)
{
  for (int i = 0; i < NC; ++i) {
    change[i] = 0.0;
    for (int j = 0; j < NV; ++j) {
      change[i] += rates_by[j * NC + i] * dq[j];
    }
  }
}

int @NAME@_differentiate(
  const @NAME@_model *model, const double *q, const double *qd, const double *tau, double *qdd,
  double *lam, double *derivatives)
{
  double rates[2 * NV * NC1];
  const int status = @NAME@_evaluate(model, q, qd, tau, qdd, lam);
  if (status == @UPPER@_OK && !derivatives_of(model, q, qd, qdd, lam, derivatives, rates)) {
    return @UPPER@_SINGULAR;
  }
  return status;
}
@LINEAR@@BLOCKS@"""

# In CasADi's calling convention.
BLOCKS = """
/* All Jacobians, blocks of their own: of each result by each argument. */
int jac_@NAME@(const double **arg, double **res, long long int *iw, double *w, int mem)
{
  static const double zero[NQ + NV] = {0.0};
  const double *q = arg[0] ? arg[0] : zero;
  double qdd[NV], lam[NC1], *found = w, *by_q = w + 3 * NV * (NV + NC);
  (void)iw;
  (void)mem;
  const int status = @NAME@_differentiate(
    &@NAME@_default, q, arg[1] ? arg[1] : zero, arg[2] ? arg[2] : zero, qdd, lam, found);
  if (status != @UPPER@_OK) {
    return status;
  }
  by_components(q, found, by_q);
  for (int n = 0; n < RESULTS; ++n) {
    const int first = n == 0 ? 0 : NV, rows = n == 0 ? NV : NC;
    for (int k = 0; k < ARGUMENTS; ++k) {
      const double *from = k == 0 ? by_q : found + k * NV * (NV + NC);
      double *to = res[ARGUMENTS * n + k];
      for (int column = 0; to && column < (k == 0 ? NQ : NV); ++column) {
        memcpy(to + column * rows, from + column * (NV + NC) + first, rows * sizeof(double));
      }
    }
  }
  return 0;
}

long long int jac_@NAME@_n_in(void) {return ARGUMENTS + RESULTS;}
long long int jac_@NAME@_n_out(void) {return ARGUMENTS * RESULTS;}

@DENSE@

const long long int *jac_@NAME@_sparsity_in(long long int place)
{
  return place < ARGUMENTS ? @NAME@_sparsity_in(place) : @NAME@_sparsity_out(place - ARGUMENTS);
}

const long long int *jac_@NAME@_sparsity_out(long long int place)
{
  static const long long int *const found[] = {
    qdd_q, qdd_rest, qdd_rest, lam_q, lam_rest, lam_rest};
  return place >= 0 && place < ARGUMENTS * RESULTS ? found[place] : 0;
}

int jac_@NAME@_work(
  long long int *sz_arg, long long int *sz_res, long long int *sz_iw, long long int *sz_w)
{
  if (sz_arg) {*sz_arg = ARGUMENTS + RESULTS;}
  if (sz_res) {*sz_res = ARGUMENTS * RESULTS;}
  if (sz_iw) {*sz_iw = 0;}
  if (sz_w) {*sz_w = (3 * NV + NQ) * (NV + NC);}
  return 0;
}
"""

# Columns by coordinates, of such by changes of as many as there are rates.
COMPONENTS = """\
static void by_components(const double *q, const double *by_change, double *out)
{
  (void)q;
  memcpy(out, by_change, NQ * (NV + NC) * sizeof(double));
}
"""

COMPONENTS_WITH_QUATERNIONS = """\
static void by_components(const double *q, const double *by_change, double *out)
{
  /* What component a rotation about an axis changes each component by, and its sign. */
  static const int other[3][4] = {{3, 2, 1, 0}, {2, 3, 0, 1}, {1, 0, 3, 2}};
  static const double sign[3][4] = {{1, 1, -1, -1}, {-1, 1, 1, -1}, {1, -1, 1, -1}};
  enum { ROWS = NV + NC };
  for (int i = 0; i < NV; ++i) {
    if (place[i] >= 0) {
      memcpy(out + place[i] * ROWS, by_change + i * ROWS, ROWS * sizeof(double));
    }
  }
  for (int n = 0; n < BALLS; ++n) {
    for (int k = 0; k < 4; ++k) {
      double *to = out + (ball[n][0] + k) * ROWS;
      for (int row = 0; row < ROWS; ++row) {
        to[row] = 0.0;
        for (int axis = 0; axis < 3; ++axis) {
          to[row] += 2.0 * sign[axis][k] * q[ball[n][0] + other[axis][k]] *
            by_change[(ball[n][1] + axis) * ROWS + row];
        }
      }
    }
  }
}
"""

# Changes along a motion, where there is a degree of freedom; those of rotations in turning frames.
STRAIGHT = """\
static void turn_changes(const double *qd, const double *dq, double *out)
{
  (void)qd;
  (void)dq;
  (void)out;
}
"""

TURNING = """\
static void turn_changes(const double *qd, const double *dq, double *out)
{
  for (int n = 0; n < BALLS; ++n) {
    const double *w = qd + ball[n][1], *d = dq + ball[n][1];
    double *to = out + ball[n][1];
    to[0] -= w[1] * d[2] - w[2] * d[1];
    to[1] -= w[2] * d[0] - w[0] * d[2];
    to[2] -= w[0] * d[1] - w[1] * d[0];
  }
}
"""

# For mechanisms whose coordinates are all numbers.
PLAIN = """\
static void normalise(double *q) {(void)q;}

static void rates(const double *q, const double *qd, double *out)
{
  (void)q;
  memcpy(out, qd, NV * sizeof(double));
}

static void move(double *q, const double *change)
{
  for (int i = 0; i < NV; ++i) {
    q[i] += change[i];
  }
}

static int is_number(int freedom)
{
  (void)freedom;
  return 1;
}

static void apart(const double *q, const double *other, double *change)
{
  for (int i = 0; i < NV; ++i) {
    change[i] = q[i] - other[i];
  }
}
"""

# For mechanisms with orientations.
WITH_QUATERNIONS = """\
enum { BALLS = @BALLS@ };
/* First coordinate and first rate of each orientation; coordinates of the other rates, or -1. */
static const int ball[BALLS][2] = @BALL@;
static const int place[NV] = @PLACE@;

static void normalise(double *q)
{
  for (int n = 0; n < BALLS; ++n) {
    double *r = q + ball[n][0];
    const double factor = 1.0 / sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2] + r[3] * r[3]);
    for (int k = 0; k < 4; ++k) {
      r[k] *= factor;
    }
  }
}

static void rates(const double *q, const double *qd, double *out)
{
  for (int i = 0; i < NV; ++i) {
    if (place[i] >= 0) {
      out[place[i]] = qd[i];
    }
  }
  for (int n = 0; n < BALLS; ++n) {
    const double *r = q + ball[n][0], *turn = qd + ball[n][1];
    const double i = 0.5 * turn[0], j = 0.5 * turn[1], k = 0.5 * turn[2];
    double *to = out + ball[n][0];
    to[0] = r[3] * i + r[1] * k - r[2] * j;
    to[1] = r[3] * j + r[2] * i - r[0] * k;
    to[2] = r[3] * k + r[0] * j - r[1] * i;
    to[3] = -(r[0] * i + r[1] * j + r[2] * k);
  }
}

/* Turn by the exponential of a change. */
static void move(double *q, const double *change)
{
  for (int i = 0; i < NV; ++i) {
    if (place[i] >= 0) {
      q[place[i]] += change[i];
    }
  }
  for (int n = 0; n < BALLS; ++n) {
    double *r = q + ball[n][0];
    const double *turn = change + ball[n][1];
    double i = 0.5 * turn[0], j = 0.5 * turn[1], k = 0.5 * turn[2];
    const double angle = sqrt(i * i + j * j + k * k);
    const double sine = angle > 1e-9 ? sin(angle) / angle : 1.0, s = cos(angle);
    i *= sine;
    j *= sine;
    k *= sine;
    const double x = r[0], y = r[1], z = r[2], w = r[3];
    r[0] = w * i + x * s + y * k - z * j;
    r[1] = w * j + y * s + z * i - x * k;
    r[2] = w * k + z * s + x * j - y * i;
    r[3] = w * s - x * i - y * j - z * k;
  }
  normalise(q);
}

static int is_number(int freedom) {return place[freedom] >= 0;}

/* Changes along the rates from other coordinates to some, of orientations by the shorter turn. */
static void apart(const double *q, const double *other, double *change)
{
  for (int i = 0; i < NV; ++i) {
    if (place[i] >= 0) {
      change[i] = q[place[i]] - other[place[i]];
    }
  }
  for (int n = 0; n < BALLS; ++n) {
    const double *r = q + ball[n][0], *o = other + ball[n][0];
    double *to = change + ball[n][1];
    const double w = o[3] * r[3] + o[0] * r[0] + o[1] * r[1] + o[2] * r[2];
    to[0] = o[3] * r[0] - o[0] * r[3] - o[1] * r[2] + o[2] * r[1];
    to[1] = o[3] * r[1] - o[1] * r[3] - o[2] * r[0] + o[0] * r[2];
    to[2] = o[3] * r[2] - o[2] * r[3] - o[0] * r[1] + o[1] * r[0];
    const double sine = sqrt(to[0] * to[0] + to[1] * to[1] + to[2] * to[2]);
    /* Of small turns the sine is half the angle. */
    const double length = sine > 0.0 ? 2.0 * atan2(sine, fabs(w)) / sine : 2.0;
    for (int k = 0; k < 3; ++k) {
      to[k] *= w < 0.0 ? -length : length;
    }
  }
}
"""
