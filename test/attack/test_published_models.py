# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Models in wheels of others: refused in words, or accelerated as MuJoCo and Pinocchio do.

So are they when they have been exported, by the simulator of the format and when read again.
Of the wheels dm_control, mujoco and example-robot-data, those that are installed (``pip install
--no-deps``). Counts are printed (``-s`` shows them).
"""

from collections import Counter
from dataclasses import replace
from importlib import metadata
from pathlib import Path
import re

from closedloop_dynamics import AssemblyError, MechanismError, Simulation
from closedloop_dynamics.formats.registry import read_model, writer
from closedloop_dynamics.scene.model_scene import assembled, scene_of_model
import numpy as np
import pytest

from .simulators import of_mujoco, of_pinocchio

SUFFIXES = {'dm_control': '.xml', 'mujoco': '.xml', 'example-robot-data': '.urdf'}
# Whose accelerations models in a format should have.
SIMULATORS = {'.xml': of_mujoco, '.urdf': of_pinocchio}
# From version 4 on the files of MuJoCo are in a wheel beside it.
PARTS = {'mujoco': ('mujoco', 'mujoco_core')}
# How many files of each are models at least: fewer, and the wheel is not what it was.
LEAST = {'dm_control': 20, 'mujoco': 1, 'example-robot-data': 30}
# So many exports of each format are compared at least with the simulator that reads it.
LEAST_EXPORTED = {'dm_control': {'.xml': 20}, 'mujoco': {'.xml': 1},
                  'example-robot-data': {'.xml': 30, '.urdf': 30}}
# From this condition of the inertia on accelerations have less digits than are compared.
WORST = 1e10
NONE, STANDARD = {'type': 'gravity', 'acceleration': (0.0, 0.0, 0.0)}, (0.0, 0.0, -9.81)
# What every message begins with: the file, perhaps one that the model names, and its line.
PLACE = re.compile(r'/[^\n]*?(:\d+)?: ')


def files_of(wheel):
    """Return the files of an installed wheel that may be models; skip the test without one."""
    found = []
    for part in PARTS.get(wheel, (wheel,)):
        try:
            found += metadata.files(part) or ()
        except metadata.PackageNotFoundError:
            continue
    if not found:
        pytest.skip(f'needs {wheel}, whose models are read')
    return sorted(Path(one.locate()) for one in found if one.suffix == SUFFIXES[wheel])


def without_friction(imported):
    """Return an imported model without friction, which others regularise."""
    return replace(imported, effects={
        name: values for name, values in imported.effects.items()
        if values['type'] != 'joint_friction'})


def with_gravity(imported):
    """Return an imported model with gravity, if it is none."""
    return replace(imported, effects={'gravity': NONE, **imported.effects})


def state(simulation):
    """Return coordinates and rates that loops and couplings allow."""
    rng, coordinates = np.random.default_rng(0), simulation.mechanism.coordinates
    if simulation.mechanism.closures:
        simulation.set_state(simulation.position, rng.normal(size=coordinates.nv))
        return simulation.position.copy(), simulation.velocity.copy()
    q = coordinates.moved(simulation.position, 0.3 * rng.normal(size=coordinates.nv))
    return q, rng.normal(size=coordinates.nv)


def differ(ours, theirs, qd):
    """Return by how much accelerations differ, of the largest, or of the largest rate's square."""
    scale = max(np.abs(theirs).max(), np.abs(qd).max() ** 2)
    return float(np.abs(ours - theirs).max() / scale)


def compared(path, imported):
    """Return what comes of a model, and by how much its accelerations are others."""
    mechanism = imported.mechanism
    # Gains of drives act in none of both.
    if any(not one.quantity.endswith(' gain') for one in imported.omitted) or any(
            what.endswith(' taken') for what in imported.ignored):
        return 'with something left out or mended, as reported', 0.0
    try:
        simulation = Simulation(scene_of_model(path, without_friction(imported)))
    except AssemblyError:
        # Something without mass moves alone, which is reported.
        return 'without mass', 0.0
    q, qd = state(simulation)
    theirs = SIMULATORS[path.suffix](path, simulation, q, qd)
    if theirs is None:
        return 'that their simulator does not read from its folder', 0.0
    ours = simulation.forward_dynamics(q, qd)[0]
    return f'compared{" with loops" * bool(mechanism.closures)}', differ(ours, theirs, qd)


