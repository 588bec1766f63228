// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

#ifndef CLOSEDLOOP_DYNAMICS__ENGINE__ARGUMENTS_HPP_
#define CLOSEDLOOP_DYNAMICS__ENGINE__ARGUMENTS_HPP_

#include <array>
#include <cstddef>
#include <cstdint>
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

#include "callable.hpp"
#include "forces.hpp"
#include "objects.hpp"
#include "run.hpp"
#include "signature.hpp"
#include "stop_flag.hpp"

// Functions of C++ as functions of Python, or methods, where the first parameter is an object:
// arguments are converted by the types of the parameters, and checked by the text of the function.
// Arrays are used in place (C-contiguous, of float64 or int64), named tuples of arrays become the
// structs of the same fields, None an empty one.

namespace closedloop
{

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

#define CLOSEDLOOP_TYPE(type, name) \
  template<> \
  inline constexpr const char * type_name<type> = "closedloop_dynamics.engine.native." name;
CLOSEDLOOP_TYPE(Model, "Model")
CLOSEDLOOP_TYPE(Manifold, "Manifold")
CLOSEDLOOP_TYPE(Workspace, "Workspace")
CLOSEDLOOP_TYPE(EffectTable, "EffectTable")
CLOSEDLOOP_TYPE(System, "System")
CLOSEDLOOP_TYPE(RunObject, "Run")
CLOSEDLOOP_TYPE(Snapshot, "Snapshot")
CLOSEDLOOP_TYPE(StopFlag, "StopFlag")
CLOSEDLOOP_TYPE(Callable, "Callable")
CLOSEDLOOP_TYPE(Bound, "Bound")
#undef CLOSEDLOOP_TYPE

/// Counts of objects, by letters of signatures: Q coordinates, V rates, C equations that are worked
/// on, A all of them, S numbers of a state, L of a whole one, T torques, with those of cut joints, B
/// rows of bodies and D columns of these at least, W components of a wrench, P of a point, K cut
/// joints, G their freedoms that anything acts in, Z states of effects, F frictions that may rest, N
/// places of a table of derivatives of steps.
inline Index count_of(const Model & model, char letter)
{
  switch (letter) {
    case 'Q': return model.coordinates();
    case 'V': return model.joints();
    case 'C': return model.equations();
    case 'S': return model.coordinates() + model.joints();
    case 'B': return model.tree.rows;
    case 'D': return model.planar() ? 31 : 81;
    case 'W': return model.size();
    case 'P': return model.planar() ? 2 : 3;
    case 'K': return model.cut.rows;
    default: throw std::logic_error("no such count of a model");
  }
}
inline Index count_of(const Workspace & work, char letter)
{
  return letter == 'B' ? work.body.rows : letter == 'W' ? work.size() : work.planar() ? 2 : 3;
}
inline Index count_of(const Manifold & manifold, char letter)
{
  return letter == 'Q' ? manifold.place.size + manifold.balls.rows : manifold.place.size;
}
inline Index count_of(const EffectTable & effects, char letter)
{
  switch (letter) {
    case 'V': return effects.applied.size - effects.cuts.index.rows;
    case 'T': return effects.applied.size;
    case 'B': return effects.reaction.rows;
    case 'D': return effects.reaction.columns == 6 ? 31 : 81;
    case 'G': return effects.cuts.index.rows;
    case 'F': return effects.static_friction.rows.size - 1;
    default: throw std::logic_error("no such count of effects");
  }
}
inline Index count_of(const System & system, char letter)
{
  switch (letter) {
    case 'Q': return system.nq();
    case 'V': return system.nv();
    case 'C': return system.lam.size;
    case 'A': return (system.whole.empty() ? system.lam : system.whole.lam).size;
    case 'S': return system.ns();
    case 'T': return system.tau.size;
    case 'E': return system.effects.count();
    case 'Z': return system.effects.states.size;
    case 'N': return step_routine::STEP_COLUMNS;
    default: return count_of(system.model, letter);
  }
}
inline Index count_of(RunObject & run, char letter)
{
  return letter == 'L' ? run.run.whole_length(*run.system) : count_of(*run.system, letter);
}
/// Others have none.
template<class Object>
Index count_of(const Object &, char)
{
  throw std::logic_error("no such count");
}

/// What is known while the arguments of a function are read.
struct Reading : Signature
{
  using Signature::Signature;
  /// That of the function: a workspace beside it is of it, a manifold fits it.
  const Model * model = nullptr;
};

template<class Object>
void fit(Object & object, Reading & reading) {reading.count_by(object);}
inline void fit(Model & model, Reading & reading)
{
  reading.model = reading.model == nullptr ? &model : reading.model;
  reading.count_by(model);
}
inline void fit(Workspace & work, Reading & reading)
{
  if (reading.model != nullptr && !(work.fits(*reading.model) && reading.model->is_connected())) {
    refuse(
      PyExc_ValueError, std::string(reading.function()) +
      ": expected a model whose joints have code, and a workspace of it");
  }
  reading.count_by(work);
}
inline void fit(Manifold & manifold, Reading & reading)
{
  const Model * model = reading.model;
  if (model != nullptr && !manifold.fits(model->coordinates(), model->joints())) {
    refuse(
      PyExc_ValueError, std::string(reading.function()) + ": expected the manifold of the model");
  }
  reading.count_by(manifold);
}

template<class Record>
void read_record(PyObject * from, Record & to, Reading & reading);

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

/// Refuse what is no such thing.
[[noreturn]] inline void refuse_type(Reading & reading, const std::string & expected)
{
  refuse(
    PyExc_TypeError, std::string(reading.function()) + ": " + std::string(reading.name()) +
    ": expected " + expected);
}

/// The letter of the type of an array's entries; '?' where it takes more than one.
inline char kind_of(const Py_buffer & view)
{
  return view.format != nullptr && view.format[0] != '\0' && view.format[1] == '\0' ?
         view.format[0] : '?';
}

template<class Number>
bool is_of(const Py_buffer & view)
{
  const char kind = kind_of(view);
  const bool is_kind = std::is_same_v<std::remove_const_t<Number>, double> ?
    kind == 'd' : kind == 'l' || kind == 'q';
  return is_kind && view.itemsize == 8 &&
         reinterpret_cast<std::uintptr_t>(view.buf) % alignof(Number) == 0;
}

/// See an array as numbers of a type, of some lengths.
template<class Number, class ... Length>
void read_array(PyObject * from, Reading & reading, Number * & data, Length & ... lengths)
{
  constexpr int dimensions = sizeof...(Length);
  Py_buffer view{};
  const int flags = c_contiguous | PyBUF_FORMAT | (std::is_const_v<Number>? 0 : PyBUF_WRITABLE);
  if (PyObject_GetBuffer(from, &view, flags) < 0) {
    throw PythonError();
  }
  // The caller holds a reference to the array.
  PyBuffer_Release(&view);
  if (!is_of<Number>(view) || view.ndim != dimensions) {
    refuse_type(
      reading, std::string(
        std::is_same_v<std::remove_const_t<Number>, double>? "float64" : "int64") + " of " +
      std::to_string(dimensions) + " dimensions, got format '" + kind_of(view) + "' of " +
      std::to_string(view.ndim));
  }
  data = static_cast<Number *>(view.buf);
  int n = 0;
  ((lengths = view.shape[n++]), ...);
  reading.check_entries(data, (lengths * ...));
  reading.check_shape({lengths ...});
}

template<class Number>
void read(PyObject * from, Vector<Number> & to, Reading & reading)
{
  read_array(from, reading, to.data, to.size);
}

template<class Number>
void read(PyObject * from, Matrix<Number> & to, Reading & reading)
{
  read_array(from, reading, to.data, to.rows, to.columns);
}

template<class Number>
void read(PyObject * from, Cube<Number> & to, Reading & reading)
{
  read_array(from, reading, to.data, to.pages, to.rows, to.columns);
}

/// Read an array of numbers; Python reports anything else.
inline void read(PyObject * from, OptionalVector & to, Reading &)
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
  to.is_array = view.ndim == 1 && is_of<double>(view);
  if (to.is_array) {
    to.numbers = {static_cast<const double *>(view.buf), view.shape[0]};
  }
}

