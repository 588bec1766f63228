// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ARGUMENTS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ARGUMENTS_HPP_

#include <array>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <exception>
#include <memory>
#include <new>
#include <stdexcept>
#include <string>
#include <string_view>
#include <thread>
#include <tuple>
#include <type_traits>
#include <utility>
#include <vector>

#include "bounds.hpp"
#include "data.hpp"
#include "forces.hpp"
#include "handles.hpp"
#include "python_api.hpp"
#include "run.hpp"

// Functions of C++ as functions of Python: arguments are converted by the types of the parameters.
// Arrays are used in place (C-contiguous, of float64 or int64), named tuples of arrays become the
// structs of the same fields, None an empty one.

namespace closedloop
{

template<class Record>
void read_record(PyObject * from, Record & to, Place place);

struct Ignore
{
  template<class ... Field>
  void operator()(Field && ...) const {}
};

template<class Type, class = void>
struct IsRecord : std::false_type {};
template<class Type>
struct IsRecord<Type, std::void_t<decltype(std::declval<Type &>().fields(Ignore{}))>>
  : std::true_type {};

/// The letter of the type of an array's entries; '?' where it takes more than one.
inline char kind_of(const Py_buffer & view)
{
  return view.format != nullptr && view.format[0] != '\0' && view.format[1] == '\0' ?
         view.format[0] : '?';
}

inline bool is_real(const Py_buffer & view) {return view.itemsize == 8 && kind_of(view) == 'd';}

template<class Number>
bool is_aligned(const Py_buffer & view)
{
  return reinterpret_cast<std::uintptr_t>(view.buf) % alignof(Number) == 0;
}

/// See an array as numbers of a type, with so many dimensions.
template<class Number>
Number * read_array(PyObject * from, int dimensions, Index * shape, Place place)
{
  Py_buffer view{};
  const int flags = c_contiguous | PyBUF_FORMAT | (std::is_const_v<Number>? 0 : PyBUF_WRITABLE);
  if (PyObject_GetBuffer(from, &view, flags) < 0) {
    throw PythonError();
  }
  // The caller holds a reference to the array.
  PyBuffer_Release(&view);
  constexpr bool wants_real = std::is_same_v<std::remove_const_t<Number>, double>;
  const char kind = kind_of(view);
  const bool fits = wants_real ?
    is_real(view) : view.itemsize == 8 && (kind == 'l' || kind == 'q');
  if (!fits || view.ndim != dimensions || !is_aligned<Number>(view)) {
    PyErr_Format(
      PyExc_TypeError, "%s, argument %zd: expected %s of %d dimensions, got format '%c' of %d",
      place.function, place.argument, wants_real ? "float64" : "int64", dimensions, kind,
      view.ndim);
    throw PythonError();
  }
  for (int n = 0; n < dimensions; ++n) {
    shape[n] = view.shape[n];
  }
  return static_cast<Number *>(view.buf);
}

template<class Number>
void read(PyObject * from, Vector<Number> & to, Place place)
{
  to.data = read_array<Number>(from, 1, &to.size, place);
}

template<class Number>
void read(PyObject * from, Matrix<Number> & to, Place place)
{
  Index shape[2];
  to.data = read_array<Number>(from, 2, shape, place);
  to.rows = shape[0];
  to.columns = shape[1];
}

template<class Number>
void read(PyObject * from, Cube<Number> & to, Place place)
{
  Index shape[3];
  to.data = read_array<Number>(from, 3, shape, place);
  to.pages = shape[0];
  to.rows = shape[1];
  to.columns = shape[2];
}

/// Read an array of numbers; Python reports anything else.
inline void read(PyObject * from, OptionalVector & to, Place)
{
  to = {};
  to.is_none = from == &_Py_NoneStruct;
  if (to.is_none || !PyObject_CheckBuffer(from)) {
    return;
  }
  Py_buffer view{};
  if (PyObject_GetBuffer(from, &view, c_contiguous | PyBUF_FORMAT) < 0) {
    PyErr_Clear();
    return;
  }
  // The caller holds a reference to the array.
  PyBuffer_Release(&view);
  to.is_array = view.ndim == 1 && is_real(view) && is_aligned<double>(view);
  if (to.is_array) {
    to.numbers = {static_cast<const double *>(view.buf), view.shape[0]};
  }
}

inline void read(PyObject * from, double & to, Place)
{
  to = PyFloat_AsDouble(from);
  if (to == -1.0 && PyErr_Occurred() != nullptr) {
    throw PythonError();
  }
}

inline void read(PyObject * from, Index & to, Place)
{
  to = PyLong_AsLongLong(from);
  if (to == -1 && PyErr_Occurred() != nullptr) {
    throw PythonError();
  }
}

inline void read(PyObject * from, bool & to, Place)
{
  const int found = PyObject_IsTrue(from);
  if (found < 0) {
    throw PythonError();
  }
  to = found == 1;
}

/// The last value of each enumeration that Python hands over.
constexpr Index last_of(Stabilisation) {return static_cast<Index>(Stabilisation::INDEPENDENT);}
constexpr Index last_of(effect::Role) {return effect::INERTIA;}
constexpr Index last_of(effect::Gap) {return effect::EVENT;}
constexpr Index last_of(Status) {return static_cast<Index>(Status::DOUBTFUL);}
constexpr Index last_of(Responses) {return static_cast<Index>(Responses::CARRIED);}

template<class Type>
auto read(PyObject * from, Type & to, Place place)
->std::enable_if_t<std::is_enum_v<Type>>
{
  Index number;
  read(from, number, place);
  if (number < 0 || number > last_of(Type{})) {
    PyErr_Format(
      PyExc_ValueError, "%s, argument %zd: expected 0 to %zd, got %zd", place.function,
      place.argument, static_cast<Py_ssize_t>(last_of(Type{})), static_cast<Py_ssize_t>(number));
    throw PythonError();
  }
  to = static_cast<Type>(number);
}

inline void read(PyObject * from, std::string_view & to, Place)
{
  Py_ssize_t length = 0;
  const char * text = PyUnicode_AsUTF8AndSize(from, &length);
  if (text == nullptr) {
    throw PythonError();
  }
  // The caller holds a reference to the text.
  to = {text, static_cast<std::size_t>(length)};
}

/// Read a tuple of records.
template<class Record>
void read(PyObject * from, std::vector<Record> & to, Place place)
{
  const Py_ssize_t count = PyTuple_Size(from);
  if (count < 0) {
    throw PythonError();
  }
  to.assign(static_cast<std::size_t>(count), {});
  for (Py_ssize_t n = 0; n < count; ++n) {
    read_record(PyTuple_GetItem(from, n), to[static_cast<std::size_t>(n)], place);
  }
}

inline void read(PyObject * from, const System * & to, Place place)
{
  // The caller holds a reference to the handle.
  to = read_handle<System>(from, place).get();
}

inline void read(PyObject * from, Manifold & to, Place place)
{
  to = from == &_Py_NoneStruct ? Manifold() : *read_handle<Manifold>(from, place);
}

/// A run with what it works on; `owner` keeps the state.
struct RunObject
{
  std::shared_ptr<System> system;
  Values state;
  std::shared_ptr<void> owner;
  Run run;

