// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__HANDLES_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__HANDLES_HPP_

#include <algorithm>
#include <initializer_list>
#include <memory>
#include <new>
#include <string>
#include <utility>

#include "callable_dynamics.hpp"
#include "callable_steps.hpp"
#include "data.hpp"
#include "python_api.hpp"

// What Python holds of objects of the engine: a capsule with the object, and views of its arrays by
// name, each of which keeps its memory, whatever becomes of the object.

namespace closedloop
{

/// Thrown where Python's error is set.
struct PythonError {};

/// A reference that is given back.
class Owned
{
public:
  explicit Owned(PyObject * object)
  : object_(object)
  {
    if (object == nullptr) {
      throw PythonError();
    }
  }
  Owned(Owned && other) noexcept
  : object_(std::exchange(other.object_, nullptr)) {}
  Owned(const Owned &) = delete;
  Owned & operator=(const Owned &) = delete;
  Owned & operator=(Owned &&) = delete;
  ~Owned()
  {
    if (object_ != nullptr) {
      Py_DecRef(object_);
    }
  }
  PyObject * get() const {return object_;}
  PyObject * release() {return std::exchange(object_, nullptr);}

private:
  PyObject * object_;
};

/// Which argument is read, for messages.
struct Place
{
  const char * function;
  Py_ssize_t argument;
};

/// Names of the capsules of the types that Python has handles of.
template<class Type>
inline constexpr const char * handle_name = nullptr;
template<>
inline constexpr const char * handle_name<Model> = "closedloop_dynamics.engine.Model";
template<>
inline constexpr const char * handle_name<Manifold> = "closedloop_dynamics.engine.Manifold";
template<>
inline constexpr const char * handle_name<Workspace> = "closedloop_dynamics.engine.Workspace";
template<>
inline constexpr const char * handle_name<EffectTable> = "closedloop_dynamics.engine.EffectTable";
template<>
inline constexpr const char * handle_name<CallableDynamics> =
  "closedloop_dynamics.engine.CallableDynamics";
template<>
inline constexpr const char * handle_name<CallableSteps> =
  "closedloop_dynamics.engine.CallableSteps";
template<>
inline constexpr const char * handle_name<Data> = "closedloop_dynamics.engine.System";

/// The object of a handle, or of an object that has a handle as its attribute `native`.
template<class Type>
std::shared_ptr<Type> read_handle(PyObject * from, Place place)
{
  const char * name = handle_name<Type>;
  if (PyCapsule_IsValid(from, name) != 0) {
    return *static_cast<std::shared_ptr<Type> *>(PyCapsule_GetPointer(from, name));
  }
  PyObject * attribute = PyObject_GetAttrString(from, "native");
  if (attribute == nullptr || PyCapsule_IsValid(attribute, name) == 0) {
    PyErr_Clear();
    Py_DecRef(attribute);
    PyErr_Format(
      PyExc_TypeError, "%s, argument %zd: expected a handle of %s", place.function,
      place.argument, name);
    throw PythonError();
  }
  const Owned handle(attribute);
  return *static_cast<std::shared_ptr<Type> *>(PyCapsule_GetPointer(attribute, name));
}

/// An object of Python through whose buffer an array is seen.
struct MemoryObject
{
  PyObject head;
  std::shared_ptr<void> memory;
  const char * format;
  Py_ssize_t shape[3];
  Py_ssize_t strides[3];
  int dimensions;
  bool is_constant;
};

inline int fill_buffer(PyObject * object, Py_buffer * view, int flags)
{
  auto * from = reinterpret_cast<MemoryObject *>(object);
  if (from->is_constant && (flags & PyBUF_WRITABLE) != 0) {
    PyErr_SetString(PyExc_BufferError, "constant of the engine");
    view->obj = nullptr;
    return -1;
  }
  *view = {};
  view->buf = from->memory.get();
  view->obj = object;
  Py_IncRef(object);
  view->itemsize = 8;
  view->len = view->itemsize;
  for (int n = 0; n < from->dimensions; ++n) {
    view->len *= from->shape[n];
  }
  view->readonly = from->is_constant ? 1 : 0;
  view->ndim = from->dimensions;
  view->format = const_cast<char *>(from->format);
  view->shape = from->shape;
  view->strides = from->strides;
  return 0;
}

inline void free_memory(PyObject * object)
{
  PyTypeObject * type = object->ob_type;
  reinterpret_cast<MemoryObject *>(object)->memory.~shared_ptr();
  PyObject_Free(object);
  Py_DecRef(reinterpret_cast<PyObject *>(type));
}

/// The type of these objects, made with the module.
inline PyObject * make_memory_type()
{
  static PyType_Slot slots[] = {
    {Py_bf_getbuffer, reinterpret_cast<void *>(fill_buffer)},
    {Py_tp_dealloc, reinterpret_cast<void *>(free_memory)}, {0, nullptr}};
  static PyType_Spec spec = {
    "closedloop_dynamics.engine.native.Memory", sizeof(MemoryObject), 0,
    Py_TPFLAGS_DISALLOW_INSTANTIATION, slots};
  return PyType_FromSpec(&spec);
}

inline PyObject * memory_type = nullptr;

/// Writes views of arrays into a dictionary, by name; records within records with a dot. Those that
/// Python has handles of are left out.
class Views
{
public:
  explicit Views(PyObject * dictionary, std::string prefix = "")
  : dictionary_(dictionary), prefix_(std::move(prefix)) {}

