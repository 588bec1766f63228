// Copyright 2026 The closedloop_dynamics authors
//
// Licensed under the Apache License, Version 2.0 (the "License");
// you may not use this file except in compliance with the License.
// You may obtain a copy of the License at
//
//     http://www.apache.org/licenses/LICENSE-2.0
//
// Unless required by applicable law or agreed to in writing, software
// distributed under the License is distributed on an "AS IS" BASIS,
// WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
// See the License for the specific language governing permissions and
// limitations under the License.

/// @file
/// The engine in Python: shapes and types are checked here, and nothing is computed.

#include <cstdint>
#include <cstring>
#include <exception>
#include <new>

#include "build_info.hpp"
#include "least_squares.hpp"
#include "python_api.hpp"

namespace closedloop {
namespace {

/// Call a function of C++ for Python: an exception becomes Python's, and `failed` is returned.
template <typename Function, typename Result>
Result guarded(Function &&function, Result failed) {
  try {
    return function();
  } catch (const std::bad_alloc &) {
    PyErr_SetString(PyExc_MemoryError, "out of memory");
  } catch (const std::exception &error) {
    PyErr_SetString(PyExc_RuntimeError, error.what());
  } catch (...) {
    PyErr_SetString(PyExc_RuntimeError, "unknown exception in the engine");
  }
  return failed;
}

/// An array of float64 that Python owns; it stays where it is as long as this exists.
class Doubles {
 public:
  Doubles() = default;
  Doubles(const Doubles &) = delete;
  Doubles &operator=(const Doubles &) = delete;
  ~Doubles() { PyBuffer_Release(&view_); }

  /// Bind an array of so many dimensions; or set Python's error, which names the array, and
  /// return false.
  bool bind(PyObject *array, const char *name, int dimensions, bool writable) {
    if (PyObject_GetBuffer(
            array, &view_, c_contiguous | PyBUF_FORMAT | (writable ? PyBUF_WRITABLE : 0)) < 0) {
      return false;
    }
    if (view_.format == nullptr || std::strcmp(view_.format, "d") != 0 ||
        reinterpret_cast<std::uintptr_t>(view_.buf) % alignof(double) != 0) {
      PyErr_Format(
          PyExc_TypeError, "%s: expected aligned float64, got format '%s'", name,
          view_.format == nullptr ? "B" : view_.format);
      return false;
    }
    if (view_.ndim != dimensions) {
      PyErr_Format(
          PyExc_ValueError, "%s: expected %d dimensions, got %d", name, dimensions, view_.ndim);
      return false;
    }
    return true;
  }

  double *data() const { return static_cast<double *>(view_.buf); }
  Py_ssize_t size(int dimension) const { return view_.shape[dimension]; }

