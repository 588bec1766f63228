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
Records of arrays behind an address, and compiled functions that are called with one.

What a function is compiled for depends on the type of its arguments. A function that is handed
the address of a record has one type for all of them: who calls it needs to be compiled only once.

"""

import ctypes
import functools

import numpy as np

from . import function_table

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
    def call_with_record(typingctx, addresses, what, first, second):
        """
        Call a function behind an address.

        Parameters
        ----------
        typingctx
            Of numba.
        addresses : ndarray of int
            Of the function and of its record, as ``addresses_of`` returns them.
        what : int
            What it shall do.
        first, second : ndarray, shape (n,)
            What it shall work on.

        Returns
        -------
        int

        """
        def generate(context, builder, signature, arguments):
            table, one, other = (
                context.make_array(signature.args[n])(context, builder, arguments[n])
                for n in (0, 2, 3))
            function, record = (
                builder.load(builder.gep(table.data, [WORD(place)])) for place in range(2))
            handed = [record, arguments[1], one.nitems, one.data, other.data]
            kind = ir.FunctionType(WORD, [value.type for value in handed])
            return builder.call(builder.inttoptr(function, kind.as_pointer()), handed)

        return types.int64(addresses, types.int64, first, second), generate
else:
    def record_at(address):
        """Return the record, which without a compiler stands for its address."""
        return address

    def array_at(address, count):
        """Return the array, which without a compiler stands for its address."""
        return address

    def call_with_record(addresses, what, first, second):
        """Call the function, which without a compiler stands with its record for both."""
        function, record = addresses
        return function(record, what, len(first), first, second)


def addresses_of(function, record):
    """
    Return where a function and its record are, the function compiled for such a record.

    Parameters
    ----------
    function : compiled function
        By ``compiled.addressed``; of a pointer to the record, what to do, the length of arrays,
        and pointers to two of them.
    record : NamedTuple
        Of arrays, None and further such records.

    Returns
    -------
    addresses : ndarray of int, shape (2,)
    words : ndarray of int
        The record as it is laid out, to be kept as long as its arrays.

    """
    if not function_table.available():
        return (function, record), None
    words, kind = packed(record)
    if (function, kind) not in _compiled:
        _compiled[function, kind] = _address(function, typeof(record))
    return np.array([_compiled[function, kind], words.ctypes.data]), words


def _address(function, record):
    """Return where a function is, compiled for a type of records."""
    numbers = types.CPointer(types.float64)
    signature = (types.CPointer(record), types.int64, types.int64, numbers, numbers)
    function.compile(signature)
    code = function.overloads[signature]
    return code.library.get_pointer_to_function(code.fndesc.llvm_cfunc_wrapper_name)


def from_python(addresses, what, array):
    """
    Return the function behind addresses as one that Python calls again and again.

    Parameters
    ----------
    addresses : ndarray of int
        As ``addresses_of`` returns them.
    what : int
        What it shall do.
    array : ndarray, shape (n,)
        On what, which must outlast it; handed over as both.

    Returns
    -------
    callable
        Without arguments.

    """
    if not function_table.available():
        return functools.partial(call_with_record, addresses, what, array, array)
    return functools.partial(
        _SIGNATURE(int(addresses[0])), int(addresses[1]), what, len(array), array.ctypes.data,
        array.ctypes.data)


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
