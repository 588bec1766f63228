# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A scene as WebAssembly: evaluation, correction of the loops, motion of the bodies, energies."""

from collections import Counter

import numpy as np

from .c_source import require_c
from ..codegen.differentiation import differentiated
from ..codegen.expression_graph import Q, QD
from ..codegen.function_table import (
    behind, BODY, CLOSURE, CORRECTION, CORRECTIONS, CUT_POINT, ENERGY, EVALUATION, GRAVITY,
    JACOBIAN, LAM, QDD, TAU, VALUES)
from ..codegen.joint_forces import closures_of
from ..codegen.scene_routines import Forces, PLACE_BIAS, POWER, SceneTrace
from ..codegen.vectors import add, scale, ZERO
from ..codegen.wasm_writer import DOUBLE, module
from ..effects.force_law import MOTION as LAW_OF_MOTION, PROFILE
from ..effects.traced_laws import act, powers
from ..engine.types import CUT_NUMBER, CUT_ROW
from ..simulation.traced_scene import TracedScene

# Inputs and outputs beside those of function tables: a wrench on each body, in world axes at its
# origin; motion of each body; forces where loops close; of each effect 1 where it acts, 0 where it
# is switched off.
PUSH, MOTION, FORCE, SWITCH = behind(PLACE_BIAS, 4)
# Numbers of a body's motion: its origin, its axes row by row, velocity and angular velocity.
MOTION_COLUMNS = 18
NAMES = {Q: 'q', QD: 'qd', TAU: 'tau', PUSH: 'push', SWITCH: 'switch', BODY: 'body',
         GRAVITY: 'gravity', CUT_POINT: 'cut_point', VALUES: 'values', QDD: 'qdd', LAM: 'lam',
         POWER: 'power', CORRECTIONS: 'change', CLOSURE: 'closure', ENERGY: 'energies',
         MOTION: 'motion', FORCE: 'force', JACOBIAN: 'jacobian'}


def wasm_module(simulation):
    """
    Write a scene as a module of WebAssembly.

    Its functions have no arguments and return 1, or 0 in a singular position: ``evaluation`` of
    q, qd, tau, push and switch to qdd, lam and power; ``correction`` of q and qd to change (that
    of q, then of qd) and closure; ``energies`` (kinetic, of gravity, stored) [J]; ``bodies``:
    motion; ``forces`` of q and lam to force, three numbers a cut joint, on body A in world axes
    [N]. Those of other equations, which may take over, end in ``_1``, ``_2``; where there are
    any, ``jacobian`` has the rows of all equations at q. Forces over time are numbers behind
    those of ``values``, prescribed motions in ``cut_point``: ``clocks_of``.

    Parameters
    ----------
    simulation : Simulation
        In the state to start from; parameters are those that effects and masses have now.

    Returns
    -------
    binary : bytes
    arrays : dict of str to list
        By name, where an array begins in the memory [numbers], and the numbers it is to have at
        first, or of results how many they are.

    Raises
    ------
    SimulationError
        Where something of the scene has no such code, with names and reasons; or where the scene
        starts in a singular position.

    """
    require_c(simulation, 'WebAssembly', timed=True)
    system = simulation.data.system
    model, table = system.model, system.effects
    values = TracedScene(simulation.data, instant=True).values
    rows, nv, nc = len(model.tree), len(system.qdd), len(system.lam)
    cuts = len(simulation.mechanism.cut_joints)
    given = {Q: simulation.position, QD: simulation.velocity, TAU: np.zeros(nv),
             PUSH: np.zeros(6 * rows), SWITCH: np.ones(0 if table is None else len(table.role)),
             BODY: model.body,
             GRAVITY: model.gravity, CUT_POINT: model.cut_point, VALUES: values}
    found = {QDD: nv, LAM: nc, POWER: 2, CORRECTIONS: 2 * nv, CLOSURE: nc, ENERGY: 3,
             MOTION: MOTION_COLUMNS * rows, FORCE: 3 * cuts}
    routines, choices = [], choices_of(simulation)
    traced = [(one, what, f'_{number}' * bool(number))
              for number, (one, _) in enumerate(choices)
              for what in (EVALUATION, CORRECTION, 'forces')]
    if len(choices) > 1:
        whole = simulation.data.loop_model.equations.model
        traced.append((whole, 'jacobian', ''))
        found[JACOBIAN] = (len(whole.column) - 1) * nv
    for one, what, ending in (*traced, (model, 'energies', ''), (model, 'bodies', '')):
        trace = _Trace(one, table, values.shape, cuts)
        if what in (EVALUATION, CORRECTION):
            routines.append(trace.routine(what))
        else:
            getattr(trace, what)()
            routines.append(trace.named(what))
        routines[-1].name += ending
    binary, addresses = module(routines, {
        **{source: array.size for source, array in given.items()}, **found})
    return binary, {
        NAMES[source]: [address // DOUBLE, given[source].ravel().tolist() if source in given
                        else found[source]]
        for source, address in addresses.items()}


