# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""All that follows from a state and torques, as one value."""

from dataclasses import dataclass, fields
from typing import Any, Sequence, Tuple

import numpy as np

from ..kinematics.state import State
from ..mechanism.named_array import frozen, NamedArray, sealed


@dataclass(frozen=True, eq=False, repr=False)
class Evaluation:
    """
    Quantities of a state under torques, or of a batch of states; immutable.

    A batch has a leading axis everywhere.

    Attributes
    ----------
    state : State
    torque : ndarray, shape (number of ``Simulation.torque_names``,)
        As commanded [N m or N].
    acceleration : ndarray, shape (nv,)
        Joint accelerations [rad/s^2 or m/s^2].
    multipliers : ndarray, shape (nc,)
        Lagrange multipliers [N, N m], as ``Simulation.multipliers``.
    effort : ndarray, shape (nv,)
        Joint torques behind the drives [N m or N].
    joint_forces : NamedArray, shape (number of joints, 3), in space 6
        By joint; as ``Simulation.joint_forces`` [N m, N].
    constraint_forces : NamedArray, shape (number of cut joints, 3), in space 6
        By cut joint; as ``Simulation.constraint_forces`` [N m, N].
    points : NamedArray, shape (number of points, 2), in space 3
        Places of the named points [m].
    body_poses : NamedArray, shape (number of bodies, 3), in space 7
        By body; as ``Simulation.body_poses`` [m, rad].
    coupling_forces : NamedArray, shape (number of couplings,)
        Generalized forces of the couplings, by name.
    motion_forces : NamedArray, shape (number of prescribed motions,)
        Torques and forces that prescribed motions take, by effect [N m, N].
    kinetic_energy, stored_energy : float, or ndarray of shape (n,)
        Of bodies and rotors; in gravity and effects [J].
    closure : float, or ndarray of shape (n,)
        Largest closure error of positions [m or rad].

    """

    state: State
    torque: np.ndarray
    acceleration: np.ndarray
    multipliers: np.ndarray
    effort: np.ndarray
    joint_forces: NamedArray
    constraint_forces: NamedArray
    points: NamedArray
    body_poses: NamedArray
    coupling_forces: NamedArray
    motion_forces: NamedArray
    kinetic_energy: Any
    stored_energy: Any
    closure: Any

    def __post_init__(self) -> None:
        """Make the arrays read-only; nobody else holds them."""
        for array in (self.torque, self.acceleration, self.multipliers, self.effort):
            sealed(array)

    @classmethod
    def stack(cls, evaluations: 'Sequence[Evaluation]', state: State) -> 'Evaluation':
        """Return the evaluations of a batch of states, of which there is one at least."""
        def all_of(name: str) -> Any:
            values = [getattr(each, name) for each in evaluations]
            first = values[0]
            return first.stacked(values) if isinstance(first, NamedArray) else frozen(values)

        return cls(state, *(all_of(field.name) for field in fields(cls)[1:]))

    @property
    def energy(self) -> Any:
        """Kinetic and stored energy [J]."""
        return self.kinetic_energy + self.stored_energy

    def __reduce__(self) -> Tuple[Any, ...]:
        """Copy and pickle as read-only arrays."""
        return Evaluation, tuple(getattr(self, field.name) for field in fields(self))

    def __repr__(self) -> str:
        """Show the number of states and the largest acceleration."""
        count = f'{len(self.state)} states' if self.state.is_batch else (
            f'a state at t = {self.state.time:.9g} s')
        largest = np.abs(self.acceleration).max(initial=0.0)
        return (f'<Evaluation of {count}: acceleration {self.acceleration.shape} up to '
                f'{largest:.6g}, multipliers {self.multipliers.shape}, '
                f'{len(self.joint_forces)} joints, {len(self.points)} points>')
