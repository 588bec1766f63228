# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Machines derived from others: the effects carried over, and those left out."""

from dataclasses import replace
from typing import NamedTuple, Tuple

from closedloop_dynamics.effects.actuator import Actuator
from closedloop_dynamics.effects.effect import WORLD
from closedloop_dynamics.effects.end_stop import EndStop
from closedloop_dynamics.effects.external_force import ExternalForce
from closedloop_dynamics.effects.gravity import Gravity
from closedloop_dynamics.effects.joint_damping import JointDamping
from closedloop_dynamics.effects.joint_friction import JointFriction
from closedloop_dynamics.effects.joint_spring import JointSpring
from closedloop_dynamics.effects.payload import Payload
from closedloop_dynamics.effects.point_spring import PointSpring
from closedloop_dynamics.effects.prescribed_force import PrescribedForce
from closedloop_dynamics.effects.prescribed_motion import PrescribedMotion
from closedloop_dynamics.effects.registry import effect_type
from closedloop_dynamics.effects.rotor import Rotor
from closedloop_dynamics.scene.records import Scene

# Numbers of a profile over time that change sign with the coordinate.
PROFILE = ('offset', 'speed', 'amplitude', 'values', 'rates', 'accelerations')


class Variant(NamedTuple):
    """A scene that was made of another one."""

    scene: Scene
    left_out: Tuple[str, ...]  # Parts of the other scene that it does not have, and the reasons


def variant(scene, mechanism, initial, effects, left_out) -> Variant:
    """Return a scene of another mechanism, with the effects that were carried over."""
    return Variant(replace(
        scene, name=mechanism.name, path=None, description=mechanism.description,
        mechanism=replace(mechanism, parameters={}, source=None, tree=None), initial=initial,
        effects=effects, parameters={}, source=None,
        switched_off=tuple(name for name in scene.switched_off if name in effects)),
        tuple(left_out))


def carried_effects(scene, signs, world, place, turned=()):
    """
    Return the effects of a scene for a machine whose joints count another way, and those left out.

    ``signs``, by joint and by freedom: what the new coordinate is times the old one; None where it
    is neither, 1 for others. ``world`` takes a vector in the old world's axes, returns it in
    those of the new one, mirrored; None where the old world is a moving body: gravity alone stays.
    ``place`` takes a body's name, a place in its frame and an inertia along its axes, returns both
    in its new frame; None for a body that is there no more. ``turned``: joints of which parent and
    child have changed places.
    """
    effects, left_out = {}, []
    for name, effect in scene.effects.items():
        joint = getattr(effect, 'joint', None)
        found = _carried(effect, signs.get(joint, 1), world, place)
        # The parent carries the rotor.
        if found is None or type(effect) is Rotor and (joint in turned or effect.axis is not None):
            left_out.append(f'effects.{name} ({effect_type(effect)})')
        else:
            effects[name] = found
    return effects, left_out


def _carried(effect, sign, world, place):
    """Return an effect of the new machine; None where there is none."""
    kind = type(effect)
    mirrored = world is not None
    if kind is Gravity:
        return replace(effect, acceleration=world(effect.acceleration)) if mirrored else effect
    if kind is Payload:
        moved = place(effect.body, effect.position, effect.inertia)
        return moved and replace(effect, position=moved[0], inertia=moved[1])
    if kind is PointSpring:
        if effect.anchor is None:
            return effect
        return replace(effect, anchor=world(effect.anchor)) if mirrored else None
    if kind is ExternalForce or getattr(effect, 'point', None) is not None:
        return _at_point(effect, world)
    if sign is None:
        return None
    if kind in (JointDamping, JointFriction, Actuator, Rotor):
        return effect
    if kind is JointSpring:
        return replace(effect, rest=sign * effect.rest)
    if kind is EndStop:
        return effect if sign > 0 else replace(
            effect, lower=_turned(effect.upper), upper=_turned(effect.lower))
    if kind in (PrescribedForce, PrescribedMotion):
        return effect if sign > 0 else _negated(effect)
    return None


def _at_point(effect, world):
    """Return a mirrored force or motion of a point, in the world's axes."""
    kind = type(effect)
    if world is None or getattr(effect, 'axes', None) not in (None, WORLD):
        return None
    if kind is ExternalForce and not isinstance(effect.torque, tuple):
        return replace(effect, force=world(effect.force), torque=-effect.torque)
    if kind is PrescribedForce:
        return replace(effect, direction=world(effect.direction))
    # A place along a direction is the same along the mirrored one.
    return replace(effect, direction=world(effect.direction)) if kind is PrescribedMotion else None


def _turned(value):
    return None if value is None else -value


def _negated(effect):
    """Return a profile of which all values have the other sign."""
    changes = {}
    for key in PROFILE:
        value = getattr(effect, key, None)
        if value is not None:
            changes[key] = tuple(-each for each in value) if isinstance(value, tuple) else -value
    if effect.expression is not None:
        changes['expression'] = f'-({effect.expression})'
    return replace(effect, **changes)
