// SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
// SPDX-License-Identifier: Apache-2.0

/// @file
/// The part of Python's stable binary interface (PEP 384) that the bindings use, under its names.
///
/// A module that uses only this part runs in every Python from 3.11 on, and is compiled without the
/// headers of any: machines without a C++ compiler rarely have these, and a Python for another
/// architecture is not needed to compile for it. The sizes and orders of the members are promised
/// by https://docs.python.org/3/c-api/stable.html. A test compiles this file behind Python.h, which
/// gives the types then: each declaration below must agree with Python's own.

#pragma once

#include <cstddef>

#ifndef Py_PYTHON_H
extern "C" {
using Py_ssize_t = std::ptrdiff_t;
struct PyTypeObject;
struct PyThreadState;
enum PyGILState_STATE { PyGILState_LOCKED, PyGILState_UNLOCKED };

struct PyObject {
  Py_ssize_t ob_refcnt;
  PyTypeObject *ob_type;
};

struct Py_buffer {
  void *buf;
  PyObject *obj;
  Py_ssize_t len;
  Py_ssize_t itemsize;
  int readonly;
  int ndim;
  char *format;
  Py_ssize_t *shape;
  Py_ssize_t *strides;
  Py_ssize_t *suboffsets;
  void *internal;
};

using PyCFunction = PyObject *(*)(PyObject *, PyObject *);
using visitproc = int (*)(PyObject *, void *);
using traverseproc = int (*)(PyObject *, visitproc, void *);
using inquiry = int (*)(PyObject *);
using freefunc = void (*)(void *);

struct PyType_Slot {
  int slot;
  void *pfunc;
};

struct PyType_Spec {
  const char *name;
  int basicsize;
  int itemsize;
  unsigned int flags;
  PyType_Slot *slots;
};

struct PyMethodDef {
  const char *ml_name;
  PyCFunction ml_meth;
  int ml_flags;
  const char *ml_doc;
};

struct PyModuleDef_Slot {
  int slot;
  void *value;
};

struct PyModuleDef_Base {
  PyObject ob_base;
  PyObject *(*m_init)();
  Py_ssize_t m_index;
  PyObject *m_copy;
};

struct PyModuleDef {
  PyModuleDef_Base m_base;
  const char *m_name;
  const char *m_doc;
  Py_ssize_t m_size;
  PyMethodDef *m_methods;
  PyModuleDef_Slot *m_slots;
  traverseproc m_traverse;
  inquiry m_clear;
  freefunc m_free;
};
}
#endif

static_assert(sizeof(PyObject) == 16);
static_assert(sizeof(Py_buffer) == 80 && offsetof(Py_buffer, format) == 40);
static_assert(offsetof(Py_buffer, shape) == 48 && offsetof(Py_buffer, ndim) == 36);
static_assert(sizeof(PyMethodDef) == 32 && offsetof(PyMethodDef, ml_doc) == 24);
static_assert(sizeof(PyType_Slot) == 16);
static_assert(sizeof(PyType_Spec) == 32 && offsetof(PyType_Spec, slots) == 24);
static_assert(sizeof(PyModuleDef_Slot) == 16);
static_assert(sizeof(PyModuleDef) == 104 && offsetof(PyModuleDef, m_slots) == 72);

// Macros, as in Python.h: behind it a second definition must be the same, token by token.
#define METH_VARARGS 0x0001
#define METH_NOARGS 0x0004
#define METH_FASTCALL 0x0080
#define PyBUF_WRITABLE 0x0001
#define PyBUF_FORMAT 0x0004
#define Py_mod_exec 2
#define Py_bf_getbuffer 1
#define Py_tp_dealloc 52
#define Py_tp_methods 64
#define Py_TPFLAGS_DISALLOW_INSTANTIATION (1UL << 7)

inline constexpr int c_contiguous = 0x0038;  ///< PyBUF_C_CONTIGUOUS

extern "C" {
extern PyObject *PyExc_BufferError;
extern PyObject *PyExc_MemoryError;
extern PyObject *PyExc_RuntimeError;
extern PyObject *PyExc_TypeError;
extern PyObject *PyExc_ValueError;
extern PyObject _Py_NoneStruct;

PyObject *PyBool_FromLong(long);
void PyBuffer_Release(Py_buffer *);
PyObject *PyDict_New();
int PyDict_SetItemString(PyObject *, const char *, PyObject *);
PyObject *PyCMethod_New(PyMethodDef *, PyObject *, PyObject *, PyTypeObject *);
int PyErr_CheckSignals();
void PyErr_Clear();
PyObject *PyErr_Occurred();
void PyErr_SetString(PyObject *, const char *);
void PyEval_RestoreThread(PyThreadState *);
PyThreadState *PyEval_SaveThread();
double PyFloat_AsDouble(PyObject *);
PyObject *PyFloat_FromDouble(double);
PyGILState_STATE PyGILState_Ensure();
void PyGILState_Release(PyGILState_STATE);
long long PyLong_AsLongLong(PyObject *);
PyObject *PyLong_FromLongLong(long long);
int PyModule_AddObjectRef(PyObject *, const char *, PyObject *);
int PyModule_AddStringConstant(PyObject *, const char *, const char *);
PyObject *PyModuleDef_Init(PyModuleDef *);
int PyObject_CheckBuffer(PyObject *);
void PyObject_Free(void *);
PyObject *PyObject_GetAttrString(PyObject *, const char *);
int PyObject_GetBuffer(PyObject *, Py_buffer *, int);
int PyObject_IsTrue(PyObject *);
PyObject *PyType_FromSpec(PyType_Spec *);
PyObject *PyType_GenericAlloc(PyTypeObject *, Py_ssize_t);
PyObject *PyTuple_GetItem(PyObject *, Py_ssize_t);
PyObject *PyTuple_Pack(Py_ssize_t, ...);
Py_ssize_t PyTuple_Size(PyObject *);
const char *PyUnicode_AsUTF8AndSize(PyObject *, Py_ssize_t *);
void Py_DecRef(PyObject *);
void Py_IncRef(PyObject *);
}
