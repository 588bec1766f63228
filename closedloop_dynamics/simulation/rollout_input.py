# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""What ``Simulation.rollout`` is given: shapes, numbers of samples and steps."""

import numpy as np

from .key_paths import resolve
from .rollout_run import Schedule


class Given:
    """
    What differs between the samples, as arrays of one length.

    Attributes
    ----------
    torques : ndarray, shape (rows, na) or (samples, rows, na)
    position, velocity : ndarray, shape (nv,) or (samples, nv); or None
    parameters : dict of tuple of str to ndarray, shape () or (samples,)
    rows, samples : int

    Raises
    ------
    ValueError

    """

    def __init__(self, simulation, torques, position, velocity, parameters):
        """Check shapes and names."""
        nv, na = len(simulation.joint_names), len(simulation.actuated_joints)
        torques = np.zeros((1, na)) if torques is None else _numbers('torques', torques)
        if torques.ndim == 1:
            torques = torques[np.newaxis]
        self.torques = _shaped('torques', torques, (None, na), 'actuated joints')
        self.position = None if position is None else _shaped(
            'initial_position', _numbers('initial_position', position), (nv,), 'joints')
        self.velocity = None if velocity is None else _shaped(
            'initial_velocity', _numbers('initial_velocity', velocity), (nv,), 'joints')
        self.parameters = {
            resolve(simulation.scene, key): np.asarray(values, dtype=float)
            for key, values in (parameters or {}).items()}
        self.rows = self.torques.shape[-2]
        self.samples = self._samples()

    def _samples(self):
        """Return how many samples all arguments together ask for."""
        arrays = {'torques': (self.torques, 2), 'initial_position': (self.position, 1),
                  'initial_velocity': (self.velocity, 1)}
        arrays.update({f'parameters: {".".join(key)}': (values, 0)
                       for key, values in self.parameters.items()})
        found = {}
        for name, (array, ndim) in arrays.items():
            if array is not None and array.ndim > ndim:
                if array.ndim > ndim + 1:
                    raise ValueError(f'{name}: expected one number for each sample, got shape '
                                     f'{array.shape}')
                found.setdefault(len(array), name)
        if len(found) > 1:
            raise ValueError('expected the same number of samples everywhere, got ' + ', '.join(
                f'{count} in {name}' for count, name in found.items()))
        return next(iter(found), 1)

    def torques_of(self, sample):
        """Return the torques of a sample, shape (rows, na)."""
        return _of(self.torques, 2, sample)

    def state_of(self, sample):
        """Return position and velocity of a sample, shape (nv,) or None."""
        return _of(self.position, 1, sample), _of(self.velocity, 1, sample)

    def parameters_of(self, sample):
        """Return the parameters of a sample."""
        return {key: float(_of(values, 0, sample)) for key, values in self.parameters.items()}


def _of(array, ndim, sample):
    """Return what a sample gets of an array that all may share."""
    return array if array is None or array.ndim == ndim else array[sample]


def scheduled(step_size, rows, duration, steps, every):
    """
    Return when torques change and instants are kept, in steps.

    Parameters
    ----------
    step_size : float
        [s].
    rows : int
        Of torques.
    duration, steps, every
        As for ``Simulation.rollout``.

    Raises
    ------
    ValueError

    """
    if duration is not None:
        if steps is not None:
            raise ValueError('steps: expected it without duration, got both')
        steps = round(duration / step_size)
        if not abs(steps * step_size - duration) <= 1e-9 * max(step_size, duration):
            raise ValueError(f'duration: expected a multiple of the step size {step_size:g} s, '
                             f'got {duration:g}')
    elif steps is None:
        if rows == 1:
            raise ValueError('steps: expected it, or duration, where torques are constant; got '
                             'neither')
        steps = rows
    for name, value in (('steps', steps), ('every', every)):
        if int(value) != value or value < 1:
            raise ValueError(f'{name}: expected a whole number > 0, got {value!r}')
    if steps % rows or steps % every:
        name, count = ('rows of torques', rows) if steps % rows else ('every', every)
        raise ValueError(f'steps: expected a multiple of {name} ({count}), got {steps}')
    return Schedule(step_size, int(steps), int(steps) // rows, int(every))


def _numbers(name, values):
    array = np.array(values, dtype=float)
    if not np.isfinite(array).all():
        raise ValueError(f'{name}: expected finite numbers, got others among them')
    return array


def _shaped(name, array, shape, what):
    """Return an array of a shape (None: any length but zero), of one or of many samples."""
    tail = array.shape[-len(shape):]
    if array.ndim not in (len(shape), len(shape) + 1) or 0 in array.shape[:-1] or any(
            wanted is not None and wanted != got for wanted, got in zip(shape, tail)):
        inner = ', '.join('rows' if n is None else str(n) for n in shape)
        raise ValueError(f'{name}: expected shape ({inner}) or (samples, {inner}), with the '
                         f'{shape[-1]} {what} last; got {array.shape}')
    return array