  /// The run, if it still is one of the system.
  Run & fitting()
  {
    if (!run.fits(*system)) {
      throw std::invalid_argument("expected a run of this system");
    }
    return run;
  }
};

/// Type in Python of objects that have methods, made with the module; nullptr: they are handles.
template<class Type>
inline PyObject * type_of = nullptr;
template<class Type>
inline constexpr bool has_methods =
  std::is_same_v<Type, RunObject> || std::is_same_v<Type, Snapshot>;

template<class Type>
struct Holding
{
  PyObject head;
  std::unique_ptr<Type> object;
};

template<class Type>
Type & object_in(PyObject * from, Place place)
{
  if (reinterpret_cast<PyObject *>(from->ob_type) != type_of<Type>) {
    PyErr_Format(
      PyExc_TypeError, "%s, argument %zd: expected an object of another type of the engine",
      place.function, place.argument);
    throw PythonError();
  }
  return *reinterpret_cast<Holding<Type> *>(from)->object;
}

template<class Type>
void free_object(PyObject * object)
{
  PyTypeObject * type = object->ob_type;
  reinterpret_cast<Holding<Type> *>(object)->object.~unique_ptr();
  PyObject_Free(object);
  Py_DecRef(reinterpret_cast<PyObject *>(type));
}

/// Make the type of objects that have these methods.
template<class Type>
PyObject * make_type(const char * name, PyMethodDef * methods)
{
  PyType_Slot slots[] = {
    {Py_tp_methods, methods}, {Py_tp_dealloc, reinterpret_cast<void *>(free_object<Type>)},
    {0, nullptr}};
  PyType_Spec spec = {
    name, sizeof(Holding<Type>), 0, Py_TPFLAGS_DISALLOW_INSTANTIATION, slots};
  return type_of<Type> = PyType_FromSpec(&spec);
}

inline void read(PyObject * from, const Run * & to, Place place)
{
  to = &object_in<RunObject>(from, place).run;
}

inline void read(PyObject * from, std::shared_ptr<System> & to, Place place)
{
  to = read_handle<System>(from, place);
}

template<class Type>
auto read(PyObject * from, Type & to, Place place)->std::enable_if_t<IsRecord<Type>::value>
{
  read_record(from, to, place);
}

template<class Record>
void read_record(PyObject * from, Record & to, Place place)
{
  if (from == &_Py_NoneStruct) {
    return;
  }
  to.fields(
    [&](auto & ... field) {
      if (PyTuple_Size(from) != static_cast<Py_ssize_t>(sizeof...(field))) {
        PyErr_Format(
          PyExc_TypeError, "%s, argument %zd: expected a tuple of %zd fields", place.function,
          place.argument, static_cast<Py_ssize_t>(sizeof...(field)));
        throw PythonError();
      }
      Py_ssize_t n = 0;
      (read(PyTuple_GetItem(from, n++), field, place), ...);
    });
}

/// An array, or a record of arrays, with what keeps these.
template<class Record>
struct Kept
{
  Record record;
  std::shared_ptr<void> owner;
};

template<class Record>
void read(PyObject * from, Kept<Record> & to, Place place)
{
  read(from, to.record, place);
  Py_IncRef(from);
  to.owner = std::shared_ptr<void>(
    from, [](void * object) {
      const PyGILState_STATE state = PyGILState_Ensure();
      Py_DecRef(static_cast<PyObject *>(object));
      PyGILState_Release(state);
    });
}

/// Storage of a converted argument of a type.
template<class Type, class = void>
struct Holder
{
  Type value{};
  void take(PyObject * from, Place place) {read(from, value, place);}
  Type & get() {return value;}
};

template<class Type>
struct Holder<Type, std::enable_if_t<(handle_name<Type> != nullptr)>>
{
  std::shared_ptr<Type> value;
  void take(PyObject * from, Place place)
  {
    // There may be none of these.
    if constexpr (std::is_same_v<Type, Manifold> || std::is_same_v<Type, EffectTable>) {
      if (from == &_Py_NoneStruct) {
        value = std::make_shared<Type>();
        return;
      }
    }
    value = read_handle<Type>(from, place);
  }
  Type & get() {return *value;}
};

template<class Type>
struct Holder<Type, std::enable_if_t<(has_methods<Type>)>>
{
  Type * value = nullptr;
  void take(PyObject * from, Place place) {value = &object_in<Type>(from, place);}
  Type & get() {return *value;}
};

/// The system that an argument computes with; nullptr: none.
template<class Argument>
System * system_in(const Argument &) {return nullptr;}
inline System * system_in(const Holder<System> & system) {return system.value.get();}
inline System * system_in(const Holder<RunObject> & run) {return run.value->system.get();}

/// Refuse to compute with what another thread computes with, or mark it as computed with.
inline void check_free(const System * system, const char * function)
{
  const std::thread::id worker = system != nullptr ? *system->worker : std::thread::id();
  if (worker != std::thread::id() && worker != std::this_thread::get_id()) {
    PyErr_Format(
      PyExc_RuntimeError, "%s: another thread computes with this simulation or model: give each "
      "thread its own, or let them wait for one another by a lock", function);
    throw PythonError();
  }
}
inline void mark(const System * system, bool works)
{
  if (system != nullptr) {
    *system->worker = works ? std::this_thread::get_id() : std::thread::id();
  }
}

/// Whether a function keeps track of what is evaluated by itself, or leaves it as it is; all others
/// leave something else in the memory of a system.
template<auto Function>
inline constexpr bool keeps_evaluation = false;
/// Whether a function only reads numbers of a run, which other threads may show while it goes on.
template<auto Function>
inline constexpr bool only_reads = false;
inline void outdate(const System * system)
{
  if (system != nullptr) {
    system->latest->forget();
  }
}

inline PyObject * to_python(bool value) {return PyBool_FromLong(value);}
inline PyObject * to_python(double value) {return PyFloat_FromDouble(value);}
inline PyObject * to_python(Index value) {return PyLong_FromLongLong(value);}
template<class Type>
auto to_python(Type value)->std::enable_if_t<std::is_enum_v<Type>, PyObject *>
{
  return PyLong_FromLongLong(static_cast<Index>(value));
}
template<class ... Value>
PyObject * to_tuple(const Value & ... value)
{
  const std::array<Owned, sizeof...(Value)> items{Owned(to_python(value)) ...};
  return std::apply(
    [](const auto & ... item) {
      return PyTuple_Pack(sizeof...(item), item.get() ...);
    }, items);
}
inline PyObject * to_python(Vector3 value) {return to_tuple(value.x, value.y, value.z);}
template<class First, class Second>
PyObject * to_python(const std::pair<First, Second> & value)
{
  return to_tuple(value.first, value.second);
}
/// Hand over an object that has methods.
template<class Type>
PyObject * to_python(std::unique_ptr<Type> && object)
{
  Owned made(PyType_GenericAlloc(reinterpret_cast<PyTypeObject *>(type_of<Type>), 0));
  new (&reinterpret_cast<Holding<Type> *>(made.get())->object)
    std::unique_ptr<Type>(std::move(object));
  return made.release();
}

inline void set_items(PyObject *) {}
template<class Value, class ... Rest>
void set_items(PyObject * to, const char * name, const Value & value, const Rest & ... rest)
{
  const Owned item(to_python(value));
  if (PyDict_SetItemString(to, name, item.get()) < 0) {
    throw PythonError();
  }
  set_items(to, rest ...);
}

/// A record of results becomes a dictionary by its names.
template<class Record>
auto to_python(const Record & record)->decltype(record.names(Ignore{}), static_cast<PyObject *>(nullptr))
{
  Owned found(PyDict_New());
  record.names([&](const auto & ... each) {set_items(found.get(), each ...);});
  return found.release();
}

/// Call a function for Python: an exception becomes Python's.
template<class Function>
PyObject * guarded(Function && function)
{
  try {
    return function();
  } catch (const PythonError &) {
  } catch (const std::bad_alloc &) {
    PyErr_SetString(PyExc_MemoryError, "out of memory");
  } catch (const std::invalid_argument & error) {
    PyErr_SetString(PyExc_ValueError, error.what());
  } catch (const std::exception & error) {
    PyErr_SetString(PyExc_RuntimeError, error.what());
  } catch (...) {
    PyErr_SetString(PyExc_RuntimeError, "unknown exception in the engine");
  }
  return nullptr;
}

/// Releases Python's interpreter lock while a function runs.
class Released
{
public:
  Released()
  : state_(PyEval_SaveThread()) {}
  Released(const Released &) = delete;
  Released & operator=(const Released &) = delete;
  ~Released() {PyEval_RestoreThread(state_);}

private:
  PyThreadState * state_;
};

/// A function whose arguments, or the first of them, are read once.
class Bound
{
public:
  virtual ~Bound() = default;
  /// Call it with the arguments that are left.
  virtual PyObject * run(PyObject * const * from, Py_ssize_t count) = 0;
  void keep(PyObject * object)
  {
    Py_IncRef(object);
    owners.emplace_back(object);
  }

private:
  std::vector<Owned> owners;
};

/// Required shape of an argument, by the system or model, which is the first one: not checked; nq;
/// nv; nc; ns; 2; (nc, nv); (nv, nv); wrenches and accelerations of all bodies; rows of ns.
enum class Length
{
  ANY, Q, QD, MULTIPLIERS, STATE, PAIR, JACOBIAN, INERTIA, WRENCHES, ROWS_OF_STATE
};

inline Index coordinates(const System & system) {return system.nq();}
inline Index coordinates(const Model & model) {return model.coordinates();}
inline Index states(const System & system) {return system.ns();}
inline Index states(const Model & model) {return model.coordinates() + model.joints();}
inline const Model & model_of(const System & system) {return system.model;}
inline const Model & model_of(const Model & model) {return model;}

template<class First, class Type>
bool has_length(const First &, Length, const Type &) {return true;}
template<class First>
bool has_length(const First & first, Length length, const Values & values)
{
  const Model & model = model_of(first);
  return length == Length::ANY || values.size == (
    length == Length::Q ? coordinates(first) : length == Length::QD ? model.joints() :
    length == Length::MULTIPLIERS ? model.equations() :
    length == Length::PAIR ? 2 : states(first));
}
template<class First>
bool has_length(const First & first, Length length, const Table & table)
{
  const Model & model = model_of(first);
  switch (length) {
    case Length::JACOBIAN:
      return has_shape(table, model.equations(), model.joints());
    case Length::INERTIA:
      return has_shape(table, model.joints(), model.joints());
    case Length::WRENCHES:
      return has_shape(table, model.tree.rows, 2 * model.size());
    default:
      return length == Length::ANY || table.columns == states(first);
  }
}

/// A model or a workspace among arguments; nullptr for others, and where it has not been read.
template<class Object, class Argument>
const Object * find(const Argument &) {return nullptr;}
template<class Object>
const Object * find(const Holder<Object> & holder) {return holder.value.get();}

/// Precondition of a function: a function of all its parameters, or of the first ones, that returns
/// an error message, or nullptr. The default: no precondition (preconditions.hpp).
template<auto Function>
inline constexpr auto precondition = nullptr;

template<class Class, class ... Parameters>
constexpr Py_ssize_t count_parameters(const char * (Class::*)(Parameters...) const)
{
  return sizeof...(Parameters);
}

template<auto Function, bool Releases, Length ... lengths>
struct Kernel;

template<
  class Result, class ... Parameters, Result(*Function)(Parameters...), bool Releases,
  Length ... lengths>
struct Kernel<Function, Releases, lengths...>: Bound
{
  std::tuple<Holder<std::decay_t<Parameters>>...> arguments;

