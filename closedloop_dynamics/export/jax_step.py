# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The step of a model over a period as a function of JAX, called by XLA without Python."""

import ctypes
from functools import cache
import hashlib
from pathlib import Path
import secrets
import tempfile

import numpy as np

from .callable_steps import CallableSteps
from ..codegen.cache import directory
from ..engine import build
from ..mechanism.extras import of_an_extra

with of_an_extra():
    import jax
    from jax.extend.core import Primitive
    from jax.interpreters import ad, batching, mlir
    import jax.numpy as jnp

# The function that XLA calls: its arguments are the rows of all inputs and outputs.
TARGET, MOST_LETTERS = 'closedloop_dynamics_step', 1000
_Words = ctypes.CFUNCTYPE(
    None, ctypes.c_int64, ctypes.POINTER(ctypes.c_double), ctypes.POINTER(ctypes.c_double),
    ctypes.c_void_p)
SOURCE = """\
#include "xla/ffi/api/ffi.h"

namespace ffi = xla::ffi;
using Rows = int64_t (void *, int64_t, const double * const *, double * const *);

using Words = void (int64_t, const double *, const double *, char *);

// Inputs are of doubles, with the same leading axes.
static ffi::Error call_rows(
  ffi::RemainingArgs inputs, ffi::RemainingRets outputs, int64_t function, int64_t address,
  int64_t words, int64_t)
{
  const double * in[6];
  double * out[6];
  int64_t rows = 1, lengths[6];
  for (size_t n = 0; n < inputs.size(); ++n) {
    const auto one = inputs.get<ffi::AnyBuffer>(n);
    if (!one.has_value()) {
      return one.error();
    }
    in[n] = one->typed_data<double>();
    const auto shape = one->dimensions();
    rows = 1;
    for (size_t k = 0; k + 1 < shape.size(); ++k) {
      rows *= shape[k];
    }
    lengths[n] = shape[shape.size() - 1];
  }
  for (size_t n = 0; n < outputs.size(); ++n) {
    auto one = outputs.get<ffi::AnyBuffer>(n);
    if (!one.has_value()) {
      return one.error();
    }
    out[n] = (*one)->typed_data<double>();
  }
  const int64_t failed =
    reinterpret_cast<Rows *>(function)(reinterpret_cast<void *>(address), rows, in, out);
  if (failed == 0) {
    return ffi::Error::Success();
  }
  // Python writes what failed.
  const int64_t row = failed / 16;
  std::string text(@LENGTH@, '\\0');
  reinterpret_cast<Words *>(words)(
    failed, in[0] + row * lengths[0], in[1] + row * lengths[1], text.data());
  return ffi::Error::InvalidArgument(text.c_str());
}

XLA_FFI_DEFINE_HANDLER_SYMBOL(
  closedloop_dynamics_step, call_rows,
  ffi::Ffi::Bind().RemainingArgs().RemainingRets().Attr<int64_t>("function").Attr<int64_t>(
    "address").Attr<int64_t>("words").Attr<int64_t>("token"));
"""


def jax_step(model, period, method='rk4', steps=None):
    """
    Return the step of a model over a period, torques held, as a function of JAX.

    XLA calls the engine for it, without Python: under ``jit``, ``grad``, ``vmap`` and ``scan``. A
    small library is compiled for that when the package first meets a version of JAX.

    Parameters
    ----------
    model : Model
        All of whose effects have derivatives.
    period, method, steps
        As for ``Stepper``.

    Returns
    -------
    callable
        Of coordinates, shape (nq,), that close the loops, rates, shape (nv,), and torques of the
        actuated joints, shape (na,); returns coordinates and rates after the period. With leading
        axes, the same in all three, the states of a batch are advanced in one call. Derivatives
        are those of the arithmetic of the steps, by single coordinates, as of ``Sensitivity``:
        first ones, forward and reverse. Processors other than the CPU are not served.

    Raises
    ------
    SimulationError, ValueError
        As ``Stepper`` does.
    RuntimeError
        Where JAX is not set to 64 bits, or there is no C++ compiler. (What is wrong with a state
        is raised by JAX, with its number.)

    """
    require_64_bits()
    of = CallableSteps(model, period, method, steps)
    nq, nv, _ = of.shapes
    return native_function(of, of.step, (nq, nv), of.shapes)


def require_64_bits():
    """Refuse JAX with numbers of single precision."""
    if not jax.config.jax_enable_x64:
        raise RuntimeError("expected JAX with 64 bits: jax.config.update('jax_enable_x64', True)")


