# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A machine for a page that simulates by itself: WebAssembly, its columns, drives and numbers."""

import base64
from contextlib import suppress
from dataclasses import replace
import math

import numpy as np

from .columns import Columns, joint_plots, Plot
from .description import describe, described_drive, EARTH
from .drives import DRIVE_RATE
from .driving import DRIVE_PERIOD, Driving
from .editing import Editor, LENGTH
from .hand import DAMPING, GIVE
from .messages import describe_effects, OWN
from .page import packed
from ..effects.gravity import Gravity
from ..effects.prescribed_motion import PrescribedMotion
from ..export.wasm_source import choices_of, clocks_of, wasm_module
from ..kinematics.modeling import extent, mechanism_arrays
from ..mechanism.errors import SimulationError
from ..scene.key_paths import changed, resolve
from ..scene.tableau import DOP853
from ..simulation.simulation import Simulation

# Largest error of a step, as a share of one and the size of a number.
TOLERANCE = 1e-12
# How long the motion that a controller makes is recorded for a page, which has none, and the time
# between two places of it [s]; how near its end must come to an earlier state to go on from there,
# as a share of the motion.
RECORDED, PLACED, SAME = 10.0, 0.02, 0.02
# Step of a number by which the page's arrays are found to follow it in proportion, and what
# rounding makes of that, both as shares.
STEP, ROUNDING = 0.25, 1e-9


def standalone(scene, motion):
    """
    Return what a page is made of that simulates a scene by itself.

    Parameters
    ----------
    scene : Scene
        What to simulate.
    motion : OwnMotion
        What drives it from the start.

    Returns
    -------
    description : dict
        Of ``description.describe``.
    machine : dict
        For ``page/standalone.js``, as JSON can.

    Raises
    ------
    SimulationError
        Where something of the scene cannot be written as WebAssembly, with names and reasons.

    """
    simulation = Simulation.from_scene(scene)
    binary, arrays = wasm_module(simulation)
    driving = Driving(motion)
    driving.begin(simulation)
    driving.start()
    mechanism, size = scene.mechanism, extent(scene.mechanism)
    gravity = next((name for name, record in scene.effects.items()
                    if isinstance(record, Gravity)), 'gravity')
    columns, sliders = _columns(mechanism), _sliders(scene, simulation)
    description = describe(
        mechanism, columns, scene.effects, mode='live', title=scene.name, hand=True,
        drives=[described_drive(mechanism, name, simulation.position, driving.reach(name),
                                driving.modes(name)) for name in driving.drives],
        gravity=gravity, own=any(value is not None for _, value in motion.starts.values()),
        sliders=[slider for slider, _ in sliders])
    manifold, names = simulation.data.system.manifold, simulation.coordinates
    mass = sum(body.mass for body in mechanism.bodies) or 1.0
    stiffness = mass * EARTH / (GIVE * size)
    places, (rows, points) = simulation.data.loop_model.placements, (
        simulation.data.loop_model.named_points)
    settings = simulation.data.system.settings
    machine = {
        'module': base64.b64encode(binary).decode('ascii'),
        'arrays': {name: [first, content if isinstance(content, int) else packed(
            content, np.float64)] for name, (first, content) in arrays.items()},
        'clocks': clocks_of(simulation),
        'choices': [rows for _, rows in choices_of(simulation)],
        'units': [one.tolist() for one in simulation.data.loop_model.equations.units()],
        'planar': mechanism.planar,
        'balls': [] if manifold is None else manifold.balls.tolist(),
        'place': list(range(names.nv)) if manifold is None else manifold.place.tolist(),
        'closure_tolerance': float(settings.closure_tolerance),
        'closure_limit': float(settings.closure_limit),
        **METHOD, 'step_size': simulation.step_size,
        'unique': not simulation.data.has_redundant_constraints,
        'bodies': [_placed(places[body.name]) for body in mechanism.bodies],
        'points': [[row, *place] for row, place in zip(rows.tolist(), points.tolist())],
        'position': names.place.tolist(), 'actuated': list(names.actuated),
        'turns': np.setdiff1d(np.arange(names.nq), names.place[names.place >= 0]).tolist(),
        'drives': _drives(driving, names),
        'own': _recording(driving, simulation),
        'hand': [stiffness, DAMPING * math.sqrt(stiffness * mass)],
        'effects': _effects(scene, simulation, gravity),
        'numbers': {slider['key']: change for slider, change in sliders}}
    return description, machine


