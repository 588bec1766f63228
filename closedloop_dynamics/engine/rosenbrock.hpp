// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ROSENBROCK_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ROSENBROCK_HPP_

#include <utility>
#include <vector>

#include "error_control.hpp"
#include "fixed_steps.hpp"

// RODAS4, a linearly implicit method for stiff scenes: L-stable, stiffly accurate, order 4(3). Each
// step solves six linear systems with one factorization of I - h gamma J; the Jacobian J comes from
// generated code where the scene has derivatives and the system has that code, else from finite
// differences of the derivative. Its cost grows with the cube of the number of states.
//
// Source: Hairer and Wanner, Solving Ordinary Differential Equations II, 2nd ed. (1996), section
// VI.4, in the form that needs no product with J.

namespace closedloop
{

/// Rows of the scratch of the stiff method.
constexpr Index STIFF_ROWS = 12;

/// The matrix of a step, factored, and the scratch.
struct StiffScratch
{
  Table matrix;  ///< Shape (ns, ns)
  Indices pivots;  ///< Shape (ns,)
  Table rows;  ///< Shape (STIFF_ROWS, ns)
};

/// One step with error control, on the memory of a run.
struct StiffStep
{
  Stabilisation stabilisation;
  StepControl & control;
  Table scale;  ///< Shape (2, ns): absolute and relative tolerances
  StiffScratch scratch;

  /// Make one accepted step of a state, in place, up to `limit` at most [s].
  Status make(const System &, Values state, double limit, Interrupt &) const;
};

/// Memory of the stiff method that a stepper owns.
class StiffMemory
{
public:
  explicit StiffMemory(Index states)
  : matrix_(states, states), rows_(STIFF_ROWS, states), pivots_(static_cast<std::size_t>(states)) {}
  StiffScratch view() {return {matrix_.view(), closedloop::view(pivots_), rows_.view()};}
  /// The same matrix with other rows.
  StiffScratch with(Table rows) {return {matrix_.view(), closedloop::view(pivots_), rows};}

private:
  OwnedTable matrix_, rows_;
  std::vector<Index> pivots_;
};

/// Steps of one size.
class FixedStiffSteps : public StepsOfOneSize<FixedStiffSteps>
{
public:
  FixedStiffSteps(const System & system, const MethodOptions & options)
  : StepsOfOneSize(system, options.stabilisation), memory_(system.ns()) {}
  void rewind(const System &) override {memory_.view().rows.fill(0.0);}

  std::pair<Status, Index> make(
    const System &, Values state, double step_size, Index steps);

private:
  StiffMemory memory_;
};

/// Steps with error control; the last of an advance ends on the grid.
class StiffSteps : public StepperOf<StiffSteps>
{
public:
  StiffSteps(const System &, const MethodOptions &);
  Advance advance(const System &, Values state, const Grid &) override;
  void go_on() override {continues_ = true;}
  void restart(const System &, bool moved) override;
  void rewind(const System &) override;
  StepReport report() const override {return report_of(control_, tolerance_);}
  void clear_report() override {control_.clear_counts();}

private:
  double tolerance_;
  bool continues_ = false;
  StepControl control_;
  OwnedTable scale_;
  StiffMemory memory_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ROSENBROCK_HPP_
