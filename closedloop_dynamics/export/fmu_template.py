# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The C of a functional mock-up unit: the interface of FMI 2.0 or 3.0 around the C of a scene.

``fmu`` fills in the words. ``COMMON`` is what a unit is; then come the types and functions of a
version, and functions that both have, under the names of either. The types are those of the
standard's headers, which are not needed.
"""

# What the versions call otherwise.
WORDS = {
    '3.0': {'FMI': 'fmi3', 'BOOLEAN': 'bool', 'REAL': 'Float64', 'INTEGER': 'Int32',
            'LENGTH': ', size_t value_count', 'FITS': 'value_count == count', 'KEPT': 'FMUState',
            'DESERIALIZE': 'DeserializeFMUState', 'RATES': 'GetContinuousStateDerivatives'},
    '2.0': {'FMI': 'fmi2', 'BOOLEAN': 'int', 'REAL': 'Real', 'INTEGER': 'Integer',
            'LENGTH': '', 'FITS': '1', 'KEPT': 'FMUstate',
            'DESERIALIZE': 'DeSerializeFMUstate', 'RATES': 'GetDerivatives'}}

COMMON = """\
/* The interface of FMI @VERSION@ around @NAME@.c. */
#include "@NAME@.c"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

/* The standard hands over more than this unit needs. */
#if defined __GNUC__
#pragma GCC diagnostic ignored "-Wunused-parameter"
#endif

#if defined _WIN32
#define EXPORT __declspec(dllexport)
#else
#define EXPORT __attribute__((visibility("default")))
#endif

enum {
  POINTS = @UPPER@_POINTS, SIZE = @SIZE@, INPUTS = @INPUTS@, PARAMETERS = @PARAMETERS@,
  /* Independent coordinates; none where there is no model exchange. */
  FREE = @FREE@, EXCHANGE = @EXCHANGE@, DERIVATIVES = @DERIVATIVES@
};
/* Value references, in this order. */
enum {
  TIME, TAU, POSITION = TAU + INPUTS, RATE = POSITION + NQ, ACCELERATION = RATE + NV,
  MULTIPLIER = ACCELERATION + NV, PLACE = MULTIPLIER + NC, ENERGY = PLACE + SIZE * POINTS,
  STATE = ENERGY + 3, CHANGE = STATE + 2 * FREE, PARAMETER = CHANGE + 2 * FREE,
  STEP_SIZE = PARAMETER + PARAMETERS, ENERGY_LIMIT, STEP_COST, FREEDOM = STEP_COST + 3,
  END = FREEDOM + FREE
};
/* Statuses, of the same numbers in both versions. */
enum { OK, WARNING, DISCARD, ERROR };
/* Modes, as bits. */
enum {
  INSTANTIATED = 1, INITIALIZATION = 2, EVENT = 4, CONTINUOUS = 8, STEP = 16, TERMINATED = 32,
  RUNNING = EVENT | CONTINUOUS | STEP, ANY = 63
};

static const char token[] = "@TOKEN@";
/* Freedoms that the inputs act in; the coordinate of each freedom, or -1 of rotations. */
static const int input[INPUTS + 1] = {@INPUT@};
static const int coordinate[NV] = {@COORDINATE@};
/* How readily each freedom follows from the others: rotations always, driven ones seldom. */
static const double weight[NV] = {@WEIGHT@};
static const int first_choice[FREE + 1] = {@CHOICE@};
/* Start values of parameters, whether each may be changed while the model runs, and what of the
 * model follows: from place to place the parameter, the number of the model, and its share. */
static const double parameter_start[PARAMETERS + 1] = {@STARTS@};
static const unsigned char tunable[PARAMETERS + 1] = {@TUNABLE@};
enum { SHARES = @SHARES@ };
static const struct {int parameter; size_t number; double share;} shares[SHARES + 1] = {
@SHARE@
};

/* All that a state of the unit is. */
typedef struct {
  @NAME@_model model;
  @NAME@_state state;
  double tau[NV], qdd[NV], lam[NC1], time, step_size;
  double parameter[PARAMETERS + 1];
  /* Share of the energy exchanged that the balance may miss without a warning; at 0 nothing is
   * measured. */
  double energy_limit;
  /* Since the start: largest differences of a step to two of half its size, and the error of the
   * energy balance; stored and dissipated energy, and work; the most that was exchanged at the
   * end of a communication step. */
  double step_cost[3], stored, dissipated, work, exchanged;
  int choice[FREE + 1];
  /* Determinant of the dependent coordinates where they were chosen. */
  double chosen_at;
  /* Whether coordinates have been set, so that the loops are open; whether accelerations are
   * those of the state; in which mode the unit is; whether it has warned of the energy balance. */
  int open, known, mode, warned;
} Values;

typedef struct {
  Values values;
  int exchange;
  void *environment, *logger;
  char name[256];
} Instance;

static void complain(const Instance *instance, int status, const char *message);