def _columns(mechanism):
    """Return the columns of a page's rows."""
    plots = joint_plots(mechanism)
    plots += [Plot('energy', name, 'J', column=f'energy.{name}')
              for name in ('kinetic', 'stored', 'work less losses')]
    plots += [Plot(*one, method=True, log=one[0] != 'cost') for one in (
        ('closure error', 'largest', 'm or rad', True, 'closure'),
        ('error of the energy balance', 'balance', 'J', True, 'energy.error'),
        ('cost', 'computing', '% of real time', True, 'cost'),
        ('evaluations', 'in a simulated second', '1/s', True, 'evaluations'))]
    return Columns(mechanism, plots=plots)


def _tableau():
    """Return the explicit method of the page's steps, without the slopes of dense output."""
    count = len(DOP853.b)
    assert not DOP853.error[:, count:].any()
    a = DOP853.a[:count, :count]
    return {'a': a.tolist(), 'b': DOP853.b.tolist(), 'c': a.sum(axis=1).tolist(),
            'error': DOP853.error[:, :count].tolist(), 'order': DOP853.error_order + 1,
            'tolerance': TOLERANCE}


# What all machines have in common: how steps are made, and the rate of drives.
METHOD = {'tableau': _tableau(), 'rate': DRIVE_RATE}


def _placed(placement):
    """Return the row of a body, its origin and its axes, column by column, in that row."""
    return [placement.row, *placement.origin.tolist(), *placement.axes.T.ravel().tolist()]


def _drives(driving, names):
    """Return freedom, mode and value of each drive at the start, by joint."""
    return {joint: [names.index[joint], drive.mode, drive.value]
            for joint, drive in driving.drives.items()}


