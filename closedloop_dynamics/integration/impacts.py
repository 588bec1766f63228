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

"""
The instants at which bodies begin to touch and part again.

Within a step a contact is there or not, whatever the sign of the gap, so that the motion is
smooth and what a step finds of the gap is right to its last digits. A step at whose end a gap
contradicts that is never taken: it is cut where the gap changes its sign, by a cubic through gap
and rate at both ends, then by Newton's method within the bracket of the longest part that agrees
and the shortest that does not. The next step begins at once with the size that suits the new
motion.

A step whose ends agree may have passed through a contact in between. It has not where the gaps of
both ends together are more than the gap can have changed by: the step's size times the fastest
rate in all its evaluations. Otherwise dense output is looked into, and the step halved until every
interval is clear:

- Where the gap is smooth (lines, planes, stops, cables), a cubic through gaps and rates less its
  error stays on the right side; the error is what the interval before was found to miss at its
  middle, and falls with the fourth power.
- Beside a body of finite extent the nearest place jumps from one side to another, and no cubic is
  valid. There the chord of the path, as that body sees it, comes nowhere nearer than the path
  departs from it; what both ends are near does not count, but places between.

Where that is not clear at the finest level, the step ends there.

"""

import math

from ..core.compiled import compiled, inlined, merged
from ..effects import curve
from ..effects.table import (
    BEND, CHANGED, CIRCLE_CONTACT, CURVE_CONTACT, DATA, ENTRIES, ERROR, FASTEST, FREE, GAP, HIGH,
    LARGEST, LEVELS, LOST, LOW, NODE_COLUMNS, NODE_LEVELS, PLACE, RATE, REFINED, SHARES,
    SPATIAL_BODY_CONTACT, SPEED, STATE, STORED, SUSPECTED, TOP, TOUCHING, UNDECIDED, WRONG)

# Gaps of less than this are none [m]: a contact begins or ends there.
CLOSED = 1e-11
# The least part of a step that is looked for where bodies touch to begin with: they do where the
# gap is no more than NO_GAP [m].
LEAST_PART, NO_GAP = 1e-6, 1e-9
# Halvings of the interval in which it is.
HALVINGS = 50
# Parts of a step that agree and those that do not are the same where they are as close as this.
SAME = 1e-12
# Rates may be this much faster between the evaluations of a step.
FASTER = 1.25
# A path is resolved where it is no longer than the largest gap that is seen, or than so many
# chords: a point on a circle that comes near does not turn round unseen.
CHORDS = 2.0
# What a smaller interval is found to miss may be this many times what is expected.
SAFER = 2.0
# Share of the larger gap by which the path may depart from its chord.
BENT = 0.25
# Evaluations on the wrong side, relative to what the gap may change by, that tell nothing.
SLIGHT = 0.01
# Cuts of one step where nothing but suspicion is the reason, and of one that agrees for the last
# digits of its end.
MOST_SUSPICIONS, MOST_REFINED = 4, 10
# Even parts of an interval between which a cubic is judged, beside its turning points.
PLACES = 8
# How far what touches is from velocity times time, as a share of the way that it would have gone,
# and relative to how deep it is: beyond both, a method has stepped over the whole impact.
FAR, DEPTHS = 0.25, 10.0
# Part of a refused trial that is tried next.
SHORTER = 0.2
# Dissipated energy may fall by this share of it, or of what is stored, by errors of integration.
FALLS = 1e-3


@merged
def begin(effects):
    """
    Decide, after the evaluation at which a step begins, which bodies touch during it.

    Parameters
    ----------
    effects : EffectTable
        Of the system; here and below.

    Returns
    -------
    bool
        Whether any begin or cease to touch just here.

    """
    contacts, changed = effects.contacts, False
    for k in range(contacts.rows.shape[0]):
        row = contacts.rows[k]
        if effects.enabled[row] == 1:
            gap, rate = contacts.now[row, GAP], contacts.now[row, RATE]
            touches = gap < 0.0
            if abs(gap) <= 2.0 * CLOSED:
                changed = True
                touches = rate < 0.0
            contacts.mode[row] = TOUCHING if touches else FREE
            for i in range(PLACE + 3):
                contacts.start[row, i] = contacts.now[row, i]
            contacts.trial[row, CHANGED] = 0.0
            contacts.trial[row, LOST] = effects.states[effects.index[row, STATE]]
    forget(contacts)
    return changed


