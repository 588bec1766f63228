// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_HARDWARE__SIMULATION_CONTROL_HPP_
#define CLOSEDLOOP_HARDWARE__SIMULATION_CONTROL_HPP_

#include <atomic>
#include <chrono>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "rclcpp/node.hpp"
#include "rosgraph_msgs/msg/clock.hpp"
#include "simulation_interfaces/msg/result.hpp"
#include "simulation_interfaces/srv/get_simulation_state.hpp"
#include "simulation_interfaces/srv/get_simulator_features.hpp"
#include "simulation_interfaces/srv/reset_simulation.hpp"
#include "simulation_interfaces/srv/set_simulation_state.hpp"
#include "simulation_interfaces/srv/step_simulation.hpp"

namespace closedloop_hardware
{

/// Simulated time: paused, stepped and reset by the services of simulation_interfaces, and
/// published on /clock. Its callbacks run in the executor, `pass` and `take_reset` in the cycle of
/// the controller manager, which waits for nothing.
class SimulationControl
{
public:
  /// `period` [s]: of a cycle. With a `pace` above 0, so many simulated seconds per second, /clock
  /// leads: it goes on by a period when the cycle has taken the one before.
  SimulationControl(rclcpp::Node & node, double period, double pace);

  /// Tell whether time passes in this cycle; `ready`: where it could.
  bool pass(bool ready);

  /// Tell, once, whether the start is wanted back.
  bool take_reset() {return reset_.exchange(false);}

private:
  template<typename Service>
  using Answer = void (SimulationControl::*)(
    typename Service::Request::SharedPtr, typename Service::Response::SharedPtr);
  using GetState = simulation_interfaces::srv::GetSimulationState;
  using SetState = simulation_interfaces::srv::SetSimulationState;
  using Features = simulation_interfaces::srv::GetSimulatorFeatures;
  using Reset = simulation_interfaces::srv::ResetSimulation;
  using Step = simulation_interfaces::srv::StepSimulation;

  const std::int64_t period_;  // [ns]
  std::int64_t time_ = 0;
  // Of the cycle: whether time stands still but for steps that are left; whether it is back at the
  // start since; whether it could pass in the latest cycle, and took the latest tick.
  std::atomic<bool> paused_{false}, stopped_{false}, reset_{false}, ready_{false}, taken_{true};
  std::atomic<std::int64_t> steps_{0};
  std::chrono::steady_clock::time_point ticked_;
  rclcpp::Publisher<rosgraph_msgs::msg::Clock>::SharedPtr clock_;
  rclcpp::TimerBase::SharedPtr timer_;
  std::vector<rclcpp::ServiceBase::SharedPtr> services_;
  rclcpp::Service<Step>::SharedPtr step_;
  std::shared_ptr<rmw_request_id_t> stepping_;  // The request that is answered after its steps

  template<typename Service>
  void serve(rclcpp::Node & node, const std::string & name, Answer<Service> answer);
  void tick();
  void get_features(Features::Request::SharedPtr, Features::Response::SharedPtr);
  void get_state(GetState::Request::SharedPtr, GetState::Response::SharedPtr);
  void set_state(SetState::Request::SharedPtr, SetState::Response::SharedPtr);
  void reset(Reset::Request::SharedPtr, Reset::Response::SharedPtr);
  void step(std::shared_ptr<rmw_request_id_t> header, Step::Request::SharedPtr request);
  std::uint8_t state() const;
};

}  // namespace closedloop_hardware

#endif  // CLOSEDLOOP_HARDWARE__SIMULATION_CONTROL_HPP_
