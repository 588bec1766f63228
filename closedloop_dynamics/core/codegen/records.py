# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Functions that compiled code calls by their address, each with the address of a record.

What a function is compiled for depends on the types of its arguments. Who knows only addresses is
compiled once, and what a scene does not need has no address: it is not compiled at all.

Addresses are arrays: first that of the record, which all functions work on, then those of the
functions, zero for those that are not there. Without a compiler they are lists of the things
themselves.

"""

import ctypes
import functools

import numpy as np

from . import function_table
from ..compiled import merged, replaced

# Place of the record among addresses.
RECORD = 0
_SIGNATURE = ctypes.CFUNCTYPE(
    ctypes.c_int64, ctypes.c_void_p, ctypes.c_int64, ctypes.c_int64, ctypes.c_void_p,
    ctypes.c_void_p)
# Addresses of functions by the kinds of their records, quicker to tell than numba's types.
_compiled = {}

if function_table.available():
    from llvmlite import ir
    from numba import types, typeof
    from numba.extending import intrinsic
    from numba.np.arrayobj import populate_array

    WORD = ir.IntType(64)

    @intrinsic
    def record_at(typingctx, address):
        """
        Return the record at an address.

        Parameters
        ----------
        typingctx
            Of numba.
        address : pointer to a record
            As ``packed`` has laid it out.

        Returns
        -------
        NamedTuple

        """
        def generate(context, builder, signature, arguments):
            model = context.data_model_manager[signature.return_type]
            return model.load_from_data_pointer(builder, arguments[0])

        return address.dtype(address), generate

    @intrinsic
    def array_at(typingctx, address, count):
        """
        Return the numbers at an address.

        Parameters
        ----------
        typingctx
            Of numba.
        address : pointer to float
            Of the first.
        count : int
            How many.

        Returns
        -------
        ndarray, shape (count,)

        """
        kind = types.Array(types.float64, 1, 'C')

        def generate(context, builder, signature, arguments):
            array, size = context.make_array(kind)(context, builder), ir.Constant(WORD, 8)
            populate_array(array, data=arguments[0], shape=[arguments[1]], strides=[size],
                           itemsize=size, meminfo=None)
            return array._getvalue()

        return kind(address, types.intp), generate

    @intrinsic
    def call_at(typingctx, addresses, place, number, first, second):
        """
        Call a function by its address.

        Parameters
        ----------
        typingctx
            Of numba.
        addresses : ndarray of int
            As ``link`` fills it.
        place : int
            Of the function among them.
        number : int
            What it is told.
        first, second : ndarray, shape (n,)
            What it shall work on. It sees both with the length of the first.

        Returns
        -------
        int
            1 where a question is answered by yes.

        """
        def generate(context, builder, signature, arguments):
            table, one, other = (
                context.make_array(signature.args[n])(context, builder, arguments[n])
                for n in (0, 3, 4))
            function, record = (
                builder.load(builder.gep(table.data, [place]))
                for place in (arguments[1], WORD(RECORD)))
            handed = [record, arguments[2], one.nitems, one.data, other.data]
            kind = ir.FunctionType(WORD, [value.type for value in handed])
            return builder.call(builder.inttoptr(function, kind.as_pointer()), handed)

        return types.int64(addresses, types.intp, types.int64, first, second), generate
else:
    def record_at(address):
        """Return the record, which without a compiler stands for its address."""
        return address

    def array_at(address, count):
        """Return the array, which without a compiler stands for its address."""
        return address

    def call_at(addresses, place, number, first, second):
        """Call the function, which without a compiler stands for its address."""
        return addresses[place](addresses[RECORD], number, len(first), first, second)


def addressed(function):
    """
    Compile what is called by its address.

    Parameters
    ----------
    function : function
        Of a record, a number, and two arrays of the same length; returns a number, 1 for yes.

    """
    kernel = merged(function)

    def called(address, number, count, first, second):
        return int(kernel(
            record_at(address), number, array_at(first, count), array_at(second, count)))

    return replaced(function, called)


def link(record, functions):
    """
    Return addresses.

    Parameters
    ----------
    record : NamedTuple
        Of arrays, None and further such records; all must outlast the addresses.
    functions : sequence
        Of functions that are ``addressed``, compiled here for such a record, or None.

    Returns
    -------
    addresses : ndarray of int, shape (1 + number of functions,)
    words : ndarray of int
        The record as it is laid out, to be kept as long as its arrays.

    """
    if not function_table.available():
        return [record, *(function or 0 for function in functions)], np.zeros(0, dtype=np.int64)
    words, kind = packed(record)
    addresses = [words.ctypes.data]
    for function in functions:
        if function is not None and (function, kind) not in _compiled:
            _compiled[function, kind] = _address(function, typeof(record))
        addresses.append(0 if function is None else _compiled[function, kind])
    return np.array(addresses), words


def _address(function, record):
    """Compile a function for a type of records, and return its address."""
    numbers = types.CPointer(types.float64)
    signature = (types.CPointer(record), types.int64, types.int64, numbers, numbers)
    function.compile(signature)
    code = function.overloads[signature]
    return code.library.get_pointer_to_function(code.fndesc.llvm_cfunc_wrapper_name)


def from_python(addresses, place, array):
    """
    Return a function behind addresses as one that Python calls again and again.

    Parameters
    ----------
    addresses : ndarray of int
        As ``link`` returns them.
    place : int
        Of the function among them.
    array : ndarray, shape (n,)
        On what, which must outlast it; handed over as both. The function is told zero.

    Returns
    -------
    callable
        Without arguments.

    """
    if not function_table.available():
        return functools.partial(call_at, addresses, place, 0, array, array)
    return functools.partial(
        _SIGNATURE(int(addresses[place])), int(addresses[RECORD]), 0, len(array),
        array.ctypes.data, array.ctypes.data)


def packed(record):
    """
    Lay out a record as compiled code has it in memory.

    Returns
    -------
    words : ndarray of int
        Of 8 bytes throughout.
    kind : tuple
        What the type of the record depends on: those of its parts, in their order.

    """
    words, kind = [], []

    def lay_out(value):
        if value is None:
            words.append(0)
            kind.append(None)
        elif isinstance(value, np.ndarray):
            # No owner is told: nothing is counted, as numba's runtime is not used.
            words.extend((0, 0, value.size, value.itemsize, value.ctypes.data, *value.shape,
                          *value.strides))
            kind.append((value.dtype, value.ndim, value.flags.num))
        else:
            kind.append((type(value), len(value)))
            for part in value:
                lay_out(part)

    lay_out(record)
    return np.array(words, dtype=np.int64), tuple(kind)