@merged
def forget(contacts):
    """
    Forget the bracket, and what former trials have shown.

    A trial that fails for another reason says nothing. ``contacts``: of the effects.

    """
    contacts.search[LOW], contacts.search[HIGH] = 0.0, math.inf
    contacts.search[SUSPECTED] = contacts.search[REFINED] = 0.0
    _clear(contacts)


@inlined
def _clear(contacts):
    """Prepare for the evaluations of another trial."""
    for k in range(contacts.rows.shape[0]):
        row = contacts.rows[k]
        for column in (FASTEST, SPEED, WRONG):
            contacts.trial[row, column] = 0.0


@merged
def end(contacts):
    """Let gaps decide again which bodies touch, after a step; ``contacts`` as above."""
    for k in range(contacts.rows.shape[0]):
        contacts.mode[contacts.rows[k]] = UNDECIDED


@inlined
def _cubic(start, slope, bend, twist, share):
    """Return the gap at a share of a step."""
    return start + share * (slope + share * (bend + share * twist))


@inlined
def _coefficients(left, right, row, sign, size):
    """Return the coefficients of the cubic through gaps and rates of two nodes, by share."""
    start, slope = sign * left[row, GAP], sign * size * left[row, RATE]
    rise, last = sign * right[row, GAP] - start, sign * size * right[row, RATE]
    return start, slope, 3.0 * rise - 2.0 * slope - last, slope + last - 2.0 * rise


@inlined
def _turning_points(slope, bend, twist):
    """Return where slope + 2 bend x + 3 twist x^2 = 0, the lesser first; 1 where nowhere."""
    one, other = 1.0, 1.0
    root = bend * bend - 3.0 * twist * slope
    if root >= 0.0:
        sum_of_two = -(bend + math.copysign(math.sqrt(root), bend))
        one = slope / sum_of_two if sum_of_two != 0.0 else 1.0
        other = sum_of_two / (3.0 * twist) if twist != 0.0 else 1.0
    return min(one, other), max(one, other)


@inlined
def _crossing(left, right, row, sign, size):
    """
    Return the share of an interval at which a gap first has the sign that ends it; 1 if none.

    By the cubic that has the gaps and rates of both ends, between its turning points.

    """
    start, slope, bend, twist = _coefficients(left, right, row, sign, size)
    one, other = _turning_points(slope, bend, twist)
    before = 0.0
    for k in range(3):
        after = one if k == 0 else other if k == 1 else 1.0
        if before < after <= 1.0:
            if _cubic(start, slope, bend, twist, after) > CLOSED:
                for _ in range(HALVINGS):
                    middle = 0.5 * (before + after)
                    if _cubic(start, slope, bend, twist, middle) > 0.0:
                        after = middle
                    else:
                        before = middle
                return after
            before = after
    return 1.0


@inlined
def _sign(contacts, row):
    """Return the sign by which a gap contradicts its mode."""
    return 1.0 if contacts.mode[row] == TOUCHING else -1.0


@inlined
def _is_judged(effects, row):
    """Return whether a contact is there or not by decision."""
    return effects.enabled[row] == 1 and effects.contacts.mode[row] != UNDECIDED


@inlined
def _is_finite(effects, row):
    """Return whether a roller may pass a body within a step without any sign at its ends."""
    kind = effects.kind[row]
    return kind == CURVE_CONTACT or (
        kind == CIRCLE_CONTACT and effects.values[row, 11] > 0.0) or (
        kind == SPATIAL_BODY_CONTACT and effects.values[row, 11] > 0.0
        and effects.data[effects.index[row, DATA] + 9] == 0.0)


