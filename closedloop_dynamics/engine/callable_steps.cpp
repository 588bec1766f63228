// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <algorithm>

#include "callable.hpp"

namespace closedloop
{

namespace
{
class CallableSteps : public Callable
{
public:
  CallableSteps(
    const std::shared_ptr<System> & system, const SteppedRun & run, Table scratch,
    const Tape & tape, const StepRoutines & routines, Indices actuated, Table ends,
    const RunInputs & inputs)
  : Callable(system, actuated), run_(run), scratch_(scratch), tape_(tape), routines_(routines),
    ends_(ends), inputs_(inputs) {}

  Status compute(Index n, RowInputs in) override
  {
    take_row(n, in, tape_.state[0], run_.torque[0]);
    return record_steps(*system_, run_, scratch_, tape_).first;
  }

  Status write_results(Index n, RowInputs, RowOutputs out) override
  {
    copy_out(tape_.state[tape_.steps()], n, out);
    return Status::DONE;
  }

  Status write_changes(Index n, RowInputs in, RowOutputs out) override
  {
    copy_in(in + 3, n, inputs_.start);
    inputs_.torque[0].fill(0.0);
    inputs_.parameter.fill(0.0);
    for (Index k = 0; k < actuated_.size; ++k) {
      inputs_.torque(0, actuated_[k]) = in[5][n * actuated_.size + k];
    }
    const Status found = change_of_steps(
      *system_, run_, scratch_, tape_, routines_, inputs_, ends_).first;
    copy_out(ends_[1], n, out);
    return found;
  }

  Status write_weights(Index n, RowInputs in, RowOutputs out) override
  {
    ends_[0].fill(0.0);
    copy_in(in + 3, n, ends_[1]);
    const Status found = gradient_of_steps(
      *system_, run_, scratch_, tape_, routines_, ends_, inputs_).first;
    copy_out(inputs_.start, n, out);
    for (Index k = 0; k < actuated_.size; ++k) {
      out[2][n * actuated_.size + k] = inputs_.torque(0, actuated_[k]);
    }
    return found;
  }

private:
  /// Coordinates and rates of a row of an array of both.
  void copy_out(Values from, Index n, RowOutputs out) const
  {
    const Index nq = system_->nq(), nv = system_->nv();
    std::copy_n(from.data, nq, out[0] + n * nq);
    std::copy_n(from.data + nq, nv, out[1] + n * nv);
  }
  void copy_in(RowInputs in, Index n, Values to) const
  {
    const Index nq = system_->nq(), nv = system_->nv();
    std::copy_n(in[0] + n * nq, nq, to.data);
    std::copy_n(in[1] + n * nv, nv, to.data + nq);
  }

  const SteppedRun run_;
  const Table scratch_;
  const Tape tape_;
  const StepRoutines routines_;
  const Table ends_;
  const RunInputs inputs_;
};
}  // namespace

std::shared_ptr<Callable> callable_steps(
  const std::shared_ptr<System> & system, const SteppedRun & run, Table scratch,
  const Tape & tape, const StepRoutines & routines, Indices actuated, Table ends,
  const RunInputs & inputs)
{
  check(*system, run, tape);
  return std::make_shared<CallableSteps>(
    system, run, scratch, tape, routines, actuated, ends, inputs);
}

}  // namespace closedloop
