// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "callable_steps.hpp"

namespace closedloop
{

namespace
{
constexpr Index STATUSES = 16;

/// Call a function after the step of each row, which it returns the status of.
template<class Function>
Index of_rows(CallableSteps & of, Index count, const double * const * in, Function && then)
{
  const std::lock_guard<std::mutex> alone(*of.busy);
  const System & system = *of.system;
  const Index nq = system.nq(), nv = system.nv(), na = of.actuated.size;
  const Values start = of.tape.state[0], tau = of.run.torque[0];
  for (Index n = 0; n < count; ++n) {
    std::copy_n(in[0] + n * nq, nq, system.q(start).data);
    std::copy_n(in[1] + n * nv, nv, system.qd(start).data);
    // What is known of the equations that are worked on is of another motion.
    system.whole.numbers.fill(0.0);
    tau.fill(0.0);
    for (Index k = 0; k < na; ++k) {
      tau[of.actuated[k]] = in[2][n * na + k];
    }
    Status status = record_steps(system, of.run, of.scratch, of.tape).first;
    if (status == Status::DONE) {
      status = then(n);
    }
    if (status != Status::DONE) {
      return STATUSES * n + static_cast<Index>(status);
    }
  }
  return 0;
}

/// Coordinates and rates of a row of an array of both.
void copy_out(const CallableSteps & of, Values from, Index n, double * const * out)
{
  const Index nq = of.system->nq(), nv = of.system->nv();
  std::copy_n(from.data, nq, out[0] + n * nq);
  std::copy_n(from.data + nq, nv, out[1] + n * nv);
}

void copy_in(const CallableSteps & of, const double * const * in, Index n, Values to)
{
  const Index nq = of.system->nq(), nv = of.system->nv();
  std::copy_n(in[0] + n * nq, nq, to.data);
  std::copy_n(in[1] + n * nv, nv, to.data + nq);
}
}  // namespace

Index step_rows(
  CallableSteps * of, Index count, const double * const * in, double * const * out)
{
  return of_rows(
    *of, count, in, [&](Index n) {
      copy_out(*of, of->tape.state[of->tape.steps()], n, out);
      return Status::DONE;
    });
}

Index change_rows(
  CallableSteps * of, Index count, const double * const * in, double * const * out)
{
  const Index na = of->actuated.size;
  return of_rows(
    *of, count, in, [&](Index n) {
      copy_in(*of, in + 3, n, of->inputs.start);
      of->inputs.torque[0].fill(0.0);
      of->inputs.parameter.fill(0.0);
      for (Index k = 0; k < na; ++k) {
        of->inputs.torque(0, of->actuated[k]) = in[5][n * na + k];
      }
      const Status found = change_of_steps(
        *of->system, of->run, of->scratch, of->tape, of->routines, of->inputs,
        of->instants).first;
      copy_out(*of, of->instants[1], n, out);
      return found;
    });
}

Index weight_rows(
  CallableSteps * of, Index count, const double * const * in, double * const * out)
{
  const Index na = of->actuated.size;
  return of_rows(
    *of, count, in, [&](Index n) {
      of->instants[0].fill(0.0);
      copy_in(*of, in + 3, n, of->instants[1]);
      const Status found = gradient_of_steps(
        *of->system, of->run, of->scratch, of->tape, of->routines, of->instants,
        of->inputs).first;
      copy_out(*of, of->inputs.start, n, out);
      for (Index k = 0; k < na; ++k) {
        out[2][n * na + k] = of->inputs.torque(0, of->actuated[k]);
      }
      return found;
    });
}

CallableSteps callable_steps(
  const std::shared_ptr<System> & system, const SteppedRun & run, Table scratch,
  const Tape & tape, const StepRoutines & routines, Indices actuated, Table instants,
  const RunInputs & inputs)
{
  // Threads of other programs have no signals to look at.
  system->interrupted = nullptr;
  return {
    system, run, scratch, tape, routines, actuated, instants, inputs,
    std::make_unique<std::mutex>()};
}

void fill_addresses(CallableSteps & of, Indices out)
{
  out[0] = reinterpret_cast<Index>(&of);
  RowsFunction * const functions[] = {step_rows, change_rows, weight_rows};
  for (Index n = 0; n < 3; ++n) {
    out[1 + n] = reinterpret_cast<Index>(functions[n]);
  }
}

}  // namespace closedloop
