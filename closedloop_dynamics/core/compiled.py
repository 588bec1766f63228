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

"""The one decorator of the compiled kernels."""

import gc
import warnings

try:
    import numba
    from numba.core import event
    from numba.core.sigutils import normalize_signature
    from numba.core.types import unliteral
except ImportError:
    numba = None
    warnings.warn(
        'numba is not installed: the same kernels run interpreted, several hundred times '
        'slower. Install numba for real-time simulation.', RuntimeWarning, stacklevel=2)
else:
    from .cache import KernelCache

    class _RareCollections(event.Listener):
        """
        Let Python look for garbage rarely while numba compiles.

        It makes millions of objects most of which stay until it is done: looking through them
        again and again would be a sixth of the time that the first start takes.

        """

        def __init__(self):
            self._before = []

        def on_start(self, event):
            self._before.append(gc.get_threshold())
            objects, *rest = self._before[-1]
            # Objects made until the next look; 700 in Python 3.11, zero where nobody looks.
            gc.set_threshold(objects and max(50000, objects), *rest)

        def on_end(self, event):
            gc.set_threshold(*self._before.pop())

    # Within the compiler's lock.
    event.register('numba:compile', _RareCollections())


def _compile(function, allocates=False, from_c=False, stored_as=None, **options):
    """Return ``function`` compiled, or without numba as it is."""
    if numba is None:
        return function
    # Without numba's runtime no array can be made, and none is counted: the counting of the
    # arrays of a model and a workspace takes longer than many a kernel.
    options['_nrt'] = allocates
    # Unpacking a model and a workspace from Python is as much code as many a kernel: private
    # kernels, which only kernels call, go without.
    kernel = numba.njit(
        error_model='numpy', no_cfunc_wrapper=not from_c,
        no_cpython_wrapper=from_c or function.__name__.startswith('_'), **options)(function)
    if not numba.config.DISABLE_JIT:
        # Numba would compile anew for every constant that it is called with.
        compile_for = kernel.compile
        kernel.compile = lambda signature: compile_for(tuple(
            unliteral(kind) for kind in normalize_signature(signature)[0]))
        # Numba has no public way to bring a cache of one's own.
        kernel._cache = KernelCache(stored_as or function)
    return kernel


def is_stored(kernel, signature):
    """Return whether what a kernel compiles to for the types of arguments is on disk."""
    return kernel._cache.is_stored(signature, kernel.targetctx)


def compiled(function):
    """
    Compile ``function`` with numba, cached on disk; without numba return it as it is.

    Division by zero follows IEEE 754 (``error_model='numpy'``): no kernel
    raises, poor pivots are reported through the status instead.

    """
    return _compile(function)


def allocating(function):
    """
    Compile like ``compiled`` what makes arrays: nothing that each step needs.

    Parameters
    ----------
    function : function
        The rank-revealing path, which is taken rarely.

    """
    return _compile(function, allocates=True)


def inlined(function):
    """
    Compile like ``compiled``, and always inline into the calling kernel.

    For the stages of one evaluation: a call hands over every array of the model and the
    workspace (some 150 words), which would cost as much as the stage itself.

    """
    return _compile(function, forceinline=True)


def replaced(function, called):
    """Compile ``called`` as what C calls in the place of ``function`` (``codegen.records``)."""
    # Machine code is found by name and types: what numba adds to tell namesakes apart counts in
    # each process from the start, and code comes from the disk, from several processes.
    called.__name__ = function.__name__
    called.__qualname__ = f'{function.__module__}.{function.__qualname__}'
    return _compile(called, stored_as=function, from_c=True)


def released(function):
    """
    Compile like ``compiled``, and let go of Python's lock while the kernel runs.

    For whole runs, so that several threads compute at the same time; each needs a system of its
    own.

    """
    return _compile(function, nogil=True)


def merged(function):
    """
    Compile into every calling kernel, never on its own.

    For the layers between the integrators and the evaluation: numba optimises all the code below
    a kernel again for each layer above it, which is most of the time that the first start
    takes.

    """
    return _compile(function, inline='always')


@inlined
def choose(condition, yes, no):
    """
    Return one of two numbers, without a branch where the processor can.

    Kernels choose by it between values that depend on the state: then they can be unrolled
    (``codegen``), for which branches may depend on topology alone.

    Parameters
    ----------
    condition : bool
        What decides.
    yes, no : float
        Both are computed.

    Returns
    -------
    float

    """
    return yes if condition else no
