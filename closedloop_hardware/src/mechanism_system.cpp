// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "closedloop_hardware/mechanism_system.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <set>
#include <stdexcept>
#include <tuple>
#include <unordered_map>

#include "hardware_interface/lexical_casts.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/logging.hpp"

namespace closedloop_hardware
{

using hardware_interface::CallbackReturn;
using hardware_interface::ComponentInfo;
using hardware_interface::InterfaceInfo;
using hardware_interface::return_type;

namespace
{
using Parameters = std::unordered_map<std::string, std::string>;

const std::map<std::string, Command> KINDS{
  {"effort", Command::EFFORT}, {"position", Command::POSITION}, {"velocity", Command::VELOCITY}};
const std::array<std::string, 6> COMPONENTS{
  "force.x", "force.y", "force.z", "torque.x", "torque.y", "torque.z"};

std::invalid_argument expected(
  const std::string & place, const std::string & what, const std::string & got)
{
  return std::invalid_argument(place + ": expected " + what + ", got '" + got + "'");
}

/// Refuse parameters of other names.
void require_known(
  const std::string & place, const Parameters & parameters, const std::set<std::string> & known)
{
  std::string names;
  for (const std::string & name : known) {
    names += (names.empty() ? "" : ", ") + name;
  }
  for (const auto & [name, value] : parameters) {
    if (known.count(name) == 0) {
      throw expected(place, known.empty() ? "no parameter" : "parameters " + names, name);
    }
  }
}

std::string text(const std::string & place, const Parameters & parameters, const std::string & name)
{
  const auto found = parameters.find(name);
  if (found == parameters.end() || found->second.empty()) {
    throw std::invalid_argument(place + ": expected a parameter " + name + ", got none");
  }
  return found->second;
}

double number(const std::string & place, const std::string & value)
{
  try {
    const double found = hardware_interface::stod(value);
    if (std::isfinite(found)) {
      return found;
    }
  } catch (const std::exception &) {
    // As below.
  }
  throw expected(place, "a finite number", value);
}
}  // namespace

CallbackReturn MechanismSystem::on_init(
  const hardware_interface::HardwareComponentInterfaceParams & params)
{
  if (SystemInterface::on_init(params) != CallbackReturn::SUCCESS) {
    return CallbackReturn::ERROR;
  }
  try {
    set_up();
  } catch (const std::exception & error) {
    RCLCPP_FATAL(get_logger(), "ros2_control '%s': %s", info_.name.c_str(), error.what());
    return CallbackReturn::ERROR;
  }
  return CallbackReturn::SUCCESS;
}

void MechanismSystem::set_up()
{
  const std::string place = "hardware";
  const Parameters & parameters = info_.hardware_parameters;
  require_known(place, parameters, {"model", "step_size", "bandwidth", "period", "real_time_factor"});
  const bool follows = std::any_of(
    info_.joints.begin(), info_.joints.end(), [](const ComponentInfo & joint) {
      const auto & commands = joint.command_interfaces;
      return std::any_of(commands.begin(), commands.end(), [](const InterfaceInfo & command) {
        return command.name != "effort";
      });
    });
  const bool given = parameters.count("bandwidth") > 0;
  mechanism_ = std::make_unique<Mechanism>(
    text(place, parameters, "model"),
    number("step_size", text(place, parameters, "step_size")),
    follows || given ? number("bandwidth", text(place, parameters, "bandwidth")) : 0.0);
  if (follows && number("bandwidth", parameters.at("bandwidth")) == 0.0) {
    throw expected("bandwidth", "more than 0 rad/s to follow positions and velocities", "0");
  }
  if (parameters.count("period") > 0) {
    period_ = number("period", parameters.at("period"));
    if (!(*period_ > 0.0)) {
      throw expected("period", "a time above 0 [s]", parameters.at("period"));
    }
  }
  double pace = 0.0;
  if (parameters.count("real_time_factor") > 0) {
    pace = number("real_time_factor", parameters.at("real_time_factor"));
    if (!(pace > 0.0)) {
      throw expected("real_time_factor", "more than 0", parameters.at("real_time_factor"));
    }
    if (!period_) {
      throw expected("period", "a time [s], by which /clock goes on with real_time_factor", "none");
    }
  }
  if (const auto node = get_node()) {
    control_ = std::make_unique<SimulationControl>(*node, period_.value_or(0.0), pace);
  }
  std::for_each(info_.joints.begin(), info_.joints.end(), [this](const auto & one) {
    add_joint(one);
  });
  for (const auto * const those : {&info_.sensors, &info_.gpios}) {
    std::for_each(those->begin(), those->end(), [this](const auto & one) {add_sensor(one);});
  }
  std::map<std::string, double> start;
  for (const ComponentInfo & joint : info_.joints) {
    for (const InterfaceInfo & state : joint.state_interfaces) {
      const std::string name = joint.name + "/" + state.name;
      if (state.initial_value.empty()) {
        continue;
      }
      if (state.name != "position") {
        throw expected(name, "an initial_value of positions only", state.initial_value);
      }
      start[joint.name] = number(name + ": initial_value", state.initial_value);
    }
  }
  if (!start.empty()) {
    mechanism_->start_at(start);
  }
}

void MechanismSystem::add_joint(const ComponentInfo & joint)
{
  const std::map<std::string, Quantity> quantities{
    {"position", Quantity::POSITION}, {"velocity", Quantity::VELOCITY},
    {"acceleration", Quantity::ACCELERATION}, {"effort", Quantity::EFFORT}};
  const std::string place = "joint " + joint.name;
  require_known(place, joint.parameters, {"effort_limit"});
  const std::size_t index = mechanism_->joint(joint.name);
  if (joint.parameters.count("effort_limit") > 0) {
    mechanism_->limit_effort(
      index, number(place, joint.parameters.at("effort_limit")));
  }
  for (const InterfaceInfo & state : joint.state_interfaces) {
    const std::string name = joint.name + "/" + state.name;
    if (quantities.count(state.name) == 0) {
      throw expected(name, "a state position, velocity, acceleration or effort", state.name);
    }
    measured_.push_back({name, quantities.at(state.name), index, 0, nullptr});
  }
  for (const InterfaceInfo & command : joint.command_interfaces) {
    const std::string name = joint.name + "/" + command.name;
    if (KINDS.count(command.name) == 0) {
      throw expected(name, "a command effort, position or velocity", command.name);
    }
    commanded_.push_back({name, KINDS.at(command.name), index, nullptr});
  }
}

void MechanismSystem::add_sensor(const ComponentInfo & sensor)
{
  const std::string place = sensor.type + " " + sensor.name;
  if (!sensor.command_interfaces.empty()) {
    throw expected(place, "no command interface", sensor.command_interfaces.front().name);
  }
  require_known(place, sensor.parameters, {"joint"});
  const std::size_t number = mechanism_->wrench_place(text(place, sensor.parameters, "joint"));
  for (const InterfaceInfo & state : sensor.state_interfaces) {
    const std::string name = sensor.name + "/" + state.name;
    const auto found = std::find(COMPONENTS.begin(), COMPONENTS.end(), state.name);
    if (found == COMPONENTS.end()) {
      throw expected(name, "a state force.x to force.z, torque.x to torque.z", state.name);
    }
    const std::size_t component = found - COMPONENTS.begin();
    measured_.push_back({name, Quantity::WRENCH, number, component, nullptr});
  }
}

CallbackReturn MechanismSystem::on_configure(const rclcpp_lifecycle::State &)
{
  for (Measured & one : measured_) {
    one.handle = get_state_interface_handle(one.name);
  }
  for (Commanded & one : commanded_) {
    one.handle = get_command_interface_handle(one.name);
  }
  active_ = running_ = false;
  mechanism_->reset();
  publish(true);
  return CallbackReturn::SUCCESS;
}

CallbackReturn MechanismSystem::on_activate(const rclcpp_lifecycle::State &)
{
  active_ = true;
  running_ = false;
  return CallbackReturn::SUCCESS;
}

CallbackReturn MechanismSystem::on_deactivate(const rclcpp_lifecycle::State &)
{
  active_ = false;
  return CallbackReturn::SUCCESS;
}

CallbackReturn MechanismSystem::on_error(const rclcpp_lifecycle::State &)
{
  active_ = false;
  return CallbackReturn::SUCCESS;
}

/// Return the commands after a switch; those of other hardware are passed over.
std::vector<Command> MechanismSystem::switched(
  const std::vector<std::string> & start, const std::vector<std::string> & stop) const
{
  const auto has = [](const std::vector<std::string> & names, const std::string & name) {
      return std::find(names.begin(), names.end(), name) != names.end();
    };
  std::vector<Command> commands = mechanism_->commands();
  for (const Commanded & one : commanded_) {
    if (has(stop, one.name) && commands[one.joint] == one.kind) {
      commands[one.joint] = Command::NONE;
    }
  }
  for (const Commanded & one : commanded_) {
    if (has(start, one.name)) {
      if (commands[one.joint] != Command::NONE) {
        throw expected(one.name, "one command interface of a joint at a time", "two");
      }
      commands[one.joint] = one.kind;
    }
  }
  return commands;
}

return_type MechanismSystem::prepare_command_mode_switch(
  const std::vector<std::string> & start, const std::vector<std::string> & stop)
{
  try {
    if (mechanism_->can_follow(switched(start, stop))) {
      return return_type::OK;
    }
    RCLCPP_ERROR(
      get_logger(), "expected position and velocity commands in joints that move independently, "
      "as many as there are degrees of freedom at most, got others");
  } catch (const std::exception & error) {
    RCLCPP_ERROR(get_logger(), "%s", error.what());
  }
  return return_type::ERROR;
}

return_type MechanismSystem::perform_command_mode_switch(
  const std::vector<std::string> & start, const std::vector<std::string> & stop)
{
  mechanism_->set_commands(switched(start, stop));
  // Until a controller writes.
  for (const Commanded & one : commanded_) {
    if (mechanism_->commands()[one.joint] == one.kind) {
      std::ignore = set_command(one.handle, mechanism_->commanded(one.joint), true);
    }
  }
  return return_type::OK;
}

return_type MechanismSystem::read(const rclcpp::Time &, const rclcpp::Duration & period)
{
  if (control_ && control_->take_reset()) {
    mechanism_->restart();
  }
  const bool ready = active_ && running_;
  const bool passes = control_ ? control_->pass(ready) : ready;
  if (passes && !mechanism_->advance(period_.value_or(period.seconds()))) {
    RCLCPP_ERROR(
      get_logger(), "after %g s of simulated time: %s", mechanism_->time(), mechanism_->fault());
    return return_type::ERROR;
  }
  running_ = active_;
  publish(false);
  return return_type::OK;
}

return_type MechanismSystem::write(const rclcpp::Time &, const rclcpp::Duration &)
{
  for (const Commanded & one : commanded_) {
    if (mechanism_->commands()[one.joint] != one.kind) {
      continue;
    }
    // Where a controller is writing it at this instant, the command of before.
    double value = mechanism_->commanded(one.joint);
    std::ignore = get_command(one.handle, value, false);
    if (!std::isfinite(value)) {
      RCLCPP_ERROR(
        get_logger(), "%s: expected a finite command, got %g", one.name.c_str(), value);
      return return_type::ERROR;
    }
    mechanism_->command(one.joint, value);
  }
  return return_type::OK;
}

/// Show the present state; in a cycle without waiting: a value that is being read stays for one.
void MechanismSystem::publish(bool wait)
{
  for (const Measured & one : measured_) {
    const double value =
      one.quantity == Quantity::POSITION ? mechanism_->position(one.joint) :
      one.quantity == Quantity::VELOCITY ? mechanism_->velocity(one.joint) :
      one.quantity == Quantity::ACCELERATION ? mechanism_->acceleration(one.joint) :
      one.quantity == Quantity::EFFORT ? mechanism_->effort(one.joint) :
      mechanism_->wrench(one.joint)[one.component];
    std::ignore = set_state(one.handle, value, wait);
  }
}

}  // namespace closedloop_hardware

PLUGINLIB_EXPORT_CLASS(
  closedloop_hardware::MechanismSystem, hardware_interface::SystemInterface)
