# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Accelerations and multipliers of a model as a function of JAX, with exact derivatives."""

from threading import Lock

import numpy as np

from .derivatives import Differentiator
from .simulation import Simulation
from ..mechanism.extras import of_an_extra

with of_an_extra():
    import jax
    import jax.numpy as jnp


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
        with closes the loops. States of a batch (``jax.vmap``) are evaluated one by one.

    Raises
    ------
    SimulationError
        As ``Differentiator`` does. (What is wrong with a state is raised by JAX, with the message
        of ``SingularityError``.)
    RuntimeError
        Where JAX is not set to 64 bits.

    """
    if not jax.config.jax_enable_x64:
        raise RuntimeError("expected JAX with 64 bits: jax.config.update('jax_enable_x64', True)")
    simulation, lock = Simulation(model), Lock()
    differentiate = Differentiator(simulation)
    names, driven = model.coordinates, simulation.data.actuated
    nq, nv, nc = names.nq, names.nv, len(simulation.data.system.lam)

    def values(*state):
        with lock:
            return simulation.forward_dynamics(*map(np.asarray, state))

    def derivatives(*state):
        q, qd, torque = map(np.asarray, state)
        with lock:
            found = differentiate(q, qd, torque)
        return (found.by_position @ _turns(names, q), found.by_velocity,
                np.ascontiguousarray(found.by_torque[:, driven]))

    def asked(function, state, *shapes):
        wanted = [jax.ShapeDtypeStruct(shape, np.float64) for shape in shapes]
        return jax.pure_callback(function, tuple(wanted), *state, vmap_method='sequential')

    @jax.custom_jvp
    def dynamics(q, qd, torque):
        return asked(values, (q, qd, torque), (nv,), (nc,))

    @dynamics.defjvp
    def _(state, changes):
        matrices = asked(derivatives, state, *((nv + nc, n) for n in (nq, nv, len(driven))))
        change = sum(matrix @ one for matrix, one in zip(matrices, changes))
        return dynamics(*state), (change[:nv], change[nv:])

    return lambda q, qd, torque: dynamics(*(
        jnp.asarray(one, dtype=np.float64) for one in (q, qd, torque)))


def _turns(names, q):
    """Return the changes of rates' kind, rotations among them, for those of coordinates."""
    matrix = np.zeros((names.nv, names.nq))
    single = names.place >= 0
    matrix[single, names.place[single]] = 1.0
    for place, rate in names.balls:
        x, y, z, w = q[place:place + 4]
        matrix[rate:rate + 3, place:place + 4] = 2.0 * np.array(
            ((w, z, -y, -x), (-z, w, x, -y), (y, -x, w, -z)))
    return matrix
