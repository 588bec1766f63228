// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "callable.hpp"

#include <algorithm>
#include <utility>

namespace closedloop
{

namespace
{
constexpr Index STATUSES = 16;
}

Callable::Callable(std::shared_ptr<System> system, Indices actuated)
: system_(std::move(system)), actuated_(actuated)
{
  // Threads of other programs have no signals to look at.
  system_->interrupted = nullptr;
}

template<Status (Callable::* Write)(Index, RowInputs, RowOutputs)>
Index Callable::of_rows(Callable * of, Index count, RowInputs in, RowOutputs out)
{
  const std::lock_guard<std::mutex> alone(of->busy_);
  for (Index n = 0; n < count; ++n) {
    Status status = of->compute(n, in);
    if (status == Status::DONE) {
      status = (of->*Write)(n, in, out);
    }
    if (status != Status::DONE) {
      return STATUSES * n + static_cast<Index>(status);
    }
  }
  return 0;
}

std::array<Index, 4> Callable::addresses()
{
  using Function = Index (Callable *, Index, RowInputs, RowOutputs);
  const auto address = [](Function * function) {return reinterpret_cast<Index>(function);};
  return {
    reinterpret_cast<Index>(this), address(of_rows<&Callable::write_results>),
    address(of_rows<&Callable::write_changes>), address(of_rows<&Callable::write_weights>)};
}

void Callable::take_row(Index n, RowInputs in, Values state, Values tau) const
{
  const Index nq = system_->nq(), nv = system_->nv(), na = actuated_.size;
  std::copy_n(in[0] + n * nq, nq, system_->q(state).data);
  std::copy_n(in[1] + n * nv, nv, system_->qd(state).data);
  tau.fill(0.0);
  for (Index k = 0; k < na; ++k) {
    tau[actuated_[k]] = in[2][n * na + k];
  }
  // What is known of the equations that are worked on is of another motion.
  system_->whole.numbers.fill(0.0);
}

}  // namespace closedloop
