# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A state of a mechanism, or a batch of states, as one value."""

from dataclasses import dataclass
from typing import Any, Dict, Iterator, List, Sequence, Tuple, Union

import numpy as np
from numpy.typing import ArrayLike

from ..mechanism.coordinates import Coordinates
from ..mechanism.named_array import frozen, NamedArray, Place, reals, sealed

# Names that a representation spells out.
MOST_NAMES = 6


@dataclass(frozen=True, eq=False, repr=False)
class State:
    """
    A state, or a batch of states along a leading axis; it never changes.

    ``Model.assemble`` makes states that close the loops, ``Model.state`` takes numbers as they
    are, ``Simulation.snapshot`` states where a run stands.

    Parameters
    ----------
    time : float or array_like, shape (n,)
        [s]; one time does for a whole batch.
    q : array_like, shape (nq,) or (n, nq)
        Joint coordinates [rad or m].
    qd : array_like, shape (nv,) or (n, nv)
        Joint rates [rad/s or m/s].
    own : array_like, shape (nz,) or (n, nz)
        The effects' own states.
    coordinates : mechanism.coordinates.Coordinates
        Names of the joints.

    Raises
    ------
    ValueError
        For other shapes, and numbers that are not finite.

    """

    time: Any
    q: Any
    qd: Any
    own: Any
    coordinates: Coordinates

    def __post_init__(self) -> None:
        """Copy the numbers, and refuse an invalid state."""
        q, qd, own = (_numbers(name, getattr(self, name)) for name in ('q', 'qd', 'own'))
        batch = q.shape[:-1]
        for name, array, last in (('q', q, self.coordinates.nq), ('qd', qd, self.coordinates.nv),
                                  ('own', own, own.shape[-1])):
            expected = (*batch, last)
            if array.shape != expected or len(batch) > 1:
                raise ValueError(
                    f'state: expected {name} of shape ({last},), or (n, {last}) with the same n '
                    f'in q, qd and own, got {array.shape} beside q of shape {q.shape}')
        time = _numbers('time', self.time, least=0)
        if time.shape not in ((), batch):
            raise ValueError(f'state: expected one time, or times of shape {batch}, got shape '
                             f'{time.shape}')
        if batch:
            time = frozen(np.broadcast_to(time, batch))
        object.__setattr__(self, 'time', time if batch else float(time))
        for name, array in (('q', q), ('qd', qd), ('own', own)):
            object.__setattr__(self, name, array)

    @classmethod
    def stack(cls, states: 'Sequence[State]') -> 'State':
        """
        Return a batch of single states.

        Raises
        ------
        ValueError
            For no state at all, or states of several mechanisms.

        """
        if not states:
            raise ValueError('states: expected at least one, got none')
        first = states[0].coordinates
        for state in states:
            if state.coordinates.names != first.names:
                raise ValueError(
                    f'states: expected states of one mechanism with the joints '
                    f'{", ".join(first.names)}, got one with {", ".join(state.coordinates.names)}')
        time, q, qd, own = (np.array([getattr(state, name) for state in states])
                            for name in ('time', 'q', 'qd', 'own'))
        return cls(time, q, qd, own, first)

    @property
    def position(self) -> NamedArray:
        """Joint coordinates by joint; of a spherical or free joint a quaternion is among them."""
        return NamedArray('position', _places(self.coordinates, True), self.q, -1)

    @property
    def velocity(self) -> NamedArray:
        """Joint rates by joint."""
        return NamedArray('velocity', _places(self.coordinates, False), self.qd, -1)

    @property
    def is_batch(self) -> bool:
        """Whether there is a leading axis."""
        return self.q.ndim == 2

    @property
    def each(self) -> 'List[State]':
        """Return the states of a batch, or this one alone."""
        return list(self) if self.is_batch else [self]

    def __len__(self) -> int:
        if not self.is_batch:
            raise TypeError(f'state: expected a batch, got a single state of q {self.q.shape}')
        return len(self.q)

    def __bool__(self) -> bool:
        """Whether it is a state at all: it is, also where a batch is empty."""
        return True

    def __getitem__(self, places: Union[int, slice]) -> 'State':
        """Return one state of a batch, or a batch of some."""
        len(self)
        return State(self.time[places], self.q[places], self.qd[places], self.own[places],
                     self.coordinates)

    def __iter__(self) -> 'Iterator[State]':
        return (self[k] for k in range(len(self)))

    def __reduce__(self) -> Tuple[Any, ...]:
        """Copy and pickle as read-only arrays."""
        return State, (self.time, self.q, self.qd, self.own, self.coordinates)

    def __repr__(self) -> str:
        """Show a state by its joints, a batch by its shapes."""
        if self.is_batch:
            return (f'<{len(self)} States: q {self.q.shape}, qd {self.qd.shape}, '
                    f'own {self.own.shape}>')
        numbers = [f'{name} = {_shown(value)}' for name, value in self.position.items()]
        if len(numbers) > MOST_NAMES:
            numbers[MOST_NAMES:] = [f'and {len(numbers) - MOST_NAMES} more']
        own = f'; {len(self.own)} own states of effects' if len(self.own) else ''
        fastest = np.abs(self.qd).max(initial=0.0)
        moving = f'fastest rate {fastest:.6g}' if fastest else 'at rest'
        return f'<State at t = {self.time:.9g} s: {", ".join(numbers)}; {moving}{own}>'


def _numbers(name: str, values: ArrayLike, least: int = 1) -> np.ndarray:
    """Return finite numbers as a new array that cannot be written."""
    found = sealed(reals(f'state: {name}', values))
    if found.ndim < least:
        raise ValueError(f'state: expected a sequence for {name}, got {values!r}')
    if not np.isfinite(found).all():
        raise ValueError(f'state: expected finite numbers for {name}, got {values!r}')
    return found


def _places(coordinates: Coordinates, positions: bool) -> Dict[str, Place]:
    """Return where the numbers of joints are, by the names that a mapping of them has."""
    whole = coordinates.coordinates if positions else coordinates.rates
    return {key: whole[key] if key in coordinates.with_orientation
            else int(coordinates.place[coordinates.index[key]]) if positions
            else coordinates.index[key] for key in coordinates.keys}


def _shown(value: Any) -> str:
    """Return a number, or those of an orientation, with six digits."""
    if isinstance(value, float):
        return f'{value:.6g}'
    return f'({", ".join(f"{number:.6g}" for number in value)})'
