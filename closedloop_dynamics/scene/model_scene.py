# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Scenes of models in other formats: under gravity, at rest, with the loops closed.

What a model says of damping, springs and the like becomes effects. Omissions are reported by a
warning, and so is how far the joints moved to close the loops.
"""

from dataclasses import replace
import warnings

import numpy as np

from .records import Initial, Scene
from ..effects.registry import EFFECTS
from ..formats.building import lines
from ..kinematics.global_assembly import (
    CLOSED, ClosureProblem, find_closed, never_closed, STARTS_EACH)
from ..kinematics.modeling import extent
from ..mechanism.digits import suspicions
from ..mechanism.errors import AssemblyError
from ..mechanism.fields import at, FieldError
from ..mechanism.mechanism import FIXED, MechanismError, REVOLUTE, SPHERICAL
from ..mechanism.rotations import quaternion_of

# So many of the joints that moved the furthest are reported.
MOST_NAMED = 3
HELD = 'the drives held'
# Loops that are open by less than this in sizes of the mechanism are so by digits of the file.
DIGITS = 1e-6
# Types of joints that close loops at an anchor.
ANCHORED = (SPHERICAL, REVOLUTE, FIXED)
# Shorter displacements are not reported [rad or m].
FAR = 0.05


class ModelWarning(UserWarning):
    """Parts of a model that were left out, or joints that were moved."""


def scene_of_model(path, imported):
    """
    Return the scene of a model that was read from a path.

    MechanismError where it cannot be simulated; AssemblyError where no position was found that
    closes the loops.
    """
    mechanism, effects = imported.mechanism, {}
    try:
        for name, values in imported.effects.items():
            record = EFFECTS[values['type']]
            with at('effects', name):
                effects[name] = record(**{
                    key: value for key, value in values.items() if key != 'type'})
        # Before the search: a mechanism that cannot be simulated is refused at once.
        Scene(path.stem, path, mechanism.description, mechanism,
              _at_rest(mechanism, mechanism.coordinates.start()), effects)
    except FieldError as error:
        raise MechanismError(f'{path}: {error}') from None
    imported, initial = closed_start(imported)
    mechanism = imported.mechanism
    for note in lines(imported, extent(mechanism)):
        warnings.warn(f'{path.name}: {note}', ModelWarning, stacklevel=2)
    return Scene(path.stem, path, mechanism.description, mechanism, initial, effects)


def closed_start(imported):
    """
    Search where a model starts with its loops closed: as it is drawn, or near.

    Returns what was read, as ``assembled`` returns it, and the start, at rest. AssemblyError where
    none was found; it states which loops stay open.
    """
    imported, found, notes = assembled(imported)
    if not found.closed:
        raise AssemblyError(' '.join(notes))
    for note in notes:
        warnings.warn(f'{imported.mechanism.name}: {note}', ModelWarning, stacklevel=2)
    return imported, _at_rest(imported.mechanism, found.q)


def _at_rest(mechanism, q):
    return Initial(tuple(q.tolist()), (0.0,) * mechanism.coordinates.nv)


def assembled(imported):
    """
    Close the loops of a model with drives held and limits kept, or as well as possible.

    Returns what was read, with the anchors of loops moved where the last digits of a file keep
    them open; the result of ``find_closed``; and notes about it, none where nothing moved.
    """
    mechanism, size = imported.mechanism, extent(imported.mechanism)
    start = ClosureProblem(mechanism, size).start(imported.position)
    if not (mechanism.cut_joints or mechanism.couplings):
        return imported, find_closed(mechanism, size, start), []
    cuts = {cut.name for cut in mechanism.cut_joints}
    drives, limits = [
        name for name in mechanism.actuated_joints if name not in cuts], imported.limits
    # What is quick comes first.
    attempts = [((), limits, '', 0), ((), limits, '', STARTS_EACH)]
    if drives:
        attempts = [(drives, limits, HELD, 0), attempts[0], (drives, limits, HELD, 1), attempts[1]]
    if imported.limits:
        attempts.append(((), {}, '', STARTS_EACH))
    tried = []
    for hold, limits, condition, starts in attempts:
        found = find_closed(mechanism, size, start, hold, limits, starts)
        if found.closed:
            break
        mended, anchors = _with_anchors_moved(mechanism, found.q, found.closure_errors, size)
        if anchors:
            again = find_closed(mended, size, found.q, (), limits, 0)
            if again.closed:
                imported = replace(imported, mechanism=mended)
                notes = _moves(mended, start, again._replace(how=found.how), condition,
                               bool(imported.limits and not limits))
                return imported, again, [*notes, *anchors]
        tried.append(found)
    else:
        found = min(tried, key=lambda one: sum(one.closure_errors.values()))
        never = never_closed(mechanism, size, start)
        return imported, found, [f'{mechanism.name} cannot be assembled: ' + '; '.join(
            f'{name} stays open by {gap:.3g}' for name, gap in found.closure_errors.items()
            if gap > CLOSED * size) + ' (m, sines of angles), at the nearest place found. ' + (
                'Whatever all others do, these stay open by themselves, each moved by its own '
                'joints alone: ' + '; '.join(
                    f'{name} by {gap:.3g}' for name, gap in never.items())
                + '. Check the types of its joints, lengths and frames.' if never else
                'Give it a start nearer to a closed one, or check lengths and frames.'),
                                 *suspicions(mechanism)]
    return imported, found, _moves(
        mechanism, start, found, condition, bool(imported.limits and not limits))


def _with_anchors_moved(mechanism, q, closure_errors, size):
    """
    Return a mechanism whose loops, closed but for rounded digits, close exactly, and notes.

    ``closure_errors``: how far its loops are open at q [m, sines of angles]; ``size``: of the
    mechanism [m]. Notes say which anchors were moved; none where a loop is open by more, or cannot
    be closed so.
    """
    open_by = {name: gap for name, gap in closure_errors.items() if gap > CLOSED * size}
    if not open_by or max(open_by.values()) > DIGITS * size:
        return mechanism, []
    frames, origins = ClosureProblem(mechanism, size).frames(q)
    cuts, notes = [], []
    for cut in mechanism.cut_joints:
        if cut.name in open_by and cut.type in ANCHORED:
            a, b = frames[cut.body_a], frames[cut.body_b]
            there = origins[cut.body_a] + a @ cut.point_a - origins[cut.body_b]
            moved = {'point_b': tuple((b.T @ there).tolist())}
            if cut.type == REVOLUTE:
                moved['axis_b'] = tuple((b.T @ a @ cut.axis_a).tolist())
            elif cut.type == FIXED:
                moved['orientation'] = quaternion_of(b.T @ a)
            cut = replace(cut, **moved)
            notes.append(f'the anchor of {cut.name} was moved by {open_by[cut.name]:.2g} m, as '
                         'rounded digits of the file keep its loop open')
        cuts.append(cut)
    return replace(mechanism, cut_joints=tuple(cuts)), notes


def _moves(mechanism, start, found, condition, beyond):
    """Return notes on the way to a closed position."""
    coordinates = mechanism.coordinates
    moves = sorted(zip(np.abs(coordinates.apart(found.q, start)).tolist(), coordinates.names),
                   reverse=True)
    notes = []
    if moves[0][0] > FAR:
        most = ', '.join(f'{name} by {far:.3g}' for far, name in moves[:MOST_NAMED] if far > FAR)
        notes.append(f'the loops are drawn open and were closed {found.how}'
                     f'{", " + condition if condition else ""}; furthest moved: {most} (rad or m)')
    if beyond:
        notes.append('no position was found that closes the loops within the limits of the joints')
    return notes