 private:
  Py_buffer view_{};
};

/// Least squares on bound arrays.
struct LeastSquares {
  PyObject head;
  Doubles matrix, right, solution;
  double tolerance;
};

LeastSquares &self_of(PyObject *self) { return *reinterpret_cast<LeastSquares *>(self); }

bool bind(LeastSquares &self, PyObject *arguments) {
  PyObject *matrix, *right, *solution;
  if (!PyArg_ParseTuple(
          arguments, "OOOd:LeastSquares", &matrix, &right, &solution, &self.tolerance) ||
      !self.matrix.bind(matrix, "matrix", 2, false) ||
      !self.right.bind(right, "right", 1, false) ||
      !self.solution.bind(solution, "solution", 1, true)) {
    return false;
  }
  const Py_ssize_t rows = self.matrix.size(0), columns = self.matrix.size(1);
  if (rows == 0 || columns == 0 || self.right.size(0) != rows ||
      self.solution.size(0) != columns) {
    PyErr_Format(
        PyExc_ValueError,
        "expected matrix (m, n), right (m,), solution (n,) with m, n > 0, "
        "got (%zd, %zd), (%zd,), (%zd,)",
        rows, columns, self.right.size(0), self.solution.size(0));
    return false;
  }
  return true;
}

PyObject *least_squares_new(PyTypeObject *type, PyObject *arguments, PyObject *) {
  PyObject *object = PyType_GenericAlloc(type, 0);
  if (object == nullptr) {
    return nullptr;
  }
  // Python fills new memory with zeros, which is an array that is not bound.
  if (!bind(self_of(object), arguments)) {
    Py_DecRef(object);
    return nullptr;
  }
  return object;
}

void least_squares_dealloc(PyObject *object) {
  PyTypeObject *type = object->ob_type;
  LeastSquares &self = self_of(object);
  self.matrix.~Doubles();
  self.right.~Doubles();
  self.solution.~Doubles();
  reinterpret_cast<freefunc>(PyType_GetSlot(type, Py_tp_free))(object);
  Py_DecRef(reinterpret_cast<PyObject *>(type));
}

PyObject *least_squares_solve(PyObject *object, PyObject *) {
  return guarded(
      [&]() -> PyObject * {
        const LeastSquares &self = self_of(object);
        const Eigen::Map<const Matrix> matrix(
            self.matrix.data(), self.matrix.size(0), self.matrix.size(1));
        const Eigen::Map<const Eigen::VectorXd> right(self.right.data(), self.right.size(0));
        if (!matrix.allFinite() || !right.allFinite()) {
          PyErr_SetString(PyExc_ValueError, "matrix and right: expected finite numbers");
          return nullptr;
        }
        return PyLong_FromLong(least_squares(
            matrix, right, self.tolerance,
            Eigen::Map<Eigen::VectorXd>(self.solution.data(), self.solution.size(0))));
      },
      static_cast<PyObject *>(nullptr));
}

/// The void pointer that Python's tables hold.
template <typename Function>
void *erased(Function *function) {
  return reinterpret_cast<void *>(function);
}

PyMethodDef least_squares_methods[] = {
    {"solve", least_squares_solve, METH_NOARGS, "Write the solution and return the rank."},
    {}};

PyType_Slot least_squares_slots[] = {
    {Py_tp_new, erased(least_squares_new)},
    {Py_tp_dealloc, erased(least_squares_dealloc)},
    {Py_tp_methods, least_squares_methods},
    {Py_tp_doc,
     const_cast<char *>(
         "LeastSquares(matrix, right, solution, tolerance): shortest solution of least residual.")},
    {}};

PyType_Spec least_squares_spec = {
    "closedloop_dynamics.engine.native.LeastSquares", sizeof(LeastSquares), 0, 0,
    least_squares_slots};

bool add_type(PyObject *module, PyType_Spec &spec) {
  PyObject *type = PyType_FromSpec(&spec);
  const bool added =
      type != nullptr && PyModule_AddType(module, reinterpret_cast<PyTypeObject *>(type)) == 0;
  if (type != nullptr) {
    Py_DecRef(type);
  }
  return added;
}

int fill_module(PyObject *module) {
  const bool filled = PyModule_AddStringConstant(module, "sources", sources) == 0 &&
                      PyModule_AddStringConstant(module, "compiler", compiler) == 0 &&
                      PyModule_AddStringConstant(module, "flags", flags) == 0 &&
                      add_type(module, least_squares_spec);
  return filled ? 0 : -1;
}

PyModuleDef_Slot module_slots[] = {{Py_mod_exec, erased(fill_module)}, {}};

PyModuleDef module_definition = {
    {{1, nullptr}, nullptr, 0, nullptr},
    "closedloop_dynamics.engine.native",
    "Compiled kernels of the package.",
    0,
    nullptr,
    module_slots,
    nullptr,
    nullptr,
    nullptr};

}  // namespace
}  // namespace closedloop

extern "C" __attribute__((visibility("default"))) PyObject *PyInit_native() {
  return PyModuleDef_Init(&closedloop::module_definition);
}