inline void read(PyObject * from, double & to, Reading & reading)
{
  to = PyFloat_AsDouble(from);
  if (to == -1.0 && PyErr_Occurred() != nullptr) {
    throw PythonError();
  }
  reading.check(to);
}

inline void read(PyObject * from, Index & to, Reading & reading)
{
  to = PyLong_AsLongLong(from);
  if (to == -1 && PyErr_Occurred() != nullptr) {
    throw PythonError();
  }
  reading.check(to);
}

inline void read(PyObject * from, bool & to, Reading &)
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
constexpr Index last_of(Responses) {return static_cast<Index>(Responses::CARRIED);}

template<class Type>
auto read(PyObject * from, Type & to, Reading & reading)
->std::enable_if_t<std::is_enum_v<Type>>
{
  Index number;
  read(from, number, reading);
  if (number < 0 || number > last_of(Type{})) {
    reading.refuse(std::to_string(number));
  }
  to = static_cast<Type>(number);
}

inline void read(PyObject * from, std::string_view & to, Reading &)
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
void read(PyObject * from, std::vector<Record> & to, Reading & reading)
{
  const Py_ssize_t count = PyTuple_Size(from);
  if (count < 0) {
    throw PythonError();
  }
  to.assign(static_cast<std::size_t>(count), {});
  const int known = reading.known();
  for (Py_ssize_t n = 0; n < count; ++n) {
    read_record(PyTuple_GetItem(from, n), to[static_cast<std::size_t>(n)], reading);
    reading.forget(known);
  }
}