@merged
def part(effects, size, sought, share):
    """
    Return the part of a step on which no contact begins or ends.

    Parameters
    ----------
    effects : EffectTable
        After its laws have seen a state of the trial.
    size : float
        Of the trial [s].
    sought : int
        Row of the contact at whose change the step is to end; less than zero where none is.
    share : float
        Of the trial, at which that state is: 1 at its end, which comes first.

    Returns
    -------
    part : float
        [s]; ``size`` where the step may be taken. Another one is to be tried; twice the size:
        the same once more.
    sought : int
        As given, or found now.
    share : float
        At which dense output is to be seen next; less than zero where none is.

    """
    if share == 1.0:
        found, sought = _end(effects, size, sought)
    else:
        found, cut = _push(effects, size, share)
        sought = sought if found == size else cut
    share = -1.0
    if found == size:
        found, sought, share = _look_inside(effects, size, sought)
    if share < 0.0:
        _clear(effects.contacts)
    return found, sought, share


@compiled
def _end(effects, size, sought):
    """Judge the end of a trial; return the part to be tried, and the contact that is sought."""
    contacts = effects.contacts
    search, now = contacts.search, contacts.now
    least, first, refused = 1.0, -1, False
    for k in range(contacts.rows.shape[0]):
        row = contacts.rows[k]
        if _is_judged(effects, row):
            sign = _sign(contacts, row)
            # Written so that a NaN contradicts.
            if not sign * now[row, GAP] <= CLOSED:
                share = _crossing(contacts.start, now, row, sign, size)
                if share < least or first < 0:
                    least, first = share, row
            lost, before = effects.states[effects.index[row, STATE]], contacts.trial[row, LOST]
            refused = refused or lost < before - FALLS * (
                abs(before) + effects.output[row, STORED]) - CLOSED or (
                    sign > 0.0 and _is_far(contacts.start, now, row, size))
    if first >= 0:
        _disagree(search, size)
        if not least > LEAST_PART and abs(contacts.start[first, GAP]) <= NO_GAP:
            return _change(contacts, first, size)
        tried = least * size
        if not search[LOW] < tried < search[HIGH]:
            tried = 0.5 * (search[LOW] + search[HIGH])
        if search[HIGH] - search[LOW] <= SAME * search[HIGH]:
            tried = search[LOW]
        return tried, first
    if refused:
        _disagree(search, size)
        search[LOW] = 0.0
        return SHORTER * size, -1
    if sought >= 0:
        gap, rate = now[sought, GAP], now[sought, RATE]
        search[LOW] = max(search[LOW], size)
        search[REFINED] += 1.0
        if (abs(gap) > CLOSED and search[REFINED] <= MOST_REFINED
                and search[HIGH] - search[LOW] > SAME * search[HIGH]):
            tried = size - gap / rate
            # The rate tells whether the contact lies ahead.
            if not size < tried < search[HIGH]:
                tried = 0.5 * (search[LOW] + search[HIGH])
            return tried, sought
    _begin_look(contacts)
    return size, sought


@inlined
def _is_far(start, now, row, size):
    """Return whether a gap has changed otherwise than by its rates."""
    way = size * max(abs(start[row, RATE]), abs(now[row, RATE]))
    missed = abs(now[row, GAP] - start[row, GAP] - 0.5 * size * (
        start[row, RATE] + now[row, RATE]))
    return missed > FAR * way and missed > DEPTHS * max(abs(start[row, GAP]), abs(now[row, GAP]))


@inlined
def _disagree(search, size):
    """Note that a part of a step of a size [s] does not agree with the modes."""
    search[HIGH] = min(search[HIGH], size)
    if search[LOW] >= search[HIGH]:
        search[LOW] = 0.0


@inlined
def _change(contacts, row, size):
    """Change a mode that ends as soon as it begins; where it has been, let the gap decide."""
    if contacts.trial[row, CHANGED] == 0.0:
        contacts.mode[row] = FREE if contacts.mode[row] == TOUCHING else TOUCHING
    else:
        # It bounces too fast to be followed.
        contacts.mode[row] = UNDECIDED
    contacts.trial[row, CHANGED] = 1.0
    contacts.search[HIGH] = math.inf
    return 2.0 * size, -2


