// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__OBJECTS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__OBJECTS_HPP_

#include <algorithm>
#include <initializer_list>
#include <memory>
#include <new>
#include <string>
#include <utility>

#include "data.hpp"
#include "python_api.hpp"

// What Python holds of the engine: objects of types with methods, and views of their arrays by name,
// each of which keeps its memory, whatever becomes of the object.

namespace closedloop
{

/// Thrown where Python's error is set.
struct PythonError {};

[[noreturn]] inline void refuse(PyObject * error, const std::string & text)
{
  PyErr_SetString(error, text.c_str());
  throw PythonError();
}

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

inline PyObject * none()
{
  Py_IncRef(&_Py_NoneStruct);
  return &_Py_NoneStruct;
}

/// The names of types of objects in Python, and the types, made with the module.
template<class Type>
inline constexpr const char * type_name = nullptr;
template<class Type>
inline PyObject * type_of = nullptr;

/// An object of Python.
template<class Type>
struct Holding
{
  PyObject head;
  std::shared_ptr<Type> object;
};

template<class Type>
std::shared_ptr<Type> & held_by(PyObject * object)
{
  return reinterpret_cast<Holding<Type> *>(object)->object;
}

template<class Type>
bool holds(PyObject * object)
{
  return reinterpret_cast<PyObject *>(object->ob_type) == type_of<Type>;
}

template<class Type>
void free_object(PyObject * object)
{
  PyTypeObject * type = object->ob_type;
  held_by<Type>(object).~shared_ptr();
  PyObject_Free(object);
  Py_DecRef(reinterpret_cast<PyObject *>(type));
}

/// Make the type of the objects that hold one of these, with a further slot.
template<class Type>
void make_type(PyType_Slot further)
{
  PyType_Slot slots[] = {
    {Py_tp_dealloc, reinterpret_cast<void *>(free_object<Type>)}, further, {0, nullptr}};
  PyType_Spec spec = {
    type_name<Type>, sizeof(Holding<Type>), 0, Py_TPFLAGS_DISALLOW_INSTANTIATION, slots};
  type_of<Type> = Owned(PyType_FromSpec(&spec)).release();
}

/// None where there is no object.
template<class Type>
PyObject * to_python(std::shared_ptr<Type> object)
{
  if (object == nullptr) {
    return none();
  }
  Owned made(PyType_GenericAlloc(reinterpret_cast<PyTypeObject *>(type_of<Type>), 0));
  new (&held_by<Type>(made.get())) std::shared_ptr<Type>(std::move(object));
  return made.release();
}

template<class Type>
auto to_python(Type value)->std::enable_if_t<type_name<Type> != nullptr, PyObject *>
{
  return to_python(std::make_shared<Type>(std::move(value)));
}

/// An array, seen through the buffer of an object.
struct Memory
{
  std::shared_ptr<void> memory;
  const char * format;
  bool is_constant;
  int dimensions;
  Py_ssize_t shape[3];
  Py_ssize_t strides[3];
};
template<>
inline constexpr const char * type_name<Memory> = "closedloop_dynamics.engine.native.Memory";

inline int fill_buffer(PyObject * object, Py_buffer * view, int flags)
{
  Memory & from = *held_by<Memory>(object);
  *view = {};
  if (from.is_constant && (flags & PyBUF_WRITABLE) != 0) {
    PyErr_SetString(PyExc_BufferError, "constant of the engine");
    return -1;
  }
  view->buf = from.memory.get();
  view->obj = object;
  Py_IncRef(object);
  view->itemsize = 8;
  view->len = from.dimensions > 0 ? from.shape[0] * from.strides[0] : view->itemsize;
  view->readonly = from.is_constant ? 1 : 0;
  view->ndim = from.dimensions;
  view->format = const_cast<char *>(from.format);
  view->shape = from.shape;
  view->strides = from.strides;
  return 0;
}

/// Writes views of arrays into a dictionary, by name; records within records with a dot. Those that
/// are objects in Python are left out.
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
  template<class Number>
  void put(
    const std::string & name, std::shared_ptr<Number> memory, bool is_constant,
    std::initializer_list<Py_ssize_t> shape) const
  {
    // Windows has 32 bits in a long.
    const char * format = std::is_same_v<std::remove_extent_t<Number>, double> ? "d" :
      sizeof(long) == sizeof(Index) ? "l" : "q";
    Memory made{std::move(memory), format, is_constant, static_cast<int>(shape.size()), {}, {}};
    std::copy(shape.begin(), shape.end(), made.shape);
    Py_ssize_t stride = 8;
    for (int n = made.dimensions - 1; n >= 0; --n) {
      made.strides[n] = stride;
      stride *= made.shape[n];
    }
    const Owned object(to_python(std::make_shared<Memory>(std::move(made))));
    if (PyDict_SetItemString(dictionary_, name.c_str(), object.get()) < 0) {
      throw PythonError();
    }
  }
  template<class Number>
  void add(const std::string & name, const Array<Vector<Number>> & array) const
  {
    put(name, array.memory(), array.is_constant, {array.size});
  }
  template<class Number>
  void add(const std::string & name, const Array<Matrix<Number>> & array) const
  {
    put(name, array.memory(), array.is_constant, {array.rows, array.columns});
  }
  template<class Number>
  void add(const std::string & name, const Array<Cube<Number>> & array) const
  {
    put(name, array.memory(), array.is_constant, {array.pages, array.rows, array.columns});
  }
  void add(const std::string & name, const std::shared_ptr<Settings> & settings) const
  {
    const auto put_one = [&](const char * part, double & number) {
        put(name + "." + part, std::shared_ptr<double>(settings, &number), false, {});
      };
    put_one("baumgarte_gain", settings->baumgarte_gain);
    put_one("closure_tolerance", settings->closure_tolerance);
    put_one("closure_limit", settings->closure_limit);
    put_one("aside", settings->aside);
  }
  template<class Record>
  auto add(const std::string & name, Record & record) const->decltype(record.arrays(*this))
  {
    if constexpr (type_name<Record> == nullptr) {
      record.arrays(Views(dictionary_, name + "."));
    }
  }

  PyObject * dictionary_;
  std::string prefix_;
};

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__OBJECTS_HPP_
