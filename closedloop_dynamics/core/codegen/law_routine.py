# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The law of one kind of effect by itself, for any row of the table of effects.

The engine calls it between the motion of the bodies and their accelerations, where no routine of
the whole scene acts, and where it is asked what effects store and read (``engine/dispatch.cpp``).
"""

from collections import defaultdict
from types import SimpleNamespace

import numpy as np

from . import space
from .expression_graph import ExpressionGraph, LOAD, Q, QD, Routine
from .function_table import (
    BODY, COUNT, ENTRIES, OTHER_BODY, OUTPUT, RATES, STATES, TAU, VALUES)
from .joint_kernels import NO_JOINT
from .live_scene import LiveForces
from .machine_code import machine_code, ROW
from .rows import by_column
from .spatial import Recursion
from .vectors import is_number, ZERO
from ..types import TREE_COLUMNS

# What stands for the joint of a row, and for its bodies.
JOINT, FIRST_BODY, SECOND_BODY = 0, 1, 2
_addresses = {}


def addresses_of_laws(laws, numbers):
    """
    Return the addresses of the routines of laws, compiled unless they are stored.

    Parameters
    ----------
    laws : dict of int to tuple
        By kind of effect ``plane`` or ``space``, whose bodies it acts on, and the law, which takes
        a ``RowForces`` and applies the effect.
    numbers : int
        Of a row of the table.

    Returns
    -------
    dict of int to int

    """
    missing = tuple(sorted(laws.keys() - _addresses.keys()))
    if missing:
        find = machine_code(('laws', missing), lambda: [
            RowTrace(laws[kind][0], numbers).routine(f'law_{kind}', laws[kind][1])
            for kind in missing], ROW)
        _addresses.update((kind, find(f'law_{kind}')) for kind in missing)
    return _addresses


class RowTrace:
    """
    One joint and two bodies, as ``live_scene.LiveTrace`` has those of a mechanism.

    In ``plane`` or ``space``, with so many numbers of a row of the table.
    """

    nv = 1

    def __init__(self, arrays, numbers):
        self.graph, self._arrays = ExpressionGraph(), arrays
        # Arrays begin with the row in question: how long rows are does not matter.
        self.laws = SimpleNamespace(columns=defaultdict(int, {VALUES: numbers}), cuts=(), states=0)
        self.q, self.qd = ([self.graph.put(LOAD, source, 0)] for source in (Q, QD))
        self.constant = SimpleNamespace(tree=np.zeros((2, TREE_COLUMNS), dtype=np.int64))
        self.recursion = Recursion([], [], ZERO)
        self.recursion.motion = [None, *(arrays.motion_of(
            self._row(source), NO_JOINT, self.recursion.ground) for source in (BODY, OTHER_BODY))]
        self.recursion.force = [None, ZERO + ZERO, ZERO + ZERO]

    def _row(self, source):
        return [self.graph.put(LOAD, source, n) for n in range(space.WORK_COLUMNS)]

    def state(self, place):
        """Return one of the effect's states."""
        return self.graph.put(LOAD, STATES, place)

    def entry(self, place):
        """Return one of the numbers of the effect's entries."""
        return self.graph.put(LOAD, ENTRIES, place)

    def at(self, source, _, column):
        """Return a number of the row of an array of the effects."""
        return self.graph.put(LOAD, source, column)

    def routine(self, name, law):
        """
        Return the routine of a law.

        Parameters
        ----------
        name : str
            Of the machine code's symbol.
        law : callable
            Takes a ``RowForces`` and applies the effect.

        Returns
        -------
        Routine

        """
        forces = RowForces(self)
        law(forces)
        forces.record(OUTPUT, 0, forces.stored)
        added = {TAU: dict(enumerate(forces.torque)), **{
            source: by_column(force, self._arrays.FORCES)
            for source, force in zip((BODY, OTHER_BODY), self.recursion.force[FIRST_BODY:])}}
        return Routine(name, self.graph, forces.outputs + [
            (RATES, place, rate) for place, rate in forces.rates.items()] + [
            (source, place, value) for source, values in added.items()
            for place, value in values.items() if not is_number(value, 0.0)])


class RowForces(LiveForces):
    """Inputs and outputs of a law that is traced for any row."""

    def __init__(self, trace):
        super().__init__(trace)
        self.rates, self.count = {}, trace.at(COUNT, 0, 0)

    def read(self, *values):
        """Store the readings of the effect."""
        self.record(OUTPUT, 1, *values)
