# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Code for the derivatives of a scene's accelerations, and the arrays that it works on."""

from functools import cache

import numpy as np

from .traced_scene import TracedScene
from ..codegen import function_table as calls
from ..codegen.derivatives import COLUMN, DerivativeTrace, FLOW, RATE
from ..codegen.machine_code import LANES, machine_code, PACKED
from ..codegen.routines import topology
from ..engine import native


class DerivativeCode:
    """
    Code for the derivatives of accelerations and multipliers, compiled once for a mechanism.

    ``qdd``, ``lam``, those of the state, are read by the code; ``states``, nz: of the effects,
    whose rates are differentiated, too; all of them, or none; ``scene``: that of the data,
    where it was traced before.

    ``table`` is as ``engine.native.call_for_columns`` takes it; ``columns``, ``found``, shape
    (blocks, LANES (nv + nc)): LANES columns side by side: changes of the residuals, and the
    derivatives; ``rates``, shape (2 nv, nc): derivatives of J qd by coordinates and rates;
    ``flows``, shape (2 nv, nz): derivatives of the rates of the effects' states.
    """

    def __init__(self, data, qdd, lam, states=0, scene=None):
        self._scene, model = scene or TracedScene(data), data.system.model
        effects = data.system.effects
        nv, nc = len(qdd), len(lam)
        shape = -(-3 * nv // calls.LANES), (nv + nc) * calls.LANES
        self.columns, self.found = np.zeros(shape), np.zeros(shape)
        self.rates, self.flows = np.zeros((2 * nv, nc)), np.zeros((2 * nv, states))
        key = 'derivatives', topology(model), *self._scene.key, states

        @cache
        def routines():
            return DerivativeTrace(model, self._scene.act, self._scene.values.shape).in_lanes(
                states)

        first = machine_code(key, lambda: routines()[0], PACKED)
        count = np.zeros(1)
        native.call(np.array([first('shared')]), 0, count, count)
        self._factors = np.zeros(int(count[0]))
        self.table = self._scene.table({
            calls.QDD: qdd, calls.LAM: lam, RATE: self.rates, FLOW: self.flows,
            COLUMN: self.columns, calls.SHARED: self._factors, **(
                {} if effects is None else {calls.SIDES: effects.code.sides})})
        self._residuals = first('residuals')
        self.table[:2] = self._residuals, machine_code(key, lambda: routines()[1], LANES)('solve')

    def enable_for(self, data):
        """Enable the code for data with the effects of the code; else disable it."""
        self.table[0] = self._residuals if TracedScene(data).key == self._scene.key else 0
