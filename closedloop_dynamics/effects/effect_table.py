# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The engine's table of the listed effects, made of their rows."""

from typing import NamedTuple

import numpy as np

from . import law_code
from .element import NO_CUTS, Row
from ..engine.types import Handle


class EffectElement(NamedTuple):
    """An effect as the engine has it: a ``ForceElement`` with the address of its routine."""

    role: int
    routine: int
    joints: np.ndarray
    bodies: np.ndarray
    equation: np.ndarray
    values: np.ndarray
    numbers: np.ndarray
    entries: int
    # Sizes of its states.
    scale: np.ndarray
    initial: np.ndarray
    summed: bool
    loaded: bool
    gap: int
    enabled: bool


class EffectTable(Handle):
    """
    The listed effects, of which ``engine/effect_table.hpp`` says what it holds.

    Attributes
    ----------
    elements : list of ForceElement
        As they are at present.

    """

    def __init__(self, native, elements):
        super().__init__(native, elements=elements)

    @classmethod
    def of(cls, model, whole, elements=(), cuts=None):
        """
        Return a table of effects, all switched on.

        Parameters
        ----------
        model, whole : Model
            The mechanism, on some of its equations and on all.
        elements : sequence of ForceElement
            In the order of the scene.
        cuts : tuple of 2 ndarrays, optional
            Index and values of the freedoms of cut joints that anything acts in.

        """
        return cls(model.effects(
            whole, for_engine(elements, len(model.gravity) == 3), *cuts or NO_CUTS),
            list(elements))

    @property
    def description(self):
        """Return what ``described`` rebuilds the table of: elements, which act, cut joints."""
        return list(self.elements), self.enabled.tolist(), (
            self.cuts.index.copy(), self.cuts.values.copy())

    @classmethod
    def described(cls, model, whole, elements, enabled, cuts):
        """Return a table by its ``description``."""
        made = cls.of(model, whole, elements, cuts)
        for number, element in enumerate(elements):
            if not enabled[number]:
                made.put(number, element, False)
        return made

    def copied(self, system):
        """Return the table of a copy, of the engine, of the system that this one is of."""
        return EffectTable(system.own_effects(), list(self.elements))

    @property
    def is_spatial(self):
        """Whether it is of a mechanism in space."""
        return self.reaction.shape[1] == 12

    @property
    def laws(self):
        """Laws of the rows (list of ForceLaw)."""
        return [element.law for element in self.elements]

    @property
    def rows(self):
        """All effects as laws on symbols have them (list of Row)."""
        return [self.row(number) for number in range(len(self.elements))]

    @property
    def enabled_rows(self):
        """Return the ``rows`` of the effects that act."""
        return [self.row(number) for number in np.flatnonzero(self.enabled).tolist()]

    def row(self, number):
        """Return one of ``rows``."""
        return Row(self.elements[number], number, int(self.first_state[number]),
                   int(self.first_number[number]))

    def put(self, number, element, enabled):
        """Have an effect say something else, or be switched, while a simulation may run."""
        one, = for_engine([element], self.is_spatial, enabled)
        self.put_effect(number, one)
        self.elements[number] = element


def for_engine(elements, spatial, enabled=True):
    """Return elements as the engine has them; code of laws is compiled where it is missing."""
    routines = law_code.routines_of([Row(element) for element in elements], spatial)
    return tuple(EffectElement(
        element.law.role, routine,
        *(np.array(places, dtype=np.int64)
          for places in (element.joints, element.bodies, element.equation)),
        *(np.array(numbers, dtype=float) for numbers in (element.values, element.numbers)),
        len(element.data), *(np.array([getattr(state, name) for state in element.states], float)
                             for name in ('scale', 'initial')),
        element.summed, element.loaded, element.gap, enabled)
        for element, routine in zip(elements, routines))
