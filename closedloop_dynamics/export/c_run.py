# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What the step size, and single precision, of exported C change, measured in runs."""

import ctypes
from dataclasses import replace
from pathlib import Path
import tempfile
from typing import NamedTuple

import numpy as np

from .c_source import c_source
from ..engine import build
from ..mechanism.errors import SimulationError

FLAGS = '-x', 'c', '-std=c99', '-fPIC', '-fvisibility=hidden'
# Sources of more bytes are compiled without optimisation: it would take a minute.
LONG = 1_000_000
# Steps of the runs that measure, without torques.
STEPS = 1000
# Steps from one look at them to the next.
LOOKED_AT = 10


class StepCost(NamedTuple):
    """
    What a step size costs in a run without torques.

    Attributes
    ----------
    duration : float
        Of the run [s].
    energy : float
        Largest error of the energy balance, as a share of the largest kinetic energy.
    apart : float
        Largest difference of a joint coordinate to a run of half the step size [rad or m].

    """

    duration: float
    energy: float
    apart: float


def compiled(files, name, *options):
    """
    Compile a source, ``name``, for this machine; return a shared library's bytes.

    ``files``: all by name; ``options``: further ones of the compiler. SimulationError where there
    is none, or it fails.
    """
    with tempfile.TemporaryDirectory() as folder:
        for place, text in files.items():
            Path(folder, place).write_text(text, encoding='utf-8')
        size = '-O0' if max(map(len, files.values())) > LONG else '-O2'
        out = Path(folder, 'unit')
        try:
            # ziglang makes its library of C++ first, which takes a minute, where it compiles that.
            build.run([*(build.compiler() or build.zig(language='cc')), *FLAGS, size, *options,
                       '-shared', Path(folder, name), '-o', out, '-lm'])
        except build.BuildError as error:
            raise SimulationError(f'{name} could not be compiled: {error}') from None
        return out.read_bytes()


def step_cost(simulation):
    """
    Return the ``StepCost`` of the step size of a simulation, by the method of exported C.

    Raises
    ------
    SimulationError
        Where a run without torques fails.

    """
    method = replace(simulation.scene.method, integrator='rk4', stabilisation='projection')
    whole, half = (type(simulation)(replace(simulation.scene, method=replace(
        method, step_size=share * method.step_size))) for share in (1.0, 0.5))
    tau, kinetic, residual, apart = np.zeros(len(simulation.actuated_joints)), 0.0, 0.0, 0.0
    for _ in range(STEPS // LOOKED_AT):
        whole.advance(tau, LOOKED_AT)
        half.advance(tau, 2 * LOOKED_AT)
        energies = whole.energy_balance
        kinetic = max(kinetic, energies.kinetic)
        residual = max(residual, abs(energies.residual))
        apart = max(apart, np.abs(simulation.coordinates.apart(
            whole.position, half.position)).max(initial=0.0))
    return StepCost(STEPS * simulation.step_size, residual / kinetic if kinetic else 0.0,
                    float(apart))


def error_of_float32(simulation):
    """
    Return how far a run of the C in single precision is from one in double [rad or m].

    The largest difference of a joint coordinate in ``STEPS`` steps without torques.

    Raises
    ------
    SimulationError
        Where there is no compiler, or a step fails.

    """
    runs = [_steps(simulation, float32) for float32 in (False, True)]
    return max(float(np.abs(simulation.coordinates.apart(*pair)).max(initial=0.0))
               for pair in zip(*runs))


def _steps(simulation, float32):
    """Yield the coordinates after each step of compiled C."""
    source, header = c_source(simulation, 'model', float32=float32)
    kind, real = (np.float32, ctypes.c_float) if float32 else (np.float64, ctypes.c_double)
    state = np.concatenate((simulation.position, simulation.velocity)).astype(kind)
    tau = np.zeros(len(simulation.velocity), dtype=kind)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, 'model.so')
        path.write_bytes(compiled({'model.c': source, 'model.h': header}, 'model.c',
                                  '-fvisibility=default'))
        library = ctypes.CDLL(str(path))
    model = ctypes.byref(ctypes.c_char.in_dll(library, 'model_default'))
    for number in range(STEPS):
        if library.model_step(model, ctypes.c_void_p(state.ctypes.data),
                              ctypes.c_void_p(tau.ctypes.data), real(simulation.step_size)):
            raise SimulationError(f'step {number} of the C in {kind.__name__} failed')
        yield state[:len(simulation.position)].astype(float)
