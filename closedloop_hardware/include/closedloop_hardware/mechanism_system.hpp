// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_HARDWARE__MECHANISM_SYSTEM_HPP_
#define CLOSEDLOOP_HARDWARE__MECHANISM_SYSTEM_HPP_

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "closedloop_hardware/mechanism.hpp"
#include "closedloop_hardware/simulation_control.hpp"
#include "hardware_interface/system_interface.hpp"

namespace closedloop_hardware
{

/// A simulated mechanism as hardware of ros2_control: each read advances it by the period of the
/// controller manager, under the commands of the latest write.
class MechanismSystem : public hardware_interface::SystemInterface
{
public:
  using hardware_interface::SystemInterface::on_init;
  hardware_interface::CallbackReturn on_init(
    const hardware_interface::HardwareComponentInterfaceParams & params) override;
  /// Return to the start.
  hardware_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State &) override;
  hardware_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State &) override;
  hardware_interface::CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override;
  /// Let the hardware be configured again after an error: that returns it to the start.
  hardware_interface::CallbackReturn on_error(const rclcpp_lifecycle::State &) override;
  hardware_interface::return_type prepare_command_mode_switch(
    const std::vector<std::string> & start, const std::vector<std::string> & stop) override;
  hardware_interface::return_type perform_command_mode_switch(
    const std::vector<std::string> & start, const std::vector<std::string> & stop) override;
  hardware_interface::return_type read(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;
  hardware_interface::return_type write(
    const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
  enum class Quantity {POSITION, VELOCITY, ACCELERATION, EFFORT, WRENCH};
  struct Measured
  {
    std::string name;
    Quantity quantity;
    std::size_t joint, component;  // Of a wrench its place
    hardware_interface::StateInterface::SharedPtr handle;
  };
  struct Commanded
  {
    std::string name;
    Command kind;
    std::size_t joint;
    hardware_interface::CommandInterface::SharedPtr handle;
  };

  std::unique_ptr<Mechanism> mechanism_;
  std::unique_ptr<SimulationControl> control_;  // Null without an executor for its services
  std::vector<Measured> measured_;
  std::vector<Commanded> commanded_;
  std::optional<double> period_;  // Where each cycle lasts the same [s]
  // Whether time passes in a read: not in the first one, whose state is that of the activation.
  bool active_ = false, running_ = false;

  void set_up();
  void add_joint(const hardware_interface::ComponentInfo & joint);
  void add_sensor(const hardware_interface::ComponentInfo & sensor);
  std::vector<Command> switched(
    const std::vector<std::string> & start, const std::vector<std::string> & stop) const;
  void publish(bool wait);
};

}  // namespace closedloop_hardware

#endif  // CLOSEDLOOP_HARDWARE__MECHANISM_SYSTEM_HPP_
