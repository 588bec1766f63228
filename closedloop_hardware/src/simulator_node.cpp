// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <memory>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "closedloop_hardware/mechanism.hpp"
#include "geometry_msgs/msg/wrench_stamped.hpp"
#include "rclcpp_components/register_node_macro.hpp"
#include "rclcpp_lifecycle/lifecycle_node.hpp"
#include "sensor_msgs/msg/joint_state.hpp"
#include "std_srvs/srv/set_bool.hpp"
#include "std_srvs/srv/trigger.hpp"

namespace closedloop_hardware
{

using rclcpp_lifecycle::LifecycleNode;
using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;
using geometry_msgs::msg::WrenchStamped;
using sensor_msgs::msg::JointState;
using std_srvs::srv::SetBool;
using std_srvs::srv::Trigger;
using std::chrono::steady_clock;

namespace
{
// A subscriber that stalls for a second at 1 kHz still gets everything.
const rclcpp::QoS STATES(1000);
const rclcpp::QoS COMMANDS = rclcpp::QoS(1000).best_effort();
// Periods that were missed and are made up for; the others are dropped.
constexpr std::int64_t MOST_MADE_UP = 10;
// Between two warnings of one kind [ms].
constexpr int QUIET = 5000;
}  // namespace

/// A mechanism, of the C that closedloop export writes, that follows the clock under efforts: a
/// managed node, and a component. Its topics are those of closedloop_simulator.
class SimulatorNode : public LifecycleNode
{
public:
  explicit SimulatorNode(const rclcpp::NodeOptions & options)
  : LifecycleNode("closedloop_simulator", options)
  {
    rcl_interfaces::msg::ParameterDescriptor about;
    about.read_only = true;
    const auto declare = [&](const std::string & name, auto value, const std::string & text) {
        about.description = text;
        declare_parameter(name, value, about);
      };
    declare("model", std::string(), "Library of the C that closedloop export writes.");
    declare("step_size", 0.001, "Longest step [s].");
    declare("publish_rate", 100.0, "States published per second [Hz].");
    declare("forces", std::vector<std::string>(), "Joints whose forces are published.");
    declare("autostart", true, "Configure and activate by itself.");
    if (get_parameter("autostart").as_bool()) {
      start_ = create_wall_timer(std::chrono::seconds(0), [this] {
          start_->cancel();
          if (configure().label() == "inactive") {
            activate();
          }
        });
    }
  }

  CallbackReturn on_configure(const rclcpp_lifecycle::State &) override
  {
    const double rate = get_parameter("publish_rate").as_double();
    try {
      if (!(rate > 0.0) || !std::isfinite(rate)) {
        throw std::invalid_argument("publish_rate: expected more than 0 Hz");
      }
      mechanism_ = std::make_unique<Mechanism>(
        get_parameter("model").as_string(), get_parameter("step_size").as_double(), 0.0);
      forces_.clear();
      const std::vector<std::string> joints = get_parameter("forces").as_string_array();
      for (const std::string & joint : joints) {
        const std::string topic = "constraint_forces/" + joint;
        forces_.emplace_back();
        forces_.back().place = mechanism_->wrench_place(joint);
        forces_.back().message.header.frame_id = topic;
        forces_.back().publisher = create_publisher<WrenchStamped>(topic, STATES);
      }
    } catch (const std::exception & error) {
      RCLCPP_ERROR(get_logger(), "%s", error.what());
      return CallbackReturn::FAILURE;
    }
    period_ = std::chrono::nanoseconds(std::llround(1e9 / rate));
    state_.name = mechanism_->joint_names();
    joints_.clear();
    std::vector<Command> commands(mechanism_->commands().size(), Command::NONE);
    for (const std::string & name : state_.name) {
      joints_.push_back(mechanism_->joint(name));
      commands[joints_.back()] = Command::EFFORT;
    }
    mechanism_->set_commands(commands);
    for (auto * const values : {&state_.position, &state_.velocity, &state_.effort}) {
      values->resize(joints_.size());
    }
    states_ = create_publisher<JointState>("joint_states", STATES);
    command_ = create_subscription<JointState>(
      "joint_command", COMMANDS, [this](JointState::ConstSharedPtr message) {follow(*message);});
    pause_ = create_service<SetBool>(
      "~/pause", [this](SetBool::Request::SharedPtr request, SetBool::Response::SharedPtr response) {
        paused_ = request->data;
        begin();
        response->success = true;
      });
    reset_ = create_service<Trigger>(
      "~/reset", [this](Trigger::Request::SharedPtr, Trigger::Response::SharedPtr response) {
        mechanism_->restart();
        response->success = true;
      });
    return CallbackReturn::SUCCESS;
  }

  CallbackReturn on_activate(const rclcpp_lifecycle::State & state) override
  {
    begin();
    timer_ = create_wall_timer(period_, [this] {tick();});
    return LifecycleNode::on_activate(state);
  }

