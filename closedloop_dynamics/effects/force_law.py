# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of effects on symbols: what they are to the engine, and what a row of the table gives them.

A law is a function that stands in the file of its effect. It takes the forces
(``codegen.scene_routines.Forces``) when it is the turn of a row, and says what acts, what is
stored and lost, and what is read. The code of whole scenes, derivatives, C and the routine of the
law by itself are traced from it.
"""

from dataclasses import dataclass
from importlib import import_module
from typing import Callable, Optional

# Roles, that is, what the engine knows of a law beside its routine: a force, and nothing else; one
# of a drive, in the place of a command; a force, or the motion in a closure equation, over time,
# whose data are a profile; dry friction, which may hold at rest; inertia, whose force follows from
# accelerations.
FORCE, DRIVE, PROFILE, MOTION, FRICTION, INERTIA = range(6)
# What the gap of a law is, which ends steps where it opens or closes: there is none; the distance
# from a boundary without end; from a body that a step may pass, about its point or as a curve; a
# number of a user's law, which accounts for its energy otherwise.
NO_GAP, BOUNDARY, ROUND, OUTLINE, EVENT = range(5)


@dataclass(frozen=True, eq=False)
class ForceLaw:
    """
    A law of effects.

    Attributes
    ----------
    act : callable or None
        Takes the forces; None where the engine alone applies the effect.
    role : int
        ``FORCE`` to ``INERTIA``.
    terms : callable
        Which terms of the law there are, a tuple, of a ``table.Row``: the code of a scene has no
        others. Forces give a law the tuple as ``terms``, or None for all that there may be.
    listed : int
        Numbers of each entry, where there is a list of any length that the engine searches; 0: the
        data are as long as the law reads them.
    engine_only : str or None
        Why there are neither derivatives nor C.
    in_lanes : bool
        Whether states may be evaluated side by side: not where time ends steps, commands pass
        through, lists are searched or cables are watched, which each lane would do by itself.
    in_balls : bool
        Whether code may have it in one freedom of a joint with an orientation.
    name : str
        Of its routine.

    """

    act: Optional[Callable]
    role: int = FORCE
    terms: Callable = lambda row: ()
    listed: int = 0
    engine_only: Optional[str] = None
    in_lanes: bool = True
    in_balls: bool = False

    @property
    def name(self):
        return self.act.__name__

    @property
    def follows_time(self):
        """Whether, where the time is held, what it does is a number or depends on one."""
        return self.role == PROFILE

    def parts(self, row):
        """Return what its routine depends on beside the numbers of joints and bodies."""
        return ()

    def refusal(self, instant, along):
        """
        Return why it has no derivatives, or None.

        ``instant``: whether the time is held; ``along``: whether they are those of a motion.
        """
        return None if instant and self.role == PROFILE else self.engine_only

    def __reduce__(self):
        """Return where it is found: it is one object in a process."""
        return _found, (self.act.__module__, self.name)


def _found(module, name):
    return getattr(import_module(module), name)


def force_law(**keys):
    """Make a function of forces the law of an effect; ``keys`` are those of ``ForceLaw``."""
    return lambda act: ForceLaw(act, **keys)
