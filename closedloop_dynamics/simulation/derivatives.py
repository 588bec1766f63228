# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of accelerations and multipliers of a scene, by generated code."""

import re
from typing import NamedTuple

import numpy as np

from .derivative_code import DerivativeCode
from .parameters import parameter_arrays
from .readings import readings_of
from .step_derivatives import StepDerivatives
from .traced_scene import require_derivatives, structure, TracedScene
from ..codegen.function_table import LANES
from ..engine import native
from ..mechanism.errors import SimulationError, SingularityError
from ..mechanism.named_array import by_shapes


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
    by_parameter : ndarray, shape (nv + nc, np)
        Of accelerations and multipliers, coordinates and rates held.
    closure_by_parameter, closure_rate_by_parameter : ndarray, shape (nc, np)
        Of the errors of the closure equations, and of J qd.

    """

    acceleration: np.ndarray
    multipliers: np.ndarray
    by_position: np.ndarray
    by_velocity: np.ndarray
    by_torque: np.ndarray
    jacobian: np.ndarray
    closure_rate_by_position: np.ndarray
    by_parameter: np.ndarray
    closure_by_parameter: np.ndarray
    closure_rate_by_parameter: np.ndarray

    def __repr__(self):
        """Show the shapes."""
        return by_shapes(self, *self._fields)


class WrenchDerivatives(NamedTuple):
    """
    Wrenches in the joints, and their derivatives in one state.

    Attributes
    ----------
    joints : tuple of str
        Those of the spanning tree that are not fixed, behind them all cut joints.
    wrench : ndarray, shape (n, 3), in space (n, 6)
        As ``Simulation.force``, in world axes: what the parent exerts on the child at the child's
        origin; in cut joints what body B exerts on body A at the cut point of A [N m, N].
    by_position, by_velocity, by_torque : ndarray, shape (n, 3, nv), in space (n, 6, nv)
        By coordinates, rates and torques, as in ``Derivatives``.
    by_parameter : ndarray, shape (n, 3, np), in space (n, 6, np)
        Coordinates and rates held.

    """

    joints: tuple
    wrench: np.ndarray
    by_position: np.ndarray
    by_velocity: np.ndarray
    by_torque: np.ndarray
    by_parameter: np.ndarray

    def __repr__(self):
        """Show the names and shapes."""
        return by_shapes(self, *self._fields)


class Differentiator:
    """
    Derivatives of the accelerations, multipliers and joint forces of any state of a scene.

    Compiled once for a mechanism and its effects; masses, lengths and parameters of effects are
    read again with each call.

    Parameters
    ----------
    simulation : Simulation
        Of the scene; its state stays as it is.
    parameters : sequence of str
        Key paths of numbers of the scene: ``'mechanism.bodies.crank.mass'``.

    Raises
    ------
    SimulationError
        Where an effect has no derivative, or the mechanism is too large, with names and reasons.
    ValueError
        For numbers that do not exist, or that the motion does not follow smoothly.

    Notes
    -----
    Forces over time are those of the simulation's present time; the numbers of their profiles are
    no parameters. The residuals of motion and closure are differentiated, and solved by the
    factors of the articulated inertias and of the constraint matrix
    (``codegen.derivatives``). Coordinates
    of the tree are changed one by one, with the loops open and equations of closure as they are
    then: by directions that keep the loops closed these are the derivatives of the motion. Terms
    of Baumgarte's method are left out. By parameters, what of the scene the arrays of masses and
    places are made of is differentiated by differences of sixth order, which are exact but for
    rounding, where the Differentiator is made; all else as above.

    """

    def __init__(self, simulation, parameters=()):
        self._data = data = readings_of(simulation)
        require_derivatives(data, instant=True)
        for key in parameters:
            if re.fullmatch(r'effects\..*\.period', key):
                raise ValueError(f'{key}: expected a number that forces at an instant follow, '
                                 'got that of a profile over time')
        self._scene = TracedScene(data, instant=True)
        self._steps = StepDerivatives(data, parameter_arrays(data, parameters), self._scene)
        self._enabled, self._laws = dict(data.effect_set.enabled), structure(data)
        system, self._model = data.system, data.system.model
        nv, nc = len(system.qdd), len(system.lam)
        self._qdd, self._lam = np.zeros(nv), np.zeros(nc)
        self._code = DerivativeCode(data, self._qdd, self._lam, scene=self._scene)

    def __repr__(self):
        """Show the mechanism and the parameters."""
        return (f'<Differentiator of {self._data.scene.name}, parameters: '
                f'{", ".join(self._steps.parameters.names) or "none"}>')

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
        q, qd = self._evaluated(position, velocity, torque)
        if not native.call_for_columns(
                self._code.table, q, qd, self._code.columns, self._code.found) or (
                not np.isfinite(self._code.found).all()):
            raise SingularityError(
                'The accelerations have no derivatives here: closure equations depend on one '
                'another in this position, or nearly, points that a spring joins meet, or a '
                'spring stands against half a turn. Take a position beside it. (So it is '
                'everywhere where masses differ so much that the elimination alone cannot '
                'decide.)')
        nv = len(self._qdd)
        # From blocks of columns to rows of all columns.
        found, rates = self._code.found, self._code.rates
        found = found.reshape(len(found), -1, LANES).transpose(1, 0, 2)
        found = found.reshape(len(found), -1)
        parts = [found[:, first:first + nv].copy() for first in range(0, 3 * nv, nv)]
        by_parameter = np.zeros((len(found), 0)), *np.zeros((2, len(self._lam), 0))
        if self._steps.parameters.names:
            by_parameter = self._steps.by_parameter(q, qd, self._qdd, self._lam)
        return Derivatives(self._qdd.copy(), self._lam.copy(), *parts, rates[nv:].T.copy(),
                           rates[:nv].T.copy(), *by_parameter)

    def wrenches(self, position, velocity, torque=None):
        """
        Differentiate the wrenches in the joints in a state that closes the loops.

        Parameters
        ----------
        position, velocity, torque
            As for a call.

        Returns
        -------
        WrenchDerivatives

        Raises
        ------
        ValueError
            For numbers that make no sense.
        SimulationError
            Where the multipliers alone do not determine the wrenches.
        SingularityError
            In positions where closure equations depend on one another, or nearly.

        """
        joints, _ = self._data.force_places()
        if not joints:
            raise SimulationError(
                'The wrenches in the joints have no derivatives here: closure equations that '
                'repeat others are left out, so that forces are not unique, or couplings hand '
                'torques over at cut joints.')
        q, qd = self._evaluated(position, velocity, torque)
        joints += [cut.name for cut in self._data.mechanism.cut_joints]
        nv, size = len(qd), 3 if self._data.mechanism.planar else 6
        # In the plane: the moment about z, and the forces along x and y.
        kept = [2, 3, 4] if size == 3 else range(6)
        wrench, changes = (
            found.reshape(len(joints), 6, -1)[:, kept]
            for found in self._steps.wrenches(q, qd, self._qdd, self._lam))
        return WrenchDerivatives(
            tuple(joints), wrench[:, :, 0], *np.split(changes, [nv, 2 * nv, 3 * nv], axis=2))

    def _evaluated(self, position, velocity, torque):
        """Evaluate a state with the generated code; return copies of its numbers."""
        if self._model is not self._data.system.model:
            raise SimulationError(
                'The simulation works on other closure equations now: make a new Differentiator.')
        if self._enabled != self._data.effect_set.enabled:
            raise SimulationError(
                'Other effects are switched on now: make a new Differentiator.')
        if self._laws != structure(self._data):
            raise SimulationError(
                'Effects have other expressions, ends or lists of numbers now: make a new '
                'Differentiator.')
        self._qdd[:], _ = self._data.forward_dynamics(position, velocity, torque)
        self._lam[:] = self._data.system.lam
        self._scene.update()
        return tuple(np.array(one, dtype=float) for one in (position, velocity))