static int failed(const Instance *instance, int status, const char *message)
{
  complain(instance, status == WARNING ? WARNING : ERROR, message);
  return status;
}

static const char *category(int status)
{
  return status == WARNING ? "logStatusWarning" : "logStatusError";
}

static const char *reason(int status)
{
  return status == @UPPER@_SINGULAR ? "closure equations depend on one another, or nearly" :
    status == @UPPER@_OPEN ? "the loops cannot be closed: the step is too large" :
    "the state left the finite numbers";
}

static int require(const Instance *instance, int modes, const char *function)
{
  return instance->values.mode & modes ? OK : failed(instance, ERROR, function);
}

static int closed(Instance *instance)
{
  Values *values = &instance->values;
  if (values->open) {
    const int status = EXCHANGE ?
      close_around(&values->model, values->choice, FREE, &values->state) :
      @NAME@_correct(&values->model, &values->state);
    if (status != @UPPER@_OK) {
      return failed(instance, DISCARD, reason(status));
    }
    values->open = 0;
  }
  return OK;
}

static int evaluated(Instance *instance)
{
  Values *values = &instance->values;
  const int status = closed(instance);
  if (status == OK && !values->known) {
    const int found = @NAME@_evaluate(
      &values->model, values->state.q, values->state.qd, values->tau, values->qdd, values->lam);
    if (found != @UPPER@_OK) {
      return failed(instance, DISCARD, reason(found));
    }
    values->known = 1;
  }
  return status;
}

/* Determinant of the equations by the dependent coordinates, in the present position. */
static double determinant_now(const Values *values)
{
  static const double none[NC1] = {0.0};
  double error[NC1], jacobian[NC1][NV], change[NV] = {0.0};
  @NAME@_closure(&values->model, values->state.q, error, jacobian[0]);
  return complete(values->choice, FREE, jacobian, none, 1, change);
}

/* Choose independent coordinates again, by elimination with complete pivoting. Returns whether
 * they have changed. */
static int choose(Values *values)
{
  double error[NC1], a[NC1][NV];
  int dependent[NV] = {0}, used[NC1] = {0}, changed = 0;
  @NAME@_closure(&values->model, values->state.q, error, a[0]);
  for (int k = 0; k < NC; ++k) {
    int row = -1, column = -1;
    double best = 0.0;
    for (int i = 0; i < NC; ++i) {
      for (int j = 0; j < NV; ++j) {
        if (!used[i] && !dependent[j] && weight[j] * fabs(a[i][j]) > best) {
          best = weight[j] * fabs(a[i][j]);
          row = i;
          column = j;
        }
      }
    }
    if (row < 0) {
      return 0;
    }
    used[row] = dependent[column] = 1;
    for (int i = 0; i < NC; ++i) {
      const double factor = used[i] ? 0.0 : a[i][column] / a[row][column];
      for (int j = 0; j < NV; ++j) {
        a[i][j] -= factor * a[row][j];
      }
    }
  }
  for (int j = 0, n = 0; j < NV; ++j) {
    if (!dependent[j] && coordinate[j] < 0) {
      return 0;
    }
    if (!dependent[j] && n < FREE) {
      changed |= values->choice[n] != j;
      values->choice[n++] = j;
    }
  }
  values->chosen_at = determinant_now(values);
  return changed;
}

static void begin(Values *values)
{
  memset(values, 0, sizeof *values);
  values->model = @NAME@_default;
  values->state = @NAME@_start;
  values->step_size = @LONGEST@;
  values->mode = INSTANTIATED;
  memcpy(values->parameter, parameter_start, sizeof parameter_start);
  memcpy(values->choice, first_choice, sizeof first_choice);
}

static Instance *instantiate(const char *name, const char *given, int exchange, void *environment,
                             void *logger)
{
  Instance *instance = calloc(1, sizeof *instance);
  if (!instance) {
    return 0;
  }
  if (name) {
    strncpy(instance->name, name, sizeof instance->name - 1);
  }
  instance->environment = environment;
  instance->logger = logger;
  instance->exchange = exchange;
  if (!given || strcmp(given, token) != 0 || (exchange && !EXCHANGE)) {
    failed(instance, ERROR, given && strcmp(given, token) == 0 ?
           "this unit has no model exchange" : "the token is not that of this unit");
    free(instance);
    return 0;
  }
  begin(&instance->values);
  return instance;
}

/* What of the model follows from the parameters. */
static void derive(Values *values)
{
  double *number = (double *)&values->model;
  memcpy(&values->model, &@NAME@_default, sizeof values->model);
  for (int n = 0; n < SHARES; ++n) {
    const int k = shares[n].parameter;
    number[shares[n].number] +=
      shares[n].share * (values->parameter[k] - parameter_start[k]);
  }
}

