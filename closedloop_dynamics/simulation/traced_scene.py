# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A scene as generated code sees it: which laws act, and where its numbers are."""

import numpy as np

from .errors import SimulationError
from ..core.codegen import function_table as calls
from ..effects.table import ENTRIES, FIRST, SECOND, VALUE_COLUMNS
from ..effects.traced_laws import act, constants_of, refused


def refusals(simulation):
    """
    Return the parts of a simulation without derivatives, and the reasons.

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


def require_derivatives(simulation):
    """
    Refuse a scene that has no derivatives.

    Raises
    ------
    SimulationError
        With names and reasons.

    """
    reasons = refusals(simulation)
    if reasons:
        raise SimulationError(
            f'{simulation.scene.name} has no derivatives: ' + '; '.join(
                f'{what} ({why})' for what, why in reasons.items()))


class TracedScene:
    """
    Mechanism and effects of a scene as inputs of generated code.

    Parameters
    ----------
    simulation : Simulation

    Attributes
    ----------
    values : ndarray, shape (rows, VALUE_COLUMNS)
        Numbers of the effects.
    key : tuple
        Dependences of the code beside the mechanism.

    """

    def __init__(self, simulation):
        """Collect the effects that are traced."""
        self._model, self._effects = simulation.system.model, simulation.system.effects
        self._laws, effects = simulation.effect_set.laws, self._effects
        self.values = np.zeros((0, VALUE_COLUMNS)) if effects is None else effects.values
        measured = laws_of(simulation)
        rows = () if effects is None else tuple(
            (row, int(effects.kind[row]),
             *measured.get(row, effects.index[row, [FIRST, SECOND]].tolist()))
            for row in np.flatnonzero(effects.enabled).tolist())
        self.key = rows, self.values.shape

    def act(self, forces):
        """Apply the effects to a ``core.codegen.scene_routines.Forces``."""
        act(self._effects, forces, self._laws)

    def table(self, arrays, columns):
        """
        Return a table of addresses, without routines; it does not keep the arrays.

        Parameters
        ----------
        arrays : dict of int to ndarray
            By their places, beside those of the scene.
        columns : int
            Length of the table.

        Returns
        -------
        ndarray of int, shape (columns,)

        """
        table = np.zeros(columns, dtype=np.int64)
        for place, array in {calls.BODY: self._model.body, calls.GRAVITY: self._model.gravity,
                             calls.CUT_POINT: self._model.cut_point, calls.VALUES: self.values,
                             **arrays}.items():
            table[place] = array.ctypes.data
        return table


def laws_of(simulation):
    """Return the code's dependence on laws with lists of numbers, or of users, by rows."""
    table, laws, found = simulation.system.effects, simulation.effect_set.laws, {}
    for row in () if table is None else np.flatnonzero(
            table.enabled * table.index[:, ENTRIES]).tolist():
        # A user's law is called by its address, which says nothing.
        own = ((laws[row].arithmetic,) if row in laws else
               tuple(table.index[row, [FIRST, SECOND]].tolist()))
        found[row] = (*own, constants_of(table, row))
    return found
