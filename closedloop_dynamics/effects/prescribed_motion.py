# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Prescribed motion of a joint or a point as a function of time (a rheonomic constraint).

    q = f(t)          of a joint
    e . p = f(t)      of a named point, along a direction e in world axes

One closure equation beside those of the loops, exact: its right-hand sides are f, f' and f''. Its
multiplier is the torque of the drive, or its force along e, found with the accelerations; work
done on the mechanism: the integral of that times f'. f may bend but not jump, nor may f'. When:
cranks at constant speed, cams and programs of axes, torques of an inverse-dynamics run.
"""

from dataclasses import dataclass
from functools import partial
import math
from typing import Optional, Tuple

import numpy as np

from . import expression, profile
from .effect import Effect
from .element import ForceElement, OWN, State, WORK
from .force_law import force_law, MOTION
from ..mechanism.checks import (
    count, freedom, list_of, name, not_negative, number, one_of, positive, text, vector)
from ..mechanism.coordinates import EITHER
from ..mechanism.fields import at, FieldError, shown
from ..mechanism.mechanism import DrivingConstraint, GROUND, Vector

REST, MOVING = 'rest', 'moving'
COMMANDED = 'commanded'
RATES = ('values', 'rates', 'accelerations')
# Most points of a profile that is commanded, where a scene does not say.
ROOM = 200
# Jumps of f and f', against the largest value and rate, that are rounding.
NO_JUMP = 1e-9
SHAPES = {
    'constant': ((), ('offset',)),
    'constant_speed': (('speed',), ('offset',)),
    'sine': (('amplitude', 'frequency'), ('phase', 'offset')),
    'trapezoid': (profile.RAMPS[0], (*profile.RAMPS[1], 'ramp')),
    'cycloid': profile.RAMPS,
    'table': (('times', 'values'), ('ends', 'period')),
    'expression': (('expression',), ()),
    COMMANDED: ((), ('times', 'values', 'rates', 'accelerations', 'ends', 'room'))}


@dataclass(frozen=True)
class PrescribedMotion(Effect):
    """
    A motion of a joint or a point that is given over time.

    Attributes
    ----------
    shape : str
        ``constant``, ``constant_speed``, ``sine``, ``trapezoid`` (of the speed), ``cycloid``,
        ``table``, ``expression``, or ``commanded`` while it runs.
    joint : str or None
        What moves: a joint, or
    point : str or None
        a named point.
    direction : tuple of 2 floats, or 3 in space, or None
        Along which the point moves, in world axes; its length does not matter.
    offset : float or None
        Added; a trapezoid or cycloid rises from there [rad; m]; where the joint or point starts
        in the scene when not given.
    speed : float or None
        Of a constant speed [rad/s; m/s].
    amplitude : float or None
        Height of a sine, of a trapezoid's or a cycloid's rise [rad; m].
    frequency : float or None
        Of a sine, positive [Hz].
    phase : float or None
        Of a sine [rad]; 0 when not given.
    start : float or None
        When a rise begins, zero or more [s]; 0 when not given.
    rise : float or None
        How long it takes, positive [s].
    ramp : float or None
        How long the speed of a trapezoid grows, and falls, at most half the rise [s]; a third of
        the rise when not given, and of the fall.
    hold : float or None
        How long the rest on top takes, zero or more [s]; for good when not given.
    fall : float or None
        How long the way back takes, positive [s]; as long as the rise when not given.
    period : float or None
        After which a trapezoid, cycloid or table repeats, positive [s]; never when not given.
    times : tuple of floats or None
        Of a table or a profile that was commanded, growing [s].
    values : tuple of floats or None
        At these times [rad; m]; through a table a cubic spline leads.
    rates, accelerations : tuple of floats or None
        Of a profile that was commanded, at these times [rad/s; m/s], [rad/s^2; m/s^2]: polynomials
        of the third degree, with accelerations of the fifth.
    ends : str or None
        Of a table: ``rest`` (when not given), where it rests before and after, or ``moving``,
        where it goes on at the speed that it has there. So does a commanded profile after its end.
    room : int or None
        Most points of a profile that is commanded, one or more; 200 when not given.
    expression : str or None
        Of the time ``t`` [s], such as ``4.7124*t`` [rad; m].

    """

    CHECKS = {
        'joint': freedom, 'point': name, 'direction': vector, 'shape': one_of(tuple(SHAPES)),
        'offset': number, 'speed': number, 'amplitude': number, 'frequency': positive,
        'phase': number, 'start': not_negative, 'rise': positive, 'ramp': positive,
        'hold': not_negative, 'fall': positive, 'period': positive, 'times': list_of(number),
        'values': list_of(number), 'rates': list_of(number), 'accelerations': list_of(number),
        'ends': one_of((REST, MOVING)), 'room': count, 'expression': text}
    FILES = {'file': ('times', 'values')}
    VECTORS = ('direction',)
    STIFFENS = False
    READINGS = ('force', 'power', 'position', 'velocity')

    shape: str
    joint: Optional[str] = None
    point: Optional[str] = None
    direction: Optional[Vector] = None
    offset: Optional[float] = None
    speed: Optional[float] = None
    amplitude: Optional[float] = None
    frequency: Optional[float] = None
    phase: Optional[float] = None
    start: Optional[float] = None
    rise: Optional[float] = None
    ramp: Optional[float] = None
    hold: Optional[float] = None
    fall: Optional[float] = None
    period: Optional[float] = None
    times: Optional[Tuple[float, ...]] = None
    values: Optional[Tuple[float, ...]] = None
    ends: Optional[str] = None
    expression: Optional[str] = None
    rates: Optional[Tuple[float, ...]] = None
    accelerations: Optional[Tuple[float, ...]] = None
    room: Optional[int] = None

    def __post_init__(self):
        """Refuse a motion of nothing or of two things, and one that jumps."""
        super().__post_init__()
        profile.require_joint_or_point(self, 'a direction for a point, and for no joint')
        profile.require_keys(self, SHAPES)
        object.__setattr__(self, '_data', self._profile())
        if self.expression is None:
            # What was commanded begins where the profile before it was.
            _require_smooth([segment for segment in self._data if segment[0] < math.inf][
                self.shape == COMMANDED and self.times is not None:], self.period)
        elif not np.isfinite(self.at(0.0)).all():
            raise FieldError('position, rate and acceleration that are finite at t = 0',
                             f'{shown(self.expression)}, whose are '
                             f'{", ".join(f"{one:g}" for one in self.at(0.0))}',
                             path=('expression',))

    @property
    def from_start(self):
        """Whether the motion starts where the scene does: no offset, or no profile, is given."""
        if self.shape == COMMANDED:
            return self.times is None
        return self.offset is None and 'offset' in SHAPES[self.shape][1]

    def _profile(self):
        """Return the entries of the table: segments, from 0 on, or expression and derivatives."""
        if self.shape == 'expression':
            with at('expression'):
                return expression.programs(self.expression)
        if self.shape == 'constant':
            return (profile.segment(0.0, 0.0, 0.0),)
        if self.shape == 'constant_speed':
            return (profile.segment(0.0, 0.0, self.speed),)
        if self.shape == 'table':
            return _of_table(self)
        if self.shape == COMMANDED:
            return _commanded(self)
        if self.shape == 'trapezoid':
            return profile.ramps(self, 0.0, self._trapezoid)
        if self.shape == 'cycloid':
            return profile.ramps(self, 0.0, partial(profile.ramp, shape='cycloid'))
        return (profile.segment(0.0, 0.0, wave=profile.wave(self)),)

    def _trapezoid(self, start, duration, level, height):
        """Return the segments of a rise with a trapezoidal speed."""
        ramp = duration / 3.0 if self.ramp is None else self.ramp
        if ramp > 0.5 * duration:
            raise FieldError(f'at most half of the time that a rise or fall takes '
                             f'({0.5 * duration:g} s)', f'{ramp:g}', path=('ramp',))
        speed = height / (duration - ramp)
        curve, climbed = 0.5 * speed / ramp, 0.5 * speed * ramp
        return [profile.segment(start, level, 0.0, curve),
                profile.segment(start + ramp, level + climbed, speed),
                profile.segment(start + duration - ramp, level + height - climbed, speed, -curve)]

    @property
    def ENDS_STEPS(self):  # noqa: N802
        """Whether the profile has corners."""
        return self.expression is None and (len(self._data) > 1 or self.period is not None)

    def fit(self, mechanism):
        """Refuse invalid names, as every effect, and the motion of a point on the ground."""
        super().fit(mechanism)
        if self.point is not None:
            if mechanism.point(self.point).body == GROUND:
                raise FieldError('a point of a body that moves', f'{self.point!r} on the ground',
                                 path=('point',))

    def motion(self, key):
        """Return the closure equation, named by a key."""
        if self.joint is not None:
            return DrivingConstraint(key, freedom=self.joint)
        length = math.hypot(*self.direction)
        return DrivingConstraint(key, point=self.point,
                                 direction=tuple(one / length for one in self.direction))

    def commanded(self, now, start, times, values, rates=None, accelerations=None):
        """
        Return the keys of another profile, from the present state on through points.

        ``now``: the time [s]; ``start``: where the joint or point starts in the scene; ``times``,
        ``values``: of the points, the first not before now, and growing [s], [rad; m]; rates and
        accelerations at the points or None: without rates those of the cubic spline through the
        points, at rest at the last one. FieldError for points in the past, for those that are no
        numbers, and for jumps away from the present state.
        """
        if self.shape != COMMANDED:
            raise FieldError(f'a motion of the shape {COMMANDED}, which follows commands',
                             f'one of the shape {self.shape}', path=('shape',))
        if accelerations is not None and rates is None:
            raise FieldError('accelerations only beside rates', 'them alone',
                             path=('accelerations',))
        given = {key: self.CHECKS[key](values) for key, values in (
            ('times', times), ('values', values), ('rates', rates),
            ('accelerations', accelerations)) if values is not None}
        for key, numbers in given.items():
            if len(numbers) != len(given['times']) or not numbers:
                raise FieldError(f'{len(given["times"]) or "one or more"} numbers',
                                 f'{len(numbers)}', path=(key,))
        knots = np.array([given[key] for key in RATES if key in given])
        times, same = np.array(given['times']), profile.SAME_TIME * max(1.0, abs(now))
        present = self.at(now, start)
        if times[0] < now - same:
            raise FieldError(f'times from now on, which is {now:.9g} s', f'{times[0]:.9g} s',
                             path=('times', 0))
        if times[0] <= now + same:
            for what, one, other in zip(('position', 'rate'), present, knots[:, 0]):
                if not abs(other - one) <= NO_JUMP * max(1.0, abs(one)):
                    raise FieldError(f'a profile that begins at the present {what}, {one:.9g}',
                                     f'a jump to {other:.9g}', path=(what,))
            present[2] = knots[2, 0] if len(knots) > 2 else present[2]
            times, knots = times[1:], knots[:, 1:]
        times = np.concatenate(([now], times))
        knots = np.column_stack((present[:len(knots)], knots))
        if rates is None:
            knots = np.array((knots[0], _slopes(times, knots[0], present[1])))
        found = dict(zip(RATES, knots))
        return {key: tuple(map(float, found[key])) if key in found else None
                for key in RATES} | {'times': tuple(map(float, times))}

    def clock(self, time):
        """Return the time, and which segment of the profile is the present one."""
        segments = ((0.0,),) if self.expression is not None else self._data
        return time, profile.present(segments, self.period, time)

    def at(self, time, start=0.0):
        """
        Return where the motion is at a time [s], its rate and its acceleration, shape (3,).

        ``start``: where the joint or point starts in the scene [rad; m].
        """
        found = [expression.value_at(entry, time) for entry in self._data] if (
            self.expression is not None) else profile.values_at(self._data, self.period, time)
        return np.array(found) + [self._offset(start), 0.0, 0.0]

    def _offset(self, start):
        return start if self.from_start else self.offset or 0.0

    def element(self, machine):
        """Return the effect as a row of the table."""
        *equation, start = machine.motion(self.motion(''))
        first, second = np.cumsum([len(entry) for entry in self._data[:2]]) if (
            self.expression is not None) else (0, 0)
        return ForceElement(
            motion_over_time, equation=tuple(equation),
            values=(self.period or 0.0, float(self.expression is not None), self._offset(start),
                    float(first), float(second)),
            states=(State(OWN), State(OWN, 1.0, self.clock(0.0)[1]), State(WORK)),
            data=self._data)


@force_law(role=MOTION, terms=profile.terms, in_lanes=False,
           engine_only='it follows the time')
def motion_over_time(forces):
    position, rate, change = profile.present_values(forces)
    forces.drive(forces.values[2] + position, rate, change)


def _of_table(record):
    """Return the segments of a cubic spline through a table."""
    times, values, period = profile.require_table(record)
    moving = record.ends == MOVING
    if period is not None:
        profile.require_closed(values)
        if record.ends is not None:
            raise FieldError('this key only without period', shown(record.ends), path=('ends',))
    # Not before it is wanted: it takes a third of the time that loading the package would.
    from scipy.interpolate import CubicSpline
    spline = CubicSpline(times, values, bc_type='periodic' if period is not None else (
        'not-a-knot' if moving else 'clamped'))
    rows = [profile.segment(start, *spline.c[::-1, k]) for k, start in enumerate(times[:-1])]
    if period is None:
        slopes = spline(times[[0, -1]], 1) * moving
        rows = [profile.segment(times[0] - 1.0, values[0] - slopes[0], slopes[0]), *rows,
                profile.segment(times[-1], values[-1], slopes[1])]
    return tuple(tuple(map(float, row)) for row in rows)


def _commanded(record):
    """Return the segments of a profile that was commanded, and room for those of others."""
    room = record.room or ROOM
    if record.times is None:
        for key in RATES:
            if getattr(record, key) is not None:
                raise FieldError('this key beside times', 'it alone', path=(key,))
        rows = [profile.segment(0.0, 0.0)]
    else:
        rows = _through(record)
    if len(rows) > room + 2:
        raise FieldError(f'at most {room} points, which there is room for',
                         f'{len(rows) - 2}', 'give it more `room` in the scene', ('times',))
    # Segments that never begin.
    rows += (room + 2 - len(rows)) * [profile.segment(math.inf)]
    return tuple(tuple(map(float, row)) for row in rows)


def _through(record):
    """Return polynomials through the points of a commanded profile, at rest before the first."""
    given = [(key, getattr(record, key)) for key in RATES]
    for key, numbers in given[:2] + [one for one in given[2:] if one[1] is not None]:
        if numbers is None or len(numbers) != len(record.times):
            raise FieldError(f'{len(record.times)} numbers, one for each time',
                             'none' if numbers is None else f'{len(numbers)}', path=(key,))
    times = np.array(record.times)
    if len(times) < 1 or not (np.diff(times) > profile.SAME_TIME * np.maximum(
            1.0, np.abs(times[1:]))).all():
        raise FieldError('one time or more, growing', shown(record.times), path=('times',))
    knots = np.array([numbers for _, numbers in given if numbers is not None]).T
    last_rate = knots[-1, 1]
    if record.ends != MOVING and last_rate != 0.0:
        raise FieldError('rest at the end (a rate of 0)', f'a rate of {last_rate:g}',
                         'or `ends: moving` in the scene', ('rates', len(times) - 1))
    rows = [profile.segment(times[0] - 1.0, knots[0, 0])]
    with np.errstate(all='ignore'):
        for start, duration, one, other in zip(times, np.diff(times), knots, knots[1:]):
            row = profile.segment(start, *_polynomial(duration, one, other))
            if not np.isfinite(row).all():
                raise FieldError('a profile that can be followed',
                                 f'rates or accelerations beyond all bounds at t = {start:.6g} s')
            rows.append(row)
    return [*rows, profile.segment(times[-1], knots[-1, 0], last_rate)]


def _slopes(times, values, rate):
    """Return the slopes of the cubic spline through points, with a rate at first, then rest."""
    if len(times) < 3:
        return np.array([rate, *(len(times) - 1) * (0.0,)])
    if not (np.diff(times) > 0.0).all():
        raise FieldError('times that grow', shown(times.tolist()), path=('times',))
    from scipy.interpolate import CubicSpline
    found = CubicSpline(times, values, bc_type=((1, rate), (1, 0.0)))(times, 1)
    # Not even by rounding.
    found[-1] = 0.0
    return found


def _polynomial(duration, one, other):
    """Return the coefficients of the polynomial between two points: value, rate, acceleration."""
    h, way = duration, other[0] - one[0]
    if len(one) == 2:
        slope = way / h
        return (*one, (3.0 * slope - 2.0 * one[1] - other[1]) / h,
                (one[1] + other[1] - 2.0 * slope) / h ** 2)
    rate, last, curve, end = one[1] * h, other[1] * h, one[2] * h * h, other[2] * h * h
    return (*one[:2], 0.5 * one[2],
            (20.0 * way - 12.0 * rate - 8.0 * last - 3.0 * curve + end) / (2.0 * h ** 3),
            (-30.0 * way + 16.0 * rate + 14.0 * last + 3.0 * curve - 2.0 * end) / (2.0 * h ** 4),
            (12.0 * way - 6.0 * rate - 6.0 * last - curve + end) / (2.0 * h ** 5))


def _require_smooth(segments, period):
    """Refuse segments where position or speed jumps from one to the next."""
    ends = [*(segment[0] for segment in segments[1:]), *([] if period is None else [period])]
    # Once around, where the profile begins again.
    following = [*segments[1:], *([] if period is None else [segments[0]])]
    met = [(*_at(one, end - one[0]), *_at(other, 0.0), end)
           for one, other, end in zip(segments, following, ends)]
    inside = [_at(segment, share * (end - segment[0]))
              for segment, end in zip(segments, ends) for share in (0.25, 0.5, 1.0)]
    for n, (what, unit) in enumerate((
            ('position', EITHER['position']), ('speed', EITHER['velocity']))):
        most = max((abs(each[n]) for each in inside), default=0.0)
        for row in met:
            if abs(row[n + 2] - row[n]) > NO_JUMP * most:
                raise FieldError(
                    'a motion without jumps of its position and speed',
                    f'a {what} that jumps from {row[n]:.6g} to {row[n + 2]:.6g} {unit} at '
                    f't = {row[4]:.6g} s')


def _at(segment, u):
    """Return value and rate of a segment after some time."""
    return profile.values_of_segment(segment[1:], u)[:2]
