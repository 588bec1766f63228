# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A law of effects by itself, for any row of the table of effects that obeys it.

The engine calls it between the motion of the bodies and their accelerations, where no routine of
the whole scene acts, and where it is asked what effects store and read (``engine/dispatch.cpp``).
"""

from collections import defaultdict
from types import SimpleNamespace

import numpy as np

from . import space
from .expression_graph import chosen, ExpressionGraph, LOAD, Q, QD, Routine
from .function_table import (
    COUNT, ENTRIES, LAW_COLUMNS, OUTPUT, RATES, RIGHT_SIDE, STATES, TAU, VALUES)
from .joint_kernels import NO_JOINT
from .live_scene import LiveForces, REST
from .machine_code import machine_code, ROW
from .rows import by_column
from .spatial import Recursion
from .vectors import is_number, ZERO
from ..engine.types import COORDINATE, DOF, TREE_COLUMNS

# Addresses of routines by what they depend on.
compiled = {}


def addresses_of_laws(traces):
    """
    Return the addresses of the routines of laws, compiled unless they are stored.

    Parameters
    ----------
    traces : dict of tuple to callable
        By what a routine depends on; returns its ``RowTrace``.

    Returns
    -------
    dict of tuple to int

    """
    missing = sorted(traces.keys() - compiled.keys(), key=repr)
    if missing:
        names = {key: f'law_{number}' for number, key in enumerate(missing)}
        find = machine_code(('laws', *missing), lambda: [
            traces[key]().routine(name) for key, name in names.items()], ROW)
        compiled.update((key, find(name)) for key, name in names.items())
    return compiled


class RowTrace:
    """
    Joints and bodies of one law, as ``live_scene.LiveTrace`` has those of a mechanism.

    Parameters
    ----------
    arrays : module
        ``plane`` or ``space``, whose bodies it acts on.
    numbers : int
        Of a row of the table.
    coordinates : int
        Of joints, that it reads.
    row : effects.element.Row
        One that obeys the law.

    """

    def __init__(self, arrays, numbers, coordinates, row):
        self.graph, self._arrays, self.nv = ExpressionGraph(), arrays, coordinates
        self.row, self.size = row, 3 if arrays is space else 2
        # Arrays begin with the row in question: how long rows are does not matter.
        self.laws = SimpleNamespace(columns=defaultdict(int, {VALUES: numbers}), cuts=(), states=0)
        self.q, self.qd = ([self.graph.put(LOAD, source, joint) for joint in range(self.nv)]
                           for source in (Q, QD))
        tree = np.zeros((1 + self.nv, TREE_COLUMNS), dtype=np.int64)
        tree[1:, [DOF, COORDINATE]] = np.arange(self.nv)[:, np.newaxis]
        self.constant = SimpleNamespace(tree=tree)
        self.recursion = Recursion([], [], ZERO)
        self.bodies = range(1, 1 + len(row.bodies))
        self.recursion.motion = [None, *(arrays.motion_of(
            [self.graph.put(LOAD, self._body(body), n) for n in range(space.WORK_COLUMNS)],
            NO_JOINT, self.recursion.ground) for body in self.bodies)]
        self.recursion.force = [None, *(ZERO + ZERO for _ in self.bodies)]

    @staticmethod
    def _body(body):
        """Return the place of the address of a body's row, behind those of arrays."""
        return LAW_COLUMNS - 1 + body

    def state(self, place):
        """Return one of the effect's states."""
        return self.graph.put(LOAD, STATES, place)

    def entry(self, place):
        """Return one of the numbers of the effect's entries."""
        return self.graph.put(LOAD, ENTRIES, place)

    def at(self, source, _, column):
        """Return a number of the row of an array of the effects."""
        return self.graph.put(LOAD, source, column)

    def routine(self, name):
        """Return the routine of the law, ``name`` being that of the machine code's symbol."""
        forces = RowForces(self)
        forces.turn_to(self.row)
        self.row.law.act(forces)
        forces.record(OUTPUT, 0, forces.stored)
        added = {TAU: dict(enumerate(forces.torque)), **{
            self._body(body): by_column(self.recursion.force[body], self._arrays.FORCES)
            for body in self.bodies}}
        return Routine(name, self.graph, forces.outputs + [
            (RATES, place, rate) for place, rate in forces.rates.items()] + [
            (source, place, value) for source, values in added.items()
            for place, value in values.items() if not is_number(value, 0.0)])


class RowForces(LiveForces):
    """Inputs and outputs of a law that is traced for any row."""

    def __init__(self, trace):
        super().__init__(trace)
        self.rates = {}

    @property
    def size(self):
        return self.trace.size

    def turn_to(self, row, held=None):
        """Have joints and bodies of any row, and all terms that the law may have."""
        super().turn_to(row)
        self.row = self.first = self.begin = 0
        self.count, self.terms = self.trace.at(COUNT, 0, 0), None
        self.bodies = list(self.trace.bodies)
        self.joints = [self.freedom((joint, 1.0)) for joint in range(self.nv)]

    def read(self, *values, first=1):
        """Store the readings of the effect, from one on."""
        self.record(OUTPUT, first, *values)

    def drive(self, position, rate, change):
        """Store what the closure equation of a motion is to have."""
        self.flow(1.0, 0.0)
        self.record(RIGHT_SIDE, 0, position, rate, change)

    def keep_entry(self, number, value):
        self.record(ENTRIES, number, value)

    def rub(self, most, limit):
        """Return the force of dry friction that slides; the engine holds what is at rest."""
        rate, direction = self.joint.rate, self.state(0)
        rests = abs(direction) < 0.5
        # One that breaks away within a step slides from then on.
        leaves = abs(rate) > REST
        direction = chosen(rests, rate, direction)
        sliding = chosen(direction < 0.0, most, -most)
        return chosen(rests, chosen(leaves, sliding, 0.0), sliding)
