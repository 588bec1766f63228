# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Quantities: name, unit and values, in one record for all who compute, write or draw them.

Tables, pages, pictures and objectives take torques, forces and coordinates of a driven motion from
here, by the columns of ``DrivenRun.table``; maps of workspaces, tolerances and studies of accuracy
describe theirs by the same record.
"""

from typing import Dict, NamedTuple

import numpy as np

from ..mechanism.coordinates import QUANTITIES, unit_of
from ..visual.trajectory import without_marks


class Extreme(NamedTuple):
    """A number, and the value of the drive at which it is taken."""

    value: float
    drive: float


class Quantity(NamedTuple):
    """A number, or one at each pose, node or setting."""

    name: str  # As of a joint, or of a coordinate of a point: ``point.tool.x``
    unit: str  # Of the SI
    values: np.ndarray = None  # Shape (n,); None where only the kind is known
    meaning: str = ''

    @property
    def shown(self):
        """Return it as a designer reads it: in degrees where it turns."""
        if 'rad' not in self.unit:
            return self
        return self._replace(unit=self.unit.replace('rad', 'deg'), values=np.degrees(self.values))

    @property
    def label(self):
        """Return name and unit, where it has one."""
        return f'{self.name} [{self.unit}]' if self.unit != '1' else self.name

    def text(self, value):
        """Return a value of its kind, in its unit, as a designer reads it."""
        found = self._replace(values=value).shown
        return f'{found.values:.6g} {found.unit}'

    def extreme(self, drive, pick=np.argmax):
        """Return the largest value, by default, and the value of a drive where it is taken."""
        place = int(pick(self.values))
        return Extreme(float(self.values[place]), float(drive.values[place]))

    def largest(self, drive):
        """Return the value of the largest magnitude, with its sign, as ``extreme``."""
        return self.extreme(drive, lambda values: np.argmax(np.abs(values)))

    @property
    def rms(self):
        """Return the root of the mean square over the poses."""
        return float(np.sqrt(np.mean(self.values ** 2)))


def by_name(table) -> Dict[str, np.ndarray]:
    """Return the columns of ``DrivenRun.table`` by name."""
    names, rows = table
    return dict(zip(without_marks(names), rows.T))


def coordinate(mechanism, name, values=None):
    """Return a joint coordinate, or one of a point."""
    return Quantity(name, unit_of(mechanism, 'position', name), values)


def moved(run, column) -> Dict[str, Quantity]:
    """Return the coordinates of all joints but the drives, and of all points."""
    names = [name for name in column if name.startswith(('position.', 'point.'))
             and name.partition('.')[2] not in run.driven]
    return {what: coordinate(run.mechanism, what, column[name])
            for name in names for what in [name.removeprefix('position.')]}


def torques(run, column) -> Dict[str, Quantity]:
    """Return the drives' efforts, by joint or driven coordinate."""
    names = {name: f'effort.{name}' for name in run.mechanism.actuated_joints}
    if run.mechanism.motions:
        names = {name: f'motion.{motion.name}.force' for name, motion in zip(
            run.driven, run.mechanism.motions)}
    return {what: Quantity(what, unit_of(run.mechanism, 'effort', what), column[name])
            for what, name in names.items()}


def force_parts(column):
    """Return the components of the forces in all joints, shape (axes, n) [N], by joint."""
    names = dict.fromkeys(name.split('.', 1)[1].rpartition('.')[0] for name in column
                          if name.startswith('force.'))
    return {name: np.array([column[f'force.{name}.{axis}'] for axis in 'xyz'
                            if f'force.{name}.{axis}' in column]) for name in names}


def forces(column) -> Dict[str, Quantity]:
    """Return the magnitudes of the forces in all joints, by joint."""
    return {name: Quantity(name, 'N', np.linalg.norm(parts, axis=0))
            for name, parts in force_parts(column).items()}


def curves(run, table):
    """Return the curves over the drive, by quantity and name, each shape (n,)."""
    column, names, found = by_name(table), run.mechanism.coordinates, {}
    for quantity in tuple(QUANTITIES)[:3]:
        for unit in QUANTITIES[quantity]:
            lines = [Quantity(name, unit, column[f'{quantity}.{name}']).shown
                     for name, own in zip(names.names, names.units(quantity))
                     if own == unit and f'{quantity}.{name}' in column]
            if lines:
                found[f'{quantity} [{lines[0].unit}]'] = lines
    found['drive torque [N m], force [N]'] = torques(run, column).values()
    found['joint force [N]'] = forces(column).values()
    return {label: {one.name: one.values for one in lines} for label, lines in found.items()}
