# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Many runs of one model, from states, under sequences of torques."""

from typing import Any, Mapping, Optional, Sequence, Union
from weakref import WeakKeyDictionary

from numpy.typing import ArrayLike

from .model import begins, Model
from .rollout import Rollout
from .rollout_run import STATE
from .simulation import Simulation
from ..kinematics.state import State
from ..scene.records import Method

# The latest simulation of each model that rollouts are made with.
_SIMULATIONS: 'WeakKeyDictionary[Model, Simulation]' = WeakKeyDictionary()


def rollout(model: Model, states: Optional[State] = None, torques: Optional[ArrayLike] = None, *,
            method: Union[None, str, Mapping[str, Any], Method] = None,
            duration: Optional[float] = None, steps: Optional[int] = None, every: int = 1,
            parameters: Optional[Mapping[str, ArrayLike]] = None,
            quantities: Sequence[str] = STATE, threads: Optional[int] = None) -> Rollout:
    """
    Run a model from many states, or under many sequences of torques, in parallel.

    Parameters
    ----------
    model : Model
        It stays as it is.
    states : State, optional
        Where the runs begin: a batch, or a single state for all of them; the scene's start when
        not given. The time of the results counts from there.
    torques : array_like, shape (samples, rows, number of actuated joints)
        As for ``Simulation.rollout``, as are the others.
    method : str, mapping or Method, optional
        As for ``Simulation``.
    duration, steps, every, parameters, quantities, threads
        As for ``Simulation.rollout``.

    Returns
    -------
    rollout.Rollout

    Raises
    ------
    ValueError
        For arguments that make no sense, and for states in which effects have gone on since they
        began (the lag of a drive, the clock of a prescribed motion).

    """
    simulation = _SIMULATIONS.get(model)
    wanted = (model.scene if method is None else model.scene.with_method(method)).method
    if simulation is None or simulation.scene.method != wanted:
        simulation = _SIMULATIONS[model] = Simulation(model, None, method)
    if states is not None and not begins(model, states):
        raise ValueError(
            'rollout: expected states in which the effects begin again, as Model.assemble returns '
            'them, got some in which they have gone on; run Simulation(model, state) for these')
    return simulation.rollout(
        torques, None if states is None else states.q, None if states is None else states.qd,
        duration=duration, steps=steps, every=every, parameters=parameters,
        quantities=quantities, threads=threads)
