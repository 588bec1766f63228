# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""C++ around Pinocchio, compiled when a benchmark first asks for it."""

import ctypes
import hashlib
import os
from pathlib import Path
import shlex
import subprocess
import sys
import tempfile

import numpy as np
import pinocchio as pin

MOTION = Path(__file__).with_name('pinocchio_motion.hpp')


def compiled(source, *libraries):
    """
    Compile a file against the installed wheel, once for each version of both.

    Parameters
    ----------
    source : pathlib.Path
        C++ with functions in the manner of C.
    libraries : str
        Options that link more than Pinocchio itself.

    Returns
    -------
    ctypes.CDLL or None
        None where there is no compiler, or the headers do not suffice.

    """
    prefix = Path(pin.__file__).resolve().parents[4]
    options = ['-O3', '-DNDEBUG', '-std=c++17', '-shared', '-fPIC', '-w',
               '-DBOOST_MPL_LIMIT_LIST_SIZE=30', '-DBOOST_MPL_CFG_NO_PREPROCESSED_HEADERS',
               f'-I{prefix}/include', f'-I{prefix}/include/eigen3']
    links = [f'-L{prefix}/lib', '-lpinocchio_default', *libraries,
             f'-Wl,-rpath,{prefix}/lib']
    text = ''.join([source.read_text(), MOTION.read_text(), ' '.join(options + links),
                    pin.__version__])
    cache = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    library = cache / 'closedloop_dynamics' / (
        f'{source.stem}_{hashlib.sha256(text.encode()).hexdigest()[:16]}.so')
    if not library.exists():
        print(f'compiling {source.name} around Pinocchio (a minute, this time alone) ...',
              file=sys.stderr)
        library.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=library.parent) as scratch:
            made = Path(scratch) / 'made.so'
            try:
                subprocess.run(
                    [*shlex.split(os.environ.get('CXX', 'g++')), *options, str(source), '-o',
                     str(made), *links], check=True, capture_output=True, text=True)
            except (OSError, subprocess.CalledProcessError) as error:
                lines = (getattr(error, 'stderr', '') or str(error)).strip().splitlines()
                print(f'no loops in C++: {lines[0] if lines else error}', file=sys.stderr)
                return None
            made.replace(library)
    loaded = ctypes.CDLL(str(library))
    loaded.create.restype = ctypes.c_void_p
    return loaded


class Machine:
    """
    A mechanism in the C++ of pinocchio_motion.hpp, with integrators.

    Parameters
    ----------
    library : ctypes.CDLL
        Compiled.
    handle : int
        Of its ``create``.

    """

    def __init__(self, library, handle):
        self._library, self._handle = library, ctypes.c_void_p(handle)
        self.nq, self.nv = library.coordinates(self._handle), library.freedoms(self._handle)

    def set_state(self, q, qd, tau):
        """Go to a state under joint torques."""
        self._library.set_state(self._handle, pointer(q), pointer(qd), pointer(tau))

    def evaluate(self, count):
        """Evaluate the present state again and again; return its accelerations."""
        result = np.zeros(self.nv)
        self._library.evaluate(self._handle, ctypes.c_long(count), pointer(result))
        return result

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,)."""
        self.set_state(q, qd, tau)
        return self.evaluate(1)

    def differentiate(self, count):
        """
        Differentiate in the present state again and again.

        Returns
        -------
        ndarray, shape (3, nv, nv)
            Of the accelerations by coordinates, rates and torques, which are the first axis.

        """
        result = np.zeros((3, self.nv, self.nv))
        self._library.differentiate(self._handle, ctypes.c_long(count), pointer(result))
        return result.transpose(0, 2, 1)

    def runge_kutta(self, step, steps):
        """Make steps of RK4."""
        self._library.runge_kutta_4(self._handle, ctypes.c_double(step), ctypes.c_long(steps))

    def fehlberg(self, duration, tolerance, first_step):
        """Make steps of Runge-Kutta-Fehlberg 7(8) under error control."""
        self._library.fehlberg_78(self._handle, ctypes.c_double(duration),
                                  ctypes.c_double(tolerance), ctypes.c_double(first_step))

    def held(self, torques, advance):
        """
        Hold torques, one row after the other.

        Parameters
        ----------
        torques : ndarray, shape (n, nv)
            One after the other.
        advance : str, number, number...
            Name of an integrator's function in C++, and what it takes.

        """
        name, *values = advance
        arguments = [ctypes.c_long(value) if isinstance(value, int) else ctypes.c_double(value)
                     for value in values]
        call, set_torque, handle = getattr(self._library, name), self._library.set_torque, (
            self._handle)
        for torque in [pointer(row) for row in torques]:
            set_torque(handle, torque)
            call(handle, *arguments)

    def position(self):
        """Return the coordinates, shape (nq,)."""
        q = np.zeros(self.nq)
        self._library.get_position(self._handle, pointer(q))
        return q


def pointer(values, kind=float):
    """Return what C takes of an array, which lives as long."""
    return np.ascontiguousarray(values, dtype=kind).ctypes.data_as(ctypes.c_void_p)
