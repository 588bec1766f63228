# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Spring whose force over its stroke is a table, in a joint or between two points.

    tau = y(q) - c qd           in a joint
    F = y(l) + c l'             pulls two points together, l being their distance

y is linear between the rows or a cubic spline; beyond the ends it goes on straight, with the slope
that it has there. The energy stored is the integral of the table from its first stroke on; c l'^2
is dissipated. When: gas springs (negative between points: they push), constant-force springs,
bistable springs, rubber buffers, a measured characteristic.
"""

from dataclasses import dataclass
from typing import Optional, Tuple

import numpy as np

from .effect import Effect
from .element import DISSIPATED, ForceElement, State
from .force_law import force_law
from .points import pull_together, two_places
from ..mechanism.checks import freedom, list_of, name, not_negative, number, one_of, vector
from ..mechanism.fields import FieldError, shown
from ..mechanism.mechanism import Vector

# Numbers of an entry: stroke at which a piece begins, coefficients, energy there.
COLUMNS = 6


@dataclass(frozen=True)
class ForceTable(Effect):
    """
    Spring whose force over its stroke is a table.

    Attributes
    ----------
    strokes : tuple of floats
        Joint coordinates or distances, growing [rad; m].
    forces : tuple of floats
        Torques or forces there, on the joint or pulling the points together [N m; N].
    joint : str or None
        Where it acts: a joint, or
    point_a : str or None
        a named point and
    point_b : str or None
        another one, or
    anchor : tuple of 2 floats, or 3 in space, or None
        a place in the world [m].
    interpolation : str
        ``linear`` or ``cubic`` (a spline).
    damping : float
        c, zero or more [N m s/rad; N s/m].

    """

    CHECKS = {'strokes': list_of(number), 'forces': list_of(number), 'joint': freedom,
              'point_a': name, 'point_b': name, 'anchor': vector,
              'interpolation': one_of(('linear', 'cubic')), 'damping': not_negative}
    FILES = {'file': ('strokes', 'forces')}
    VECTORS = ('anchor',)
    READINGS = ('force', 'stroke')
    DRAWN_AS_SPRING = True

    strokes: Tuple[float, ...]
    forces: Tuple[float, ...]
    joint: Optional[str] = None
    point_a: Optional[str] = None
    point_b: Optional[str] = None
    anchor: Optional[Vector] = None
    interpolation: str = 'linear'
    damping: float = 0.0

    def __post_init__(self):
        """Refuse an invalid table, and ends that are missing or too many."""
        super().__post_init__()
        if (self.joint is None) == (self.point_a is None):
            raise FieldError('either joint or point_a', 'both' if self.joint else 'neither',
                             path=('joint',))
        if self.joint is not None and (self.point_b or self.anchor) is not None:
            raise FieldError('point_b or anchor only beside point_a',
                             shown(self.point_b or self.anchor), path=('point_b',))
        if len(self.strokes) < 2:
            raise FieldError('two strokes or more', f'{len(self.strokes)}', path=('strokes',))
        if len(self.forces) != len(self.strokes):
            raise FieldError(f'{len(self.strokes)} forces, one for each stroke',
                             f'{len(self.forces)}', path=('forces',))
        for index, (one, other) in enumerate(zip(self.strokes, self.strokes[1:])):
            if not one < other:
                raise FieldError(f'strokes that grow (more than {one:g})', f'{other:g}',
                                 path=('strokes', index + 1))

    def element(self, machine):
        """Return the effect as a row of the table."""
        states, data = (State(DISSIPATED),), _pieces(
            np.array(self.strokes), np.array(self.forces), self.interpolation)
        if self.joint is not None:
            return ForceElement(
                table_in_joint, joints=(machine.joint(self.joint),), values=(self.damping,),
                states=states, data=data)
        bodies, places = machine.two_points(self.point_a, self.point_b, self.anchor)
        return ForceElement(table_between_points, bodies=bodies, values=(self.damping, *places),
                            states=states, data=data)


@force_law(listed=COLUMNS, in_lanes=False)
def table_in_joint(forces):
    joint = forces.joint
    force, energy = _force_and_energy(forces, joint.value)
    loss = forces.values[0] * joint.rate
    joint.push(force - loss)
    forces.store(-energy)
    forces.flow(loss * joint.rate)
    forces.read(force - loss, joint.value)


@force_law(listed=COLUMNS, in_lanes=False)
def table_between_points(forces):
    damping = forces.values[0]

    def tension(length, rate):
        force, energy = _force_and_energy(forces, length)
        return force + damping * rate, energy, damping * rate * rate
    pull_together(forces, two_places(forces, 1), tension)


def _force_and_energy(forces, stroke):
    """Return force and energy at a stroke, by the piece that is there."""
    start, a, b, c, d, energy = forces.piece(COLUMNS, stroke)
    u = stroke - start
    return (a + u * (b + u * (c + u * d)),
            energy + u * (a + u * (b / 2.0 + u * (c / 3.0 + u * d / 4.0))))


def _pieces(strokes, forces, interpolation):
    """Return the pieces of a table: one before it, those between its rows, one beyond it."""
    if interpolation == 'cubic':
        # Not before it is wanted: it takes a third of the time that loading the package would.
        from scipy.interpolate import CubicSpline
        inside = CubicSpline(strokes, forces).c[::-1].T
    else:
        slopes = np.diff(forces) / np.diff(strokes)
        inside = np.column_stack((forces[:-1], slopes, 0.0 * slopes, 0.0 * slopes))
    widths = np.diff(strokes)
    powers = widths[:, None] ** np.arange(1, 5) / np.arange(1, 5)
    energies = np.concatenate(([0.0], np.cumsum((inside * powers).sum(axis=1))))
    last = inside[-1]
    slope = last[1] + widths[-1] * (2.0 * last[2] + widths[-1] * 3.0 * last[3])
    rows = [(strokes[0], forces[0], inside[0, 1], 0.0, 0.0, 0.0)]
    rows += [(start, *row, energy) for start, row, energy in zip(strokes, inside, energies)]
    rows.append((strokes[-1], forces[-1], slope, 0.0, 0.0, energies[-1]))
    return tuple(tuple(map(float, row)) for row in rows)
