# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A motion that was simulated or recorded."""

from dataclasses import dataclass, fields

import numpy as np

# What is behind the name of a column of a force that is not unique.
LEAST = '.least'


@dataclass(frozen=True)
class Trajectory:
    """States of one mechanism at n instants."""

    mechanism: object  # Mechanism.mechanism.Mechanism
    time: np.ndarray  # Shape (n,) [s]
    # Shape (n, nq), (n, nv), (n, nv): of the joints, in the order of ``Mechanism.coordinates``
    # [rad or m, and per s; N m or N]; orientations are quaternions.
    position: np.ndarray
    velocity: np.ndarray
    effort: np.ndarray
    # Shape (n, number of cut joints, 3): moment [N m] and force [N] along x and y that body
    # B exerts on body A, in world axes. In space 6: moment and force along x, y and z.
    forces: np.ndarray

    def part(self, which):
        """Return some of its instants, chosen by a slice or an array of truth values."""
        return Trajectory(self.mechanism, *(
            getattr(self, each.name)[which] for each in fields(self)[1:]))


def wrench_parts(mechanism):
    """Return the names of a wrench's components in columns, moments first, in their order."""
    return ('torque', 'x', 'y') if mechanism.planar else (
        'torque_x', 'torque_y', 'torque_z', 'x', 'y', 'z')


def without_marks(names):
    """Return the names of columns without the marks of forces that are not unique."""
    return [name.removesuffix(LEAST) for name in names]


def magnitudes(wrenches):
    """Return the magnitudes of the forces in wrenches of shape (..., 3), in space (..., 6)."""
    return np.linalg.norm(force_of(wrenches), axis=-1)


def force_of(wrenches):
    """Return the forces in wrenches, moments first, of shape (..., 3), in space (..., 6)."""
    return wrenches[..., wrenches.shape[-1] // 2:]


def from_rows(mechanism, names, rows):
    """Return the motion in rows of ``recording.run``."""
    column = dict(zip(without_marks(names), np.array(rows, dtype=float).T))
    zero = np.zeros(len(rows))

    def joints(quantity):
        names = mechanism.coordinates.columns(quantity)
        return np.stack([column[name] for name in names], axis=1)

    parts = wrench_parts(mechanism)
    forces = [[column.get(f'force.{cut.name}.{part}', zero) for part in parts]
              for cut in mechanism.cut_joints]
    return Trajectory(
        mechanism, column['time'], joints('position'), joints('velocity'), joints('effort'),
        np.array(forces).reshape(len(forces), len(parts), len(rows)).transpose(2, 0, 1))
