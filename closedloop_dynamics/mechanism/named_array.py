# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Arrays whose rows have names."""

from collections.abc import Mapping
from typing import Any, Dict, Iterator, Optional, Sequence, Tuple, Union

import numpy as np
from numpy.lib.mixins import NDArrayOperatorsMixin

from .fields import among, nearest

Place = Union[int, slice]


def reals(name: str, values: Any) -> np.ndarray:
    """
    Return real numbers as a new array of floats.

    Raises
    ------
    ValueError
        For complex numbers, whose imaginary parts would be lost, text and rows of several lengths;
        ``name`` says of what.

    """
    wanted = 'numbers'
    try:
        found = np.asarray(values)
        if found.dtype.kind in 'biufO':
            return np.array(found, dtype=float, order='C')
        wanted = 'real numbers' if found.dtype.kind == 'c' else wanted
    except (TypeError, ValueError):
        pass
    raise ValueError(f'{name}: expected {wanted}, got {values!r}')


def frozen(values: Any) -> np.ndarray:
    """Return numbers as a new array that cannot be written."""
    return sealed(np.array(values, dtype=float))


def sealed(array: np.ndarray) -> np.ndarray:
    """Return an array made read-only; nobody else holds it."""
    array.flags.writeable = False
    return array


def by_shapes(record: Any, *names: str) -> str:
    """Return a representation of a record: arrays and batches by shape, all else as it is."""
    def shown(value: Any) -> str:
        shape = np.shape(value) if isinstance(value, np.ndarray) else ()
        return f'array{shape}' if shape else repr(value)

    return (f'<{type(record).__name__}: '
            f'{", ".join(f"{name} {shown(getattr(record, name))}" for name in names)}>')


class NamedArray(NDArrayOperatorsMixin, Mapping[str, np.ndarray]):
    """
    A read-only array whose rows can be looked up by name.

    ``forces['elbow']`` is the row of that name, ``numpy.asarray(forces)`` all of them,
    ``forces.names`` what they are called, ``forces.shape`` how many there are. Arithmetic is that
    of arrays, and returns arrays. Before the rows there may be the axis of a batch.

    Parameters
    ----------
    what : str
        Name of the quantity, for messages.
    places : dict of str to int or slice
        Where the rows are, by name.
    array : ndarray, shape (..., rows), or (..., rows, columns)
        That nobody else holds; it cannot be written any more.
    axis : int
        Of the rows: -1 or -2.

    Raises
    ------
    KeyError
        For an unknown name; it says which there are.

    """

    __slots__ = ('what', 'array', '_places', '_axis')

    def __init__(self, what: str, places: Dict[str, Place], array: np.ndarray,
                 axis: int) -> None:
        array.setflags(write=False)
        self.what, self.array, self._places, self._axis = what, array, places, axis

    @property
    def shape(self) -> Tuple[int, ...]:
        """Shape of the array."""
        return self.array.shape

    @property
    def names(self) -> Tuple[str, ...]:
        """Names of the rows, in their order."""
        return tuple(self._places)

    def __getitem__(self, name: Any) -> Any:
        """
        Return the row of a name; a number where it has no columns and there is no batch.

        Whatever else indexes an array, such as the position of a row, is taken as such.
        """
        if not isinstance(name, str):
            return self.array[name]
        if name not in self._places:
            raise KeyError(f'{self.what}: expected one of {among(self._places) or "no names"}, '
                           f'got {name!r}{_hint(name, self._places)}')
        place = self._places[name]
        found = self.array[..., place] if self._axis == -1 else self.array[..., place, :]
        return float(found) if found.ndim == 0 else found

    def stacked(self, arrays: 'Sequence[NamedArray]') -> 'NamedArray':
        """Return arrays of the same names as one, with the axis of a batch."""
        return NamedArray(
            self.what, self._places, np.array([each.array for each in arrays]), self._axis)

    def __iter__(self) -> Iterator[str]:
        return iter(self._places)

    def __len__(self) -> int:
        return len(self._places)

    def __array__(self, dtype: Any = None, copy: Optional[bool] = None) -> np.ndarray:
        """Return all rows."""
        if dtype is None and not copy:
            return self.array
        return np.array(self.array, dtype=dtype)

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **keywords: Any) -> Any:
        """Compute with all rows."""
        return getattr(ufunc, method)(*(
            one.array if isinstance(one, NamedArray) else one for one in inputs), **keywords)

    def __reduce__(self) -> Tuple[Any, ...]:
        """Copy and pickle as read-only arrays."""
        return NamedArray, (self.what, self._places, self.array, self._axis)

    def __repr__(self) -> str:
        """Return the meaning of the numbers, their shape and their names."""
        return f'<{self.what} {self.array.shape} of {", ".join(self._places) or "nothing"}>'


def _hint(name: Any, names: Mapping[str, Place]) -> str:
    """Return a guess which name was meant."""
    hint = nearest(name, names) if isinstance(name, str) else None
    return f' ({hint})' if hint else ''