def native_function(of, value, lengths, changing, turned=lambda q, change: change):
    """
    Return a function of coordinates, rates and torques that the engine computes.

    ``of``: a ``CallableSteps``, or one like it; ``value``: the address of its function;
    ``lengths``: of the results; ``changing``: of the changes that ``of.change`` takes, which
    ``turned`` makes of those of coordinates.
    """
    _register()
    # Programs that JAX keeps on disk must not be taken for those of another process.
    token = secrets.randbits(62)

    @_Words
    def words(code, q, qd, out):
        text = of.failure(code, *(
            np.ctypeslib.as_array(one, (length,)).copy()
            for one, length in zip((q, qd), of.shapes))).encode()
        ctypes.memmove(out, text, min(len(text), MOST_LETTERS - 1))

    def call(function, lengths, *arrays):
        lead = arrays[0].shape[:-1]
        return jax.ffi.ffi_call(
            TARGET, [jax.ShapeDtypeStruct((*lead, length), np.float64) for length in lengths],
            vmap_method='broadcast_all')(
                *arrays, function=np.int64(function), address=np.int64(of.address),
                words=np.int64(ctypes.cast(words, ctypes.c_void_p).value),
                token=np.int64(token))

    @jax.custom_jvp
    def weights_of(*given):
        return tuple(call(of.weight, changing, *given))

    @weights_of.defjvp
    def _(given, changes):
        raise NotImplementedError(f'{of!r} has first derivatives alone')

    change = _Linear(repr(of), lambda *given: call(of.change, lengths, *given),
                     weights_of, lengths)

    @jax.custom_jvp
    def function(*state):
        return tuple(call(value, lengths, *state))

    @function.defjvp
    def _(state, changes):
        return function(*state), tuple(
            change(*state, turned(state[0], changes[0]), *changes[1:]))

    def whole(q, qd, torque):
        given = [jnp.asarray(one, dtype=np.float64) for one in (q, qd, torque)]
        for name, one, length in zip(('q', 'qd', 'torque'), given, of.shapes):
            if one.shape != (*given[0].shape[:-1], length):
                raise ValueError(f'{name}: expected shape '
                                 f'{(*given[0].shape[:-1], length)}, got {one.shape}')
        return function(*given)

    # Addresses are of use as long as these are there.
    whole.kept = of, words
    return whole


class _Linear:
    """
    A function of a state that is linear in changes of it, with its transpose.

    ``forward`` and ``backward`` take the state, then changes, or weights of results, with leading
    axes that are the same in all; ``lengths``: of the results.
    """

    def __init__(self, name, forward, backward, lengths):
        self._primitive = primitive = Primitive(name)
        primitive.multiple_results = True
        primitive.def_impl(jax.jit(forward))
        primitive.def_abstract_eval(lambda *given: [
            jax.core.ShapedArray((*given[0].shape[:-1], length), np.float64)
            for length in lengths])
        mlir.register_lowering(primitive, mlir.lower_fun(forward, multiple_results=True))

        def transpose(weights, *given):
            state = given[:3]
            lead = state[0].shape[:-1]
            weights = [jnp.zeros((*lead, length)) if type(one) is ad.Zero else one
                       for one, length in zip(weights, lengths)]
            return [None, None, None, *backward(*state, *weights)]

        def batch(given, axes):
            size = next(one.shape[axis] for one, axis in zip(given, axes) if axis is not None)
            rows = [jnp.broadcast_to(one, (size, *one.shape)) if axis is None else
                    jnp.moveaxis(one, axis, 0) for one, axis in zip(given, axes)]
            return self(*rows), [0 for _ in lengths]

        def differentiate(given, changes):
            if any(type(one) is not ad.Zero for one in changes[:3]):
                raise NotImplementedError(f'{name} has first derivatives alone')
            moved = [jnp.zeros_like(one) if type(change) is ad.Zero else change
                     for one, change in zip(given[3:], changes[3:])]
            return self(*given), self(*given[:3], *moved)

        ad.primitive_transposes[primitive] = transpose
        ad.primitive_jvps[primitive] = differentiate
        batching.primitive_batchers[primitive] = batch

    def __call__(self, *given):
        return self._primitive.bind(*given)


@cache
def _register():
    """Have XLA know the function, compiled when a version of JAX is first met."""
    source = SOURCE.replace('@LENGTH@', str(MOST_LETTERS))
    key = hashlib.sha256(f'{source}{jax.__version__}'.encode()).hexdigest()[:16]
    with tempfile.TemporaryDirectory() as folder:
        kept = directory()
        library = Path(kept or folder, f'jax_{key}.so')
        if not library.is_file():
            text, made = Path(folder, 'step.cpp'), Path(folder, 'step.so')
            text.write_text(source)
            try:
                build.run([*(build.compiler() or build.zig()), '-std=c++17', '-O2', '-fPIC',
                           '-shared', '-isystem', jax.ffi.include_dir(),
                           text, '-o', made])
            except build.BuildError as error:
                raise RuntimeError(
                    f'what JAX calls could not be compiled: {error}') from None
            # Another process may make the same.
            beside = library.with_suffix(f'.{secrets.token_hex(4)}')
            beside.write_bytes(made.read_bytes())
            beside.replace(library)
        handler = ctypes.CDLL(str(library)).closedloop_dynamics_step
        jax.ffi.register_ffi_target(TARGET, jax.ffi.pycapsule(handler), platform='cpu')
        # It stays loaded.
        return handler