@inlined
def _begin_look(contacts):
    """Put both ends of a trial on the stack."""
    search, nodes = contacts.search, contacts.nodes
    search[TOP], search[SHARES], search[SHARES + 1] = 1.0, 0.0, 1.0
    search[NODE_LEVELS + 1] = 0.0
    for k in range(contacts.rows.shape[0]):
        row = contacts.rows[k]
        for i in range(PLACE + 3):
            nodes[0, row, i] = contacts.start[row, i]
            nodes[1, row, i] = contacts.now[row, i]
        nodes[1, row, ERROR] = nodes[1, row, BEND] = math.inf
        contacts.trial[row, LARGEST] = max(abs(nodes[0, row, GAP]), abs(nodes[1, row, GAP]))


@compiled
def _push(effects, size, share):
    """
    Put what was seen within a trial on the stack.

    Returns
    -------
    part : float
        [s]; less than ``size`` where a contact begins or ends there.
    sought : int

    """
    contacts = effects.contacts
    search, nodes, now = contacts.search, contacts.nodes, contacts.now
    top = int(search[TOP])
    left, right, begin_share = nodes[0], nodes[top], search[SHARES]
    length = search[SHARES + top] - begin_share
    along = (share - begin_share) / length
    # Of what is missed within the interval, and what of it is left in its parts.
    shape, longer = along * (1.0 - along), max(along, 1.0 - along)
    earliest, first = 1.0, -1
    for k in range(contacts.rows.shape[0]):
        row = contacts.rows[k]
        if not _is_judged(effects, row):
            continue
        sign = _sign(contacts, row)
        if not sign * now[row, GAP] <= CLOSED:
            found = begin_share + along * length * _crossing(
                left, now, row, sign, along * length * size)
            if found < earliest:
                earliest, first = found, row
        start, slope, bend, twist = _coefficients(left, right, row, 1.0, length * size)
        error = abs(now[row, GAP] - _cubic(start, slope, bend, twist, along)) / (
            16.0 * shape * shape)
        apart = 0.0
        for i in range(3):
            chord = left[row, PLACE + i] + along * (right[row, PLACE + i] - left[row, PLACE + i])
            apart += (now[row, PLACE + i] - chord) ** 2
        for i in range(PLACE + 3):
            nodes[top + 1, row, i] = now[row, i]
        error = SAFER * error * longer ** 4
        apart = SAFER * math.sqrt(apart) / (4.0 * shape) * longer * longer
        for node in (top, top + 1):
            nodes[node, row, ERROR] = error
            nodes[node, row, BEND] = apart
        contacts.trial[row, LARGEST] = max(contacts.trial[row, LARGEST], abs(now[row, GAP]))
    if first >= 0:
        _disagree(search, size)
        search[LOW] = 0.0
        if not earliest > LEAST_PART and abs(contacts.start[first, GAP]) <= NO_GAP:
            return _change(contacts, first, size)
        return earliest * size, first
    search[NODE_LEVELS + top] += 1.0
    search[NODE_LEVELS + top + 1] = search[NODE_LEVELS + top]
    search[SHARES + top + 1], search[TOP] = share, top + 1.0
    return size, -1


@compiled
def _look_inside(effects, size, sought):
    """Go from interval to interval as long as they are clear; returns as ``part`` does."""
    contacts = effects.contacts
    search, nodes = contacts.search, contacts.nodes
    top = int(search[TOP])
    while top > 0:
        length = search[SHARES + top] - search[SHARES]
        along, followed = 1.0, True
        for k in range(contacts.rows.shape[0]):
            row = contacts.rows[k]
            if _is_judged(effects, row):
                where, well = _suspect(effects, row, nodes[0], nodes[top], length * size, size)
                along, followed = min(along, where), followed and well
        if along < 1.0:
            share = search[SHARES] + along * length
            search[TOP] = top
            if search[NODE_LEVELS + top] < LEVELS:
                return size, sought, share
            if not followed or search[SUSPECTED] < MOST_SUSPICIONS:
                # Nothing is known of this place but that it must be seen.
                search[SUSPECTED] += 1.0
                search[LOW] = 0.0
                return share * size, -1, -1.0
        for k in range(contacts.rows.shape[0]):
            for i in range(NODE_COLUMNS):
                nodes[0, contacts.rows[k], i] = nodes[top, contacts.rows[k], i]
        search[SHARES] = search[SHARES + top]
        top -= 1
    return size, sought, -1.0


