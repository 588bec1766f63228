// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__HOST_STEPS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__HOST_STEPS_HPP_

#include <memory>
#include <utility>

#include "arguments.hpp"

namespace closedloop
{

/// Python's interpreter lock, in a computation that has released it.
class Interpreter
{
public:
  Interpreter()
  : state_(PyGILState_Ensure()) {}
  Interpreter(const Interpreter &) = delete;
  Interpreter & operator=(const Interpreter &) = delete;
  ~Interpreter() {PyGILState_Release(state_);}

private:
  PyGILState_STATE state_;
};

/// Steps of a solver that is an object of Python (integration/scipy_solvers.py).
class HostSteps : public StepperOf<HostSteps>
{
public:
  HostSteps(const System & system, Stabilisation stabilisation, PyObject * solver)
  : StepperOf(system, stabilisation), solver_(solver) {Py_IncRef(solver);}
  HostSteps(const HostSteps & other)
  : StepperOf(other)
  {
    const Interpreter held;
    solver_ = PyObject_CallMethod(other.solver_, "copy", nullptr);
    if (solver_ == nullptr) {
      throw PythonError();
    }
  }
  HostSteps & operator=(const HostSteps &) = delete;
  ~HostSteps() override
  {
    const Interpreter held;
    Py_DecRef(solver_);
  }

  /// An error of Python ends the steps, which count as not made.
  Advance advance(const System &, Values state, const Grid & grid) override
  {
    const Interpreter held;
    Advance ended{Status::INTERRUPTED, 0.0};
    try {
      const Owned memory(
        PyMemoryView_FromMemory(
          reinterpret_cast<char *>(state.data),
          state.size * static_cast<Py_ssize_t>(sizeof(double)), PyBUF_WRITE));
      const Owned found(
        PyObject_CallMethod(
          solver_, "advance", "Odndni", memory.get(), grid.origin,
          static_cast<Py_ssize_t>(grid.done), grid.step_size,
          static_cast<Py_ssize_t>(grid.steps), static_cast<int>(std::exchange(restarts_, false))));
      read(PyTuple_GetItem(found.get(), 0), ended.status, {"advance", 1});
      read(PyTuple_GetItem(found.get(), 1), ended.elapsed, {"advance", 2});
    } catch (const PythonError &) {
      ended.status = Status::INTERRUPTED;
    }
    return ended;
  }
  void go_on() override {restarts_ = true;}
  void restart(const System &, bool) override {restarts_ = true;}
  void rewind(const System &) override {restarts_ = true;}

private:
  PyObject * solver_ = nullptr;
  bool restarts_ = true;
};

/// A method of the engine by its name, or a solver of Python.
struct GivenMethod
{
  std::string_view name;
  PyObject * solver = nullptr;

  std::unique_ptr<Stepper> make(const System & system, const MethodOptions & options) const
  {
    if (solver != nullptr) {
      return std::make_unique<HostSteps>(system, options.stabilisation, solver);
    }
    return make_stepper(system, name, options);
  }
};

inline void read(PyObject * from, GivenMethod & to, Place)
{
  Py_ssize_t length = 0;
  const char * name = PyUnicode_AsUTF8AndSize(from, &length);
  if (name != nullptr) {
    to.name = {name, static_cast<std::size_t>(length)};
  } else {
    PyErr_Clear();
    to.solver = from;
  }
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__HOST_STEPS_HPP_