def clocks_of(simulation):
    """
    Return what follows the time: a list of dicts, as JSON can.

    ``array`` and ``index``: where its numbers go, ``count`` of them: a force or the time; or
    position, rate and acceleration of a prescribed motion, with an ``offset``. Rows of ``pieces``
    with a ``period`` [s] or 0, or ``programs``, say what they are; neither: the time.
    """
    table, model = simulation.data.system.effects, simulation.data.system.model
    found = []
    for row in () if table is None else table.enabled_rows:
        if row.law.role == LAW_OF_MOTION:
            cut, _, column = row.equation
            one = {'array': 'cut_point', 'index': cut * model.cut_point.shape[1] + column,
                   'count': 3, 'offset': float(row.values[2])}
        elif row.law.follows_time:
            one = {'array': 'values', 'index': table.values.size + row.number, 'count': 1,
                   'offset': 0.0}
        else:
            continue
        if row.law.role in (PROFILE, LAW_OF_MOTION):
            entries = [list(map(float, entry)) for entry in table.elements[row.number].data]
            one.update({'programs': entries} if row.values[1] == 1.0 else {
                'pieces': [entry for entry in entries if np.isfinite(entry[0])],
                'period': float(row.values[0])})
        found.append(one)
    return found


def choices_of(simulation):
    """
    Return pairs of a model and its equations among all.

    First those that are worked on, then others that may take over.
    """
    data, model = simulation.data, simulation.data.system.model
    present = data.loop_model.equations.kept
    return [(model, np.flatnonzero(present).tolist()), *(
        (model.with_cut(data.loop_model.model_of(kept)[0].cut), np.flatnonzero(kept).tolist())
        for kept in data.loop_model.choices(data.initial[0]) if (kept != present).any())]


class _SwitchedForces(Forces):
    """Forces of effects that an input switches on and off."""

    def __init__(self, trace):
        super().__init__(trace)
        self._switches = trace.symbols(SWITCH, (trace.switches,))

    @property
    def _switch(self):
        return self._switches[self.row]

    def twist(self, joint, torque):
        super().twist(joint, torque * self._switch)

    def push(self, body, offset, force, moment=ZERO):
        super().push(body, offset, *(scale(each, self._switch) for each in (force, moment)))

    def store(self, energy):
        super().store(energy * self._switch)

    def flow(self, *rates, first=0):
        super().flow(*(rate * self._switch for rate in rates), first=first)


class _Trace(SceneTrace):
    """A scene with a wrench on each body; a trace serves for one routine."""

    def __init__(self, model, table, values, cuts, with_arms=True):
        super().__init__(model, lambda forces: act(table, forces), values, with_arms, None)
        self._cuts, self._table, self._driven = cuts, table, []
        self.switches = 0 if table is None else len(table.role)
        if table is not None:
            self._driven = [row.equation for row in table.enabled_rows
                            if row.law.role == LAW_OF_MOTION]

    def without_arms(self):
        """Return a trace of the same with all multipliers."""
        return _Trace(self.constant, self._table, self.values.shape, self._cuts, False)

    def evaluation(self):
        """Accelerations, multipliers and power of effects."""
        super().evaluation()
        lam = {place: value for source, place, value in self.outputs if source == LAM}
        driven = sum(lam[self.constant.cut[row, CUT_ROW]] * self.model.cut_point[row, column + 1]
                     for row, _, column in self._driven)
        dissipated, work = powers(self._table, self._rates)
        self.outputs += [(POWER, 0, dissipated), (POWER, 1, driven + work)]

    def acted(self):
        """Apply the effects and the wrenches; return the forces."""
        forces = super().acted()
        self._rates = forces.rates
        for row, push in list(enumerate(self.symbols(PUSH, (len(self.constant.tree), 6))))[1:]:
            if forces.size == 2:
                # In the plane there is a moment about the normal alone.
                push = (0.0, 0.0, push[2], *push[3:5], 0.0)
            Forces.push(forces, row, ZERO, tuple(push[3:]), tuple(push[:3]))
        return forces

    @property
    def forces_type(self):
        return _SwitchedForces

    def bodies(self):
        """Motion of the bodies."""
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        for row, motion in list(enumerate(self.recursion.motion))[1:]:
            numbers = (*motion.origin, *(number for axis in motion.frame for number in axis),
                       *motion.velocity, *motion.spin)
            self.outputs += [(MOTION, MOTION_COLUMNS * row + k, number)
                             for k, number in enumerate(numbers)]

    def jacobian(self):
        """Rows of J, in the mechanism's order of equations."""
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        rates = {cut[CUT_ROW] + row: closure.rate for a, cut in enumerate(self.constant.cut)
                 for row, closure in enumerate(self.recursion.closures(self.model, a))}
        for joint, rate in enumerate(self.qd):
            self.outputs += [(JACOBIAN, row * self.nv + joint, value) for row, value in zip(
                rates, differentiated(self.graph, [*rates.values()], {rate.place: 1.0}))]

    def forces(self):
        """Sum up the forces of multipliers on bodies A, by cut joint in the mechanism's order."""
        self.recursion.outward(self.model, self.q, self.qd, self.work)
        lam, taken, found = self.symbols(LAM, (self.nc,)), Counter(), {}
        for a, _, closure in closures_of(self, False):
            number, first = self.constant.cut[a, [CUT_NUMBER, CUT_ROW]].tolist()
            multiplier = lam[first + taken[a]]
            taken[a] += 1
            found[number] = add(found.get(number, ZERO), scale(closure.on_a[3:], multiplier))
        # Behind the cut joints are the couplings.
        self.outputs = [(FORCE, 3 * number + k, value) for number in range(self._cuts)
                        for k, value in enumerate(found.get(number, ZERO))]
