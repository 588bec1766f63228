# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Parts that are added to a scene: what its file says of them."""

from itertools import count
import math

import numpy as np

from .body_frames import BodyFrames
from ..mechanism.document import with_value
from ..mechanism.fields import FieldError, shown
from ..mechanism.mechanism import GROUND
from ..scene.source import with_entries

# Mass of a bar [kg/m], and numbers of others by what they are.
BAR_MASS, STIFFNESS, DAMPING, FORCE = 1.0, 100.0, 0.1, 1.0
# Shortest length of a bar [m].
SHORTEST = 1e-3
# What each part is added by.
NEEDED = {
    'point': ('body_a', 'a'), 'link': ('body_a', 'a', 'b'), 'pin': ('body_a', 'a', 'body_b'),
    'rod': ('body_a', 'a', 'body_b', 'b'), 'spring': ('body_a', 'a', 'body_b', 'b'),
    'force': ('body_a', 'a', 'b'), 'damper': ('joint',), 'drive': ('joint',)}
# Those that change the number of degrees of freedom.
CONSTRAINING = 'link', 'pin', 'rod'


def with_part(scene, text, what, position, **given):
    """
    Return the text of a scene with another part, or None where it has no place for it.

    ``what`` is a key of ``NEEDED``, ``given`` as ``editing.Editor.add`` has it; the machine stands
    at a ``position``, shape (nq,). FieldError where the part cannot be added.
    """
    if not scene.mechanism.planar and what in ('link', 'pin'):
        raise FieldError('a mechanism in the plane', 'one in space', path=(what,))
    for key in NEEDED[what]:
        if given.get(key) is None:
            raise FieldError(f'{key} of a {what}', 'none', path=(what,))
    entries = getattr(_Entries(scene, position), what)(**given)
    text = with_entries(text, entries)
    if what not in CONSTRAINING or not scene.initial.hold or text is None:
        return text
    # As many are held as there are degrees of freedom. A link that hangs free has one more.
    hangs = what == 'link' and given.get('body_b') is None
    pins = [key[-1] for key in entries if key[0] == 'initial']
    text = with_value(
        text, ('initial', 'hold'), [*scene.initial.hold, *pins] if hangs else [])
    # Where none is held, the loops are closed from the present position, to which it is nearest.
    return text if hangs or text is None else _begun_at(scene, text, position)


def _begun_at(scene, text, position):
    """Return the text of a scene that begins at a position; None where it has no place for it."""
    names = scene.mechanism.coordinates
    for name, value in zip(names.single_names, position[names.place[names.single]]):
        value = round(float(value), 9)
        text = (with_value(text, ('initial', 'position', name), value)
                or with_entries(text, {('initial', 'position', name): value}))
        if text is None:
            return None
    return text


class _Entries:
    """Entries of a file for each part, by their paths of keys."""

    def __init__(self, scene, position):
        self._effects, self._mechanism = scene.effects, scene.mechanism
        self._frames = BodyFrames(scene.mechanism, position)

    def _name(self, stem, *taken):
        mechanism = self._mechanism
        taken = {*taken, *self._effects, *(one.name for part in (
            mechanism.bodies, mechanism.joints, mechanism.cut_joints, mechanism.points,
            mechanism.couplings) for one in part)}
        return next(name for name in (f'{stem}_{k}' for k in count(1)) if name not in taken)

    def _point(self, name, body, place):
        return {('mechanism', 'points', name): {
            'body': body, 'position': self._frames.rounded(body, place)}}

    def point(self, body_a, a, **_):
        return self._point(self._name('point'), body_a, a)

    def link(self, body_a, a, b, body_b=None, **_):
        a, b = np.array(a), np.array(b)
        length = math.dist(a[:2], b[:2])
        if not length > SHORTEST:
            raise FieldError('two places apart from each other', 'one place', path=('link',))
        link, pin, mass = self._name('link'), self._name('pin'), _rounded(BAR_MASS * length)
        angle = math.atan2(b[1] - a[1], b[0] - a[0]) - self._frames.angle(body_a)
        entries = {
            ('mechanism', 'bodies', link): {
                'mass': mass, 'center_of_mass': [_rounded(length / 2.0), 0.0],
                'inertia': _rounded(mass * length ** 2 / 12.0)},
            ('mechanism', 'joints', pin): {
                'type': 'revolute', 'parent': body_a, 'child': link,
                'position': self._frames.rounded(body_a, a), 'angle': round(angle, 9),
                **({'actuated': True} if body_a == GROUND and not (
                    self._mechanism.actuated_joints) else {})},
            ('initial', 'position', pin): 0.0}
        if body_b is None:
            entries['mechanism', 'points', self._name('end')] = {
                'body': link, 'position': [round(length, 9), 0.0]}
        else:
            entries['mechanism', 'cut_joints', self._name('cut')] = {
                'type': 'revolute', 'body_a': link, 'point_a': [round(length, 9), 0.0],
                'body_b': body_b, 'point_b': self._frames.rounded(body_b, b)}
        return entries

    def pin(self, body_a, a, body_b, **_):
        if body_a == body_b:
            raise FieldError('two bodies', 'one', path=('pin',))
        return {('mechanism', 'cut_joints', self._name('cut')): {
            'type': 'revolute', 'body_a': body_a, 'point_a': self._frames.rounded(body_a, a),
            'body_b': body_b, 'point_b': self._frames.rounded(body_b, a)}}

    def rod(self, body_a, a, body_b, b, **_):
        return {('mechanism', 'cut_joints', self._name('rod')): {
            'type': 'distance', 'body_a': body_a, 'point_a': self._frames.rounded(body_a, a),
            'body_b': body_b or GROUND, 'point_b': self._frames.rounded(body_b or GROUND, b),
            'length': round(self._frames.apart(a, b), 9)}}

    def spring(self, body_a, a, body_b, b, **_):
        spring, end = self._name('spring'), self._name('spring_end')
        law = {'type': 'point_spring', 'point_a': end, 'stiffness': STIFFNESS,
               'free_length': _rounded(self._frames.apart(a, b))}
        entries = self._point(end, body_a, a)
        if body_b == GROUND:
            law['anchor'] = self._frames.rounded(GROUND, b)
        else:
            law['point_b'] = self._name('spring_end', end)
            entries.update(self._point(law['point_b'], body_b, b))
        return {**entries, ('effects', spring): law}

    def damper(self, joint, **_):
        return {('effects', self._name('damper')): {
            'type': 'joint_damping', 'joint': joint, 'coefficient': DAMPING}}

    def force(self, body_a, a, b, **_):
        point = self._name('force_at')
        size = 2 if self._mechanism.planar else 3
        way = np.subtract(b, a)[:size]
        way = FORCE * way / (np.linalg.norm(way) or 1.0)
        return {**self._point(point, body_a, a), ('effects', self._name('force')): {
            'type': 'external_force', 'point': point, 'force': [_rounded(one) for one in way]}}

    def drive(self, joint, **_):
        known = {one.name: one for one in self._mechanism.joints}
        if joint not in known or known[joint].actuated:
            raise FieldError('a joint of the tree that is not driven yet', shown(joint),
                             path=('joint',))
        return {('mechanism', 'joints', joint, 'actuated'): True}


def _rounded(value):
    return float(f'{value:.6g}')