/// What an object of Python holds, or what it has as its attribute `native`; the caller keeps it, so
/// that nothing is kept here.
template<class Type>
std::shared_ptr<Type> & find(PyObject * from, Reading & reading)
{
  // There may be none of these.
  static std::shared_ptr<Type> none;
  if constexpr (std::is_same_v<Type, Manifold> || std::is_same_v<Type, EffectTable>) {
    none = none == nullptr ? std::make_shared<Type>() : none;
  }
  PyObject * holder = from;
  if (!holds<Type>(from) && from != &_Py_NoneStruct) {
    holder = PyObject_GetAttrString(from, "native");
    PyErr_Clear();
  }
  // Not one that was made for this call.
  const bool found_one = holder != nullptr && holds<Type>(holder) && (
    holder == from || holder->ob_refcnt > 1);
  if (holder != from) {
    Py_DecRef(holder);
  }
  if (!found_one) {
    if (from == &_Py_NoneStruct && (none != nullptr || std::is_same_v<Type, StopFlag>)) {
      return none;
    }
    refuse_type(reading, std::string("an object of ") + type_name<Type>);
  }
  std::shared_ptr<Type> & found = held_by<Type>(holder);
  fit(*found, reading);
  return found;
}

template<class Type>
void read(PyObject * from, std::shared_ptr<Type> & to, Reading & reading)
{
  to = find<Type>(from, reading);
}
template<class Type>
auto read(PyObject * from, Type * & to, Reading & reading)
->std::enable_if_t<type_name<std::remove_const_t<Type>> != nullptr>
{
  to = find<std::remove_const_t<Type>>(from, reading).get();
}
inline void read(PyObject * from, const Run * & to, Reading & reading)
{
  to = &find<RunObject>(from, reading)->run;
}
inline void read(PyObject * from, Manifold & to, Reading & reading)
{
  to = Manifold(*find<Manifold>(from, reading));
}

template<class Type>
auto read(PyObject * from, Type & to, Reading & reading)->std::enable_if_t<IsRecord<Type>::value>
{
  read_record(from, to, reading);
}