static int set(Instance *instance, unsigned reference, double value)
{
  Values *values = &instance->values;
  const int before = values->mode & (INSTANTIATED | INITIALIZATION);
  if (!isfinite(value)) {
    return failed(instance, ERROR, "set: a value is not finite");
  }
  values->known = 0;
  if (reference >= TAU && reference < POSITION) {
    values->tau[input[reference - TAU]] = value;
  } else if (before && reference >= STATE && reference < CHANGE) {
    const int n = (int)(reference - STATE);
    if (n < FREE) {
      values->state.q[coordinate[values->choice[n]]] = value;
    } else {
      values->state.qd[values->choice[n - FREE]] = value;
    }
    values->open = 1;
  } else if (reference >= PARAMETER && reference < STEP_SIZE &&
             (before || (tunable[reference - PARAMETER] && values->mode & (EVENT | STEP)))) {
    values->parameter[reference - PARAMETER] = value;
    derive(values);
    values->open |= before != 0;
  } else if (before && reference == STEP_SIZE && value > 0.0) {
    values->step_size = value;
  } else if (before && reference == ENERGY_LIMIT && value >= 0.0) {
    values->energy_limit = value;
  } else {
    return failed(instance, ERROR,
                  "set: such a variable cannot be set in this mode, or to this value");
  }
  return OK;
}

static int get(Instance *instance, unsigned reference, double *value)
{
  Values *values = &instance->values;
  if (reference == TIME) {
    *value = values->time;
  } else if (reference < POSITION) {
    *value = values->tau[input[reference - TAU]];
  } else if (reference >= PARAMETER && reference < STEP_SIZE) {
    *value = values->parameter[reference - PARAMETER];
  } else if (reference == STEP_SIZE) {
    *value = values->step_size;
  } else if (reference == ENERGY_LIMIT) {
    *value = values->energy_limit;
  } else if (reference >= STEP_COST && reference < FREEDOM) {
    *value = values->step_cost[reference - STEP_COST];
  } else if (reference >= FREEDOM) {
    return failed(instance, ERROR, "get: no such variable of this type");
  } else {
    const int of_accelerations = (reference >= ACCELERATION && reference < PLACE) ||
      (reference >= CHANGE + FREE && reference < PARAMETER);
    const int status = of_accelerations ? evaluated(instance) : closed(instance);
    if (status != OK) {
      return status;
    }
    if (reference < RATE) {
      *value = values->state.q[reference - POSITION];
    } else if (reference < ACCELERATION) {
      *value = values->state.qd[reference - RATE];
    } else if (reference < MULTIPLIER) {
      *value = values->qdd[reference - ACCELERATION];
    } else if (reference < PLACE) {
      *value = values->lam[reference - MULTIPLIER];
    } else if (reference < ENERGY) {
      double places[SIZE * POINTS + 1];
      @NAME@_points(&values->model, values->state.q, places);
      *value = places[reference - PLACE];
    } else if (reference < STATE) {
      double energies[3];
      @NAME@_energies(&values->model, &values->state, energies);
      *value = energies[reference - ENERGY];
    } else if (reference < STATE + FREE) {
      *value = values->state.q[coordinate[values->choice[reference - STATE]]];
    } else if (reference < CHANGE) {
      *value = values->state.qd[values->choice[reference - STATE - FREE]];
    } else if (reference < CHANGE + FREE) {
      *value = values->state.qd[values->choice[reference - CHANGE]];
    } else {
      *value = values->qdd[values->choice[reference - CHANGE - FREE]];
    }
  }
  return OK;
}

static int get_range(Instance *instance, unsigned first, double *found, size_t count)
{
  int status = count == 2 * FREE ? OK : ERROR;
  for (int n = 0; status == OK && n < 2 * FREE; ++n) {
    status = get(instance, first + (unsigned)n, found + n);
  }
  return status;
}

static int update(Instance *instance, int *changed)
{
  int status = require(instance, EVENT, "a discrete update: not in event mode");
  *changed = 0;
  status = status == OK ? closed(instance) : status;
  if (status == OK && determinant_now(&instance->values) < 0.2 * instance->values.chosen_at) {
    *changed = choose(&instance->values);
    instance->values.chosen_at = determinant_now(&instance->values);
  }
  return status;
}

static int measured_step(Values *values, double size)
{
  @NAME@_cost cost;
  const int status = @NAME@_step_cost(
    &values->model, &values->state, values->tau, size, &cost);
  if (status == @UPPER@_OK) {
    values->step_cost[0] = fmax(values->step_cost[0], cost.position);
    values->step_cost[1] = fmax(values->step_cost[1], cost.velocity);
    values->step_cost[2] += cost.residual;
    values->stored += cost.stored;
    values->dissipated += cost.dissipated;
    values->work += cost.work;
  }
  return status;
}

