// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "closedloop_hardware/simulation_control.hpp"

#include <cmath>

#include "simulation_interfaces/msg/simulation_state.hpp"
#include "simulation_interfaces/msg/simulator_features.hpp"

namespace closedloop_hardware
{

using simulation_interfaces::msg::Result;
using simulation_interfaces::msg::SimulationState;
using simulation_interfaces::msg::SimulatorFeatures;

namespace
{
constexpr double NANOSECONDS = 1e9;
// The clock goes on without a cycle after so long: the controller manager needs time before its
// first one, and while it starts hardware.
constexpr auto PATIENCE = std::chrono::milliseconds(100);
// Between two looks at whether steps are made, where no clock is published.
constexpr auto LOOK = std::chrono::milliseconds(5);

Result result(std::uint8_t code, const std::string & message = "")
{
  Result found;
  found.result = code;
  found.error_message = message;
  return found;
}
}  // namespace

template<typename Service>
void SimulationControl::serve(
  rclcpp::Node & node, const std::string & name, Answer<Service> answer)
{
  services_.push_back(
    node.create_service<Service>(
      "~/" + name, [this, answer](
        const typename Service::Request::SharedPtr request,
        const typename Service::Response::SharedPtr response) {
        (this->*answer)(request, response);
      }));
}

SimulationControl::SimulationControl(rclcpp::Node & node, double period, double pace)
: period_(std::llround(period * NANOSECONDS)), ticked_(std::chrono::steady_clock::now())
{
  serve<Features>(node, "get_simulator_features", &SimulationControl::get_features);
  serve<GetState>(node, "get_simulation_state", &SimulationControl::get_state);
  serve<SetState>(node, "set_simulation_state", &SimulationControl::set_state);
  serve<Reset>(node, "reset_simulation", &SimulationControl::reset);
  step_ = node.create_service<Step>(
    "~/step_simulation", [this](
      const std::shared_ptr<rmw_request_id_t> header, const Step::Request::SharedPtr request) {
      step(header, request);
    });
  std::chrono::nanoseconds every = LOOK;
  if (pace > 0.0) {
    clock_ = node.create_publisher<rosgraph_msgs::msg::Clock>("/clock", rclcpp::QoS(10));
    every = std::chrono::nanoseconds(std::llround(period_ / pace));
  }
  timer_ = node.create_wall_timer(every, [this] {tick();});
}

bool SimulationControl::pass(bool ready)
{
  ready_ = ready;
  taken_ = true;
  if (!ready || (paused_ && steps_ == 0)) {
    return false;
  }
  if (paused_) {
    --steps_;
  }
  stopped_ = false;
  return true;
}

void SimulationControl::tick()
{
  if (stepping_ && (steps_ == 0 || !ready_)) {
    Step::Response response;
    response.result = steps_ == 0 ? result(Result::RESULT_OK) : result(
      Result::RESULT_OPERATION_FAILED, "the hardware is not active any more");
    steps_ = 0;
    step_->send_response(*stepping_, response);
    stepping_.reset();
  }
  const auto now = std::chrono::steady_clock::now();
  if (!clock_ || (paused_ && steps_ == 0) || !(taken_ || now - ticked_ > PATIENCE)) {
    return;
  }
  taken_ = false;
  ticked_ = now;
  time_ += period_;
  rosgraph_msgs::msg::Clock message;
  message.clock = rclcpp::Time(time_);
  clock_->publish(message);
}

std::uint8_t SimulationControl::state() const
{
  return !paused_ ? SimulationState::STATE_PLAYING :
         stopped_ ? SimulationState::STATE_STOPPED : SimulationState::STATE_PAUSED;
}

void SimulationControl::get_features(
  Features::Request::SharedPtr, Features::Response::SharedPtr response)
{
  response->features.features = {
    SimulatorFeatures::SIMULATION_RESET, SimulatorFeatures::SIMULATION_RESET_STATE,
    SimulatorFeatures::SIMULATION_STATE_GETTING, SimulatorFeatures::SIMULATION_STATE_SETTING,
    SimulatorFeatures::SIMULATION_STATE_PAUSE, SimulatorFeatures::STEP_SIMULATION_SINGLE,
    SimulatorFeatures::STEP_SIMULATION_MULTIPLE};
  response->features.custom_info = "closedloop_hardware";
}

void SimulationControl::get_state(
  GetState::Request::SharedPtr, GetState::Response::SharedPtr response)
{
  response->state.state = state();
  response->result = result(
    Result::RESULT_OK, ready_ || paused_ ? "" : "no time passes: the hardware is not active");
}

void SimulationControl::set_state(
  SetState::Request::SharedPtr request, SetState::Response::SharedPtr response)
{
  const auto wanted = request->state.state;
  if (wanted == state()) {
    response->result = result(SetState::Response::ALREADY_IN_TARGET_STATE, "already in this state");
  } else if (stepping_) {
    response->result = result(Result::RESULT_INCORRECT_STATE, "step_simulation is making steps");
  } else if (wanted > SimulationState::STATE_PAUSED) {
    response->result = result(
      Result::RESULT_FEATURE_UNSUPPORTED, "expected a state playing, paused or stopped");
  } else {
    paused_ = wanted != SimulationState::STATE_PLAYING;
    reset_ = stopped_ = wanted == SimulationState::STATE_STOPPED;
    response->result = result(Result::RESULT_OK);
  }
}

void SimulationControl::reset(
  Reset::Request::SharedPtr request, Reset::Response::SharedPtr response)
{
  if (request->scope != Reset::Request::SCOPE_STATE) {
    response->result = result(
      Result::RESULT_FEATURE_UNSUPPORTED,
      "expected the scope SCOPE_STATE: time goes on, because controllers do not take it back");
    return;
  }
  reset_ = true;
  response->result = result(Result::RESULT_OK);
}

void SimulationControl::step(
  std::shared_ptr<rmw_request_id_t> header, Step::Request::SharedPtr request)
{
  const std::string problem =
    !paused_ ? "expected a simulation that is paused, got one that is not" :
    stepping_ ? "step_simulation is making steps" :
    !ready_ ? "the hardware is not active" :
    request->steps == 0 ? "expected 1 or more steps, got 0" : "";
  if (problem.empty()) {
    stepping_ = header;
    steps_ = static_cast<std::int64_t>(request->steps);
    return;
  }
  Step::Response response;
  response.result = result(Result::RESULT_OPERATION_FAILED, problem);
  step_->send_response(*header, response);
}

}  // namespace closedloop_hardware