  static constexpr Py_ssize_t parameters = sizeof...(Parameters);
  const char * name = "";
  /// Arguments that were read once.
  Py_ssize_t bound = 0;

  /// Read arguments for the parameters from `first` on.
  void take(PyObject * const * from, Py_ssize_t first, Py_ssize_t count)
  {
    if (first + count > parameters) {
      refuse(count);
    }
    if (count == 0) {
      return;
    }
    std::apply(
      [&](auto & ... holder) {
        Py_ssize_t n = 0;
        ((n >= first && n < first + count ? holder.take(from[n - first], {name, n + 1}) : void(),
        ++n), ...);
      }, arguments);
    if constexpr ((std::is_same_v<std::decay_t<Parameters>, Workspace> || ...)) {
      check_machine();
    }
    if constexpr (sizeof...(lengths) > 0) {
      check_lengths(
        static_cast<std::size_t>(first + count), std::index_sequence_for<Parameters...>{});
    }
    using Precondition = std::remove_cv_t<decltype(precondition<Function>)>;
    if constexpr (!std::is_null_pointer_v<Precondition>) {
      constexpr Py_ssize_t parameters = count_parameters(&Precondition::operator());
      // Once: when the last of these arguments is read.
      if (first < parameters && first + count >= parameters) {
        check_together(std::make_index_sequence<parameters>{});
      }
    }
  }