/* Warn once where the energy balance misses too much, beside rounding. */
static int judged(Instance *instance, double step_size)
{
  Values *values = &instance->values;
  double energies[3];
  char message[400];
  @NAME@_energies(&values->model, &values->state, energies);
  values->exchanged = fmax(values->exchanged, energies[0] + fabs(values->stored) +
                           fabs(values->dissipated) + fabs(values->work));
  const double lost = fabs(values->step_cost[2]) -
    1e-9 * (energies[0] + fabs(energies[1] + energies[2]));
  if (values->warned || lost <= values->energy_limit * values->exchanged) {
    return OK;
  }
  values->warned = 1;
  snprintf(message, sizeof message,
           "the energy balance misses %.3g J of the %.3g J exchanged until t = %.6g s: rk4 with "
           "steps of %g s and stabilisation: projection does not follow this motion. Take a "
           "smaller step_size.", lost, values->exchanged, values->time, step_size);
  return failed(instance, WARNING, message);
}

static int do_step(Instance *instance, double now, double size)
{
  Values *values = &instance->values, before;
  if (require(instance, STEP, "DoStep: not in step mode") != OK) {
    return ERROR;
  }
  if (!(fabs(now - values->time) <= 1e-9 * (1.0 + fabs(now))) || !(size > 0.0)) {
    return failed(instance, ERROR, "DoStep: expected to go on from where the last step ended");
  }
  before = *values;
  const double count = ceil(size / values->step_size - 1e-6);
  const long steps = count < 1.0 ? 1 : (long)count;
  for (long n = 0; n < steps; ++n) {
    const int status = values->energy_limit > 0.0 ?
      measured_step(values, size / (double)steps) :
      @NAME@_step(&values->model, &values->state, values->tau, size / (double)steps);
    if (status != @UPPER@_OK) {
      *values = before;
      return failed(instance, DISCARD, reason(status));
    }
  }
  values->time = now + size;
  values->known = 0;
  return values->energy_limit > 0.0 ? judged(instance, size / (double)steps) : OK;
}

/* Changes of outputs by those of inputs and states. */
static int differentiate(
  Instance *instance, const unsigned *unknowns, size_t count, const unsigned *knowns,
  size_t known_count, const double *seed, double *found)
{
#if @DERIVATIVES@
  Values *values = &instance->values;
  static double zero[NC1];
  double jacobian[NC1][NV], right[NC1] = {0.0}, qdd[NV], lam[NC1];
  double by[3][NV][NV + NC], rates_by[2][NV][NC1];
  double dq[NV] = {0.0}, dqd[NV] = {0.0}, dtau[NV] = {0.0}, moved[NQ];
  int status = require(
    instance, INITIALIZATION | RUNNING, "GetDirectionalDerivative: not initialized");
  status = status == OK ? evaluated(instance) : status;
  if (status != OK) {
    return status;
  }
  for (size_t n = 0; n < known_count; ++n) {
    const unsigned k = knowns[n];
    if (k >= TAU && k < POSITION) {
      dtau[input[k - TAU]] += seed[n];
    } else if (k >= STATE && k < STATE + FREE) {
      dq[values->choice[k - STATE]] += seed[n];
    } else if (k >= STATE + FREE && k < CHANGE) {
      dqd[values->choice[k - STATE - FREE]] += seed[n];
    } else {
      return failed(instance, ERROR,
                    "GetDirectionalDerivative: knowns are inputs and continuous states");
    }
  }
  const double *q = values->state.q, *qd = values->state.qd;
  if (@NAME@_evaluate(&values->model, q, qd, values->tau, qdd, lam) != @UPPER@_OK ||
      !derivatives_of(&values->model, q, qd, qdd, lam, by[0][0], &rates_by[0][0][0]))
  {
    return failed(instance, DISCARD, reason(@UPPER@_SINGULAR));
  }
  @NAME@_closure(&values->model, q, right, jacobian[0]);
  complete(values->choice, FREE, jacobian, zero, 1, dq);
  change_of_rates(&rates_by[0][0][0], dq, right);
  complete(values->choice, FREE, jacobian, right, 1, dqd);
  rates(q, dq, moved);
  for (size_t n = 0; n < count; ++n) {
    unsigned k = unknowns[n];
    if (k >= CHANGE && k < CHANGE + FREE) {
      k = RATE + (unsigned)values->choice[k - CHANGE];
    } else if (k >= CHANGE + FREE && k < PARAMETER) {
      k = ACCELERATION + (unsigned)values->choice[k - CHANGE - FREE];
    }
    if (k >= POSITION && k < RATE) {
      found[n] = moved[k - POSITION];
    } else if (k >= RATE && k < ACCELERATION) {
      found[n] = dqd[k - RATE];
    } else if (k >= ACCELERATION && k < PLACE) {
      const unsigned row = k - ACCELERATION;
      found[n] = 0.0;
      for (int j = 0; j < NV; ++j) {
        found[n] += by[0][j][row] * dq[j] + by[1][j][row] * dqd[j] + by[2][j][row] * dtau[j];
      }
    } else if (k >= PLACE && k < ENERGY) {
      double velocities[SIZE * POINTS + 1];
      @NAME@_velocities(&values->model, q, dq, velocities);
      found[n] = velocities[k - PLACE];
    } else {
      return failed(instance, ERROR,
                    "GetDirectionalDerivative: such an unknown has no derivative");
    }
  }
  return OK;
#else
  return failed(instance, ERROR, "this unit was written without derivatives");
#endif
}

