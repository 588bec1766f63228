// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

// The plugin is found and loaded, and a rotor moves as it must under its commands.

#include <gtest/gtest.h>

#include <stdexcept>
#include <vector>

#include "closedloop_hardware/mechanism.hpp"
#include "hardware_interface/system_interface.hpp"
#include "pluginlib/class_loader.hpp"

using closedloop_hardware::Command;
using closedloop_hardware::Mechanism;

namespace
{
constexpr double STEP = 0.001, BANDWIDTH = 100.0, INERTIA = 2.0, START = 0.25;
// Rounding of a thousand steps.
constexpr double ROUNDING = 1e-12;

Mechanism rotor(Command command)
{
  Mechanism found(ROTOR, STEP, BANDWIDTH);
  found.set_commands({command});
  return found;
}
}  // namespace

TEST(Plugin, IsFoundAndLoaded)
{
  pluginlib::ClassLoader<hardware_interface::SystemInterface> loader(
    "hardware_interface", "hardware_interface::SystemInterface");
  ASSERT_TRUE(loader.isClassAvailable("closedloop_hardware/MechanismSystem"));
  EXPECT_TRUE(loader.createUniqueInstance("closedloop_hardware/MechanismSystem"));
}

TEST(Mechanism, FollowsTheParabolaOfAConstantEffort)
{
  Mechanism mechanism = rotor(Command::EFFORT);
  mechanism.command(0, 3.0);
  ASSERT_TRUE(mechanism.advance(1.0)) << mechanism.fault();
  EXPECT_NEAR(mechanism.time(), 1.0, ROUNDING);
  EXPECT_NEAR(mechanism.position(0), START + 0.5 * 3.0 / INERTIA, ROUNDING);
  EXPECT_NEAR(mechanism.velocity(0), 3.0 / INERTIA, ROUNDING);
  EXPECT_NEAR(mechanism.wrench(mechanism.wrench_place("hinge"))[5], 3.0, ROUNDING);
}

TEST(Mechanism, ComesToRestAtACommandedPosition)
{
  Mechanism mechanism = rotor(Command::POSITION);
  mechanism.command(0, 1.0);
  // Fifty time constants of its servo.
  ASSERT_TRUE(mechanism.advance(50.0 / BANDWIDTH)) << mechanism.fault();
  EXPECT_NEAR(mechanism.position(0), 1.0, ROUNDING);
  EXPECT_NEAR(mechanism.velocity(0), 0.0, ROUNDING);
}

TEST(Mechanism, HoldsItsStartAfterARestart)
{
  Mechanism mechanism = rotor(Command::POSITION);
  mechanism.command(0, 1.0);
  ASSERT_TRUE(mechanism.advance(0.1));
  mechanism.restart();
  EXPECT_EQ(mechanism.time(), 0.0);
  EXPECT_EQ(mechanism.commands(), std::vector<Command>{Command::POSITION});
  ASSERT_TRUE(mechanism.advance(0.1));
  EXPECT_EQ(mechanism.position(0), START);
  mechanism.reset();
  EXPECT_EQ(mechanism.commands(), std::vector<Command>{Command::NONE});
}

TEST(Mechanism, RefusesAnotherLibraryAndJoint)
{
  EXPECT_THROW(Mechanism("nowhere.so", STEP, BANDWIDTH), std::invalid_argument);
  EXPECT_THROW(rotor(Command::NONE).joint("knee"), std::invalid_argument);
}