  template<class ... Field>
  void operator()(const char * names, Field & ... field) {(add(next(names), field), ...);}

private:
  /// The next of names that are divided by commas, line breaks and spaces.
  std::string next(const char * & names) const
  {
    std::string name;
    for (; *names == ',' || *names == ' '; ++names) {}
    for (; *names != ',' && *names != '\0'; ++names) {
      name += *names;
    }
    return prefix_ + name;
  }
  void put(
    const std::string & name, std::shared_ptr<void> memory, const char * format, bool is_constant,
    std::initializer_list<Py_ssize_t> shape) const
  {
    const Owned object(PyType_GenericAlloc(reinterpret_cast<PyTypeObject *>(memory_type), 0));
    auto * made = reinterpret_cast<MemoryObject *>(object.get());
    new (&made->memory) std::shared_ptr<void>(std::move(memory));
    made->format = format;
    made->is_constant = is_constant;
    made->dimensions = static_cast<int>(shape.size());
    std::copy(shape.begin(), shape.end(), made->shape);
    Py_ssize_t stride = 8;
    for (int n = made->dimensions - 1; n >= 0; --n) {
      made->strides[n] = stride;
      stride *= made->shape[n];
    }
    if (PyDict_SetItemString(dictionary_, name.c_str(), object.get()) < 0) {
      throw PythonError();
    }
  }
  template<class Number>
  void add(const std::string & name, const Array<Vector<Number>> & array) const
  {
    put(name, array.memory(), format<Number>(), array.is_constant, {array.size});
  }
  template<class Number>
  void add(const std::string & name, const Array<Matrix<Number>> & array) const
  {
    put(name, array.memory(), format<Number>(), array.is_constant, {array.rows, array.columns});
  }
  template<class Number>
  void add(const std::string & name, const Array<Cube<Number>> & array) const
  {
    put(
      name, array.memory(), format<Number>(), array.is_constant,
      {array.pages, array.rows, array.columns});
  }
  void add(const std::string & name, const std::shared_ptr<Settings> & settings) const
  {
    const auto put_one = [&](const char * part, double & number) {
        put(name + "." + part, {settings, &number}, format<double>(), false, {});
      };
    put_one("baumgarte_gain", settings->baumgarte_gain);
    put_one("closure_tolerance", settings->closure_tolerance);
    put_one("closure_limit", settings->closure_limit);
    put_one("aside", settings->aside);
  }
  template<class Record>
  auto add(const std::string & name, Record & record) const->decltype(record.arrays(*this))
  {
    if constexpr (handle_name<Record> == nullptr) {
      record.arrays(Views(dictionary_, name + "."));
    }
  }
  template<class Number>
  static const char * format()
  {
    // Windows has 32 bits in a long.
    return std::is_same_v<Number, double> ? "d" : sizeof(long) == sizeof(Index) ? "l" : "q";
  }

  PyObject * dictionary_;
  std::string prefix_;
};

/// A handle of an object, and views of its arrays by name.
template<class Type>
auto to_python(Type value)->std::enable_if_t<handle_name<Type> != nullptr, PyObject *>
{
  auto object = std::make_unique<std::shared_ptr<Type>>(std::make_shared<Type>(std::move(value)));
  const Owned views(PyDict_New());
  (*object)->arrays(Views(views.get()));
  const Owned capsule(
    PyCapsule_New(
      object.get(), handle_name<Type>, [](PyObject * handle) {
        delete static_cast<std::shared_ptr<Type> *>(
          PyCapsule_GetPointer(handle, handle_name<Type>));
      }));
  object.release();
  return PyTuple_Pack(2, capsule.get(), views.get());
}

/// Views of the arrays of data alone, by name.
struct ViewsOf
{
  Data * data;
};

inline PyObject * to_python(ViewsOf of)
{
  Owned views(PyDict_New());
  of.data->arrays(Views(views.get()));
  return views.release();
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__HANDLES_HPP_