@inlined
def _suspect(effects, row, left, right, length, size):
    """
    Return where within an interval a contact may begin or end unseen.

    Parameters
    ----------
    effects, row
        The contact.
    left, right : ndarray, shape (ne, NODE_COLUMNS)
        Nodes.
    length, size : float
        Of the interval and of the trial [s].

    Returns
    -------
    along : float
        Share of the interval; 1 where it is clear.
    followed : bool
        Whether the interval is short enough to be judged at all.

    """
    contacts = effects.contacts
    trial, sign = contacts.trial, _sign(contacts, row)
    one, other = -sign * left[row, GAP], -sign * right[row, GAP]
    finite = contacts.mode[row] == FREE and _is_finite(effects, row)
    fastest = trial[row, SPEED] if finite else trial[row, FASTEST]
    slight = trial[row, WRONG] <= max(CLOSED, SLIGHT * size * fastest)
    if slight and one + other > FASTER * fastest * length:
        return 1.0, True
    resolved = fastest * length <= trial[row, LARGEST]
    if finite:
        bend, chord = right[row, BEND], 0.0
        for i in range(PLACE, PLACE + 3):
            chord += (right[row, i] - left[row, i]) ** 2
        resolved = resolved or fastest * length <= CHORDS * math.sqrt(chord)
        nearest, along = _nearest(effects, row, left, right)
        if not (resolved and bend <= BENT * max(one, other) + CLOSED):
            return 0.5, False
        return along if nearest < bend else 1.0, True
    if contacts.mode[row] == TOUCHING and slight:
        # Error control follows what is touched.
        return 1.0 if _crossing(left, right, row, sign, length) == 1.0 else 0.5, True
    if not resolved:
        return 0.5, False
    error = right[row, ERROR]
    if not error < math.inf:
        return 0.5, True
    start, slope, bend, twist = _coefficients(left, right, row, -sign, length)
    first, second = _turning_points(slope, bend, twist)
    least, along = 0.0, 1.0
    for k in range(1, PLACES + 2):
        share = k / PLACES if k < PLACES else first if k == PLACES else second
        if not 0.0 < share < 1.0:
            continue
        margin = _cubic(start, slope, bend, twist, share) - 16.0 * error * (
            share * (1.0 - share)) ** 2
        if margin < least:
            least, along = margin, share
    return along, True


@compiled
def _nearest(effects, row, left, right):
    """
    Return how near the chord of a path comes to a body between its ends.

    Returns
    -------
    gap : float
        Least gap of a place that is nearer than those before and after it [m]; infinity where
        there is none.
    along : float
        Share of the chord, between 0 and 1.

    """
    values, first = effects.values, PLACE
    if effects.kind[row] == CURVE_CONTACT:
        gap, along = curve.nearest_to_chord(
            effects.data, effects.index[row, DATA], effects.index[row, ENTRIES],
            left[row, first], left[row, first + 1], right[row, first], right[row, first + 1])
        return gap - values[row, 4], along
    inward, square = 0.0, 0.0
    for i in range(first, first + 3):
        move = right[row, i] - left[row, i]
        inward -= move * left[row, i]
        square += move * move
    if not 0.0 < inward < square:
        return math.inf, 0.5
    along, between, one, other = inward / square, 0.0, 0.0, 0.0
    for i in range(first, first + 3):
        between += (left[row, i] + along * (right[row, i] - left[row, i])) ** 2
        one += left[row, i] ** 2
        other += right[row, i] ** 2
    between = math.sqrt(between)
    if between > math.sqrt(min(one, other)) - NO_GAP:
        return math.inf, 0.5
    # An interval is to be parted there.
    return between - values[row, 5] - values[row, 4], min(0.99, max(0.01, along))