@pytest.mark.slow
@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('wheel', SUFFIXES)
def test_models_of_others_are_refused_in_words_or_right(wheel):
    counts, bad = Counter(), []
    for path in files_of(wheel):
        counts['tried'] += 1
        try:
            imported = read_model(path, anywhere=True, mend_inertias=True)
        except MechanismError as error:
            counts['refused'] += 1
            if not PLACE.match(str(error)):
                bad.append(f'{path}: {error}')
            continue
        outcome, off = compared(path, imported)
        counts[outcome] += 1
        if not off < 1e-10:
            bad.append(f'{path}: accelerations differ by {off:.1e}')
    print_counts(wheel, counts)
    assert not bad, '\n'.join(bad)
    assert counts['tried'] - counts['refused'] >= LEAST[wheel]


def print_counts(wheel, counts):
    print(f'{wheel}: ' + ', '.join(f'{count} {what}' for what, count in counts.items()))


def again(simulation, imported, path, q, qd):
    """
    Write a model in another format, read it again and compare accelerations.

    Parameters
    ----------
    simulation : Simulation
        Of the model; what the format cannot say is switched off.
    imported : formats.building.Imported
        As it was read.
    path : pathlib.Path
        Where to write it; its suffix gives the format.
    q : ndarray, shape (nq,)
        Coordinates.
    qd : ndarray, shape (nv,)
        Rates.

    Returns
    -------
    dict of str to float
        By what they were compared with, by how much accelerations are others.

    Raises
    ------
    MechanismError
        Where the format cannot say something.

    """
    mechanism, left_out, off = imported.mechanism, {}, {}
    path.write_text(writer(path.suffix)(
        mechanism, without_friction(imported).effects, q, left_out, imported.limits))
    # URDF has the gravity that simulators take.
    gravity = STANDARD if left_out.pop('gravity', None) else imported.effects.get(
        'gravity', NONE)['acceleration']
    simulation.set_effect('gravity', acceleration=list(gravity))
    for name in simulation.effects:
        simulation.set_effect(name, enabled=name not in left_out)
    read = Simulation(scene_of_model(path, read_model(path)))
    names, there = mechanism.coordinates.names, read.mechanism.coordinates
    # SDF is drawn where it starts, and MJCF has a key frame.
    start = read.position
    if names != there.names:
        qd = np.zeros(len(qd))
    elif path.suffix == '.urdf':
        start = q
    ours = simulation.forward_dynamics(q, qd)[0]
    theirs = read.forward_dynamics(start, qd if names == there.names else np.zeros(there.nv))[0]
    # A joint that became several has other names.
    common = [name for name in names if name in there.index]
    if common and not (path.suffix == '.urdf' and names != there.names):
        off[f'read again from {path.suffix}'] = differ(
            ours[[mechanism.coordinates.index[name] for name in common]],
            theirs[[there.index[name] for name in common]], np.append(ours, 1.0))
    if path.suffix == '.xml' or path.suffix == '.urdf' and not mechanism.cut_joints:
        theirs = SIMULATORS[path.suffix](path, simulation, q, qd)
        if theirs is not None:
            off[f'by the simulator of {path.suffix}'] = differ(ours, theirs, np.append(qd, 1.0))
    return off


@pytest.mark.slow
@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('wheel', SUFFIXES)
def test_models_of_others_that_are_exported_have_the_same_accelerations(tmp_path, wheel):
    counts, bad = Counter(), []
    for path in files_of(wheel):
        try:
            imported, found, _ = assembled(read_model(path, anywhere=True, mend_inertias=True))
            simulation = Simulation(scene_of_model(path, with_gravity(without_friction(imported))))
        except (MechanismError, AssemblyError):
            continue
        assert found.closed
        if np.linalg.cond(simulation.inertia) > WORST:
            counts['whose inertia is too ill-conditioned'] += 1
            continue
        q, qd = state(simulation)
        for suffix in ('.xml', '.urdf', '.sdf'):
            try:
                off = again(simulation, imported, tmp_path / f'again{suffix}', q, qd)
            except MechanismError:
                counts[f'that {suffix} cannot say'] += 1
                continue
            for what, by in off.items():
                counts[what] += 1
                if not by < 1e-10:
                    bad.append(f'{path}: accelerations {what} differ by {by:.1e}')
    print_counts(wheel, counts)
    assert not bad, '\n'.join(bad)
    for suffix, count in LEAST_EXPORTED[wheel].items():
        assert counts[f'by the simulator of {suffix}'] >= count
