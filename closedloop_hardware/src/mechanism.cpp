// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#include "closedloop_hardware/mechanism.hpp"

#include <dlfcn.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <sstream>
#include <stdexcept>

namespace closedloop_hardware
{

namespace
{
// What the functions of a model return, as its header has it.
constexpr int OK = 0, SINGULAR = 1, OPEN = 2;
// Least share that is left of a servo's mobility when all others hold still.
constexpr double INDEPENDENT = 1e-8;
// On the way to a start: longest change of a joint at once [rad, m]; of Newton's method the closure
// error [m, rad] that is left, its damping and most iterations.
constexpr double STRIDE = 0.05, CLOSED = 1e-12, DAMPING = 1e-14;
constexpr int MOST = 30;
// How far the model's own correction may then move a joint whose position is given [rad, m].
constexpr double HELD = 1e-9;
// Largest product of bandwidth and step size: torques are constant in a step.
constexpr double COARSEST = 0.5;

template<typename ... Parts>
std::invalid_argument error(const Parts & ... parts)
{
  std::ostringstream text;
  (text << ... << parts);
  return std::invalid_argument(text.str());
}

std::string listed(const std::vector<std::string> & names)
{
  std::string text;
  for (const std::string & name : names) {
    text += (text.empty() ? "" : ", ") + name;
  }
  return text.empty() ? "none" : text;
}

bool is_servo(Command command)
{
  return command == Command::POSITION || command == Command::VELOCITY;
}
}  // namespace

template<typename Pointer>
Pointer Model::find(const std::string & name) const
{
  return reinterpret_cast<Pointer>(dlsym(library_.get(), name.c_str()));
}

std::vector<std::string> Model::strings(const std::string & name) const
{
  std::vector<std::string> found;
  const char * const * names = find<const char * const *>(name);
  for (; names && *names; ++names) {
    found.emplace_back(*names);
  }
  return found;
}

Model::Model(const std::string & file_)
: file(file_)
{
  dlerror();
  void * const handle = dlopen(file.c_str(), RTLD_NOW | RTLD_LOCAL);
  if (!handle) {
    const char * const why = dlerror();
    throw error(
            "model: expected a shared library of the C that closedloop export writes, got '", file,
            "': ", why ? why : "no reason given");
  }
  library_.reset(handle, dlclose);
  std::string name = file.substr(file.find_last_of('/') + 1);
  name = name.substr(0, name.find('.'));
  if (!find<void *>(name + "_step") && name.rfind("lib", 0) == 0) {
    name = name.substr(3);
  }
  const auto require = [&](const std::string & suffix) {
      if (!find<void *>(name + suffix)) {
        throw error(
                "model: expected '", name, suffix, "' in ", file, ", got none: a library is called "
                "as the C that closedloop export wrote, NAME.so or libNAME.so of NAME.c, and the C "
                "is of this version");
      }
      return name + suffix;
    };
  using Sparsity = const long long int * (*)(long long int);  // NOLINT(runtime/int), CasADi's
  const auto in = find<Sparsity>(require("_sparsity_in"));
  nq = static_cast<int>(in(0)[0]);
  nv = static_cast<int>(in(1)[0]);
  nc = static_cast<int>(find<Sparsity>(require("_sparsity_out"))(1)[0]);
  positions = strings(require("_position_names"));
  velocities = strings(require("_velocity_names"));
  joints = strings(name + "_joint_names");
  numbers = find<const void *>(require("_default"));
  start = find<const double *>(require("_start"));
  evaluate = find<decltype(evaluate)>(require("_evaluate"));
  correct = find<decltype(correct)>(require("_correct"));
  step = find<decltype(step)>(require("_step"));
  move = find<decltype(move)>(require("_move"));
  closure = find<decltype(closure)>(require("_closure"));
  joint_forces = find<decltype(joint_forces)>(name + "_joint_forces");
}

Mechanism::Mechanism(const std::string & model_file, double step_size, double bandwidth)
: model_(model_file), step_size_(step_size), bandwidth_(bandwidth),
  start_(model_.start, model_.start + model_.nq + model_.nv), state_(start_),
  commands_(model_.nv, Command::NONE), acting_(commands_),
  limit_(model_.nv, std::numeric_limits<double>::infinity()), target_(model_.nv), tau_(model_.nv), qdd_(model_.nv),
  lam_(std::max(model_.nc, 1)), forces_(6 * model_.joints.size()), probe_(model_.nv),
  mobility_(model_.nv, model_.nv), missing_(model_.nv), factor_(model_.nv)
{
  if (!(step_size > 0.0) || !std::isfinite(step_size)) {
    throw error("step_size: expected a time above 0 [s], got ", step_size);
  }
  if (!(bandwidth >= 0.0) || bandwidth * step_size > COARSEST) {
    throw error(
            "bandwidth: expected 0 to ", COARSEST / step_size, " rad/s (", COARSEST,
            " / step_size), got ", bandwidth);
  }
  for (const std::string & name : model_.velocities) {
    // Orientations have no coordinate of the same name.
    const std::string sought = "position" + name.substr(std::min(name.find('.'), name.size()));
    const auto found = std::find(model_.positions.begin(), model_.positions.end(), sought);
    place_.push_back(
      found == model_.positions.end() ? -1 : static_cast<int>(found - model_.positions.begin()));
  }
  reset();
}

/// Return the name of a joint; empty where it is a part of an orientation.
std::string Mechanism::name_of(std::size_t joint) const
{
  return place_[joint] < 0 ? "" :
         model_.positions[place_[joint]].substr(std::string("position.").size());
}

std::vector<std::string> Mechanism::joint_names() const
{
  std::vector<std::string> known;
  for (std::size_t n = 0; n < place_.size(); ++n) {
    if (place_[n] >= 0) {
      known.push_back(name_of(n));
    }
  }
  return known;
}

std::size_t Mechanism::joint(const std::string & name) const
{
  for (std::size_t n = 0; n < place_.size(); ++n) {
    if (!name.empty() && name_of(n) == name) {
      return n;
    }
  }
  throw error(
          "joint: expected one of those of one degree of freedom in ", model_.file, " (",
          listed(joint_names()), "), got '", name, "'");
}

std::size_t Mechanism::wrench_place(const std::string & joint) const
{
  if (!model_.joint_forces) {
    throw error(
            "joint: expected none, got '", joint, "': forces in the joints of ", model_.file,
            " are not unique, because closure equations repeat others or couplings pass forces on");
  }
  const auto found = std::find(model_.joints.begin(), model_.joints.end(), joint);
  if (found == model_.joints.end()) {
    throw error(
            "joint: expected one of ", model_.file, " (", listed(model_.joints), "), got '", joint,
            "'");
  }
  return found - model_.joints.begin();
}

void Mechanism::limit_effort(std::size_t joint, double limit)
{
  if (!(limit > 0.0)) {
    throw error("effort_limit: expected more than 0 [N m, N], got ", limit);
  }
  limit_[joint] = limit;
}

/// Close the loops, some coordinates as they are; return the largest error left [m, rad].
double Mechanism::close_around(std::vector<double> & state, const std::vector<bool> & held) const
{
  using Rows = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Eigen::VectorXd errors(model_.nc);
  Rows jacobian(model_.nc, model_.nv);
  double left = 0.0;
  for (int n = 0; n < MOST && model_.nc > 0; ++n) {
    model_.closure(model_.numbers, state.data(), errors.data(), jacobian.data());
    left = errors.cwiseAbs().maxCoeff();
    if (!(left > CLOSED)) {
      break;
    }
    for (int k = 0; k < model_.nv; ++k) {
      if (held[k]) {
        jacobian.col(k).setZero();
      }
    }
    // Least change; a little damped, for closure equations that have come to repeat one another.
    Eigen::MatrixXd gram = jacobian * jacobian.transpose();
    gram.diagonal().array() += DAMPING * gram.trace();
    const Eigen::VectorXd change = -(jacobian.transpose() * gram.llt().solve(errors));
    if (!change.allFinite()) {
      break;
    }
    model_.move(state.data(), change.data());
  }
  return left;
}

void Mechanism::start_at(const std::map<std::string, double> & positions)
{
  std::vector<double> found(model_.start, model_.start + model_.nq + model_.nv);
  std::vector<bool> held(model_.nv, false);
  double most = 0.0;
  for (const auto & [name, value] : positions) {
    if (!std::isfinite(value)) {
      throw error("initial_value: expected a finite position of ", name, ", got ", value);
    }
    held[joint(name)] = true;
    most = std::max(most, std::abs(value - found[place_[joint(name)]]));
  }
  const int strides = std::max(1, static_cast<int>(std::ceil(most / STRIDE)));
  double left = 0.0;
  for (int n = 1; n <= strides && left <= CLOSED; ++n) {
    for (const auto & [name, value] : positions) {
      const int place = place_[joint(name)];
      found[place] += (value - found[place]) / (strides - n + 1);
    }
    left = close_around(found, held);
  }
  bool good = left <= CLOSED && model_.correct(model_.numbers, found.data()) == OK;
  for (const auto & [name, value] : positions) {
    good = good && std::abs(found[place_[joint(name)]] - value) <= HELD;
  }
  if (!good) {
    std::ostringstream text;
    for (const auto & [name, value] : positions) {
      text << (text.str().empty() ? "" : ", ") << name << " " << value;
    }
    throw error(
            "initial_value: expected positions at which the loops of ", model_.file,
            " can be closed, got ", text.str(), ": an error of ", left,
            " m or rad is left. Give positions of as many joints as there are degrees of freedom, "
            "the others follow.");
  }
  start_ = found;
  reset();
  if (*fault_) {
    throw error("initial_value: expected positions to start from, got others: ", fault_);
  }
}

void Mechanism::reset()
{
  std::fill(commands_.begin(), commands_.end(), Command::NONE);
  restart();
}

void Mechanism::restart()
{
  state_ = start_;
  time_ = 0.0;
  fault_ = "";
  for (auto * const each : {&tau_, &qdd_}) {
    std::fill(each->begin(), each->end(), 0.0);
  }
  for (std::size_t k = 0; k < target_.size(); ++k) {
    target_[k] = commands_[k] == Command::POSITION ? position(k) : 0.0;
  }
  measure();
}

/// Factor how accelerations of the joints with servos follow their efforts, scaled to 1 in each
/// joint alone; `qdd_` has the accelerations under the other efforts.
bool Mechanism::factor_mobility(const std::vector<Command> & commands)
{
  const double * const q = state_.data(), * const qd = q + model_.nq;
  for (int k = 0; k < model_.nv; ++k) {
    if (is_servo(commands[k])) {
      tau_[k] = 0.0;
    }
  }
  int status = model_.evaluate(model_.numbers, q, qd, tau_.data(), qdd_.data(), lam_.data());
  mobility_.setIdentity();
  for (int k = 0; status == OK && k < model_.nv; ++k) {
    if (is_servo(commands[k])) {
      tau_[k] = 1.0;
      status = model_.evaluate(model_.numbers, q, qd, tau_.data(), probe_.data(), lam_.data());
      tau_[k] = 0.0;
      for (int i = 0; i < model_.nv; ++i) {
        if (is_servo(commands[i])) {
          mobility_(i, k) = probe_[i] - qdd_[i];
        }
      }
    }
  }
  if (failed(status)) {
    return false;
  }
  missing_ = mobility_.diagonal();
  for (int k = 0; k < model_.nv; ++k) {
    for (int i = 0; i < model_.nv; ++i) {
      mobility_(i, k) /= std::sqrt(missing_[i] * missing_[k]);
    }
  }
  factor_.compute(mobility_);
  return factor_.info() == Eigen::Success &&
         factor_.matrixLLT().diagonal().minCoeff() > std::sqrt(INDEPENDENT);
}

bool Mechanism::can_follow(const std::vector<Command> & commands)
{
  const std::vector<double> before = tau_;
  const bool good = factor_mobility(commands);
  tau_ = before;
  return good && measure();
}

void Mechanism::set_commands(const std::vector<Command> & commands)
{
  for (std::size_t k = 0; k < commands.size(); ++k) {
    if (commands[k] != commands_[k]) {
      target_[k] = commands[k] == Command::POSITION ? position(k) : 0.0;
      commands_[k] = commands[k];
    }
  }
}

/// Find the efforts of a step: those commanded, and those by which servos, without error in the
/// model, follow positions as a critically damped oscillator and velocities as a first-order lag.
/// Servos that would need more than their limits exert these, and the others allow for that.
bool Mechanism::find_efforts()
{
  acting_ = commands_;
  for (int k = 0; k < model_.nv; ++k) {
    tau_[k] = commands_[k] == Command::EFFORT ? target_[k] : 0.0;
  }
  while (std::any_of(acting_.begin(), acting_.end(), is_servo)) {
    if (!solve_servos()) {
      return false;
    }
    int worst = -1;
    double excess = 1.0;
    for (int k = 0; k < model_.nv; ++k) {
      if (is_servo(acting_[k]) && std::abs(tau_[k]) / limit_[k] > excess) {
        worst = k;
        excess = std::abs(tau_[k]) / limit_[k];
      }
    }
    if (worst < 0) {
      break;
    }
    tau_[worst] = std::copysign(limit_[worst], tau_[worst]);
    acting_[worst] = Command::EFFORT;
  }
  return true;
}

/// Find the efforts of the servos that act, beside those of the other joints.
bool Mechanism::solve_servos()
{
  if (!factor_mobility(acting_)) {
    if (!*fault_) {
      fault_ = "joints whose positions or velocities are commanded have come to depend on one "
        "another: a singular position, or more of them than degrees of freedom";
    }
    return false;
  }
  // The scale of each joint, before its place is taken by what is missing.
  for (int k = 0; k < model_.nv; ++k) {
    probe_[k] = std::sqrt(missing_[k]);
    const double rate = is_servo(acting_[k]) ? velocity(k) : 0.0;
    const double asked =
      acting_[k] == Command::POSITION ?
      bandwidth_ * (bandwidth_ * (target_[k] - position(k)) - 2.0 * rate) :
      bandwidth_ * (target_[k] - rate);
    missing_[k] = is_servo(acting_[k]) ? (asked - qdd_[k]) / probe_[k] : 0.0;
  }
  factor_.solveInPlace(missing_);
  for (int k = 0; k < model_.nv; ++k) {
    if (is_servo(acting_[k])) {
      tau_[k] = missing_[k] / probe_[k];
    }
  }
  return true;
}

bool Mechanism::advance(double period)
{
  if (!(period >= 0.0) || !std::isfinite(period)) {
    fault_ = "expected a period of 0 or more [s]";
    return false;
  }
  for (std::size_t k = 0; k < target_.size(); ++k) {
    if (commands_[k] != Command::NONE && !std::isfinite(target_[k])) {
      fault_ = "expected finite commands";
      return false;
    }
  }
  // Rounding makes no further step.
  const double count = std::ceil(period / step_size_ - 1e-6);
  const double step = count > 0.0 ? period / count : 0.0;
  for (double n = 0.0; n < count; n += 1.0) {
    if (
      !find_efforts() || failed(model_.step(model_.numbers, state_.data(), tau_.data(), step)))
    {
      return false;
    }
    time_ += step;
  }
  return measure();
}

/// Evaluate accelerations and wrenches of the present state.
bool Mechanism::measure()
{
  const double * const q = state_.data(), * const qd = q + model_.nq;
  if (failed(model_.evaluate(model_.numbers, q, qd, tau_.data(), qdd_.data(), lam_.data()))) {
    return false;
  }
  if (model_.joint_forces) {
    model_.joint_forces(model_.numbers, q, qd, qdd_.data(), lam_.data(), forces_.data());
  }
  return true;
}

bool Mechanism::failed(int status)
{
  fault_ = status == OK ? "" :
    status == SINGULAR ? "closure equations depend on one another, or nearly: a singular position" :
    status == OPEN ? "the loops cannot be closed: the step is too large" :
    "the state left the finite numbers";
  return status != OK;
}

std::array<double, 6> Mechanism::wrench(std::size_t place) const
{
  // The model has moments first.
  std::array<double, 6> found;
  std::copy_n(forces_.begin() + 6 * place + 3, 3, found.begin());
  std::copy_n(forces_.begin() + 6 * place, 3, found.begin() + 3);
  return found;
}

}  // namespace closedloop_hardware
