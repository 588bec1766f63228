# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Controllers from their settings: law, gains and reference."""

import math

import numpy as np

from .errors import StartError
from .impedance import Impedance
from .references import CircularPath, PathError, PointToPointPath, Reference, Wave
from .settings import IMPEDANCE, OPTIMAL_MODES
from .torque_laws import ComputedTorque, ProportionalDerivative
from ..effects.actuator import Actuator
from ..mechanism.errors import SimulationError
from ..mechanism.extras import MissingLibraryError

# What regulators do not follow.
_NOT_OPTIMAL = 'circle_point', 'target_velocity', 'move_amplitude', 'feedforward'


def open_loop(values, joints):
    """
    Return the torques of modes constant and sine: ``law(time)`` returns an array, shape (n,).

    ``values`` are those of the parameters, ``joints`` the names of those to drive. Raises
    StartError if a parameter does not fit the joints; so do all functions here.
    """
    mean, wave = _spread(values, 'torque', joints), _wave(values, '', joints)
    if values['mode'] == 'constant':
        return lambda time: mean
    return lambda time: mean + wave.value(time)


def closed_loop(values, joints, simulation=None):
    """Return the law of mode pd, or with a simulation, the model, that of the other modes."""
    tuning = gains(values, joints, simulation)
    if values['mode'] == IMPEDANCE:
        return Impedance(simulation, values['impedance_point'], *tuning)
    *own, feedforward, limit = tuning
    if values['mode'] in OPTIMAL_MODES:
        return _optimal(values, joints, simulation, limit)
    wanted = reference(values, joints, simulation)
    if simulation is None:
        return ProportionalDerivative(wanted, *tuning)
    none = np.zeros_like(limit)
    controller = ProportionalDerivative(wanted, *own, none, none + np.inf, inertia=1.0)
    return ComputedTorque(simulation, controller, feedforward, limit)


def _optimal(values, joints, simulation, limit):
    # A quarter of a node's start-up time, which other modes do without.
    from .optimal_law import OptimalLaw
    path = reference(values, joints, simulation) if values['path_point'] else None
    try:
        return OptimalLaw(
            simulation, values, _spread(values, 'target_position', joints, nan_allowed=True),
            _not_negative(values, 'torque_cost', joints), limit, path)
    except (MissingLibraryError, SimulationError, ValueError) as error:
        raise StartError(f"mode '{values['mode']}': {error}") from None


def gains(values, joints, simulation=None):
    """
    Return the tunable values of a law: gains, feedforward and limit, shape (n,).

    Gains are kp, kd and ki, of shape (n,), or stiffness and damping, one per direction; of
    regulators there are none.
    """
    names, places = ('kp', 'kd', 'ki'), joints
    if values['mode'] == IMPEDANCE:
        names = 'stiffness', 'damping'
        places = ('x', 'y', 'turn') if simulation.mechanism.planar else (
            'x', 'y', 'z', 'turn_x', 'turn_y', 'turn_z')
    elif values['mode'] in OPTIMAL_MODES:
        names = ()
        for name in _NOT_OPTIMAL:
            if any(values[name]):
                raise StartError(f"parameter '{name}': expected none in mode '{values['mode']}', "
                                 'which keeps to target_position or the path of path_point')
    spread = [_not_negative(values, name, places) for name in names]
    if names and not np.any(spread):
        raise StartError(f"mode '{values['mode']}' needs a gain: {', '.join(names)} are all zero")
    limit = _not_negative(values, 'torque_limit', joints)
    drives = {} if simulation is None else {
        effect.joint: effect.max_torque for effect in simulation.effects.values()
        if isinstance(effect, Actuator)}
    return [*spread, _spread(values, 'feedforward', joints), np.array([
        value or drives.get(joint) or np.inf for joint, value in zip(joints, limit)])]


def reference(values, joints, simulation=None):
    """Return the desired positions of the joints over time, from the parameters."""
    kinds = [kind for kind in ('circle', 'path') if values[f'{kind}_point']]
    if not kinds:
        return Reference(
            _spread(values, 'target_position', joints, nan_allowed=True),
            _spread(values, 'target_velocity', joints),
            _wave(values, 'move_', joints))
    if len(kinds) > 1:
        raise StartError("parameters 'circle_point', 'path_point': expected one of them, got both")
    kind, = kinds
    if simulation is None:
        raise StartError(f"parameter '{kind}_point': a path needs mode 'computed_torque', which "
                         f"knows the mechanism; got mode '{values['mode']}'")
    try:
        mechanism, start = simulation.mechanism, simulation.position
        if kind == 'path':
            return PointToPointPath(
                mechanism, start, values['path_point'], *_ways(values, mechanism), joints)
        return CircularPath(mechanism, start, values['circle_point'], *(
            values[f'circle_{key}'] for key in ('radius', 'frequency', 'phase')), joints,
            values['circle_tilt'])
    except PathError as error:
        raise StartError(f"parameters '{kind}_*': {error}") from None


def _ways(values, mechanism):
    """Return places, shape (n, 2) or (n, 3), and durations of the ways to them and back."""
    size = 2 if mechanism.planar else 3
    places, durations = (np.array(values[f'path_{key}'], dtype=float)
                         for key in ('places', 'durations'))
    if not len(places) or len(places) % size or not np.isfinite(places).all():
        raise PathError(f'path_places: expected {size} finite numbers for each place, got '
                        f'{len(places)} numbers')
    if len(durations) != len(places) // size + 1 or not np.all(durations > 0.0) or (
            not np.isfinite(durations).all()):
        raise PathError(f'path_durations: expected {len(places) // size + 1} positive numbers, '
                        f'for the way to each place and back, got {durations.tolist()}')
    return places.reshape(-1, size), durations


def _spread(values, name, joints, nan_allowed=False):
    return np.array(per_joint(name, values[name], joints, nan_allowed))


def _not_negative(values, name, joints):
    spread = _spread(values, name, joints)
    if np.any(spread < 0.0):
        raise StartError(
            f"parameter '{name}': expected no negative value, got {list(values[name])}")
    return spread


def _wave(values, prefix, joints):
    return Wave(
        _spread(values, f'{prefix}amplitude', joints),
        _not_negative(values, f'{prefix}frequency', joints),
        _spread(values, f'{prefix}phase', joints))


def per_joint(name, values, joints, nan_allowed=False):
    """
    Return a list parameter as one value per joint: one for all joints, or one for each.

    Raises StartError if the length fits neither, or a value is not finite (or NaN, if allowed).
    """
    if not all(math.isfinite(value) or nan_allowed and math.isnan(value) for value in values):
        raise StartError(
            f"parameter '{name}': expected {'no infinite' if nan_allowed else 'finite'} "
            f'numbers, got {list(values)}')
    if len(values) == 1:
        return [values[0]] * len(joints)
    if len(values) != len(joints):
        raise StartError(
            f"parameter '{name}': expected 1 value, or {len(joints)} in the order "
            f'{", ".join(joints)}; got {len(values)}')
    return list(values)
