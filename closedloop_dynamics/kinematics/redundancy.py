# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Which closure equations repeat others, why, and in which joints forces are not unique."""

from dataclasses import replace
from typing import Dict, NamedTuple, Tuple

import numpy as np

from .assembly import Assembler
from .geometry import Geometry
from .loop_model import scaled
from ..codegen import joint_kernels, space
from ..engine.ranks import rank_of
from ..engine.types import CUT_NUMBER, CUT_TYPE, POSSIBLE
from ..mechanism.errors import AssemblyError
from ..mechanism.mechanism import GROUND, MechanismError

# Why an equation repeats others.
ANY_LENGTHS, THESE_LENGTHS = 'at any lengths', 'at these lengths only'
# Components of a wrench.
PLANAR_WRENCH = ('moment', 'force x', 'force y')
SPATIAL_WRENCH = tuple(f'{kind} {axis}' for kind in ('moment', 'force') for axis in 'xyz')
# How far lengths are changed to see that.
CHANGE = 1e-3
# Shares in dependences between equations below this are rounding.
NO_SHARE = 1e-6


class Redundancy(NamedTuple):
    """Equations that repeat others."""

    #: Cut joint or coupling, its equation, and whether it repeats others at any lengths.
    repeated: Tuple[Tuple[str, str, str], ...]
    #: Joints, cut joints and couplings whose forces are not unique: the least are reported.
    shared: Tuple[str, ...]
    #: The components of their wrenches, in world axes, that are not unique.
    components: Dict[str, Tuple[str, ...]]


def wrench_names(mechanism):
    """Return the names of the components of a wrench, in their order."""
    return PLANAR_WRENCH if mechanism.planar else SPATIAL_WRENCH


def find_redundancy(mechanism, q):
    """Find equations that repeat others at and near a position that closes the loops."""
    geometry = Geometry(mechanism)
    geometry.choose(q)
    if not geometry.has_redundant_constraints:
        return Redundancy((), (), {})
    kept, groups = geometry.equations.kept, geometry.equations.groups
    assembler = Assembler(mechanism, geometry.equations)
    if rank_of(assembler.dimensionless(q)) < kept.sum():
        q = assembler.of_largest_rank(q, 0)
    jac = assembler.dimensionless(q)
    names = _names(mechanism, geometry)
    changed = _with_other_lengths(mechanism, q)
    changed = None if changed is None else scaled(changed, groups)
    repeated = []
    for row in np.flatnonzero(~kept):
        always = changed is not None and len(changed) == len(jac) and (
            rank_of(changed[kept | (np.arange(len(jac)) == row)]) == rank_of(changed[kept]))
        repeated.append((*names[row], ANY_LENGTHS if always else THESE_LENGTHS))
    common = np.linalg.svd(jac)[0][:, kept.sum():]
    sharing = np.abs(common).max(axis=1) > NO_SHARE
    components = _components(
        mechanism, geometry, q, np.ascontiguousarray(
            common.T / geometry.equations.move(q).units()[0]), assembler.extent)
    return Redundancy(tuple(repeated), tuple(dict.fromkeys((
        *components, *(name for (name, _), shares in zip(names, sharing) if shares)))),
        components)


def _components(mechanism, geometry, q, common, extent):
    """
    Return the components of the wrenches in all joints that multipliers without effect change.

    ``common``, shape (n, nc): multipliers that move nothing: J^T of each is zero; ``extent``: size
    of the mechanism [m].
    """
    names = wrench_names(mechanism)
    moments = 1 if mechanism.planar else 3
    joints = {joint.child: joint for joint in mechanism.joints}
    origin = np.zeros(2 if mechanism.planar else 3)
    origins = {child: geometry.point(q, child, origin) for child in joints}
    points = [geometry.point(q, cut.body_a, cut.point_a) for cut in mechanism.cut_joints]
    unit = np.where(np.arange(len(names)) < moments, 1.0 / extent, 1.0)
    most = {}
    for lam in common:
        wrenches = geometry.equations.move(q).cut_wrenches(
            lam, geometry.equations.work.body)[:len(points)]
        found = {cut.name: wrench for cut, wrench in zip(mechanism.cut_joints, wrenches)}
        for cut, wrench, place in zip(mechanism.cut_joints, wrenches, points):
            for body, sign in ((cut.body_a, -1.0), (cut.body_b, 1.0)):
                while body != GROUND:
                    moved = wrench.copy()
                    moved[:moments] += _moment(place - origins[body], wrench[moments:])
                    name = joints[body].name
                    found[name] = found.get(name, 0.0) + sign * moved
                    body = joints[body].parent
        scale = max((np.abs(unit * wrench).max() for wrench in found.values()), default=0.0)
        for name, wrench in found.items():
            most[name] = np.maximum(most.get(name, 0.0), np.abs(unit * wrench) / max(
                scale, NO_SHARE))
    order = [joint.name for joint in (*mechanism.joints, *mechanism.cut_joints)]
    return {name: tuple(part for part, share in zip(names, most[name]) if share > NO_SHARE)
            for name in order if name in most and most[name].max() > NO_SHARE}


def _moment(arm, force):
    """Return the moment of a force, in the plane or in space."""
    return arm[0] * force[1] - arm[1] * force[0] if len(arm) == 2 else np.cross(arm, force)


def _names(mechanism, geometry):
    """Return the cut joint or coupling and the name of each equation that may fail to hold."""
    found, held = [], joint_kernels.arrays_of(geometry.model).HELD
    for cut in geometry.model.cut[np.argsort(geometry.model.cut[:, CUT_NUMBER])]:
        equations = space.equation_names(cut[CUT_TYPE], held)
        found += [(mechanism.closures[cut[CUT_NUMBER]].name, equation)
                  for n, equation in enumerate(equations) if cut[POSSIBLE] >> n & 1]
    return found


def _with_other_lengths(mechanism, q):
    """Return the Jacobian of the mechanism with slightly other lengths; None where it is stuck."""
    rng = np.random.default_rng(0)

    def stretched(record, *keys):
        return replace(record, **{key: tuple(
            (1.0 + CHANGE * rng.uniform(-1.0, 1.0)) * np.array(getattr(record, key)))
            for key in keys})

    other = replace(
        mechanism, joints=tuple(stretched(joint, 'position') for joint in mechanism.joints),
        cut_joints=tuple(stretched(cut, 'point_a', 'point_b') for cut in mechanism.cut_joints))
    try:
        assembler = Assembler(other, Geometry(other).equations)
        return assembler.jacobian_of_largest_rank(assembler.positions(q))
    except (AssemblyError, MechanismError):
        return None
