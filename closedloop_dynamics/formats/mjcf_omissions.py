# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Parts of a compiled MJCF model that move bodies and have no counterpart here."""

import numpy as np

from .model import Omission, UNITS
from ..mechanism.coordinates import QUANTITIES

_ALONG = 'no effect acts along such tendons'
_LINEAR = 'springs and dampers are linear'
# By field of the compiled model: quantity, kind of element, reason, units for turning and sliding
# joints, and the flag that disables it.
FIELDS = {
    'tendon_stiffness': ('stiffness', 'TENDON', _ALONG, UNITS['stiffness'], 'SPRING'),
    'tendon_damping': ('damping', 'TENDON', _ALONG, UNITS['damping'], 'DAMPER'),
    'tendon_armature': ('armature', 'TENDON', _ALONG, UNITS['armature'], None),
    'tendon_frictionloss': ('friction', 'TENDON', _ALONG, UNITS['friction'], 'FRICTIONLOSS'),
    'tendon_stiffnesspoly': (
        'higher terms of the stiffness', 'TENDON', _ALONG, ('N m/rad^2', 'N/m^2'), 'SPRING'),
    'tendon_dampingpoly': (
        'higher terms of the damping', 'TENDON', _ALONG, ('N m s^2/rad^2', 'N s^2/m^2'),
        'DAMPER'),
    'tendon_springyield': (
        'yield of the spring', 'TENDON', _ALONG, QUANTITIES['position'], 'SPRING'),
    'jnt_stiffnesspoly': (
        'higher terms of the stiffness', 'JOINT', _LINEAR, ('N m/rad^2', 'N/m^2'), 'SPRING'),
    'jnt_springyield': ('yield of the spring', 'JOINT', _LINEAR, QUANTITIES['position'], 'SPRING'),
    'dof_dampingpoly': (
        'higher terms of the damping', 'JOINT', _LINEAR, ('N m s^2/rad^2', 'N s^2/m^2'),
        'DAMPER'),
    'actuator_dampingpoly': (
        'higher terms of the damping', 'ACTUATOR', _LINEAR, ('N m s^2/rad^2', 'N s^2/m^2'),
        'DAMPER')}
# Acceleration that weights are compared by [m/s^2].
STANDARD = 9.81
# Twice the least moment of a box that MuJoCo takes from a body's [kg m^2].
LEAST = 1e-15


def disabled(mujoco, compiled, what):
    """
    Return whether the flags of a file disable something.

    ``what``: as ``mujoco.mjtDisableBit`` has it behind ``mjDSBL_``.
    """
    known = mujoco.mjtDisableBit
    if what in ('SPRING', 'DAMPER') and not hasattr(known, f'mjDSBL_{what}'):
        # Older versions have one flag for both.
        what = 'PASSIVE'
    return bool(compiled.opt.disableflags & int(getattr(known, f'mjDSBL_{what}', 0)))


def omissions(mujoco, compiled, name, carried, no_drag):
    """
    Return the omissions from a compiled model of a name, a list of Omission.

    ``carried``: fields and rows of them that are read; ``no_drag``: whether nothing of the drag of
    a fluid is left out.
    """
    found = {}
    for field, (quantity, kind, reason, units, flag) in FIELDS.items():
        if flag and disabled(mujoco, compiled, flag):
            continue
        # Older versions have less of them.
        for row, values in enumerate(np.atleast_1d(getattr(compiled, field, ()))):
            size = float(np.abs(values).max(initial=0.0))
            number = int(compiled.dof_jntid[row]) if field.startswith('dof') else row
            if size and (field, row) not in carried:
                element = mujoco.mj_id2name(
                    compiled, getattr(mujoco.mjtObj, f'mjOBJ_{kind}'), number)
                found[field, number] = Omission(
                    quantity, kind.lower(), element or f'number {number + 1}', reason, size,
                    units[not _turns(mujoco, compiled, kind, number)])
    drag = 0.0 if no_drag else _drag(compiled)
    if drag:
        weight = STANDARD * float(compiled.body_mass.sum())
        found['fluid', 0] = Omission(
            f'drag at 1 m/s, {100.0 * drag / weight:.2g} % of the weight,', 'model', name,
            f'bodies are boxes in a fluid, not ellipsoids (density {compiled.opt.density:g} '
            f'kg/m^3, viscosity {compiled.opt.viscosity:g} Pa s)', drag, 'N')
    driven = int(np.count_nonzero(compiled.body_plugin >= 0))
    if driven:
        found['plugin', 0] = Omission(f'forces of plugins on {driven} bodies', 'model', name,
                                      'plugins are not run')
    if compiled.nflex:
        found['flex', 0] = Omission(f'elasticity of {compiled.nflex} flexes', 'model', name,
                                    'bodies are rigid')
    return list(found.values())


def sides(mass, moments):
    """Return the sides of boxes of masses and principal moments, shape (..., 3) [m]."""
    beyond = np.sum(moments, axis=-1, keepdims=True) - 2.0 * moments
    return np.sqrt(6.0 * np.maximum(beyond, LEAST) / np.expand_dims(mass, -1))


def _drag(compiled):
    """Return the drag of all bodies, boxes of their inertia, on the widest face, at 1 m/s [N]."""
    massive = compiled.body_mass > 0.0
    boxes = sides(compiled.body_mass[massive], compiled.body_inertia[massive])
    across = np.sort(boxes, axis=1)[:, 1:].prod(axis=1)
    return float(np.sum(0.5 * compiled.opt.density * across
                        + 3.0 * np.pi * compiled.opt.viscosity * boxes.mean(axis=1)))


def _turns(mujoco, compiled, kind, number):
    """Return whether a joint, a tendon or an actuator is measured by an angle."""
    if kind == 'TENDON':
        first = int(compiled.tendon_adr[number])
        if compiled.wrap_type[first] != mujoco.mjtWrap.mjWRAP_JOINT:
            return False
        number, kind = int(compiled.wrap_objid[first]), 'JOINT'
    return kind != 'JOINT' or compiled.jnt_type[number] != mujoco.mjtJoint.mjJNT_SLIDE
