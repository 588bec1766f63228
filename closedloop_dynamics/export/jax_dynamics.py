# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Accelerations and multipliers of a model as a function of JAX, with exact derivatives."""

import numpy as np

from .callable_steps import opened, Shapes, STATUSES
from .jax_step import native_function, require_64_bits
from ..engine.status import NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS, SINGULAR
from ..mechanism.extras import of_an_extra
from ..simulation.derivative_code import DerivativeCode
from ..simulation.simulation import Simulation
from ..simulation.traced_scene import require_derivatives, TracedScene

with of_an_extra():
    import jax.numpy as jnp

_WORDS = {
    NOT_FINITE: 'expected finite numbers, and quaternions of norm 1',
    OPEN_LOOP: 'it leaves the loops open',
    SINGULAR: 'there is no derivative here: closure equations depend on one another, or nearly',
    POOR_EQUATIONS: 'other closure equations would have to be worked on than at the start'}


def jax_dynamics(model):
    """
    Return forward dynamics that JAX can differentiate, compile and batch.

    Parameters
    ----------
    model : Model
        All of whose effects have derivatives.

    Returns
    -------
    callable
        Of ``q``, shape (nq,), ``qd``, shape (nv,), and torques of the actuated joints, shape
        (na,); returns accelerations, shape (nv,), and multipliers, shape (nc,). It has first
        derivatives, forward and reverse: as ``derivatives.Derivatives``, each coordinate is
        changed alone, and quaternions as if they were divided by their norm. What it is called
        with closes the loops. With leading axes, the same in all three, or under ``jax.vmap``, the
        states of a batch are evaluated in one call. XLA calls the engine, as for ``jax_step``.

    Raises
    ------
    SimulationError
        As ``Differentiator`` does. (What is wrong with a state is raised by JAX, with its number.)
    RuntimeError
        Where JAX is not set to 64 bits, or there is no C++ compiler.

    """
    require_64_bits()
    of = _CallableDynamics(model)
    return native_function(of, of.evaluate, of.results, of.changing, of.turned)


class _CallableDynamics:
    """
    Accelerations and multipliers of a model, for programs that call the engine without Python.

    As ``CallableSteps``, whose ``step`` is ``evaluate`` here; ``results`` and ``changing``:
    lengths of results, and of changes of displacements, rates and torques.
    """

    def __init__(self, model):
        self._data = data = Simulation(model).data
        require_derivatives(data, instant=True)
        self._names, self._places = data.coordinates, np.array(data.actuated, dtype=np.int64)
        nv, nc = len(data.system.qdd), len(data.system.lam)
        qdd, lam = np.zeros(nv), np.zeros(nc)
        code = DerivativeCode(data, qdd, lam, scene=TracedScene(data, instant=True))
        self._kept = code, qdd, lam, data.integrated.copy()
        self.shapes = Shapes(self._names.nq, nv, len(self._places))
        self.results, self.changing = (nv, nc), (nv, nv, len(self._places))
        self._callable = data.system.native.callable_dynamics(
            self._kept[-1], self._places, code.table, qdd, lam, code.columns, code.found)
        self.address, self.evaluate, self.change, self.weight = self._callable.addresses()

    def failure(self, code, q, qd):
        """Return words for a code other than 0, and the state that it is of."""
        return (f'state {code // STATUSES}: {_WORDS.get(code % STATUSES, "it failed")}'
                f'{opened(self._data, code, q, qd)}')

    def turned(self, q, change):
        """Return the displacements, rotations among them, of changes of coordinates."""
        found = change[..., np.maximum(self._names.place, 0)]
        for place, rate in self._names.balls:
            axis, w = q[..., place:place + 3], q[..., place + 3:place + 4]
            by, by_w = change[..., place:place + 3], change[..., place + 3:place + 4]
            found = found.at[..., rate:rate + 3].set(
                2.0 * (w * by - by_w * axis - jnp.cross(axis, by)))
        return found

    def __repr__(self):
        """Show the mechanism."""
        return f'<dynamics of {self._data.scene.name}>'