/// Read the fields of a record as its own text declares them.
template<class Record>
void read_record(PyObject * from, Record & to, Reading & reading)
{
  if (from == &_Py_NoneStruct && reading.is_optional()) {
    return;
  }
  to.fields(
    [&](const char * text, auto & ... field) {
      if (PyTuple_Size(from) != static_cast<Py_ssize_t>(sizeof...(field))) {
        refuse_type(reading, "a tuple of " + std::to_string(sizeof...(field)) + " fields");
      }
      const Signature::Within within(reading, text);
      Py_ssize_t n = 0;
      ((reading.next(), read(PyTuple_GetItem(from, n++), field, reading)), ...);
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
void read(PyObject * from, Kept<Record> & to, Reading & reading)
{
  read(from, to.record, reading);
  Py_IncRef(from);
  to.owner = std::shared_ptr<void>(
    from, [](void * object) {
      const PyGILState_STATE state = PyGILState_Ensure();
      Py_DecRef(static_cast<PyObject *>(object));
      PyGILState_Release(state);
    });
}

/// A converted argument of a type, and how the function gets it.
template<class Type>
using Taken = std::conditional_t<type_name<Type> != nullptr, Type *, Type>;
template<class Type>
Type & pass(Taken<Type> & value)
{
  if constexpr (type_name<Type> != nullptr) {
    return *value;
  } else {
    return value;
  }
}

/// Call a function with the system that an argument computes with, if any.
template<class Visitor, class Value>
void for_system(Visitor &&, const Value &) {}
template<class Visitor>
void for_system(Visitor && visit, System * system) {visit(*system);}
template<class Visitor>
void for_system(Visitor && visit, RunObject * run) {visit(*run->system);}

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
template<std::size_t Count>
PyObject * to_python(const std::array<Index, Count> & values)
{
  return std::apply([](const auto & ... value) {return to_tuple(value ...);}, values);
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

/// The arrays of an object become a dictionary of views by their names.
template<class Type>
struct ViewsOf
{
  Type & object;
};
template<class Type>
PyObject * to_python(ViewsOf<Type> of)
{
  Owned views(PyDict_New());
  of.object.arrays(Views(views.get()));
  return views.release();
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

/// What a function does beside its results, as bits.
enum Manner : unsigned
{
  /// It takes long: other threads run, and Ctrl-C interrupts it.
  RELEASES = 1,
  /// It keeps track of what is evaluated by itself, or leaves it as it is; all others leave something
  /// else in the memory of a system.
  KEEPS = 2,
  /// It only reads numbers of a run, which other threads may show while it goes on.
  READS = 4
};

/// The type whose method a function is, by its first parameter; nullptr: it is a function.
template<class Type>
constexpr PyObject ** owner_of(Type *)
{
  return type_name<Type> != nullptr ? &type_of<Type> : nullptr;
}
constexpr PyObject ** owner_of(std::shared_ptr<System> *) {return &type_of<System>;}

template<auto Function, unsigned manner>
struct Kernel;

template<class Result, class ... Parameters, Result(*Function)(Parameters...), unsigned manner>
struct Kernel<Function, manner>: Bound
{
  inline static Signature::Head head = "()";
  static constexpr Py_ssize_t parameters = sizeof...(Parameters);

  std::tuple<Taken<std::decay_t<Parameters>>...> arguments;
  Reading reading{head};
  /// Arguments that were read once.
  Py_ssize_t bound = 0;

  static constexpr PyObject ** owner()
  {
    if constexpr (parameters == 0) {
      return nullptr;
    } else {
      return owner_of(
        static_cast<std::decay_t<std::tuple_element_t<0, std::tuple<Parameters...>>> *>(nullptr));
    }
  }

  /// Read the next arguments, for good.
  void take(PyObject * const * from, Py_ssize_t count)
  {
    if (bound + count > parameters) {
      refuse_count(count);
    }
    read_next(from, count);
    bound += count;
    reading.keep();
  }

  PyObject * run(PyObject * const * from, Py_ssize_t count) override
  {
    if (bound + count != parameters) {
      refuse_count(count);
    }
    if (count > 0) {
      reading.go_back();
      read_next(from, count);
    }
    if constexpr (std::is_void_v<Result>) {
      release_and_call();
      return PyErr_Occurred() != nullptr ? nullptr : none();
    } else {
      Result result = release_and_call();
      return PyErr_Occurred() != nullptr ? nullptr : to_python(std::move(result));
    }
  }

private:
  [[noreturn]] void refuse_count(Py_ssize_t count) const
  {
    refuse(
      PyExc_TypeError, std::string(reading.function()) + ": expected " +
      std::to_string(parameters - bound) + " arguments, got " + std::to_string(count));
  }

  void read_next(PyObject * const * from, Py_ssize_t count)
  {
    std::apply(
      [&](auto & ... value) {
        Py_ssize_t n = 0;
        (read_one(value, from, n++ - bound, count), ...);
      }, arguments);
  }
  template<class Value>
  void read_one(Value & value, PyObject * const * from, Py_ssize_t n, Py_ssize_t count)
  {
    if (n >= 0 && n < count) {
      // The object of a method is not in the text.
      if (owner() == nullptr || bound + n > 0) {
        reading.next();
      }
      read(from[n], value, reading);
    }
  }

  Result call()
  {
    return std::apply(
      [](auto & ... value) {return Function(pass<std::decay_t<Parameters>>(value) ...);}, arguments);
  }

  Result release_and_call()
  {
    // Under the interpreter lock, so that no other thread comes in between.
    if constexpr ((manner & READS) == 0) {
      for_systems([&](const System & system) {check_free(system);});
    }
    if constexpr ((manner & (KEEPS | READS)) == 0) {
      for_systems([](const System & system) {system.latest->forget();});
    }
    if constexpr ((manner & RELEASES) != 0) {
      const Released released(*this);
      return call();
    } else {
      return call();
    }
  }
  template<class Visitor>
  void for_systems(Visitor && visit)
  {
    std::apply([&](auto & ... value) {(for_system(visit, value), ...);}, arguments);
  }

  /// Refuse to compute with what another thread computes with.
  void check_free(const System & system) const
  {
    if (*system.worker != std::thread::id() && *system.worker != std::this_thread::get_id()) {
      refuse(
        PyExc_RuntimeError, std::string(reading.function()) + ": another thread computes with this "
        "simulation or model: give each thread its own, or let them wait for one another by a lock");
    }
  }

  /// Marks systems as computed with, and releases Python's interpreter lock, while it lives.
  class Released
  {
public:
    explicit Released(Kernel & kernel)
    : kernel_(kernel)
    {
      mark(std::this_thread::get_id());
      state_ = PyEval_SaveThread();
    }
    Released(const Released &) = delete;
    Released & operator=(const Released &) = delete;
    ~Released()
    {
      PyEval_RestoreThread(state_);
      mark({});
    }

private:
    void mark(std::thread::id worker)
    {
      kernel_.for_systems([&](const System & system) {*system.worker = worker;});
    }
    Kernel & kernel_;
    PyThreadState * state_;
  };
};

/// Methods as functions; those of a run as they are, on its system, or on its system in its state.
template<auto Method>
struct Of;
template<auto Method>
struct On;
template<auto Method>
struct In;

inline Run & self(RunObject & of) {return of.run;}
template<class Class>
Class & self(Class & of) {return of;}

template<class Class, class Result, class ... Parameters, Result (Class::* Method)(Parameters...)>
struct Of<Method>
{
  using Self = std::conditional_t<std::is_same_v<Class, Run>, RunObject, Class>;
  static Result call(Self & of, Parameters... parameters)
  {
    return (self(of).*Method)(parameters ...);
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
  std::string name;
  const char * text;
  PyObject * (*call)(PyObject *, PyObject * const *, Py_ssize_t);
  std::shared_ptr<Bound> (*bind)(PyObject * const *, Py_ssize_t);
  /// The type that it is a method of; nullptr: it is a function.
  PyObject ** owner;
};

/// A function of Python by its text (signature.hpp).
template<auto Function, unsigned manner = 0>
Entry entry(const char * text)
{
  using Made = Kernel<Function, manner>;
  Made::head = text;
  return {
    std::string(text, Made::head.length), text,
    [](PyObject * self, PyObject * const * from, Py_ssize_t count) {
      return guarded(
        [&] {
          Made kernel;
          kernel.take(&self, Made::owner() != nullptr ? 1 : 0);
          return kernel.run(from, count);
        });
    },
    [](PyObject * const * from, Py_ssize_t count) -> std::shared_ptr<Bound> {
      auto kernel = std::make_shared<Made>();
      kernel->take(from, count);
      for (Py_ssize_t n = 0; n < count; ++n) {
        kernel->keep(from[n]);
      }
      return kernel;
    }, Made::owner()};
}

}  // namespace closedloop

#endif  // CLOSEDLOOP_DYNAMICS__ENGINE__ARGUMENTS_HPP_
