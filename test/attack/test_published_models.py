# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Models in wheels of others: refused in words, or accelerated as MuJoCo and Pinocchio do.

Of the wheels dm_control, mujoco and example-robot-data, those that are installed (``pip install
--no-deps``). Counts are printed (``-s`` shows them).

"""

from collections import Counter
from dataclasses import replace
from importlib import metadata
from pathlib import Path
import re

from closedloop_dynamics.formats.building import word
from closedloop_dynamics.formats.registry import read_model
from closedloop_dynamics.mechanism.mechanism import FREE, MechanismError
from closedloop_dynamics.mechanism.rotations import of_quaternion
from closedloop_dynamics.simulation.errors import AssemblyError
from closedloop_dynamics.simulation.model_scene import scene_of_model
from closedloop_dynamics.simulation.simulation import Simulation
import numpy as np
import pytest

SUFFIXES = {'dm_control': '.xml', 'mujoco': '.xml', 'example-robot-data': '.urdf'}
# From version 4 on the files of MuJoCo are in a wheel beside it.
PARTS = {'mujoco': ('mujoco', 'mujoco_core')}
# How many files of each are models at least: fewer, and the wheel is not what it was.
LEAST = {'dm_control': 20, 'mujoco': 1, 'example-robot-data': 30}
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


def of_mujoco(path, simulation, q, qd):
    """Return MuJoCo's accelerations in our order; None where it does not read the file."""
    mujoco = pytest.importorskip('mujoco')
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError:
        return None
    coordinates, joints = simulation.mechanism.coordinates, simulation.mechanism.joints
    assert len(joints) == model.njnt
    data, order, turned = mujoco.MjData(model), np.zeros(model.nv, dtype=int), np.eye(model.nv)
    for number, joint in enumerate(joints):
        values = q[coordinates.coordinates[joint.name]].copy()
        rates = coordinates.rates[joint.name]
        address, dof = model.jnt_qposadr[number], model.jnt_dofadr[number]
        if len(values) >= 4:
            values[-4:] = np.roll(values[-4:], 1)
        if joint.type == FREE:
            # Counted from where it is drawn, in the axes that it has there.
            drawn = model.qpos0[address:address + 7]
            axes = of_quaternion(np.roll(drawn[3:], -1))
            values[:3] = drawn[:3] + axes @ values[:3]
            mujoco.mju_mulQuat(values[3:], drawn[3:], values[3:].copy())
            turned[dof:dof + 3, dof:dof + 3] = axes
        data.qpos[address:address + len(values)] = values
        order[dof:dof + rates.stop - rates.start] = range(rates.start, rates.stop)
    data.qvel[:] = turned @ qd[order]
    mujoco.mj_forward(model, data)
    # No contacts, limits, friction and drives. Drives may have the compensation of weights.
    force, columns = data.qfrc_passive - data.qfrc_bias, np.zeros((model.nv, model.nv))
    at_drives = np.asarray(model.jnt_actgravcomp, dtype=bool)[model.dof_jntid]
    force[at_drives] += data.qfrc_gravcomp[at_drives]
    for column, unit in zip(columns, np.eye(model.nv)):
        mujoco.mj_mulM(model, data, column, unit)
    found = np.empty(model.nv)
    found[order] = turned.T @ np.linalg.solve(columns, force)
    return found


def of_pinocchio(path, simulation, q, qd):
    """Return Pinocchio's accelerations in our order, with damping and springs."""
    pinocchio = pytest.importorskip('pinocchio')
    model = pinocchio.buildModelFromUrdf(str(path))
    data, coordinates = model.createData(), simulation.mechanism.coordinates
    there = {word(name): joint for name, joint in zip(model.names, model.joints)}
    joints = [there[name] for name in coordinates.names]
    position, velocity = pinocchio.neutral(model), np.zeros(model.nv)
    for joint, place, rate in zip(joints, coordinates.place, qd):
        velocity[joint.idx_v], value = rate, q[place]
        position[joint.idx_q:joint.idx_q + joint.nq] = (
            (np.cos(value), np.sin(value)) if joint.nq == 2 else value)
    moved = [joint.idx_v for joint in joints]
    inertia = np.triu(pinocchio.crba(model, data, position))[np.ix_(*2 * [sorted(moved)])]
    force = -pinocchio.nonLinearEffects(model, data, position, velocity)[moved]
    for effect in simulation.effects.values():
        if hasattr(effect, 'coefficient'):
            place = coordinates.index[effect.joint]
            force[place] -= effect.coefficient * qd[place]
    inertia = inertia + np.triu(inertia, 1).T
    ranks = np.argsort(np.argsort(moved))
    return np.linalg.solve(inertia[np.ix_(ranks, ranks)], force)


def compared(path, imported, wheel):
    """Return what comes of a model, and by how much its accelerations are others."""
    mechanism = imported.mechanism
    if imported.omitted or any(what.endswith(' taken') for what in imported.ignored):
        return 'with something left out or mended, as told', 0.0
    if mechanism.cut_joints or mechanism.couplings:
        return 'with loops', 0.0
    effects = {name: values for name, values in imported.effects.items()
               if values['type'] != 'joint_friction'}
    try:
        simulation = Simulation(scene_of_model(path, replace(imported, effects=effects)))
    except AssemblyError:
        # Something without mass moves alone, which is told.
        return 'without mass', 0.0
    rng, coordinates = np.random.default_rng(0), mechanism.coordinates
    q = coordinates.moved(simulation.position, 0.3 * rng.normal(size=coordinates.nv))
    qd = rng.normal(size=coordinates.nv)
    theirs = (of_pinocchio if wheel == 'example-robot-data' else of_mujoco)(
        path, simulation, q, qd)
    if theirs is None:
        return 'that MuJoCo does not read from its folder', 0.0
    ours = simulation.forward_dynamics(q, qd)[0]
    scale = max(np.abs(theirs).max(), np.abs(qd).max() ** 2)
    return 'compared', float(np.abs(ours - theirs).max() / scale)


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
        outcome, off = compared(path, imported, wheel)
        counts[outcome] += 1
        if not off < 1e-10:
            bad.append(f'{path}: accelerations differ by {off:.1e}')
    print(f'{wheel}: ' + ', '.join(f'{count} {what}' for what, count in counts.items()))
    assert not bad, '\n'.join(bad)
    assert counts['tried'] - counts['refused'] >= LEAST[wheel]
