# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The numbers of a file that change with a pin, a point, a length or a mass.

Where the file gives a place in numbers, these are replaced, and the points of shapes at the pin
with them; all other pins, and how bodies are turned, stay. Where a place follows from parameters,
these are solved for, and bodies may turn: the loops stay closed first, then the pin is as near as
possible to the place that is wanted, then other pins stay where they are. What a point follows
from is solved for with the joints held that the start holds. What follows from these
numbers is not written: the file is read again. The engine's loop solver is for the joints of one
machine; here lengths are unknown beside them, and each try is another machine.
"""

from copy import deepcopy
import math

import numpy as np

from .body_frames import BodyFrames
from ..kinematics.geometry import Geometry
from ..mechanism.between import BETWEEN
from ..mechanism.cylinders import SECTION as CYLINDERS
from ..mechanism.expressions import names_of, Parameters
from ..mechanism.fields import FieldError, shown
from ..mechanism.kinematics import body_poses
from ..mechanism.mechanism import DISTANCE, GROUND
from ..mechanism.reader import with_data

MECHANISM = 'mechanism'
JOINT, CUT, POINT = 'joint', 'cut', 'point'
# Of a number, for differences; largest step in lengths of the machine and in angles; what is left
# of a solution, in both; of a singular value, and of a direction, that counts as none.
DIFFERENCE, STRIDE, SETTLED, SMALLEST = 1e-6, 0.2, 1e-11, 1e-6
MOST_STEPS = 60
# Digits of a parameter, and decimals of a place, that are written.
DIGITS, DECIMALS = 12, 13
# Of lengths that are the same, in lengths of the machine; of coordinates that stay.
SAME, STILL = 1e-9, 1e-7


class Words:
    """The data that a scene, read from one text with its mechanism in it, was written in."""

    def __init__(self, scene):
        self.scene, self.mechanism = scene, scene.mechanism
        self._whole = scene.source[0]
        self._data = self._whole[MECHANISM]
        tree = scene.mechanism.tree
        self._shifts = {} if tree is None else tree.shifts

    # What the file says.

    def _at(self, keys):
        """Return the data at a key path, None where there are none."""
        here = self._whole
        for key in keys:
            if isinstance(here, dict):
                here = here.get(key)
            elif isinstance(here, list) and key.isdecimal() and int(key) < len(here):
                here = here[int(key)]
            else:
                return None
        return here

    def _key_of(self, parameter):
        own = parameter in (self._whole.get('parameters') or {})
        return ('parameters', parameter) if own else (MECHANISM, 'parameters', parameter)

    def _leaves(self, value):
        """Return the key paths of the parameters given as numbers that data follow from."""
        if isinstance(value, (list, dict)):
            items = value.values() if isinstance(value, dict) else value
            return dict.fromkeys(key for one in items for key in self._leaves(one))
        found = {}
        for name in names_of(value) if isinstance(value, str) else ():
            key = self._key_of(name)
            if self._at(key) is not None:
                found.update(self._leaves(self._at(key)) or {key: None})
        return found

    def _value(self, value, parameters):
        return np.array(Parameters(parameters).evaluated(deepcopy(value)), dtype=float)

    def _pins(self):
        """Return names, bodies and key paths of all places of joints; None: the child's frame."""
        for name, values in self._data['joints'].items():
            if BETWEEN in values:
                for side, body in enumerate(values[BETWEEN]):
                    yield name, body, (MECHANISM, 'joints', name, 'points', str(side))
            else:
                yield name, values['parent'], (MECHANISM, 'joints', name, 'position')
                yield name, values['child'], None
        for name, values in (self._data.get('cut_joints') or {}).items():
            for side in 'ab':
                yield (name, values[f'body_{side}'],
                       (MECHANISM, 'cut_joints', name, f'point_{side}'))
        for name, values in (self._data.get(CYLINDERS) or {}).items():
            for side, (end, body) in enumerate(zip(('foot', 'head'), values[BETWEEN])):
                yield f'{name}_{end}', body, (MECHANISM, CYLINDERS, name, 'points', str(side))

    def _points(self):
        for name, values in (self._data.get('points') or {}).items():
            yield name, values['body'], (MECHANISM, 'points', name, 'position')

    def _shape_points(self, body):
        """Return the key paths of the points of a body's shapes."""
        own = (MECHANISM, 'bodies', body)
        shapes = [(*own, 'shape')]
        shapes += [(*own, 'visual', str(k))
                   for k, _ in enumerate(self._at((*own, 'visual')) or ())]
        return [(*keys, kind, key) for keys in shapes for kind, values in (
            self._at(keys) or {}).items() for key in ('from', 'to', 'center') if key in values]

    # Places.

    def moved(self, kind, name, place, position):
        """
        Return the numbers of the file, by key path, of a pin or a point at a place in the world.

        ``kind`` and ``name`` as handles have them; ``place``, shape (3,) [m]; ``position`` is that
        of the machine, shape (nq,).
        """
        frames = BodyFrames(self.mechanism, position)
        if kind == POINT:
            sides = [side for side in self._points() if side[0] == name]
        else:
            sides = [side for side in self._pins() if side[0] == name and (
                kind in (JOINT, CUT) or side[2][-1][-1] == kind[-1])]
        carried = [body for _, body, keys in sides if keys is None]
        others = [keys for body in carried for keys in self._in_frame(body)]
        own = [keys for *_, keys in sides if keys is not None]
        if any(self._leaves(self._at(keys)) for keys in (*own, *others)):
            return self._solved(kind, name, own, others, carried[:1],
                                np.array(place, dtype=float), position)
        values = {}
        for _, body, keys in sides:
            if keys is not None:
                local = frames.local(body, place) + self._shift(body)
                values.update(self._with_shape(body, keys, local))
        for body in carried:
            (_, parent, keys), = [side for side in sides if side[2] is not None]
            before = frames.world(parent, self._place(keys) - self._shift(parent))
            after = frames.world(parent, frames.local(parent, place))
            back = frames.turned_back(body, before - after)
            for other in others:
                if not self._goes_with_frame(other):
                    old = self._place(other)
                    values.update(_keyed(other, old + back[:len(old)]))
        if kind.startswith(CUT) and self.mechanism.cut_joint(name).type == DISTANCE:
            cut = self.mechanism.cut_joint(name)
            other = (frames.world(cut.body_b, cut.point_b) if kind.endswith('a')
                     else frames.world(cut.body_a, cut.point_a))
            values[MECHANISM, 'cut_joints', name, 'length'] = frames.apart(other, place)
        drawn = 'initial', 'at', name
        if self._at(drawn) is not None and not self._leaves(self._at(drawn)):
            values.update(_keyed(drawn, place[:len(self._at(drawn))]))
        return self._written(values)

    def _shift(self, body):
        return np.array(self._shifts.get(body, np.zeros(2 if self.mechanism.planar else 3)))

    def _place(self, keys):
        return self._value(self._at(keys), self.scene.parameters)

    def _in_frame(self, body):
        """Return the key paths of all places that are given in the frame of a body."""
        center = (MECHANISM, 'bodies', body, 'center_of_mass')
        return [*[center] * (self._at(center) is not None),
                *(keys for _, one, keys in (*self._pins(), *self._points())
                  if one == body and keys is not None), *self._shape_points(body)]

    def _goes_with_frame(self, keys):
        """Return whether a place is a point of a shape at the pin that carries the body."""
        return keys[1] == 'bodies' and keys[-1] != 'center_of_mass' and not (
            np.abs(self._place(keys)).max() > SAME)

    def _with_shape(self, body, keys, place):
        """Return the numbers of a place in a body, and of points of its shapes there."""
        before, values = self._place(keys), _keyed(keys, place)
        if body != GROUND and keys[1] != 'points':
            for other in self._shape_points(body):
                if np.abs(self._place(other) - before).max() <= SAME:
                    values.update(_keyed(other, place))
        return values

    def _written(self, values):
        """Return numbers whose places in the file follow from no parameter, or refuse."""
        for keys, value in values.items():
            below = self._leaves(self._at(keys))
            if below:
                raise FieldError('a number in the file', (
                    f'{shown(self._at(keys))}, which follows from {_named(below)}'),
                    'change that', keys)
            if not math.isfinite(value):
                raise FieldError('a finite number', shown(value), path=keys)
        return {keys: round(value, DECIMALS) for keys, value in values.items()
                if round(value, DECIMALS) != self._number(keys)}

    def _number(self, keys):
        value = self._at(keys)
        if isinstance(value, str) and not self._leaves(value):
            # With a unit.
            value = Parameters().evaluated(value)
        return float(value) if isinstance(value, (int, float)) else None

    # Lengths and masses.

    def with_length(self, body, name, value):
        """Return the numbers of the file with which a pin has a distance [m] from a body's own."""
        known = {one: keys for one, of, keys in self._pins() if of == body}
        first = next((one.name for one in self.mechanism.joints if one.child == body),
                     next(iter(known), None))
        if name not in known or known[name] is None:
            raise FieldError('a body and a joint of it', f'{body}.{name}')
        keys, origin = known[name], known.get(first)
        leaves = self._leaves([self._at(one) for one in (keys, origin) if one is not None])
        start = 0.0 if origin is None else self._place(origin)
        if leaves:
            def length(mechanism):
                places = [self._value(self._at(one), mechanism.parameters)
                          for one in (keys, origin) if one is not None]
                return math.dist(places[0], places[1] if len(places) > 1 else 0.0 * places[0])
            return self._with(leaves, length, value, f'the length {body}: {first} to {name}')
        away = self._place(keys) - start
        return self._written(self._with_shape(
            body, keys, start + away * (value / np.linalg.norm(away))))

    def with_mass(self, body, value):
        """Return the numbers of the file with which a body has a mass [kg]."""
        own = (MECHANISM, 'bodies', body)
        key = 'mass' if self._at((*own, 'mass')) is not None else 'density'
        leaves = self._leaves(self._at((*own, key)))
        record = next(one for one in self.mechanism.bodies if one.name == body)
        if leaves:
            return self._with(leaves, lambda mechanism: next(
                one.mass for one in mechanism.bodies if one.name == body), value,
                f'the mass of {body}')
        if self._at((*own, key)) is None:
            raise FieldError('a body with a mass', shown(body))
        before = float(self._place((*own, key)))
        return self._written({(*own, key): before * value / record.mass})

    def _with(self, leaves, measure, value, what):
        """Return the value of the only parameter that a number follows from."""
        if len(leaves) > 1:
            raise FieldError('a number that follows from one parameter', (
                f'{what}, which follows from {_named(leaves)}'), 'change one of these')
        key, = leaves
        now = last = self.scene.parameters[key[-1]]
        error = measure(self._built(leaves, [now])) - value
        now += 1e-4 * (abs(now) or 1.0)
        for _ in range(MOST_STEPS):
            other = measure(self._built(leaves, [now])) - value
            if other == error or abs(other) <= 1e-14 * abs(value):
                break
            now, last, error = now - other * (now - last) / (other - error), now, other
        if not abs(other) <= SAME * abs(value):
            raise FieldError(f'a value that {key[-1]} gives', f'{value:.6g} for {what}')
        return {key: float(f'{now:.{DIGITS}g}')}

    # Parameters.

    def _built(self, leaves, values):
        """Return the mechanism with other numbers at some key paths."""
        data, own, given = deepcopy(self._data), {}, {}
        for key, value in zip(leaves, values):
            if key[0] == 'parameters':
                own[key[1]] = float(value)
            elif key[1] == 'parameters':
                given[key[2]] = float(value)
            else:
                here = data
                for word in key[1:-1]:
                    here = here[int(word) if isinstance(here, list) else word]
                here[int(key[-1]) if isinstance(here, list) else key[-1]] = float(value)
        known = data.get('parameters') or {}
        whole = Parameters.read(self._whole.get('parameters'), own).values
        return with_data(self.mechanism, data, {
            **{name: value for name, value in whole.items() if name in known}, **given})

    def _solved(self, kind, name, own, others, carried, wanted, position):
        """Return the numbers that bring a pin, given at key paths, to a place in the world."""
        bodies = {keys: body for _, body, keys in (*self._pins(), *self._points()) if keys}
        pins = {keys for _, _, keys in self._pins() if keys and keys not in own}
        # In the frame of a body whose own pin moves, masses and shapes move the other way.
        bodies.update((keys, *carried) for keys in others if keys not in bodies)
        leaves = {}
        for keys in (*own, *others):
            below = self._leaves(self._at(keys))
            if keys in own or keys in pins or not (below or self._goes_with_frame(keys)):
                leaves.update(below or dict.fromkeys(_keyed(keys, self._place(keys))))
        if kind.startswith(CUT):
            length = (MECHANISM, 'cut_joints', name, 'length')
            if self._at(length) is not None:
                leaves.update(self._leaves(self._at(length)) or {length: None})
        size = max([1e-3, *(np.abs(self._place(keys)).max() for keys in bodies)])

        def local(mechanism):
            """Return the place of each in the frame of its body, the mechanism's."""
            shifts = {} if mechanism.tree is None else mechanism.tree.shifts
            found = {}
            for keys, body in bodies.items():
                place = self._value(self._at(keys), mechanism.parameters)
                place = [changed.get((*keys, str(k)), one) for k, one in enumerate(place)]
                found[keys] = np.subtract(place, shifts.get(body, 0.0 * np.array(place)))
            return found

        def places(own_places, frames):
            return {keys: frames.world(bodies[keys], place)
                    for keys, place in own_places.items()}

        def levels(mechanism, equations, own_places, q):
            """Return what is to vanish, the most important first."""
            poses = body_poses(mechanism, q)
            found = places(own_places, BodyFrames(mechanism, q))
            planes = slice(2 if mechanism.planar else 3)
            return [equations.move(q).closures()[0],
                    size * apart(q, position)[held],
                    np.concatenate([(found[keys] - wanted)[planes] for keys in own]),
                    *(np.concatenate([np.zeros(0), *(
                        found[keys] - before[keys] for keys in found
                        if keys not in own and (keys in pins) == of_pins)])
                      for of_pins in (True, False)),
                    size * (poses - turned)[:, 2 if mechanism.planar else 3:].ravel()]

        now = [float(self.scene.parameters[key[-1]]) if key[-2] == 'parameters'
               else float(self._place(key)) for key in leaves]
        q, changed = np.array(position, dtype=float), {}
        before = places(local(self.mechanism), BodyFrames(self.mechanism, q))
        turned = body_poses(self.mechanism, q)
        coordinates, count = self.mechanism.coordinates, len(now)
        moved, apart = coordinates.moved, coordinates.apart
        # A pin takes bodies with it, a point does not.
        held = [k for k, key in enumerate(coordinates.names) if kind == POINT and (
            {key, coordinates.joint_of(key)} & set(self.scene.initial.hold))]
        now, steps = np.array(now), coordinates.nv

        def at(values):
            changed.clear()
            changed.update(zip(leaves, values))
            mechanism = self._built(leaves, values)
            return mechanism, Geometry(mechanism).equations, local(mechanism)

        for _ in range(MOST_STEPS):
            increments = DIFFERENCE * np.maximum(np.abs(now), size)
            others = [levels(*at(now + one), q) for one in np.diag(increments)]
            machine = at(now)
            found = levels(*machine, q)
            columns = [[(one - other) / step for one, other in zip(column, found)]
                       for column, step in zip(others, increments)]
            columns += [[(one - other) / DIFFERENCE for one, other in zip(
                levels(*machine, moved(q, DIFFERENCE * unit)), found)] for unit in np.eye(steps)]
            jacobians = [np.transpose(one) for one in zip(*columns)]
            change = _in_turn(jacobians, found)
            largest = np.abs(change).max() / max(1.0, size)
            change *= min(1.0, STRIDE / largest) if largest > 0.0 else 1.0
            now, q = now + change[:count], moved(q, change[count:])
            if largest <= SETTLED:
                break
        self._require_determined(leaves, np.concatenate(jacobians))
        if np.abs(levels(*at(now), q)[0]).max(initial=0.0) > SAME * size:
            raise FieldError(f'a place that {_named(leaves)} can bring it to with closed loops',
                             shown(wanted.tolist()), path=(name,))
        values = {key: float(f'{value:.{DIGITS}g}') + 0.0 for key, value in zip(leaves, now)}
        for keys in own:
            if not self._leaves(self._at(keys)):
                place = [values[one] for one in _keyed(keys, self._place(keys))]
                values.update(self._with_shape(bodies[keys], keys, np.array(place)))
        values = {key: value for key, value in values.items()
                  if abs(value - self._present(key)) > SAME * size}
        if not values:
            raise FieldError(f'a place that {_named(leaves)} can bring it nearer to',
                             shown(wanted.tolist()), path=(name,))
        return {**values, **self._start(q, position)}

    def _present(self, key):
        return (self.scene.parameters[key[-1]] if key[-2] == 'parameters'
                else float(self._place(key)))

    def _require_determined(self, leaves, jacobian):
        """Refuse parameters of which several values give the same places."""
        count = len(leaves)
        jacobian = jacobian / np.maximum(np.linalg.norm(jacobian, axis=0), SMALLEST)
        _, singular, right = np.linalg.svd(jacobian)
        free = right[np.count_nonzero(singular > SMALLEST * singular.max(initial=0.0)):, :count]
        loose = [key for key, size in zip(leaves, np.abs(free).max(axis=0, initial=0.0))
                 if size > math.sqrt(SMALLEST)]
        if loose:
            raise FieldError('a place that is determined by one value of each parameter', (
                f'one that several values of {_named(loose)} give'),
                'change one of these by its slider')

    def _start(self, q, position):
        """Return the numbers of the file's start that follow the machine's position."""
        hold, values = self.scene.initial.hold, {}
        names = self.mechanism.coordinates
        for name, now, before in zip(names.single_names, *(
                one[names.place[names.single]] for one in (q, position))):
            keys = ('initial', 'position', *name.split('.'))
            if (not hold or name in hold) and abs(now - before) > STILL and isinstance(
                    self._at(keys), (int, float, str)) and not self._leaves(self._at(keys)):
                values[keys] = float(f'{now:.{DIGITS}g}')
        return values


def _in_turn(jacobians, errors):
    """Return the change that removes errors as far as it can, each after those before it."""
    size = jacobians[0].shape[1]
    change, free = np.zeros(size), np.eye(size)
    for jac, error in zip(jacobians, errors):
        if not error.size or not free.shape[1]:
            continue
        left, singular, right = np.linalg.svd(jac @ free)
        rank = np.count_nonzero(singular > SMALLEST * max(1.0, singular.max(initial=0.0)))
        wanted = left[:, :rank].T @ -(error + jac @ change) / singular[:rank]
        change = change + free @ (right[:rank].T @ wanted)
        free = free @ right[rank:].T
    return change


def _named(keys):
    return ', '.join(dict.fromkeys(key[-1] if key[-2] == 'parameters' else '.'.join(key)
                                   for key in keys))


def _keyed(keys, values):
    return {(*keys, str(k)): float(value) for k, value in enumerate(values)}