static int enter(Instance *instance, int from, int to, const char *complaint)
{
  const int status = require(instance, from, complaint);
  if (status == OK) {
    instance->values.mode = to;
  }
  return status;
}

/* There are no other variables: with none asked for, all is well. */
static int without(const Instance *instance, size_t count)
{
  return count ? failed(instance, ERROR, "this unit has no such variables") : OK;
}

typedef int @FMI@Status;
typedef unsigned @FMI@ValueReference;
typedef @BOOLEAN@ @FMI@Boolean;

/* A function of variables that are not there. */
#define NONE(NAME, ...) \\
  EXPORT @FMI@Status @FMI@ ## NAME( \\
    Instance *instance, const @FMI@ValueReference references[], size_t count, __VA_ARGS__) \\
  { \\
    return without(instance, count); \\
  }
/* A function that this unit has no answer to. */
#define REFUSED(NAME, STATUS, MESSAGE, ...) \\
  EXPORT @FMI@Status @FMI@ ## NAME(__VA_ARGS__) \\
  { \\
    return failed(instance, STATUS, MESSAGE); \\
  }
"""

FMI3 = """
/* FMI 3.0. */
typedef void (*fmi3LogMessageCallback)(void *, fmi3Status, const char *, const char *);

static void complain(const Instance *instance, int status, const char *message)
{
  if (instance->logger) {
    fmi3LogMessageCallback log;
    memcpy(&log, &instance->logger, sizeof log);
    log(instance->environment, status, category(status), message);
  }
}

EXPORT const char *fmi3GetVersion(void) {return "3.0";}

static void *kept(fmi3LogMessageCallback log)
{
  void *logger;
  memcpy(&logger, &log, sizeof logger);
  return logger;
}

EXPORT void *fmi3InstantiateModelExchange(
  const char *name, const char *given, const char *path, bool visible, bool logging,
  void *environment, fmi3LogMessageCallback log)
{
  return instantiate(name, given, 1, environment, kept(log));
}

EXPORT void *fmi3InstantiateCoSimulation(
  const char *name, const char *given, const char *path, bool visible, bool logging,
  bool event_mode, bool early_return, const fmi3ValueReference intermediate[], size_t count,
  void *environment, fmi3LogMessageCallback log, void (*update_between)(void))
{
  if (event_mode || count) {
    if (log) {
      log(environment, ERROR, "logStatusError",
          "this unit has neither event mode nor intermediate update in co-simulation");
    }
    return 0;
  }
  return instantiate(name, given, 0, environment, kept(log));
}

EXPORT void *fmi3InstantiateScheduledExecution(
  const char *name, const char *given, const char *path, bool visible, bool logging,
  void *environment, fmi3LogMessageCallback log, void (*tick)(void *), void (*lock)(void),
  void (*unlock)(void))
{
  if (log) {
    log(environment, ERROR, "logStatusError", "this unit has no scheduled execution");
  }
  return 0;
}

EXPORT fmi3Status fmi3EnterInitializationMode(
  Instance *instance, bool has_tolerance, double tolerance, double start, bool has_stop,
  double stop)
{
  instance->values.time = start;
  return enter(instance, INSTANTIATED, INITIALIZATION,
               "EnterInitializationMode: not instantiated, or past it");
}

EXPORT fmi3Status fmi3EnterEventMode(Instance *instance)
{
  return enter(instance, CONTINUOUS, EVENT, "EnterEventMode: not in continuous-time mode");
}

