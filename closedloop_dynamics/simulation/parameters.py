# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Derivatives of the arrays of generated code by the numbers of a scene."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .data import Data
from ..codegen import function_table as calls
from ..codegen.scene_routines import POINT
from ..codegen.space import is_spatial, PARALLEL
from ..kinematics.modeling import extent
from ..mechanism.errors import AssemblyError
from ..mechanism.fields import FieldError
from ..mechanism.mechanism import MechanismError
from ..scene.key_paths import changed, numbers, resolve

# Derivatives and values at zero by numbers on both sides, both of sixth order: exact for
# polynomials, as arrays are of nearly all numbers.
WEIGHTS = np.array((3 / 4, -3 / 20, 1 / 60))
MEANS = np.array((3 / 4, -3 / 10, 1 / 20))
# A number is changed by this share of itself, where it is zero of the size of the mechanism; by
# less, with more rounding, where that is impossible.
SHARES = 2.0 ** -8, 2.0 ** -11, 2.0 ** -14
# Rounding, as a share of the largest number of an array.
ROUNDING = 1e-13
# Where numbers at both sides do not lead to what is in between, an array jumps.
JUMP = 1e-9


class ParameterArrays(NamedTuple):
    """Parameters, and the arrays of a scene."""

    names: tuple  # Key paths (tuple of str)
    #: Numbers of arrays that depend on any of them: place of the array in the function table, and
    #: in it (tuple of (int, int)).
    entries: tuple
    matrix: np.ndarray  # Shape (entries, parameters): Derivatives of these numbers
    #: In whose place code is generated: none of these numbers is one that is part of a structure
    #: (Model).
    model: object


def parameter_arrays(data, keys):
    """
    Differentiate the arrays of data, which stay as they are, by numbers of its scene.

    ``keys``: key paths, such as ``'mechanism.bodies.crank.mass'`` or ``'parameters.l'``.
    ValueError where there is no such number, or the motion does not follow it smoothly, with the
    reason.
    """
    scene, effects = data.scene, data.effect_set
    # The nearest start will do.
    scene = replace(
        scene, effects=dict(effects.records), initial=replace(scene.initial, hold=()),
        switched_off=tuple(name for name, enabled in effects.enabled.items() if not enabled))
    arrays, columns, parallel = _arrays(data), [], _parallel(data)
    flat = np.concatenate([array.ravel() for array in arrays.values()])
    size = np.concatenate([
        np.full(array.size, np.abs(array).max(initial=0.0)) for array in arrays.values()])
    for key in keys:
        others, width = _others(scene, data, key)
        parallel = np.min([parallel, *map(_parallel, others)], axis=0)
        sides = np.array([np.concatenate([
            array.ravel() for array in _arrays(other).values()]) for other in others])
        upper, lower = sides[:len(WEIGHTS)], sides[len(WEIGHTS):]
        if np.any(np.abs(MEANS @ (upper + lower) - flat) > JUMP * size):
            raise FieldError('a number that masses and places follow smoothly',
                             'one at which frames of bodies jump', '', (key,))
        column = WEIGHTS @ (upper - lower)
        columns.append(np.where(np.abs(column) > ROUNDING * size, column, 0.0) / width)
    matrix = np.array(columns).T.reshape(len(flat), len(columns))
    places = [(source, place) for source, array in arrays.items() for place in range(array.size)]
    some = np.flatnonzero(matrix.any(axis=1))
    entries = tuple(places[n] for n in some)
    return ParameterArrays(tuple(keys), entries, np.ascontiguousarray(matrix[some]), _generic(
        data.system.model, entries, parallel))


def _arrays(data):
    """Return the arrays that code reads, by their places in the function table."""
    model, effects = data.system.model, data.system.effects
    return {calls.BODY: model.body, calls.GRAVITY: model.gravity, calls.CUT_POINT: model.cut_point,
            calls.VALUES: np.zeros(0) if effects is None else finite(effects.values),
            POINT: data.loop_model.joint_places[1]}


def finite(values):
    """Return a copy of effects' numbers without infinities: ends of stops that are not there."""
    return np.where(np.isfinite(values), values, 0.0)


def _parallel(data):
    """Return which bodies share their parent's Z axis, a structure without derivatives."""
    model = data.system.model
    return model.body[:, PARALLEL] if is_spatial(model) else np.zeros(1)


def _structure(data):
    """Return the structure that no number may change: equations, and coordinates of laws."""
    model, effects = data.system.model, data.system.effects
    parts = [model.tree, model.cut, model.path_body]
    if effects is not None:
        parts += [effects.role, effects.places, effects.enabled, effects.data, effects.joints,
                  effects.bodies, effects.entries, effects.summed, effects.feels, effects.gap]
    return [(array.shape, array.tobytes()) for array in parts]


def _others(scene, data, key):
    """Return data of other values on both sides, upper ones first, and their distance."""
    path = resolve(scene, key)
    value = numbers(scene)['.'.join(path)]
    if path[0] in ('initial', 'method') or value is None:
        raise FieldError(
            'a number of the mechanism, of an effect or of the parameters',
            'one that is not given' if value is None else f'one of the {path[0]}',
            'a start is varied as a state' if path[0] == 'initial' else '', (key,))
    size, reason = abs(value) or extent(data.mechanism), None
    for share in SHARES:
        try:
            found = [Data(changed(scene, {path: value + sign * step * share * size}))
                     for sign in (1.0, -1.0) for step in range(1, len(WEIGHTS) + 1)]
        except (MechanismError, FieldError, AssemblyError) as error:
            reason = error
            continue
        if any(_structure(one) != _structure(data) for one in found):
            raise FieldError('a number that the motion follows smoothly',
                             'one by which other equations or laws are worked on', '', (key,))
        return found, share * size
    raise ValueError(f'{key}: expected a number that may change a little to both sides, got '
                     f'{value:g}: {reason}')


def _generic(model, entries, parallel):
    """Return a model in which no varied number is 0, 1 or another one's equal."""
    body, cut_point = model.body.copy(), model.cut_point.copy()
    arrays = {calls.BODY: body, calls.CUT_POINT: cut_point}
    for number, (source, place) in enumerate(entries):
        if source in arrays:
            arrays[source].flat[place] = 2.0 + 1.0 / (3.0 + number)
    if is_spatial(model):
        body[:, PARALLEL] = parallel
    return model.replaced(body=body, cut_point=cut_point)