  CallbackReturn on_deactivate(const rclcpp_lifecycle::State & state) override
  {
    timer_.reset();
    return LifecycleNode::on_deactivate(state);
  }

  CallbackReturn on_cleanup(const rclcpp_lifecycle::State &) override
  {
    command_.reset();
    pause_.reset();
    reset_.reset();
    states_.reset();
    forces_.clear();
    mechanism_.reset();
    return CallbackReturn::SUCCESS;
  }

private:
  struct Force
  {
    std::size_t place;
    WrenchStamped message;
    rclcpp_lifecycle::LifecyclePublisher<WrenchStamped>::SharedPtr publisher;
  };

  std::unique_ptr<Mechanism> mechanism_;
  std::vector<std::size_t> joints_;  // Of the names in messages
  std::vector<Force> forces_;
  JointState state_;
  rclcpp_lifecycle::LifecyclePublisher<JointState>::SharedPtr states_;
  rclcpp::Subscription<JointState>::SharedPtr command_;
  rclcpp::Service<SetBool>::SharedPtr pause_;
  rclcpp::Service<Trigger>::SharedPtr reset_;
  rclcpp::TimerBase::SharedPtr start_, timer_;
  std::chrono::nanoseconds period_{0};
  steady_clock::time_point begin_;
  std::int64_t made_ = 0;  // Periods since then
  bool paused_ = false;

  void begin()
  {
    begin_ = steady_clock::now();
    made_ = 0;
  }

  /// Take efforts by name, or refuse all of a message. NaN: not commanded.
  void follow(const JointState & message)
  {
    std::string problem = message.name.size() != message.effort.size() ?
      "expected one effort per name" : "";
    for (std::size_t k = 0; k < message.name.size() && problem.empty(); ++k) {
      if (std::find(state_.name.begin(), state_.name.end(), message.name[k]) == state_.name.end()) {
        problem = "'" + message.name[k] + "' is not a joint of this mechanism";
      } else if (std::isinf(message.effort[k])) {
        problem = "the effort of '" + message.name[k] + "' is not finite";
      }
    }
    if (!problem.empty()) {
      RCLCPP_WARN_THROTTLE(
        get_logger(), *get_clock(), QUIET, "joint_command rejected: %s", problem.c_str());
      return;
    }
    for (std::size_t k = 0; k < message.name.size(); ++k) {
      if (!std::isnan(message.effort[k])) {
        const auto found = std::find(state_.name.begin(), state_.name.end(), message.name[k]);
        mechanism_->command(joints_[found - state_.name.begin()], message.effort[k]);
      }
    }
  }

  /// Make the periods that are due, and publish each with the time at which it was.
  void tick()
  {
    const auto elapsed = steady_clock::now() - begin_;
    // A timer may wake up a little early.
    std::int64_t due = (elapsed + period_ / 20) / period_ - made_;
    if (due > MOST_MADE_UP) {
      RCLCPP_WARN_THROTTLE(
        get_logger(), *get_clock(), QUIET,
        "this machine cannot keep up: %ld periods dropped", static_cast<long>(due - 1));  // NOLINT
      begin();
      due = 1;
      begin_ -= period_;
    }
    const rclcpp::Time now = get_clock()->now();
    for (std::int64_t behind = due - 1; behind >= 0; --behind) {
      ++made_;
      const double period = std::chrono::duration<double>(period_).count();
      if (!paused_ && !mechanism_->advance(period)) {
        RCLCPP_ERROR(
          get_logger(), "stopped after %g s: %s", mechanism_->time(), mechanism_->fault());
        timer_->cancel();
        return;
      }
      publish(now - rclcpp::Duration(behind * period_));
    }
  }

  void publish(const rclcpp::Time & stamp)
  {
    for (Force & force : forces_) {
      const auto wrench = mechanism_->wrench(force.place);
      auto & found = force.message.wrench;
      std::tie(found.force.x, found.force.y, found.force.z, found.torque.x, found.torque.y,
        found.torque.z) = std::tie(
        wrench[0], wrench[1], wrench[2], wrench[3], wrench[4], wrench[5]);
      force.message.header.stamp = stamp;
      force.publisher->publish(force.message);
    }
    // The state last: a controller that answers it has the forces.
    for (std::size_t k = 0; k < joints_.size(); ++k) {
      state_.position[k] = mechanism_->position(joints_[k]);
      state_.velocity[k] = mechanism_->velocity(joints_[k]);
      state_.effort[k] = mechanism_->effort(joints_[k]);
    }
    state_.header.stamp = stamp;
    states_->publish(state_);
  }
};

}  // namespace closedloop_hardware

RCLCPP_COMPONENTS_REGISTER_NODE(closedloop_hardware::SimulatorNode)
