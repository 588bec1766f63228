# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A driven motion between its poses: extremes and dead centres that are solved, not sampled."""

import math
from typing import Dict, List, NamedTuple, Tuple

import numpy as np

from .design import TURN
from .quantities import Extreme
from .transmission import transmission_angle
from ..mechanism.mechanism import GROUND

# Share of the way between two poses to which extremes and zeros are found; extremes are flat, so
# that their values have twice as many digits.
EXACT, FLAT = 1e-13, 1e-9
# Share of a quantity's largest value below which it is zero; angles above are right ones [rad].
NOTHING, FULL = 1e-11, 0.5 * math.pi - 1e-3
# How far a linkage may be from its start after a turn of its drive [rad; sizes].
RETURNED = 1e-6


class Advantage(NamedTuple):
    """How the effort of a drive becomes that of an output: rate of the drive per that of it."""

    #: Least magnitude, where it is taken (an ``Extreme``).
    least: Extreme
    #: Values of the drive at which the output stands still and the advantage is infinite.
    dead_centres: Tuple[float, ...]


def output_joints(run) -> Dict[str, Tuple[bool, int]]:
    """
    Return the joints of the ground but the drives: whether they are cut joints, and their rates.

    By name; only joints whose coordinate is one number.
    """
    mechanism, found = run.mechanism, {}
    for is_cut, coordinates in ((False, mechanism.coordinates), (True, mechanism.cut_coordinates)):
        grounded = {joint.name for joint in mechanism.joints if joint.parent == GROUND} | {
            cut.name for cut in mechanism.cut_joints if GROUND in (cut.body_a, cut.body_b)}
        found.update({
            coordinates.names[k]: (is_cut, k) for k in coordinates.single
            if coordinates.joint_of(coordinates.names[k]) in grounded
            and coordinates.names[k] not in run.driven})
    return found


def transmission_extremes(run) -> Tuple[Extreme, ...]:
    """
    Return the extremes of the transmission angle but right angles [rad], the least one first.

    In a four-bar linkage there are two in a turn. Solved between the poses; none where nothing
    pushes an output link (``transmission.transmission_angle``).
    """
    name = run.drive.name

    def angle(position, _):
        return transmission_angle(run.mechanism, np.atleast_2d(position), name)

    values = angle(run.position, None)
    if values is None:
        return ()
    # The first pose of a whole turn is the last one, too.
    turns = _is_turn(run) and math.isclose(values[0], values[-1], rel_tol=RETURNED)
    found = []
    for sign in (1.0, -1.0):
        signed = sign * values
        before, after = np.roll(signed, 1), np.roll(signed, -1)
        before[0], after[-1] = (signed[-2] if turns else np.inf), np.inf
        places = np.flatnonzero((signed <= before) & (signed < after) & (values < FULL))
        for k in places[places < len(values) - turns].tolist():
            one = _extreme(run, lambda q, v, sign=sign: sign * float(angle(q, v)[0]), signed, k)
            found.append(one._replace(value=sign * one.value))
    return tuple(sorted(found))


def advantages(run) -> Dict[str, Advantage]:
    """Return the mechanical advantage of each output joint of the tree, by name."""
    drive = run.drive.values
    speed = (drive[-1] - drive[0]) / run.time[-1]
    found = {}
    for output, (is_cut, k) in output_joints(run).items():
        if is_cut:
            continue

        def ratio(_, velocity, k=k):
            return float(velocity[k]) / speed

        values = run.velocity[:, k] / speed
        if not np.abs(values).max() > 0.0:
            continue
        fastest = _extreme(run, lambda q, v, of=ratio: -abs(of(q, v)), -np.abs(values),
                           int(np.argmax(np.abs(values))))
        found[output] = Advantage(
            Extreme(-1.0 / fastest.value, fastest.drive), tuple(_zeros(run, ratio, values)))
    return found


def opened(run) -> Dict[str, float]:
    """
    Return how far joints are from their start after a whole turn of the drive [rad; m].

    By name, of joints that do not return but for whole turns; empty for other drives.
    """
    if not _is_turn(run):
        return {}
    names, found = run.mechanism.coordinates, {}
    for k in names.single:
        away = float(run.position[-1, names.place[k]] - run.position[0, names.place[k]])
        if not names.lengths[k]:
            away -= TURN * round(away / TURN)
        span = np.ptp(run.position[:, names.place[k]])
        if names.names[k] not in run.driven and abs(away) > RETURNED * max(1.0, span):
            found[names.names[k]] = away
    return found


def load_spectrum(force) -> List[Tuple[float, float, float]]:
    """
    Return range, mean and number of cycles of a force over a motion, the largest range first.

    By the rainflow method (ASTM E1049-85).
    """
    # Only here: a report is what asks for it.
    import rainflow
    cycles = [(size, mean, count) for size, mean, count, _, _ in rainflow.extract_cycles(force)]
    return sorted(cycles, reverse=True)


def _is_turn(run):
    """Return whether the drive makes a whole turn."""
    drive = run.drive.values
    return run.end is None and abs(abs(drive[-1] - drive[0]) - TURN) < RETURNED


def _share(run, place):
    """Return the share of the way at a place among the poses."""
    return place / (run.count - 1)


def _extreme(run, of, values, k):
    """Return the least value of a quantity, sampled at the poses, near a pose."""
    from scipy.optimize import minimize_scalar
    low, high = max(k - 1, 0), min(k + 1, len(values) - 1)
    found = minimize_scalar(lambda place: of(*run.solve(_share(run, place))[:2]),
                            bounds=(low, high), method='bounded', options={'xatol': FLAT})
    value, place = float(values[k]), float(k)
    # A pose that is as good but for rounding has a round number.
    if found.fun < value - NOTHING * abs(value):
        value, place = float(found.fun), float(found.x)
    return Extreme(value, run.drive_at(_share(run, place)))


def _zeros(run, of, values):
    """Return the values of the drive at which a quantity, sampled at the poses, is zero."""
    from scipy.optimize import brentq
    signs = np.where(np.abs(values) > NOTHING * np.abs(values).max(), np.sign(values), 0.0)
    found = []
    # The end of a turn is its beginning.
    for k in range(len(signs) - _is_turn(run)):
        if signs[k] == 0.0:
            found.append(run.drive_at(_share(run, k)))
        elif k + 1 < len(signs) and signs[k] * signs[k + 1] < 0.0:
            found.append(run.drive_at(_share(run, brentq(
                lambda place: of(*run.solve(_share(run, place))[:2]), k, k + 1, xtol=EXACT))))
    return found
