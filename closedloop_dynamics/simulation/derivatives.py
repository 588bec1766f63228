# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of accelerations and multipliers of a scene, by generated code."""

from typing import NamedTuple

import numpy as np

from .errors import SimulationError, SingularityError
from ..core.codegen import function_table as calls
from ..core.codegen.derivatives import DERIVATIVE, DerivativeUnrolling, RATE
from ..core.codegen.machine_code import machine_code, SCALAR
from ..core.codegen.routines import topology
from ..core.codegen.scene_routines import VALUES
from ..effects.table import FIRST, SECOND, VALUE_COLUMNS
from ..effects.traced_laws import act, entries_of, refused
from ..engine import native


class Derivatives(NamedTuple):
    """
    Accelerations, multipliers and their derivatives in one state.

    Attributes
    ----------
    acceleration : ndarray, shape (nv,)
    multipliers : ndarray, shape (nc,)
        Of the closure equations that the evaluation works on.
    by_position, by_velocity, by_torque : ndarray, shape (nv + nc, nv)
        Of the accelerations, behind them of the multipliers, by coordinates of the spanning tree
        (of orientations by rotations about the child's axes), rates, and torques in the joints.
    jacobian : ndarray, shape (nc, nv)
        J of the closure equations.
    closure_rate_by_position : ndarray, shape (nc, nv)
        Of J qd, the rates held.

    """

    acceleration: np.ndarray
    multipliers: np.ndarray
    by_position: np.ndarray
    by_velocity: np.ndarray
    by_torque: np.ndarray
    jacobian: np.ndarray
    closure_rate_by_position: np.ndarray


def refusals(simulation):
    """
    Tell what of a simulation has no derivatives, and why.

    Parameters
    ----------
    simulation : Simulation
        Of the scene.

    Returns
    -------
    dict of str to str
        Reasons by what is refused; empty where there are derivatives, and C (``c_source``).

    """
    found = {f'effects.{name}': reason
             for name, reason in refused(simulation.effect_set).items()}
    for name in simulation.torque_names[len(simulation.joint_names):]:
        found[name] = 'a joint that closes a loop, in which something acts'
    if not simulation.system.is_unrolled:
        found['mechanism'] = (
            'too large, or of another formulation than subsystem: code is generated for '
            'mechanisms of few bodies alone')
    return found


class Differentiator:
    """
    Derivatives of the accelerations and multipliers of any state of a scene.

    Compiled once for a mechanism and its effects; masses, lengths and parameters of effects are
    read anew with each call.

    Parameters
    ----------
    simulation : Simulation
        Of the scene; its state stays as it is.

    Raises
    ------
    SimulationError
        Where an effect has no derivative, or the mechanism is too large, with names and reasons.

    Notes
    -----
    The residuals of motion and closure are differentiated, and solved by the factors of the
    articulated inertias and of the constraint matrix (``core.codegen.derivatives``). Coordinates
    of the tree are changed one by one, with the loops open and equations of closure as they are
    then: by directions that keep the loops closed these are the derivatives of the motion. Terms
    of Baumgarte's method are left out.

    """

    def __init__(self, simulation):
        """Compile, unless an earlier process has."""
        reasons = refusals(simulation)
        if reasons:
            raise SimulationError(
                f'{simulation.scene.name} has no derivatives: ' + '; '.join(
                    f'{what} ({why})' for what, why in reasons.items()))
        self._simulation = simulation
        self._enabled, self._laws = dict(simulation.effect_set.enabled), _laws(simulation)
        self._system = system = simulation.system
        nv, nc = len(system.qdd), len(system.lam)
        self._qdd, self._lam = np.zeros(nv), np.zeros(nc)
        self._found, self._rates = np.zeros((3 * nv, nv + nc)), np.zeros((2 * nv, nc))
        effects = system.effects
        self._values = np.zeros((0, VALUE_COLUMNS)) if effects is None else effects.values
        self._table = np.zeros(RATE + 1, dtype=np.int64)
        for place, array in {
                calls.BODY: system.model.body, calls.GRAVITY: system.model.gravity,
                calls.CUT_POINT: system.model.cut_point,
                VALUES: self._values, calls.QDD: self._qdd, calls.LAM: self._lam,
                DERIVATIVE: self._found, RATE: self._rates}.items():
            self._table[place] = array.ctypes.data
        rows = () if effects is None else tuple(
            (row, int(effects.kind[row]),
             *self._laws.get(row, effects.index[row, [FIRST, SECOND]].tolist()))
            for row in np.flatnonzero(effects.enabled).tolist())
        key = 'derivatives', topology(system.model), rows, self._values.shape
        self._table[0] = machine_code(key, self._routines, SCALAR)('derivatives')

    def _routines(self):
        """Unroll the derivatives."""
        effects = self._system.effects
        one = DerivativeUnrolling(
            self._system.model,
            lambda forces: act(effects, forces, self._simulation.effect_set.laws),
            self._values.shape)
        one.derivatives()
        return [one.named('derivatives')]

    def __call__(self, position, velocity, torque=None):
        """
        Differentiate in a state that closes the loops.

        Parameters
        ----------
        position : array_like, shape (nq,)
            Joint coordinates [rad or m].
        velocity : array_like, shape (nv,)
            Joint rates [rad/s or m/s].
        torque : mapping, sequence or None
            As for ``Simulation.step``.

        Returns
        -------
        Derivatives

        Raises
        ------
        ValueError
            For numbers that make no sense.
        SingularityError
            In positions where closure equations depend on one another, or nearly.

        """
        if self._system is not self._simulation.system:
            raise SimulationError(
                'The simulation works on other closure equations now: make a new Differentiator.')
        if self._enabled != self._simulation.effect_set.enabled:
            raise SimulationError(
                'Other effects are switched on now: make a new Differentiator.')
        if self._laws and self._laws != _laws(self._simulation):
            raise SimulationError(
                'Effects have other expressions or ends now: make a new Differentiator.')
        self._qdd[:], _ = self._simulation.forward_dynamics(position, velocity, torque)
        self._lam[:] = self._system.lam
        q, qd = (np.array(one, dtype=float) for one in (position, velocity))
        if not native.call(self._table, 0, q, qd) or not np.isfinite(self._found).all():
            raise SingularityError(
                'The accelerations have no derivatives here: closure equations depend on one '
                'another in this position, or nearly, or points that a spring joins meet. Take a '
                'position beside it. (So it is everywhere where masses differ so much that the '
                'elimination alone does not tell.)')
        nv = len(self._qdd)
        parts = [part.T.copy() for part in self._found.reshape(3, nv, -1)]
        return Derivatives(self._qdd.copy(), self._lam.copy(), *parts,
                           self._rates[nv:].T.copy(), self._rates[:nv].T.copy())


def _laws(simulation):
    """Return what code of users' laws depends on, by rows: arithmetic, and what is measured."""
    table, laws = simulation.system.effects, simulation.effect_set.laws
    return {row: (law.arithmetic, entries_of(table, row).tolist()) for row, law in laws.items()}