def _recording(driving, simulation):
    """
    Return the motion that a controller makes: positions of its joints, and where to go on.

    None where no controller drives. Positions, rates and accelerations follow one another, instant
    by instant.
    """
    controlled = [name for name, drive in driving.drives.items() if drive.mode == OWN]
    if not controlled:
        return None
    names = simulation.coordinates
    freedoms = [names.index[name] for name in controlled]
    every, rows = round(PLACED / DRIVE_PERIOD), []
    for step in range(round(RECORDED / DRIVE_PERIOD) + 1):
        if step % every == 0:
            rows.append(np.concatenate([names.by_freedom(simulation.position)[freedoms],
                                        simulation.velocity[freedoms]]))
        simulation.step(driving.torques()[simulation.data.actuated], DRIVE_PERIOD)
    simulation.reset()
    rows = np.array(rows)
    # Places and rates are followed by accelerations.
    rows = np.hstack([rows, np.gradient(rows[:, len(controlled):], PLACED, axis=0)])
    # Where the end continues: at the earlier state that is nearest to it, whole turns aside.
    count = len(controlled)
    begin = rows[:3 * len(rows) // 4]
    missing, turns = rows[-1] - begin, np.zeros((len(begin), count))
    turning = ~names.lengths[freedoms]
    turns[:, turning] = 2.0 * np.pi * np.round(missing[:, :count][:, turning] / (2.0 * np.pi))
    missing[:, :count] -= turns
    scale = np.maximum(np.ptp(rows, axis=0), 1e-9)
    away = np.abs(missing / scale)[:, :2 * count].max(axis=1)
    again = int(np.argmin(away))
    return {'joints': controlled, 'period': PLACED, 'rows': packed(rows, np.float64),
            'again': again if away[again] < SAME else None, 'turns': turns[again].tolist()}


def _effects(scene, simulation, gravity):
    """
    Return the effects that act, as ``messages.describe_effects``, and where their numbers are.

    Those are in the table of effects: by key of the record its row and the columns.
    """
    table, names = simulation.data.system.effects, list(simulation.data.effect_set.by_name)
    found = describe_effects(scene.effects, lambda name: name in simulation.data.enabled_effects)
    if gravity not in found:
        down = (0.0, -EARTH) if scene.mechanism.planar else (0.0, 0.0, -EARTH)
        found = {gravity: {'type': 'gravity', 'enabled': False,
                           'values': {'acceleration': down}}, **found}
    for name, one in list(found.items()):
        if name == gravity:
            one['columns'] = {}
            continue
        if name not in names or not one['enabled'] or isinstance(
                scene.effects[name], PrescribedMotion):
            del found[name]
            continue
        record, row = scene.effects[name], names.index(name)
        one['row'] = row
        if table.elements[row].law.follows_time:
            # Its pieces are made of these.
            one['columns'] = one['values'] = {}
            continue
        one['columns'] = {key: columns for key in one['values'] if (columns := _columns_of(
            simulation, record, key, table.elements[row].values))}
        one['values'] = {key: one['values'][key] for key in one['columns']}
    return found


def _columns_of(simulation, record, key, values):
    """Return the columns of a row of the table that are the numbers of a record's key, or None."""
    given = getattr(record, key)
    numbers = [given] if isinstance(given, float) else list(given) if isinstance(
        given, tuple) and given and all(isinstance(one, float) for one in given) else []
    columns = []
    for n, number in enumerate(numbers):
        moved = number + STEP * (abs(number) or 1.0)
        other = moved if given == number else tuple(
            moved if k == n else one for k, one in enumerate(numbers))
        try:
            after = simulation.data.effect_set.element_of(
                replace(record, **{key: other})).values
        except (ValueError, SimulationError):
            return None
        changes = np.flatnonzero(np.array(after) != np.array(values))
        if len(changes) != 1 or after[changes[0]] != moved:
            return None
        columns.append(int(changes[0]))
    return columns or None


def _sliders(scene, simulation):
    """
    Return the sliders of ``Editor`` whose numbers the page's arrays follow in proportion.

    With each goes what it changes: by array (index, change per unit), and places that move (body,
    place in it, change per unit), as those of joints do that are drawn.
    """
    found, editor = [], Editor(scene)
    for slider in editor.sliders():
        key, value = slider['key'], slider['value']
        step = STEP * (abs(value) or 1.0)
        # What cannot be changed by itself has no slider here.
        with suppress(ValueError):
            change = _changes(simulation, [scene.mechanism, *(
                changed(scene, _numbers(editor, key, value, value + count * step)).mechanism
                for count in (1, 2))], step)
            if change is not None:
                found.append((slider, change))
    return found


def _numbers(editor, key, value, other):
    """Return the numbers of a scene that a slider sets, by their keys, for another value."""
    if not key.startswith(LENGTH + '.'):
        return {resolve(editor.scene, key): other}
    _, body, joint = key.split('.')
    (_, _, origin), *pins = editor.pins(body)
    path, place = next((path, place) for name, path, place in pins if name == joint)
    return {resolve(editor.scene, f'{path}.{k}'): start + (end - start) * other / value
            for k, (start, end) in enumerate(zip(origin, place))}


def _changes(simulation, mechanisms, step):
    """Return what three mechanisms, of equal steps of a number, have different; None: more."""
    model, planar = simulation.data.system.model, simulation.mechanism.planar
    arrays = [mechanism_arrays(one).model for one in mechanisms]
    found = {}
    for name in ('body', 'cut_point'):
        first, second, third = (getattr(one, name).ravel() for one in arrays)
        own = getattr(model, name).ravel()
        if own.shape != first.shape:
            return None
        slope = (second - first) / step
        size = np.abs(third - first).max(initial=0.0)
        if np.abs(third - first - 2.0 * (second - first)).max(initial=0.0) > ROUNDING * size:
            return None
        moved = np.flatnonzero(np.abs(slope * step) > ROUNDING * size) if size else []
        # In space the code has these numbers in it.
        if not planar and any(own[k] in (0.0, 1.0, -1.0) for k in moved):
            return None
        found[name] = [[int(k), float(slope[k])] for k in moved]
    if not (found['body'] or found['cut_point']):
        return None
    rows = {'ground': -1, **{body.name: k for k, body in enumerate(mechanisms[0].bodies)}}
    marks = []
    for before, after in zip(*map(_marks, mechanisms[:2])):
        if before[1] != after[1]:
            change = (np.array(after[1]) - before[1]) / step
            marks.append([rows[before[0]], *([*map(float, each), 0.0][:3]
                                             for each in (before[1], change))])
    return {**found, 'marks': marks}


def _marks(mechanism):
    """Return the bodies and places of all joints and of the ends of all cut joints."""
    return [*((joint.parent, joint.position) for joint in mechanism.joints), *(
        end for cut in mechanism.cut_joints
        for end in ((cut.body_a, cut.point_a), (cut.body_b, cut.point_b)))]
