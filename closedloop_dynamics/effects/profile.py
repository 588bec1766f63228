# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Profiles over time: a quantity as a chain of segments, each a polynomial and a sine.

    y(t) = c0 + u (c1 + ... u c5) + a sin(w u + p),     u = t - (start of the segment)

A state of the effect counts the segments, so that within a step one formula holds; steps end where
the next begins (``engine/time_events.hpp``). With a period the chain repeats for ever.
"""

from bisect import bisect_right
from functools import partial
import math
from operator import itemgetter

import numpy as np

from ..codegen.expression_graph import chosen, cosine, sine
from ..mechanism.fields import FieldError, shown

# Columns of a segment: its start [s], c0 to c5, a, w, p.
COEFFICIENTS, COLUMNS = 6, 10
# Shape -> the keys that it needs, and those that it may have.
RAMPS = (('amplitude', 'rise'), ('offset', 'start', 'hold', 'fall', 'period'))
SHAPES = {
    'constant': (('amplitude',), ()),
    'sine': (('amplitude', 'frequency'), ('phase', 'offset')),
    'trapezoid': RAMPS,
    'cycloid': RAMPS,
    'table': (('times', 'values'), ('interpolation', 'period')),
    'expression': (('expression',), ())}
INTERPOLATIONS = ('linear', 'cubic', 'step')
# Times closer than this, relative to their size, are the same.
SAME_TIME = 1e-12


def require_joint_or_point(record, wanted):
    """
    Refuse a record of neither a joint nor a point, or of both, and a point without a direction.

    ``wanted``: that of the direction. FieldError.
    """
    if (record.joint is None) == (record.point is None):
        raise FieldError('either joint or point', 'neither' if record.joint is None else 'both',
                         path=('joint',))
    if (record.point is None) != (record.direction is None):
        raise FieldError(wanted, shown(record.direction), path=('direction',))
    if record.direction is not None and not math.hypot(*record.direction) > 0.0:
        raise FieldError('a direction that is not zero', shown(record.direction),
                         path=('direction',))


def require_keys(record, shapes=SHAPES):
    """
    Refuse keys that the shape of a profile does not have, and miss those that it needs.

    Of a record with the keys of all shapes as attributes, None where not given; ``shapes``:
    required and optional keys by shape. FieldError.
    """
    required, optional = shapes[record.shape]
    for key in required:
        if getattr(record, key) is None:
            raise FieldError(f'this required key of shape: {record.shape}', 'none', path=(key,))
    for key in {key: 0 for lists in shapes.values() for keys in lists for key in keys}:
        if key not in required + optional and getattr(record, key) is not None:
            of = ', '.join(shape for shape, keys in shapes.items() if key in keys[0] + keys[1])
            raise FieldError(f'this key only with shape: {of}', shown(getattr(record, key)),
                             f'remove it, as the shape is {record.shape}', (key,))


def segments(record):
    """
    Return the segments of a profile, rows of COLUMNS floats, of a record with its shape and keys.

    FieldError.
    """
    if record.shape == 'constant':
        return (segment(0.0, record.amplitude),)
    if record.shape == 'sine':
        return (segment(0.0, record.offset or 0.0, wave=wave(record)),)
    if record.shape == 'table':
        return _of_table(record)
    return ramps(record, record.offset or 0.0, partial(ramp, shape=record.shape))


def segment(start, *coefficients, wave=(0.0, 0.0, 0.0)):
    """Return a segment: start [s], coefficients c0, c1, ..., a wave a, w, p; zero by default."""
    return (start, *coefficients, *(COEFFICIENTS - len(coefficients)) * (0.0,), *wave)


def wave(record):
    """Return a, w and p of a sine."""
    return record.amplitude, 2.0 * math.pi * record.frequency, record.phase or 0.0


def ramps(record, low, ramp):
    """
    Return the segments of a rise from ``low``, a rest on top where there is one, and a fall.

    The record has the keys of a trapezoid or cycloid; ``ramp`` returns the segments of a rise, of
    its start, duration, level and height.
    """
    fall = record.rise if record.fall is None else record.fall
    found, now = [segment(0.0, low)], record.start or 0.0
    top = low + record.amplitude
    found += ramp(now, record.rise, low, record.amplitude)
    now += record.rise
    found.append(segment(now, top))
    if record.hold is not None:
        now += record.hold
        found += ramp(now, fall, top, -record.amplitude)
        now += fall
        found.append(segment(now, low))
    elif record.fall is not None:
        raise FieldError('this key beside hold, after which it falls', 'it alone', path=('fall',))
    elif record.period is not None:
        raise FieldError('this key beside hold, after which it falls', 'it alone',
                         path=('period',))
    if record.period is not None and now > record.period * (1.0 + SAME_TIME):
        raise FieldError(f'no less than start, rise, hold and fall together ({now:g} s)',
                         f'{record.period:g}', path=('period',))
    return _without_empty(found, record.period)


def ramp(start, duration, level, height, shape):
    """Return a trapezoid's or cycloid's ramp: one segment, or none where it takes no time."""
    if duration == 0.0:
        return []
    wave = (0.0, 0.0, 0.0) if shape == 'trapezoid' else (
        -height / (2.0 * math.pi), 2.0 * math.pi / duration, 0.0)
    return [segment(start, level, height / duration, wave=wave)]


def require_table(record):
    """Return times and values of a table and its period; raise FieldError for anything else."""
    times, values, period = np.array(record.times), np.array(record.values), record.period
    if len(times) < 2:
        raise FieldError('two times or more', f'{len(times)}', path=('times',))
    if len(values) != len(times):
        raise FieldError(f'{len(times)} values, one for each time', f'{len(values)}',
                         path=('values',))
    for index, (one, other) in enumerate(zip(times, times[1:])):
        if not one < other:
            raise FieldError(f'times that grow (more than {one:g})', f'{other:g}',
                             path=('times', index + 1))
    if period is not None and (times[0] != 0.0 or abs(times[-1] - period) > SAME_TIME * period):
        raise FieldError(f'times from 0 to the period of {period:g} s',
                         f'{times[0]:g} to {times[-1]:g}', path=('times',))
    return times, values, period


def require_closed(values):
    """Refuse a periodic spline through a table that does not end where it begins."""
    if values[0] != values[-1]:
        raise FieldError(f'the first value ({values[0]:g}) again at the end of the period',
                         f'{values[-1]:g}', path=('values', len(values) - 1))


def _of_table(record):
    """Return the segments between the rows of a table; before and after it the ends hold."""
    times, values, period = require_table(record)
    kind = record.interpolation or 'linear'
    if period is not None and kind == 'cubic':
        require_closed(values)
    # Before the table, wherever that begins.
    rows = [segment(times[0] - 1.0, values[0])] if period is None else []
    if kind == 'cubic':
        # Not before it is wanted: it takes a third of the time that loading the package would.
        from scipy.interpolate import CubicSpline
        spline = CubicSpline(times, values, bc_type='not-a-knot' if period is None else 'periodic')
        rows += [segment(start, *spline.c[::-1, k])
                 for k, start in enumerate(times[:-1])]
    else:
        slopes = np.diff(values) / np.diff(times) * (kind == 'linear')
        rows += map(segment, times[:-1], values[:-1], slopes)
    rows.append(segment(times[-1], values[-1]))
    return _without_empty(rows, period)


def _without_empty(found, period):
    """Leave out segments that take no time; those of a period begin at 0."""
    ends = [segment[0] for segment in found[1:]] + [math.inf if period is None else period]
    kept = [segment for segment, end in zip(found, ends)
            if end - segment[0] > SAME_TIME * max(1.0, abs(segment[0]))]
    return tuple(tuple(map(float, segment)) for segment in kept)


def present(found, period, time):
    """Return which of the segments is the present one, counted on through all periods [s]."""
    time += SAME_TIME * max(1.0, abs(time))
    cycle = 0 if period is None else math.floor(time / period)
    inside = time if period is None else time - cycle * period
    return float(cycle * len(found) + bisect_right(found, inside, 1, key=itemgetter(0)) - 1)


def terms(row):
    """Return which terms the profile of a row of the table has, for the code of a scene."""
    if row.values[1] == 1.0:
        return 'expression',
    segments = row.data[:COLUMNS * row.count].reshape(-1, COLUMNS)
    return bool(segments[:, 5:7].any()), bool(segments[:, 7].any())


def values_of_segment(c, u, high=True, turns=True):
    """
    Return the value of a segment, its rate and its change, at a time since it began [s].

    Parameters
    ----------
    c : sequence
        Coefficients c0 to c5, a, w and p; numbers or symbols.
    u : float or Symbol
        The time.
    high, turns : bool
        Whether there are c4 and c5, and a.

    """
    last = c[3] + u * (c[4] + u * c[5]) if high else c[3]
    value = c[0] + u * (c[1] + u * (c[2] + u * last))
    rate = c[1] + u * (2.0 * c[2] + 3.0 * u * c[3])
    change = 2.0 * c[2] + 6.0 * u * c[3]
    if high:
        rate = rate + u * u * u * (4.0 * c[4] + 5.0 * u * c[5])
        change = change + u * u * (12.0 * c[4] + 20.0 * u * c[5])
    if turns:
        size, turning = c[6], c[7]
        angle = turning * u + c[8]
        value = value + size * sine(angle)
        rate = rate + size * turning * cosine(angle)
        change = change - size * turning * turning * sine(angle)
    return value, rate, change


def present_values(forces):
    """
    Return the value of the profile of an effect at the present time, its rate and its change.

    The engine has looked up the segment, or evaluated the expression and its derivatives.
    """
    begun, start, *c = forces.present_piece()
    if forces.terms == ('expression',):
        return c[:3]
    found = values_of_segment(c, forces.state(0) - begun - start, *forces.terms or ())
    if forces.terms is not None:
        return found
    written = forces.values[1] > 0.5
    return tuple(chosen(written, *both) for both in zip(c, found))


def value(forces):
    """Return the value of the profile of an effect at the present time, or the held one."""
    return present_values(forces)[0] if forces.held is None else forces.held


def values_at(segments, period, time):
    """Return the value of a profile at a time [s], its rate and its change."""
    count = len(segments)
    number = int(present(segments, period, time))
    cycle = 0 if period is None else number // count
    start, *c = segments[number - cycle * count]
    return values_of_segment(c, time - cycle * (period or 0.0) - start)
