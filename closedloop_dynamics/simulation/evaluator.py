# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""States that are evaluated beside a run, from Python: one call each."""

from copy import deepcopy
from typing import Callable, NamedTuple, Sequence

import numpy as np

from .system import (
    link_evaluation, number_of_equations, parts_of_state, System, with_equations)
from ..engine import native
from ..engine.types import Model

QUANTITIES = ('acceleration', 'multipliers')


class Request(NamedTuple):
    """A state beside the run."""

    state: np.ndarray  # Shape (ns,)
    own: np.ndarray  # Shape (nz,): effects' own states that it begins with
    torque: np.ndarray  # Shape (number of actuated joints,)
    actuated: np.ndarray  # Their places in ``System.tau``; -1 where a motion is prescribed
    lam: np.ndarray  # Shape (nc,): of all equations; of no length if these are not requested
    held: np.ndarray  # Shape (nv + nk,): scratch


def request(system: System, own: np.ndarray, actuated: np.ndarray,
            wants_multipliers: bool = True) -> Request:
    """Allocate a request; ``own`` and ``actuated`` are taken as they are."""
    *_, states = parts_of_state(system)
    return Request(
        np.zeros(states), own, np.zeros(len(actuated)), actuated,
        np.zeros(number_of_equations(system) if wants_multipliers else 0),
        np.zeros(len(system.tau)))


class Evaluator:
    """
    Accelerations and multipliers of any state, at the least cost of a call from Python.

    Write a state and torques into ``q``, ``qd`` and ``tau`` and call the evaluator; then
    ``acceleration`` and ``multipliers`` hold the results, until the next call. It works on a copy
    of the mechanism and of the effects, as they were when it was made: what changes in the
    simulation later changes nothing here.

    Attributes
    ----------
    q : ndarray, shape (nq,)
        Joint coordinates, closing the loops [rad or m].
    qd : ndarray, shape (nv,)
        Joint rates, keeping them closed [rad/s or m/s].
    tau : ndarray, shape (number of actuated joints,)
        Their torques [N m or N].
    acceleration : ndarray, shape (nv,)
    multipliers : ndarray, shape (nc,)
        The requested quantities; views, not to be written.

    """

    q: np.ndarray
    qd: np.ndarray
    tau: np.ndarray
    acceleration: np.ndarray
    multipliers: np.ndarray

    __slots__ = ('q', 'qd', 'tau', 'acceleration', 'multipliers', '_evaluate', '_refused',
                 '_names')

    def __init__(self, system: System, model: Model, own: np.ndarray, actuated: np.ndarray,
                 quantities: Sequence[str], refused: Callable[..., None]) -> None:
        """
        Copy a system.

        Parameters
        ----------
        system : System
            Of the simulation.
        model : engine.types.Model
            With all equations; that of the system where none are left out.
        own : ndarray, shape (nz,)
            The effects' own states.
        actuated : ndarray of int
            As of ``Request``.
        quantities : sequence of str
            Of ``QUANTITIES``.
        refused : callable
            Raises the error of a state, rates and torques that were refused.

        Raises
        ------
        ValueError
            For an unknown quantity.

        """
        for name in quantities:
            if name not in QUANTITIES:
                raise ValueError(f'evaluator: expected quantities of {", ".join(QUANTITIES)}, '
                                 f'got {name!r}')
        one = deepcopy(system)
        link_evaluation(one)
        whole = one
        if one.has_redundant_constraints:
            # Asked rarely: no routines are generated for it.
            whole = with_equations(one, one.model.with_cut(model.cut))
        asked = request(one, own.copy(), actuated, 'multipliers' in quantities)
        places, rates, *_ = parts_of_state(one)
        self.q, self.qd, self.tau = asked.state[places], asked.state[rates], asked.torque
        self._refused, self._names = refused, tuple(quantities)
        self._evaluate = native.bind('evaluate_request', one.native, whole.native, asked)
        results = {'acceleration': one.qdd, 'multipliers': asked.lam}
        for name in quantities:
            view = results[name].view()
            view.flags.writeable = False
            setattr(self, name, view)

    def __call__(self) -> None:
        """
        Evaluate the state in ``q``, ``qd`` and ``tau``.

        Raises
        ------
        AssemblyError
            Where the state leaves the loops open, with the loop and by how much.
        ValueError
            For numbers that are not finite, quaternions whose norm is not 1, and torques of joints
            whose motion is prescribed.

        """
        if not self._evaluate():
            self._refused(self.q, self.qd, self.tau)
            raise ValueError(
                'evaluator: expected quaternions of norm 1 to the last digits in q: '
                'normalise them')

    def __repr__(self) -> str:
        """Return the sizes of its inputs and outputs."""
        return (f'<Evaluator of {", ".join(self._names)}: q {self.q.shape}, qd {self.qd.shape}, '
                f'tau {self.tau.shape}>')
