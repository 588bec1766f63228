// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

// A loop in the place of the controller manager: MODEL STEP_SIZE BANDWIDTH, then orders on the
// standard input, a line each; answers are lines of numbers. Where an order is refused, the program
// prints why and returns 1.
//
//   start JOINT VALUE ...         initial positions
//   commands JOINT KIND ...       NONE of joints that are left out; answers 1 where servos
//                                 can follow, or 0, and calls that allocated memory
//   command JOINT VALUE
//   limit JOINT VALUE             of the effort of a servo
//   advance PERIOD COUNT          answers 1, or 0, calls that allocated memory, and why it failed
//   timed PERIOD COUNT            the same, and each cycle's time [s]: median, 99 %, most
//   state JOINT ...               time; position, velocity, acceleration, effort of each
//   wrench JOINT                  force, torque
//   reset

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <iostream>
#include <map>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "closedloop_hardware/mechanism.hpp"

using closedloop_hardware::Command;
using closedloop_hardware::Mechanism;

static long allocations = 0;  // NOLINT(runtime/int)

#ifdef __GLIBC__
// Operator new and Eigen come here, too.
extern "C" void * __libc_malloc(std::size_t);
extern "C" void * malloc(std::size_t size) noexcept
{
  ++allocations;
  return __libc_malloc(size);
}
#endif

namespace
{
Command kind(const std::string & name)
{
  static const std::map<std::string, Command> kinds{
    {"effort", Command::EFFORT}, {"position", Command::POSITION}, {"velocity", Command::VELOCITY}};
  return kinds.at(name);
}

void advance(Mechanism & mechanism, double period, std::size_t count, bool timed)
{
  std::vector<double> times(count);
  bool good = true;
  const auto before = allocations;
  for (std::size_t n = 0; n < count && good; ++n) {
    const auto begin = std::chrono::steady_clock::now();
    good = mechanism.advance(period);
    times[n] = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  }
  std::printf("%d %ld", good, allocations - before);
  if (timed) {
    std::sort(times.begin(), times.end());
    std::printf(" %.9f %.9f %.9f", times[count / 2], times[count * 99 / 100], times[count - 1]);
  }
  std::printf(" %s\n", mechanism.fault());
}

void obey(Mechanism & mechanism, std::istream & line)
{
  std::string order, joint, word;
  line >> order;
  if (order == "start") {
    std::map<std::string, double> positions;
    while (line >> joint >> word) {
      positions[joint] = std::stod(word);
    }
    mechanism.start_at(positions);
  } else if (order == "commands") {
    std::vector<Command> commands(mechanism.commands().size(), Command::NONE);
    while (line >> joint >> word) {
      commands[mechanism.joint(joint)] = kind(word);
    }
    const auto before = allocations;
    const bool good = mechanism.can_follow(commands);
    const auto allocated = allocations - before;
    if (good) {
      mechanism.set_commands(commands);
    }
    std::printf("%d %ld\n", good, allocated);
  } else if (order == "command") {
    line >> joint >> word;
    mechanism.command(mechanism.joint(joint), std::stod(word));
  } else if (order == "limit") {
    line >> joint >> word;
    mechanism.limit_effort(mechanism.joint(joint), std::stod(word));
  } else if (order == "advance" || order == "timed") {
    double period = 0.0;
    std::size_t count = 0;
    line >> period >> count;
    advance(mechanism, period, count, order == "timed");
  } else if (order == "state") {
    std::printf("%.17g", mechanism.time());
    while (line >> joint) {
      const std::size_t n = mechanism.joint(joint);
      std::printf(
        " %.17g %.17g %.17g %.17g", mechanism.position(n), mechanism.velocity(n),
        mechanism.acceleration(n), mechanism.effort(n));
    }
    std::printf("\n");
  } else if (order == "wrench") {
    line >> joint;
    for (const double value : mechanism.wrench(mechanism.wrench_place(joint))) {
      std::printf("%.17g ", value);
    }
    std::printf("\n");
  } else if (order == "reset") {
    mechanism.reset();
  } else {
    throw std::invalid_argument("no such order: " + order);
  }
}
}  // namespace

int main(int count, char ** text)
{
  try {
    if (count != 4) {
      throw std::invalid_argument("expected MODEL STEP_SIZE BANDWIDTH");
    }
    Mechanism mechanism(text[1], std::atof(text[2]), std::atof(text[3]));
    for (std::string line; std::getline(std::cin, line); ) {
      std::istringstream words(line);
      obey(mechanism, words);
    }
  } catch (const std::exception & fault) {
    std::printf("%s\n", fault.what());
    return 1;
  }
  return 0;
}
