// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_HARDWARE__MECHANISM_HPP_
#define CLOSEDLOOP_HARDWARE__MECHANISM_HPP_

#include <Eigen/Cholesky>

#include <array>
#include <cstddef>
#include <map>
#include <memory>
#include <string>
#include <vector>

namespace closedloop_hardware
{

/// What is commanded in a joint. Without a command nothing acts in it but the model's own effects.
enum class Command {NONE, EFFORT, POSITION, VELOCITY};

/// The C of `closedloop export`, compiled as a shared library.
class Model
{
public:
  /// Load a library NAME.so or libNAME.so of the C that was exported under NAME. Throws
  /// std::invalid_argument where it cannot be loaded, or lacks a function.
  explicit Model(const std::string & file);

  std::string file;
  int nq, nv, nc;
  std::vector<std::string> positions, velocities, joints;  // Of q, of qd, of joint_forces
  const void * numbers;
  const double * start;  // q, qd
  int (* evaluate)(
    const void *, const double *, const double *, const double *, double *, double *);
  int (* correct)(const void *, double *);
  int (* step)(const void *, double *, const double *, double);
  void (* move)(double *, const double *);
  void (* closure)(const void *, const double *, double *, double *);
  /// Null where forces in joints are not unique.
  void (* joint_forces)(
    const void *, const double *, const double *, const double *, const double *, double *);

private:
  std::shared_ptr<void> library_;

  template<typename Pointer>
  Pointer find(const std::string & name) const;
  std::vector<std::string> strings(const std::string & name) const;
};

/// A mechanism that moves under commands, by steps of the exported model. SI units and radians.
class Mechanism
{
public:
  /// `step_size` [s]: of the longest step. `bandwidth` [rad/s]: of the servos that follow commanded
  /// positions and velocities; 0 where there are none. Throws std::invalid_argument.
  Mechanism(const std::string & model_file, double step_size, double bandwidth);

  /// Names of the joints of one degree of freedom.
  std::vector<std::string> joint_names() const;

  /// Return the number of a joint, or the place of a joint's wrench; throw std::invalid_argument
  /// for a name that the model does not have.
  std::size_t joint(const std::string & name) const;
  std::size_t wrench_place(const std::string & joint) const;

  /// Limit the effort of a joint's servo [N m, N]: above 0, infinite at first. Commanded efforts
  /// have no limit here. Throws std::invalid_argument.
  void limit_effort(std::size_t joint, double limit);

  /// Start where joints are at these positions, and all others where the loops are closed, on the
  /// branch that leads there from the model's start. Throws std::invalid_argument where there is no
  /// such position.
  void start_at(const std::map<std::string, double> & positions);

  /// Return to the start: time 0, no command; or the commands as they are, joints held there.
  /// Neither allocates.
  void reset();
  void restart();

  /// Tell whether the servos of these commands, one a joint, can act one by one here: no more than
  /// the mechanism has degrees of freedom, and independent ones.
  bool can_follow(const std::vector<Command> & commands);

  /// Exchange the commands, and hold joints that begin to be commanded: where they are, or at rest,
  /// or without effort.
  void set_commands(const std::vector<Command> & commands);
  const std::vector<Command> & commands() const {return commands_;}

  /// Command an effort [N m, N], a position [rad, m] or a velocity; it holds until the next one.
  void command(std::size_t joint, double value) {target_[joint] = value;}
  double commanded(std::size_t joint) const {return target_[joint];}

  /// Advance by a time [s], in equal steps. Allocates nothing. Where it fails, `fault` says why,
  /// and the state is that before the step that failed.
  bool advance(double period);
  const char * fault() const {return fault_;}

  double time() const {return time_;}
  double position(std::size_t joint) const {return state_[place_[joint]];}
  double velocity(std::size_t joint) const {return state_[model_.nq + joint];}
  double acceleration(std::size_t joint) const {return qdd_[joint];}
  double effort(std::size_t joint) const {return tau_[joint];}

  /// What the parent exerts on the child of a joint, at the child's origin in its axes; in a joint
  /// that closes a loop, body B on body A, at its point of A in the axes of A: force [N], then
  /// torque [N m].
  std::array<double, 6> wrench(std::size_t place) const;

private:
  const Model model_;
  const double step_size_, bandwidth_;
  std::vector<int> place_;  // Of coordinates in q; -1 of parts of orientations
  std::vector<double> start_, state_;  // q, qd
  std::vector<Command> commands_, acting_;  // As commanded; without servos at their limits
  std::vector<double> limit_, target_, tau_, qdd_, lam_, forces_, probe_;
  Eigen::MatrixXd mobility_;
  Eigen::VectorXd missing_;
  Eigen::LLT<Eigen::MatrixXd> factor_;
  double time_ = 0.0;
  const char * fault_ = "";

  std::string name_of(std::size_t joint) const;
  bool factor_mobility(const std::vector<Command> & commands);
  bool find_efforts();
  bool solve_servos();
  bool measure();
  bool failed(int status);
  double close_around(std::vector<double> & state, const std::vector<bool> & held) const;
};

}  // namespace closedloop_hardware

#endif  // CLOSEDLOOP_HARDWARE__MECHANISM_HPP_