  void refuse(Py_ssize_t count) const
  {
    PyErr_Format(
      PyExc_TypeError, "%s: expected %zd arguments, got %zd", name, parameters - bound, count);
    throw PythonError();
  }

  Result call()
  {
    return std::apply([](auto & ... holder) {return Function(holder.get() ...);}, arguments);
  }

  PyObject * run(PyObject * const * from, Py_ssize_t count) override
  {
    if (bound + count != parameters) {
      refuse(count);
    }
    take(from, bound, count);
    if constexpr (std::is_void_v<Result>) {
      release_and_call();
      if (PyErr_Occurred() != nullptr) {
        return nullptr;
      }
      Py_IncRef(&_Py_NoneStruct);
      return &_Py_NoneStruct;
    } else {
      Result result = release_and_call();
      return PyErr_Occurred() != nullptr ? nullptr : to_python(std::move(result));
    }
  }

private:
  /// Refuse a workspace that is not one of the model beside it.
  void check_machine()
  {
    const Model * model = nullptr;
    const Workspace * work = nullptr;
    std::apply(
      [&](const auto & ... holder) {
        ((model = model != nullptr ? model : find<Model>(holder)), ...);
        ((work = work != nullptr ? work : find<Workspace>(holder)), ...);
      }, arguments);
    if (model != nullptr && work != nullptr && !(work->fits(*model) && model->is_connected())) {
      PyErr_Format(
        PyExc_ValueError, "%s: expected a model whose joints have code, and a workspace of it",
        name);
      throw PythonError();
    }
  }

