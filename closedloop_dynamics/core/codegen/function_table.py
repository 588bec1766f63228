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
How compiled code calls routines of which it knows only the address.

A function table is an array of integers: the addresses of the routines of one mechanism, then
those of the arrays that they work on. A routine is called with it and with a state, and returns
whether its results are good.

"""

import ctypes
import weakref

import numpy as np

try:
    from llvmlite import ir
    from numba import config, types
    from numba.extending import intrinsic
except ImportError:
    config = None

# Addresses of unrolled routines: of a state the accelerations and multipliers; the outward
# recursion alone, and what follows it; the corrections that close the loops.
(EVALUATION, OUTWARD, ACCELERATION, CORRECTION,
 # Not compiled before they are called: the latter two with refinement, and the forces in joints
 # after them.
 REFINED_ACCELERATION, REFINED_CORRECTION, REACTIONS,
 # Addresses of the rank-revealing path.
 RANK_REVEALING_ACCELERATION, RANK_REVEALING_POSITION, RANK_REVEALING_VELOCITY) = range(10)
ALWAYS = (EVALUATION, OUTWARD, ACCELERATION, CORRECTION)
REFINED = (REFINED_ACCELERATION, REFINED_CORRECTION)
LATER = (*REFINED, REACTIONS)
# Addresses of arrays.
(BODY, GRAVITY, CUT_POINT, TAU, BAUMGARTE, QDD, LAM, HEALTH, WORK_BODY, CLOSURE, CLOSURE_RATE,
 CORRECTIONS, REACTION) = range(10, 23)
TABLE_COLUMNS = 23
# States side by side in the vectors of ``lanes``: one of AVX-512, two of AVX2, four of NEON.
LANES = 8

_SIGNATURE = ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_void_p)


def available():
    """
    Tell whether there is a compiler.

    Returns
    -------
    bool

    """
    return config is not None and not config.DISABLE_JIT


if available():
    @intrinsic
    def call(typingctx, table, which, q, qd):
        """
        Call a routine of a function table.

        Parameters
        ----------
        typingctx
            Of numba.
        table : ndarray of int
            As ``connect`` returns it.
        which : int
            Place of the routine's address in it.
        q, qd : ndarray, shape (nv,)
            Joint coordinates and rates.

        Returns
        -------
        int
            0 where the routine could not do its work.

        """
        signature = types.int64(table, types.intp, q, qd)

        def generate(context, builder, signature, arguments):
            word = ir.IntType(64)
            arrays = [context.make_array(signature.args[n])(context, builder, arguments[n]).data
                      for n in (0, 2, 3)]
            function = ir.FunctionType(word, [array.type for array in arrays])
            address = builder.load(builder.gep(arrays[0], [arguments[1]]))
            return builder.call(builder.inttoptr(address, function.as_pointer()), arrays)

        return signature, generate

    @intrinsic
    def run_piece(typingctx, piece, constant, c, own, i, other, j, first, m, second, n):
        """
        Call a piece of the loops (``pieces``).

        Parameters
        ----------
        typingctx
            Of numba.
        piece : int
            Its address.
        constant, own, other, first, second : ndarray
            What it reads and writes.
        c, i, j, m, n : int
            Row of each, of arrays of one dimension the place.

        Returns
        -------
        int

        """
        arrays = constant, own, other, first, second
        signature = types.int64(piece, *(
            kind for array in arrays for kind in (array, types.intp)))

        def generate(context, builder, signature, arguments):
            word, number = ir.IntType(64), ir.DoubleType().as_pointer()
            rows = []
            for n in range(1, len(arguments), 2):
                array = context.make_array(signature.args[n])(context, builder, arguments[n])
                first = builder.ptrtoint(array.data, word)
                step = builder.extract_value(array.strides, 0)
                rows.append(builder.inttoptr(
                    builder.add(first, builder.mul(step, arguments[n + 1])), number))
            function = ir.FunctionType(word, 5 * [number])
            return builder.call(builder.inttoptr(arguments[0], function.as_pointer()), rows)

        return signature, generate
else:
    from .interpreted import run as run_piece  # noqa: F401

    def call(table, which, q, qd):
        """Call a routine of a function table, which is Python's without a compiler."""
        return run(table, which, q, qd)


def function(table, which):
    """
    Return a routine as a function that Python calls, quicker than any compiled kernel.

    Parameters
    ----------
    table : ndarray of int
        As ``connect`` returns it.
    which : int
        Place of the routine's address in it.

    Returns
    -------
    callable
        Of the addresses of table, q and qd.

    """
    return _SIGNATURE(int(table[which]))


# What linkages that are alive call back: as functions of addresses, and as they are.
_callbacks = {}


def run(table, which, q, qd):
    """
    Call the rank-revealing path from Python.

    Parameters
    ----------
    table : ndarray of int
        As ``connect`` returns it.
    which : int
        Place of the routine's address in it.
    q, qd : ndarray, shape (nq,), (nv,)
        Joint coordinates and rates.

    Returns
    -------
    int
        1: it always does its work.

    """
    _callbacks[id(table)][1][which](q, qd)
    return 1


def connect(arrays, coordinates, rank_revealing, find):
    """
    Return a function table without unrolled routines, but for those compiled when they are called.

    Parameters
    ----------
    arrays : dict of int to ndarray
        By the places BODY to REACTION; they are kept as long as the function table.
    coordinates : int
        Length of q.
    rank_revealing : dict of int to callable
        From RANK_REVEALING_ACCELERATION, _POSITION and _VELOCITY; called with q and qd.
    find : callable
        Returns the address of one of LATER.

    Returns
    -------
    ndarray of int, shape (TABLE_COLUMNS,)

    """
    table = np.zeros(TABLE_COLUMNS, dtype=np.int64)
    for place, array in arrays.items():
        table[place] = array.ctypes.data
    kept = {place: _SIGNATURE(_compiling(find, place)) for place in LATER}
    for place, function in rank_revealing.items():
        kept[place] = _SIGNATURE(_on_arrays(function, coordinates, len(arrays[QDD])))
    for place, routine in kept.items():
        table[place] = ctypes.cast(routine, ctypes.c_void_p).value
    _callbacks[id(table)] = kept, rank_revealing, arrays
    weakref.finalize(table, _callbacks.pop, id(table))
    return table


def take(table, routines):
    """
    Give a table other unrolled routines; those of LATER are found when called.

    Parameters
    ----------
    table : ndarray of int
        As ``connect`` returned it; changed in place.
    routines : dict of int to int
        Addresses of EVALUATION, OUTWARD, ACCELERATION and CORRECTION.

    """
    for place, address in routines.items():
        table[place] = address
    for place in LATER:
        table[place] = ctypes.cast(
            _callbacks[id(table)][0][place], ctypes.c_void_p).value


def _compiling(find, place):
    """Return a function that finds a routine, links it in its own place, and calls it."""
    def called(table, q, qd):
        address = find(place)
        (ctypes.c_int64 * TABLE_COLUMNS).from_address(table)[place] = address
        return _SIGNATURE(address)(table, q, qd)

    return called


def _on_arrays(function, nq, nv):
    """Return a function of addresses that calls one of arrays."""
    places, rates = ctypes.c_double * nq, ctypes.c_double * nv

    def called(table, q, qd):
        function(np.frombuffer(places.from_address(q)), np.frombuffer(rates.from_address(qd)))
        return 1

    return called
