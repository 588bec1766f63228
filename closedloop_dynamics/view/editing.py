# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A scene that is edited by hand: numbers, places of pins and points, parts added or removed; undone.

What a hand moves or sets is written into the text, and the scene read from that: expressions stay,
and what follows from shapes and parameters follows (``dragging``).
"""

from collections.abc import Mapping
from dataclasses import replace
import math
from pathlib import Path
import time

import numpy as np

from .adding import SHORTEST, with_part
from .dragging import CUT, JOINT, POINT, Words
from .removing import without
from ..mechanism.checks import number
from ..mechanism.document import with_scalars
from ..mechanism.fields import at, FieldError, shown
from ..mechanism.mechanism import DISTANCE, GROUND
from ..scene.key_paths import changed, numbers, resolve
from ..scene.loading import scene_of_yaml
from ..scene.source import source_of, with_numbers
from ..scene.text import scene_yaml

# Changes of the same number within so long are undone at once [s]; how many steps are kept.
GESTURE, MOST_STEPS = 1.0, 200
# Cut joints whose two points coincide: pins that can be moved.
PINS = ('revolute', 'spherical', 'universal', 'cylindrical', 'fixed')
LENGTH, BODIES = 'length', 'mechanism.bodies.'
# Largest mechanism whose lengths and masses get sliders: longer lists cannot be searched by eye.
MOST_BODIES = 100


class Editor:
    """
    A scene as it was read, and as it is now, edited.

    ``words_kept``: whether what is saved is in the words of the author of the file.
    """

    def __init__(self, scene):
        self.scene, self.words_kept = scene, True
        # What was read last, its text, which is made when needed.
        self._base, self._text = scene, None
        self._done, self._undone, self._tag = [], [], (None, 0.0)

    @property
    def undoable(self):
        """Return whether there is something to undo, and to do again."""
        return bool(self._done), bool(self._undone)

    def undo(self):
        """Go back before the last change; raise FieldError where there is none."""
        self._step(self._done, self._undone, 'undo')

    def redo(self):
        """Redo an undone change; raise FieldError where there is none."""
        self._step(self._undone, self._done, 'redo')

    def _step(self, back, forth, what):
        if not back:
            raise FieldError('a change before this', 'none', path=(what,))
        forth.append(self._present())
        (self.scene, self._base, self._text, self.words_kept), self._tag = back.pop(), (None, 0.0)

    def _present(self):
        return self.scene, self._base, self._text, self.words_kept

    def _keep(self, tag):
        """Store the present text as a step of undoing, unless the same gesture goes on."""
        now = time.monotonic()
        if tag is None or tag != self._tag[0] or now - self._tag[1] > GESTURE:
            self._done.append(self._present())
            del self._done[:-MOST_STEPS]
        self._tag = tag, now
        self._undone.clear()

    def withdraw(self, before):
        """Discard a change that gave no machine; ``before`` is an earlier ``state``."""
        (self.scene, self._base, self._text, self.words_kept), done, undone = before
        self._done, self._undone, self._tag = list(done), list(undone), (None, 0.0)

    @property
    def state(self):
        """Return all that ``withdraw`` needs."""
        return self._present(), list(self._done), list(self._undone)

    # Numbers.

    def sliders(self):
        """
        Return the numbers that a hand may change, as JSON can.

        They are parameters; of up to MOST_BODIES bodies lengths between the joints of each, and
        masses, too.
        """
        mechanism, found = self.scene.mechanism, []
        known = numbers(self.scene)

        def add(group, key, label, value, unit):
            reach = abs(value) or 1.0
            positive = unit != '' and value > 0.0
            found.append({'group': group, 'key': key, 'label': label, 'value': value,
                          'unit': unit, 'low': 0.1 * reach if positive else value - 2.0 * reach,
                          'high': value + 2.0 * reach})

        for key, value in known.items():
            if key.startswith('parameters.'):
                add('parameters', key, key.partition('.')[2], value, '')
        if len(mechanism.bodies) > MOST_BODIES:
            return found
        for body in (GROUND, *(body.name for body in mechanism.bodies)):
            (first, _, origin), *others = self.pins(body)
            for name, key, place in others:
                if key is not None and math.dist(place, origin) > SHORTEST:
                    add('lengths', f'{LENGTH}.{body}.{name}', f'{body}: {first} to {name}',
                        math.dist(place, origin), 'm')
        for body in mechanism.bodies:
            if not body.massless:
                add('masses', f'mechanism.bodies.{body.name}.mass', body.name, body.mass, 'kg')
        return found

    def set(self, key, value):  # noqa: A003
        """Give a number another value; FieldError, MechanismError where that is impossible."""
        value = number(value)
        with at(key):
            kind, _, name = key.partition('.')
            body, _, last = name.rpartition('.')
            if kind == LENGTH:
                if not value > SHORTEST:
                    raise FieldError(f'a length above {SHORTEST:g} m', shown(value))
                self._renumber(lambda words: words.with_length(body, last, value), ('set', key))
            elif key.startswith(BODIES) and last == 'mass':
                body = key[len(BODIES):].rpartition('.')[0]
                self._renumber(lambda words: words.with_mass(body, value), ('set', key))
            else:
                scene = changed(self.scene, {resolve(self.scene, key): value})
                self._keep(('set', key))
                self.scene = scene

    def effect(self, name, acts, record):
        """Store the present record of an effect, and whether it is on."""
        scene = self.scene
        if name not in scene.effects or (acts, record) == (
                name not in scene.switched_off, scene.effects[name]):
            return
        others = tuple(other for other in scene.switched_off if other != name)
        self._keep(('effect', name, acts))
        self.scene = replace(
            scene, effects={**scene.effects, name: record},
            switched_off=others if acts else (*others, name))

    def pose(self, position):
        """Set the machine's start position, shape (nq,) [rad or m]."""
        self._keep(None)
        self.scene = replace(self.scene, initial=replace(
            self.scene.initial, position=tuple(np.array(position).tolist())))

    def pins(self, body):
        """Return names, key paths and places of the joints of a body, its own one first."""
        mechanism = self.scene.mechanism
        found = [(joint.name, None, np.zeros(len(joint.position)))
                 for joint in mechanism.joints if joint.child == body]
        found += [(joint.name, f'mechanism.joints.{joint.name}.position', joint.position)
                  for joint in mechanism.joints if joint.parent == body]
        for cut in mechanism.cut_joints:
            found += [(cut.name, f'mechanism.cut_joints.{cut.name}.point_{side}', place)
                      for side, of, place in (('a', cut.body_a, cut.point_a),
                                              ('b', cut.body_b, cut.point_b)) if of == body]
        return found or [('', None, np.zeros(2 if mechanism.planar else 3))]

    # Places.

    def handles(self):
        """
        Return the movable handles, as JSON: kind, name, body and place in its frame.

        The body is by its number, -1 the ground.
        """
        mechanism = self.scene.mechanism
        rows = {GROUND: -1, **{body.name: k for k, body in enumerate(mechanism.bodies)}}

        def handle(kind, name, body, place):
            return {'kind': kind, 'name': name, 'body': rows[body], 'place': [*place, 0.0][:3]}

        found = [handle(JOINT, joint.name, joint.parent, joint.position)
                 for joint in mechanism.joints]
        for cut in mechanism.cut_joints:
            if cut.type in PINS:
                found.append(handle(CUT, cut.name, cut.body_a, cut.point_a))
            elif cut.type == DISTANCE:
                found += [handle(f'{CUT}_{side}', cut.name, body, place)
                          for side, body, place in (('a', cut.body_a, cut.point_a),
                                                    ('b', cut.body_b, cut.point_b))]
        return found + [handle(POINT, point.name, point.body, point.position)
                        for point in mechanism.points]

    def move(self, kind, name, place, position):
        """
        Move a pin or a point, named as a handle has it, to a place in the world [m].

        In the plane the third number does not count; ``position`` is the present one, shape (nq,).
        FieldError, MechanismError where it cannot be there.
        """
        if not any((kind, name) == (handle['kind'], handle['name']) for handle in self.handles()):
            raise FieldError('a pin or a point that can be moved', f'{kind} {name}')
        self._renumber(lambda words: words.moved(kind, name, place, position),
                       ('move', kind, name))

    # Parts.

    def add(self, what, position, joint=None, **places):
        """
        Add a part: ``what`` is a key of ``adding.NEEDED``.

        ``position``: present joint coordinates, shape (nq,); ``joint``: of a damper or a drive;
        ``places``: ``body_a``, ``a``, ``body_b``, ``b``: names of bodies, None for none, and
        places in the world [m]. FieldError, MechanismError, SceneError where it cannot be added.
        """
        self._rewrite(lambda text: with_part(
            self.scene, text, what, position, joint=joint, **places), what)

    def remove(self, kind, name):
        """
        Remove a part, of a kind in ``messages.REMOVALS``; return the names of all removed with it.

        FieldError, MechanismError, SceneError where others need it.
        """
        also = []

        def less(text):
            text, also[:] = without(self.scene, text, kind, name)
            return text

        self._rewrite(less, kind)
        return also

    def _renumber(self, values, tag):
        """Replace numbers of the text, which ``values`` returns for its words, and read it."""
        def change(text):
            found = self.scene if text is self._text and self.scene is self._base and isinstance(
                self.scene.source[0]['mechanism'], Mapping) else self._read(text)
            return with_scalars(text, {
                keys: repr(value) for keys, value in values(Words(found)).items()})

        self._rewrite(change, tag[0], tag)

    def _rewrite(self, change, what, tag=None):
        """Change the text, and read the scene from it."""
        text, kept = self.text()
        other = change(text)
        if other is None:
            kept, other = False, change(scene_yaml(self.scene))
        if other is None:
            raise FieldError('a place for it in the file', 'none', path=(what,))
        scene = self._read(other)
        self._keep(tag)
        self.scene = self._base = scene
        self._text, self.words_kept = other, kept

    def _read(self, text):
        path = self.scene.path or Path('scene.yaml')
        return replace(scene_of_yaml(text, path), name=self.scene.name)

    def text(self):
        """Return the scene as one YAML text, and whether in the words of its author."""
        if self._text is None:
            self._text, self.words_kept = source_of(self._base)
        text = self._text if self.scene is self._base else with_numbers(
            self._text, self._base, self.scene)
        if text is None:
            return scene_yaml(self.scene), False
        return text, self.words_kept