  template<std::size_t ... Places>
  void check_together(std::index_sequence<Places...>)
  {
    const char * found = precondition<Function>(std::get<Places>(arguments).get() ...);
    if (found != nullptr) {
      PyErr_Format(PyExc_ValueError, "%s: %s", name, found);
      throw PythonError();
    }
  }

  template<std::size_t ... Places>
  void check_lengths(std::size_t read, std::index_sequence<Places...>)
  {
    if (read == 0) {
      return;
    }
    constexpr std::size_t count = sizeof...(lengths) + 1;
    constexpr Length wanted[count] = {Length::ANY, lengths ...};
    const auto & first = std::get<0>(arguments).get();
    const auto check = [&](std::size_t place, const auto & value) {
        if (place < count && place < read && !has_length(first, wanted[place], value)) {
          PyErr_Format(
            PyExc_ValueError, "%s, argument %zd: expected the shape that the mechanism asks "
            "for (coordinates %zd, rates %zd, equations %zd, state %zd)", name, static_cast<Py_ssize_t>(place) + 1,
            static_cast<Py_ssize_t>(coordinates(first)),
            static_cast<Py_ssize_t>(model_of(first).joints()),
            static_cast<Py_ssize_t>(model_of(first).equations()),
            static_cast<Py_ssize_t>(states(first)));
          throw PythonError();
        }
      };
    (check(Places, std::get<Places>(arguments).get()), ...);
  }

