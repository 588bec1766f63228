# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The C that is the same for all mechanisms; ``c_source`` fills in the rest."""

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
 * SI units and radians throughout. */
#ifndef @UPPER@_H_
#define @UPPER@_H_

#ifdef __cplusplus
extern "C" {
#endif

/* Numbers of coordinates, of rates and torques, of multipliers, and of named points. */
enum { @UPPER@_NQ = @NQ@, @UPPER@_NV = @NV@, @UPPER@_NC = @NC@, @UPPER@_POINTS = @NP@ };

/* What functions return. Where it is not OK, nothing that they were given has changed. */
enum {
  @UPPER@_OK = 0,
  /* Closure equations depend on one another there, or nearly: a singular position. */
  @UPPER@_SINGULAR = 1,
  /* The loops cannot be closed: the step is too large. */
  @UPPER@_OPEN = 2,
  /* The state left the finite numbers. */
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

/* Kinetic energy, that in gravity, and that stored in springs [J]. */
void @NAME@_energies(const @NAME@_model *model, const @NAME@_state *state, double energies[3]);

/* Places of the named points in the world [m], @SPACE@ numbers each:
@POINTS@ */
void @NAME@_points(const @NAME@_model *model, const double *q, double *places);

/* Their velocities [m/s]. */
void @NAME@_velocities(
  const @NAME@_model *model, const double *q, const double *qd, double *velocities);

/* Errors of the closure equations, errors[NC] [m, rad], and their Jacobian, NC rows of NV numbers,
 * in the order of the multipliers. */
void @NAME@_closure(
  const @NAME@_model *model, const double *q, double *errors, double *jacobian);
@FORCES@@DIFFERENTIATE@
/* Names, for programs that load this code as a library: of q and of qd, each table ended by 0. */
extern const char *const @NAME@_position_names[];
extern const char *const @NAME@_velocity_names[];

/* CasADi's calling convention: casadi.external('@NAME@', './@NAME@.so') is the evaluation of the
 * default model as a function (q, qd, tau) -> (qdd, lam). */
int @NAME@(const double **arg, double **res, long long int *iw, double *w, int mem);

#ifdef __cplusplus
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

enum { NQ = @UPPER@_NQ, NV = @UPPER@_NV, NC = @UPPER@_NC };
/* Arrays have a length. */
enum { NC1 = NC > 0 ? NC : 1 };

const @NAME@_model @NAME@_default = {
@DEFAULT@
};

const @NAME@_state @NAME@_start = {
@START@
};

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
  enum { MOST = 8 };
  double change[2 * NV], closure[NC1];
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

/* What to step along: rates of coordinates, then accelerations. */
static int slope_at(
  const @NAME@_model *model, const double *state, const double *tau, double *slope)
{
  double lam[NC1];
  rates(state, state + NQ, slope);
  return evaluation(model, state, state + NQ, tau, slope + NQ, lam);
}

int @NAME@_step(
  const @NAME@_model *model, @NAME@_state *state, const double *tau, double step_size)
{
  enum { STATES = NQ + NV };
  static const double share[3] = {0.5, 0.5, 1.0};
  static const double weight[4] = {1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0};
  double start[STATES], stage[STATES], slope[4][STATES];
  memcpy(start, state->q, sizeof state->q);
  memcpy(start + NQ, state->qd, sizeof state->qd);
  if (!slope_at(model, start, tau, slope[0])) {
    return @UPPER@_SINGULAR;
  }
  for (int k = 0; k < 3; ++k) {
    for (int i = 0; i < STATES; ++i) {
      stage[i] = start[i] + step_size * (share[k] * slope[k][i]);
    }
    if (!slope_at(model, stage, tau, slope[k + 1])) {
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

void @NAME@_closure(
  const @NAME@_model *model, const double *q, double *errors, double *jacobian)
{
  closures_of(model, q, errors, jacobian);
}
@WRENCHES@
const char *const @NAME@_position_names[] = {@POSITIONS@};
const char *const @NAME@_velocity_names[] = {@VELOCITIES@};

/* CasADi's calling convention. */

enum { ARGUMENTS = 3, RESULTS = 2 };

int @NAME@(const double **arg, double **res, long long int *iw, double *w, int mem)
{
  static const double zero[NQ + NV];
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
@JACOBIANS@
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

# Where derivatives are asked for: in the header, and behind the functions of CasADi.
DIFFERENTIATE = """
/* Accelerations, multipliers and derivatives of both, of coordinates that close the loops: NV
 * columns by coordinates, NV by rates, NV by torques, each of NV + NC numbers, those of the
 * accelerations first. Each coordinate of the tree is changed alone; orientations are turned about
 * the child's axes. */
int @NAME@_differentiate(
  const @NAME@_model *model, const double *q, const double *qd, const double *tau, double *qdd,
  double *lam, double *derivatives);
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
  if (!BEST(columns_of, (model, q, qd, qdd, lam, columns[0], factors, rates))) {
    return 0;
  }
  for (int block = 0; block < BLOCKS; ++block) {
    BEST(solve, (columns[block], factors, found));
    for (int n = 0; n < 8 && 8 * block + n < COLUMNS; ++n) {
      for (int row = 0; row < ROWS; ++row) {
        *derivatives++ = found[8 * row + n];
      }
    }
  }
  return 1;
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

/* All Jacobians, blocks of their own: of each result by each argument. */
int jac_@NAME@(const double **arg, double **res, long long int *iw, double *w, int mem)
{
  static const double zero[NQ + NV];
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

# Of mechanisms whose coordinates are all numbers.
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
"""

# Of mechanisms with orientations.
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
"""
