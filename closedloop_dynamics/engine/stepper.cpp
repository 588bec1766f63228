// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "stepper.hpp"

#include <stdexcept>

#include "fixed_steps.hpp"
#include "switching.hpp"

namespace closedloop
{

namespace
{
struct Entry
{
  std::string_view name;
  std::unique_ptr<Stepper> (* make)(const System &, const MethodOptions &);
};

template<class Method>
constexpr Entry entry(std::string_view name)
{
  return {name, [](const System & system, const MethodOptions & options) {
            return std::unique_ptr<Stepper>(std::make_unique<Method>(system, options));
          }};
}

constexpr Entry methods[] = {
  entry<FixedSteps>("fixed"), entry<ErrorControlledSteps>("explicit"),
  entry<SwitchingSteps>("auto"), entry<FixedStiffSteps>("rodas4_fixed"),
  entry<StiffSteps>("rodas4")};
}  // namespace

void Stepper::aim(double)
{
  throw std::invalid_argument("this method keeps no accuracy that could be changed");
}

std::unique_ptr<Stepper> make_stepper(
  const System & system, std::string_view name, const MethodOptions & options)
{
  for (const Entry & each : methods) {
    if (each.name == name) {
      return each.make(system, options);
    }
  }
  throw std::invalid_argument("there is no such method of integration");
}

}  // namespace closedloop
