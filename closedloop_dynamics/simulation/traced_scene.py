# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A scene as generated code sees it: which laws act, and where its numbers are."""

import numpy as np

from ..codegen import function_table as calls
from ..codegen.function_table import VALUE_COLUMNS
from ..effects.force_law import PROFILE
from ..effects.traced_laws import act, refused
from ..mechanism.errors import SimulationError


def refusals(data, instant=False, along=False, driven=False):
    """
    Return the parts of a simulation without derivatives, and the reasons.

    Empty where there are derivatives, and C (``c_source``). ``instant``: whether the time is held;
    ``along``: whether they are those of a motion; ``driven``: whether prescribed motions are given
    from outside.
    """
    found = {f'effects.{name}': reason for name, reason in refused(
        data.effect_set, instant, along, driven).items()}
    for name in data.torque_names[len(data.joint_names):]:
        found[name] = 'a joint that closes a loop, in which something acts'
    if not data.system.is_unrolled:
        found['mechanism'] = (
            'too large: code is generated for mechanisms of few bodies alone')
    return found


def require_derivatives(data, instant=False, along=False):
    """Refuse a scene that has no derivatives, as ``refusals`` has it."""
    reasons = refusals(data, instant, along)
    if reasons:
        raise SimulationError(
            f'{data.scene.name} has no derivatives: ' + '; '.join(
                f'{what} ({why})' for what, why in reasons.items()))


class TracedScene:
    """
    Mechanism and effects of a scene as inputs of generated code.

    ``instant``: whether the time is held, so that forces over time are numbers. ``values``, shape
    (rows, VALUE_COLUMNS): numbers of the effects; where the time is held, and any follows it, with
    more rows; ``key``: dependences of the code beside the mechanism.
    """

    def __init__(self, data, instant=False):
        self._model, self._effects = data.system.model, data.system.effects
        effects = self._effects
        self.values = np.zeros((0, VALUE_COLUMNS)) if effects is None else effects.values
        self._data = None
        if instant and data.effect_set.follows_time:
            self._data = data
            count = len(effects.values)
            self.values = np.zeros((count - -count // VALUE_COLUMNS, VALUE_COLUMNS))
            self.update()
        self.key = structure(data), self.values.shape

    def update(self):
        """Take the numbers of the present time, where that is held."""
        data = self._data
        if data is None:
            return
        count = len(self._effects.values)
        self.values[:count] = self._effects.values
        present = self.values[count:].reshape(-1)
        present[:] = data.time
        for row, name in enumerate(data.effect_set.by_name):
            if self._effects.enabled[row] and self._effects.role[row] == PROFILE:
                present[row] = data.effect_readings(name)['force']

    def act(self, forces):
        """Apply the effects to a ``codegen.scene_routines.Forces``."""
        act(self._effects, forces)

    def table(self, arrays):
        """
        Return a table of addresses without routines.

        ``arrays``, by their places, beside those of the scene, are not kept by it.
        """
        arrays = {calls.BODY: self._model.body, calls.GRAVITY: self._model.gravity,
                  calls.CUT_POINT: self._model.cut_point, calls.VALUES: self.values, **arrays}
        table = np.zeros(max(arrays) + 1, dtype=np.int64)
        for place, array in arrays.items():
            table[place] = array.ctypes.data
        return table


def structure(data):
    """Return what code depends on of the effects that are switched on: their laws, by rows."""
    table = data.system.effects
    rows = () if table is None else table.enabled_rows
    return tuple((
        row.number, row.law.name, *row.law.parts(row), *row.joints, *row.bodies,
        # The force of a profile is a number.
        *(() if row.law.role == PROFILE else (
            *row.law.terms(row), *row.arms.tolist(), *row.data.tolist())))
        for row in rows)