  Result release_and_call()
  {
    // Under the interpreter lock, so that no other thread comes in between.
    if constexpr (!only_reads<Function>) {
      std::apply([&](auto & ... holder) {(check_free(system_in(holder), name), ...);}, arguments);
    }
    if constexpr (!keeps_evaluation<Function> && !only_reads<Function>) {
      std::apply([](auto & ... holder) {(outdate(system_in(holder)), ...);}, arguments);
    }
    if constexpr (Releases) {
      const Working working(arguments);
      const Released released;
      return call();
    } else {
      return call();
    }
  }

  /// Marks systems as computed with while it lives.
  class Working
  {
public:
    explicit Working(decltype(arguments) & arguments)
    : arguments_(arguments) {set(true);}
    Working(const Working &) = delete;
    Working & operator=(const Working &) = delete;
    ~Working() {set(false);}

private:
    void set(bool works)
    {
      std::apply([&](auto & ... holder) {(mark(system_in(holder), works), ...);}, arguments_);
    }
    decltype(arguments) & arguments_;
  };
};

/// Methods of a run for Python: as they are, on its system, or on its system in its state.
template<auto Method>
struct Of;
template<auto Method>
struct On;
template<auto Method>
struct In;

template<class Result, class ... Parameters, Result (Run::* Method)(Parameters...)>
struct Of<Method>
{
  static Result call(RunObject & of, Parameters... parameters)
  {
    return (of.run.*Method)(parameters ...);
  }
};
template<
  class Result, class ... Parameters, Result (Run::* Method)(const System &, Parameters...)>
struct On<Method>
{
  static Result call(RunObject & of, Parameters... parameters)
  {
    return (of.fitting().*Method)(*of.system, parameters ...);
  }
};
template<
  class Result, class ... Parameters,
  Result (Run::* Method)(const System &, Values, Parameters...)>
struct In<Method>
{
  static Result call(RunObject & of, Parameters... parameters)
  {
    return (of.fitting().*Method)(*of.system, of.state, parameters ...);
  }
};

/// A function as Python's tables and `bind` see it.
struct Entry
{
  const char * name;
  const char * doc;
  PyObject * (*call)(PyObject *, PyObject * const *, Py_ssize_t);
  std::unique_ptr<Bound> (*bind)(PyObject * const *, Py_ssize_t, const char * name);
  /// The type that it is a method of; nullptr: it is a function.
  PyObject ** owner;
};

template<class First, class ... Rest>
constexpr PyObject ** owner_of(std::tuple<First, Rest...> *)
{
  return has_methods<First> ? &type_of<First> : nullptr;
}
constexpr PyObject ** owner_of(std::tuple<> *) {return nullptr;}
template<class Result, class ... Parameters>
constexpr PyObject ** owner_of(Result (*)(Parameters...))
{
  return owner_of(static_cast<std::tuple<std::decay_t<Parameters>...> *>(nullptr));
}

/// The name under which a function is called, for messages.
template<auto Function>
inline const char * name_of = "";

template<auto Function, bool Releases, Length ... lengths>
Entry make_entry(const char * doc)
{
  // The text begins with it, and its arguments follow.
  static const std::string name(doc, std::strcspn(doc, "("));
  name_of<Function> = name.c_str();
  return {
    name.c_str(), doc,
    [](PyObject * self, PyObject * const * from, Py_ssize_t count) {
      return guarded(
        [&] {
          Kernel<Function, Releases, lengths...> kernel;
          kernel.name = name_of<Function>;
          kernel.bound = owner_of(Function) != nullptr ? 1 : 0;
          kernel.take(&self, 0, kernel.bound);
          return kernel.run(from, count);
        });
    },
    [](PyObject * const * from, Py_ssize_t count, const char * of) -> std::unique_ptr<Bound> {
      auto kernel = std::make_unique<Kernel<Function, Releases, lengths...>>();
      kernel->name = of;
      kernel->take(from, 0, count);
      kernel->bound = count;
      return kernel;
    }, owner_of(Function)};
}

/// A function of Python; `lengths`: of the arguments behind the first one, a system or a model.
template<auto Function, Length ... lengths>
Entry entry(const char * doc)
{
  return make_entry<Function, false, lengths...>(doc);
}

/// The same for a long computation: other threads run, and Ctrl-C interrupts it.
template<auto Function, Length ... lengths>
Entry released(const char * doc)
{
  return make_entry<Function, true, lengths...>(doc);
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ARGUMENTS_HPP_