#define NO_TYPE(NAME, TYPE) \\
  NONE(Get ## NAME, TYPE values[], size_t value_count) \\
  NONE(Set ## NAME, const TYPE values[], size_t value_count)
NO_TYPE(Float32, float)
NO_TYPE(Int8, int8_t)
NO_TYPE(UInt8, uint8_t)
NO_TYPE(Int16, int16_t)
NO_TYPE(UInt16, uint16_t)
NONE(SetInt32, const int32_t values[], size_t value_count)
NO_TYPE(UInt32, uint32_t)
NO_TYPE(Int64, int64_t)
NO_TYPE(UInt64, uint64_t)
NO_TYPE(Boolean, bool)
NONE(GetString, const char *values[], size_t value_count)
NONE(SetString, const char *const values[], size_t value_count)
NONE(GetBinary, size_t sizes[], const uint8_t *values[], size_t value_count)
NONE(SetBinary, const size_t sizes[], const uint8_t *const values[], size_t value_count)
NONE(GetClock, bool values[])
NONE(SetClock, const bool values[])
NONE(GetIntervalDecimal, double intervals[], int qualifiers[])
NONE(GetIntervalFraction, uint64_t counters[], uint64_t resolutions[], int qualifiers[])
NONE(GetShiftDecimal, double shifts[])
NONE(GetShiftFraction, uint64_t counters[], uint64_t resolutions[])
NONE(SetIntervalDecimal, const double intervals[])
NONE(SetIntervalFraction, const uint64_t counters[], const uint64_t resolutions[])
NONE(SetShiftDecimal, const double shifts[])
NONE(SetShiftFraction, const uint64_t counters[], const uint64_t resolutions[])
NONE(GetOutputDerivatives, const int32_t orders[], double values[], size_t value_count)

/* All outputs may depend on all inputs and states; modelDescription.xml names no less. */
REFUSED(GetNumberOfVariableDependencies, ERROR,
        "this unit reports no dependencies of single elements",
        Instance *instance, fmi3ValueReference reference, size_t *count)
REFUSED(GetVariableDependencies, ERROR, "this unit reports no dependencies of single elements",
        Instance *instance, fmi3ValueReference dependent, size_t elements[],
        fmi3ValueReference independents[], size_t elements_of_these[], int kinds[], size_t count)
REFUSED(EnterConfigurationMode, ERROR, "this unit has no structural parameters",
        Instance *instance)
REFUSED(ExitConfigurationMode, ERROR, "this unit has no structural parameters",
        Instance *instance)
REFUSED(EnterStepMode, ERROR, "EnterStepMode: there is no event mode in co-simulation",
        Instance *instance)
REFUSED(ActivateModelPartition, ERROR, "this unit has no scheduled execution",
        Instance *instance, fmi3ValueReference clock, double time)

EXPORT fmi3Status fmi3GetDirectionalDerivative(
  Instance *instance, const fmi3ValueReference unknowns[], size_t count,
  const fmi3ValueReference knowns[], size_t known_count, const double seed[], size_t seeds,
  double found[], size_t results)
{
  return seeds == known_count && results == count ?
    differentiate(instance, unknowns, count, knowns, known_count, seed, found) : ERROR;
}

EXPORT fmi3Status fmi3GetAdjointDerivative(
  Instance *instance, const fmi3ValueReference unknowns[], size_t count,
  const fmi3ValueReference knowns[], size_t known_count, const double seed[], size_t seeds,
  double found[], size_t results)
{
  int status = seeds == count && results == known_count ? OK : ERROR;
  for (size_t k = 0; status == OK && k < known_count; ++k) {
    found[k] = 0.0;
    for (size_t n = 0; status == OK && n < count; ++n) {
      const double one = 1.0;
      double change = 0.0;
      status = differentiate(instance, unknowns + n, 1, knowns + k, 1, &one, &change);
      found[k] += status == OK ? seed[n] * change : 0.0;
    }
  }
  return status;
}

EXPORT fmi3Status fmi3EvaluateDiscreteStates(Instance *instance)
{
  return require(instance, INITIALIZATION | EVENT, "EvaluateDiscreteStates: not in event mode");
}

EXPORT fmi3Status fmi3UpdateDiscreteStates(
  Instance *instance, bool *again, bool *terminate, bool *nominals, bool *changed,
  bool *has_next, double *next)
{
  int other = 0;
  const int status = update(instance, &other);
  *again = *terminate = *has_next = false;
  *nominals = *changed = other != 0;
  return status;
}

EXPORT fmi3Status fmi3GetNumberOfEventIndicators(Instance *instance, size_t *count)
{
  *count = 0;
  return OK;
}

EXPORT fmi3Status fmi3GetNumberOfContinuousStates(Instance *instance, size_t *count)
{
  *count = 2 * FREE;
  return OK;
}

EXPORT fmi3Status fmi3DoStep(
  Instance *instance, double now, double size, bool no_way_back, bool *event, bool *terminate,
  bool *early, double *last)
{
  const int status = do_step(instance, now, size);
  *event = *terminate = *early = false;
  *last = instance->values.time;
  return status;
}
"""

FMI2 = """
/* FMI 2.0. */
typedef struct {
  void (*logger)(void *, const char *, fmi2Status, const char *, const char *, ...);
  void *(*allocateMemory)(size_t, size_t);
  void (*freeMemory)(void *);
  void (*stepFinished)(void *, fmi2Status);
  void *componentEnvironment;
} fmi2CallbackFunctions;
typedef struct {
  int newDiscreteStatesNeeded, terminateSimulation, nominalsOfContinuousStatesChanged,
    valuesOfContinuousStatesChanged, nextEventTimeDefined;
  double nextEventTime;
} fmi2EventInfo;

static void complain(const Instance *instance, int status, const char *message)
{
  if (instance->logger) {
    void (*log)(void *, const char *, fmi2Status, const char *, const char *, ...);
    memcpy(&log, &instance->logger, sizeof log);
    log(instance->environment, instance->name, status, category(status), "%s", message);
  }
}

EXPORT const char *fmi2GetTypesPlatform(void) {return "default";}
EXPORT const char *fmi2GetVersion(void) {return "2.0";}

EXPORT void *fmi2Instantiate(
  const char *name, int kind, const char *given, const char *path,
  const fmi2CallbackFunctions *functions, int visible, int logging)
{
  void *logger = 0;
  if (functions) {
    memcpy(&logger, &functions->logger, sizeof logger);
  }
  return instantiate(
    name, given, kind == 0, functions ? functions->componentEnvironment : 0, logger);
}

EXPORT fmi2Status fmi2SetupExperiment(
  Instance *instance, int has_tolerance, double tolerance, double start, int has_stop,
  double stop)
{
  instance->values.time = start;
  return require(instance, INSTANTIATED, "SetupExperiment: not instantiated, or past it");
}

EXPORT fmi2Status fmi2EnterInitializationMode(Instance *instance)
{
  return enter(instance, INSTANTIATED, INITIALIZATION,
               "EnterInitializationMode: not instantiated, or past it");
}

NONE(SetInteger, const int values[])
NONE(GetBoolean, int values[])
NONE(SetBoolean, const int values[])
NONE(GetString, const char *values[])
NONE(SetString, const char *const values[])
NONE(SetRealInputDerivatives, const int orders[], const double values[])
NONE(GetRealOutputDerivatives, const int orders[], double values[])

REFUSED(CancelStep, ERROR, "CancelStep: steps are made at once", Instance *instance)
REFUSED(GetStatus, DISCARD, "GetStatus: steps are made at once",
        Instance *instance, int kind, fmi2Status *value)
REFUSED(GetIntegerStatus, DISCARD, "GetIntegerStatus: there is none",
        Instance *instance, int kind, int *value)
REFUSED(GetStringStatus, DISCARD, "GetStringStatus: there is none",
        Instance *instance, int kind, const char **value)

EXPORT fmi2Status fmi2GetDirectionalDerivative(
  Instance *instance, const fmi2ValueReference unknowns[], size_t count,
  const fmi2ValueReference knowns[], size_t known_count, const double seed[], double found[])
{
  return differentiate(instance, unknowns, count, knowns, known_count, seed, found);
}

EXPORT fmi2Status fmi2EnterEventMode(Instance *instance)
{
  return enter(instance, EVENT | CONTINUOUS, EVENT, "EnterEventMode: not in model exchange");
}

EXPORT fmi2Status fmi2NewDiscreteStates(Instance *instance, fmi2EventInfo *info)
{
  int other = 0;
  const int status = update(instance, &other);
  memset(info, 0, sizeof *info);
  info->nominalsOfContinuousStatesChanged = info->valuesOfContinuousStatesChanged = other;
  return status;
}

EXPORT fmi2Status fmi2DoStep(Instance *instance, double now, double size, int no_way_back)
{
  return do_step(instance, now, size);
}

EXPORT fmi2Status fmi2GetRealStatus(Instance *instance, int kind, double *value)
{
  if (kind != 2) {
    return failed(instance, DISCARD, "GetRealStatus: the last successful time alone is known");
  }
  *value = instance->values.time;
  return OK;
}

EXPORT fmi2Status fmi2GetBooleanStatus(Instance *instance, int kind, int *value)
{
  if (kind != 3) {
    return failed(instance, DISCARD, "GetBooleanStatus: there is none but termination");
  }
  *value = 0;
  return OK;
}
"""

BOTH = """
/* Of both versions. */
EXPORT @FMI@Status @FMI@SetDebugLogging(
  void *instance, @FMI@Boolean on, size_t count, const char *const categories[])
{
  return OK;
}

EXPORT void @FMI@FreeInstance(void *instance) {free(instance);}

EXPORT @FMI@Status @FMI@ExitInitializationMode(Instance *instance)
{
  int status = require(instance, INITIALIZATION, "ExitInitializationMode: not in its mode");
  status = status == OK ? closed(instance) : status;
  if (status == OK) {
    Values *values = &instance->values;
    values->chosen_at = EXCHANGE ? determinant_now(values) : 0.0;
    values->mode = instance->exchange ? EVENT : STEP;
  }
  return status == DISCARD ? ERROR : status;
}

EXPORT @FMI@Status @FMI@Terminate(Instance *instance)
{
  return enter(instance, RUNNING, TERMINATED, "Terminate: not initialized");
}

EXPORT @FMI@Status @FMI@Reset(Instance *instance)
{
  begin(&instance->values);
  return OK;
}

EXPORT @FMI@Status @FMI@Get@REAL@(
  Instance *instance, const @FMI@ValueReference references[], size_t count,
  double values[]@LENGTH@)
{
  int status = @FITS@ ? OK : ERROR;
  for (size_t n = 0; status == OK && n < count; ++n) {
    status = get(instance, references[n], values + n);
  }
  return status;
}

EXPORT @FMI@Status @FMI@Set@REAL@(
  Instance *instance, const @FMI@ValueReference references[], size_t count,
  const double values[]@LENGTH@)
{
  int status = @FITS@ ? OK : ERROR;
  for (size_t n = 0; status == OK && n < count; ++n) {
    status = set(instance, references[n], values[n]);
  }
  return status;
}

EXPORT @FMI@Status @FMI@Get@INTEGER@(
  Instance *instance, const @FMI@ValueReference references[], size_t count,
  int32_t values[]@LENGTH@)
{
  int status = @FITS@ ? OK : ERROR;
  for (size_t n = 0; status == OK && n < count; ++n) {
    if (references[n] < FREEDOM || references[n] >= END) {
      return failed(instance, ERROR, "get: no such variable of this type");
    }
    values[n] = instance->values.choice[references[n] - FREEDOM];
  }
  return status;
}

/* Copy a state, into memory of its own where there is none yet. */
static int copied(const Instance *instance, const void *from, void **to)
{
  if (!*to && !(*to = malloc(sizeof(Values)))) {
    return failed(instance, ERROR, "no memory is left");
  }
  memcpy(*to, from, sizeof(Values));
  return OK;
}

EXPORT @FMI@Status @FMI@Get@KEPT@(Instance *instance, void **state)
{
  return copied(instance, &instance->values, state);
}

EXPORT @FMI@Status @FMI@Set@KEPT@(Instance *instance, const void *state)
{
  if (!state) {
    return failed(instance, ERROR, "Set@KEPT@: expected a state");
  }
  memcpy(&instance->values, state, sizeof(Values));
  return OK;
}

EXPORT @FMI@Status @FMI@Free@KEPT@(Instance *instance, void **state)
{
  if (state) {
    free(*state);
    *state = 0;
  }
  return OK;
}

enum { SERIAL = sizeof token + sizeof(Values) };

EXPORT @FMI@Status @FMI@Serialized@KEPT@Size(Instance *instance, const void *state, size_t *size)
{
  *size = SERIAL;
  return OK;
}

EXPORT @FMI@Status @FMI@Serialize@KEPT@(
  Instance *instance, const void *state, unsigned char bytes[], size_t size)
{
  if (!state || size < SERIAL) {
    return failed(instance, ERROR, "Serialize@KEPT@: expected a state, and room for it");
  }
  memcpy(bytes, token, sizeof token);
  memcpy(bytes + sizeof token, state, sizeof(Values));
  return OK;
}

EXPORT @FMI@Status @FMI@@DESERIALIZE@(
  Instance *instance, const unsigned char bytes[], size_t size, void **state)
{
  if (size < SERIAL || memcmp(bytes, token, sizeof token) != 0) {
    return failed(instance, ERROR, "@DESERIALIZE@: this is not a state of this unit");
  }
  return copied(instance, bytes + sizeof token, state);
}

EXPORT @FMI@Status @FMI@EnterContinuousTimeMode(Instance *instance)
{
  return enter(instance, EVENT, CONTINUOUS, "EnterContinuousTimeMode: not in event mode");
}

/* At the end of a step: whether other coordinates had better be independent. */
EXPORT @FMI@Status @FMI@CompletedIntegratorStep(
  Instance *instance, @FMI@Boolean no_way_back, @FMI@Boolean *event, @FMI@Boolean *terminate)
{
  const Values *values = &instance->values;
  int status = require(instance, CONTINUOUS, "CompletedIntegratorStep: not in its mode");
  status = status == OK ? closed(instance) : status;
  *event = status == OK && determinant_now(values) < 0.2 * values->chosen_at;
  *terminate = 0;
  return status;
}

EXPORT @FMI@Status @FMI@SetTime(Instance *instance, double time)
{
  instance->values.time = time;
  return require(instance, CONTINUOUS | EVENT, "SetTime: not in model exchange");
}

EXPORT @FMI@Status @FMI@SetContinuousStates(
  Instance *instance, const double states[], size_t count)
{
  Values *values = &instance->values;
  if (require(instance, CONTINUOUS, "SetContinuousStates: not in continuous-time mode") != OK ||
      count != 2 * FREE)
  {
    return ERROR;
  }
  for (int n = 0; n < FREE; ++n) {
    values->state.q[coordinate[values->choice[n]]] = states[n];
    values->state.qd[values->choice[n]] = states[FREE + n];
  }
  values->open = 1;
  values->known = 0;
  return OK;
}

EXPORT @FMI@Status @FMI@@RATES@(Instance *instance, double derivatives[], size_t count)
{
  return get_range(instance, CHANGE, derivatives, count);
}

EXPORT @FMI@Status @FMI@GetEventIndicators(Instance *instance, double indicators[], size_t count)
{
  return without(instance, count);
}

EXPORT @FMI@Status @FMI@GetContinuousStates(Instance *instance, double states[], size_t count)
{
  return get_range(instance, STATE, states, count);
}

EXPORT @FMI@Status @FMI@GetNominalsOfContinuousStates(
  Instance *instance, double nominals[], size_t count)
{
  for (size_t n = 0; n < count; ++n) {
    nominals[n] = 1.0;
  }
  return OK;
}
"""
