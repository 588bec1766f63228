# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The effects of one scene, put together: model constants, table of force elements, energies.

Nothing here knows a type of effect: each answers what an ``effect.Effect`` can be asked.
"""

from dataclasses import replace

import numpy as np

from . import scene_code
from .effect_table import EffectTable
from .element import DISSIPATED, FOLLOWED, OWN, states_of, STORED, WORK
from .force_law import FRICTION, INERTIA, MOTION
from .sensor import Chain
from .traced_effect import TracedEffect, TracedLaw
from .. import codegen
from ..codegen import joint_kernels
from ..engine.types import TYPE, VARIES
from ..mechanism.checks import boolean, one_of
from ..mechanism.fields import at, FieldError, keys_of, mapping


def require_one_drive_each(records):
    """Refuse two drives of one joint: each would replace the command or the motion; FieldError."""
    drives, moved = {}, {}
    for name, record in records.items():
        motion = record.motion('')
        if motion is not None:
            other = moved.setdefault(motion, name)
            if other != name:
                raise FieldError('one motion for each joint or point',
                                 f'a second one beside {other!r}', path=(name,))
        if record.drive() is not None:
            joint, _ = record.drive()
            other = drives.setdefault(joint, name)
            if other != name:
                raise FieldError('one drive for each joint',
                                 f'a second one for {joint!r}, which {other!r} drives',
                                 path=(name, 'joint'))
    by_joint = {motion.freedom: name for motion, name in moved.items() if motion.freedom}
    for name, record in records.items():
        joint = getattr(record, 'joint', None)
        if joint in by_joint and (record.drive() is not None or record.COMMANDS):
            raise FieldError(
                'a motion or a torque of a joint, not both',
                f'a torque of {joint!r}, whose motion {by_joint[joint]!r} prescribes',
                'remove one of them', (name, 'joint'))


class EffectSet:
    """
    The listed effects, which may be switched and changed while a simulation runs.

    Attributes
    ----------
    records : dict of str to Effect
        With their present parameters.
    enabled : dict of str to bool
        The effects that are switched on.
    elements : tuple of ForceElement
        For ``EffectTable.of``.
    initial : ndarray, shape (nz,)
        The effects' states at the start.
    roles : ndarray of int, shape (nz,)
        Their roles: ``element.OWN``, ``DISSIPATED`` or ``WORK``.
    own : ndarray of int
        Which of these act back on the motion; the others are energies.
    drives : dict of int to float
        Delay of the command [s] of every joint whose command passes through a drive.
    delays : bool
        Whether any of them is late.
    sensors, sensors_at_cuts : sensor.Chain
        Sensors of the joints of the tree, and of cut joints.
    remembers : bool
        Whether what is measured depends on the states in between.
    attends : bool
        Whether either is so: commands that are late, or sensors that remember.
    follows_time : bool
        Whether any effect has states that ``begin_at_time`` sets.
    cuts : tuple of 2 ndarrays or None
        Of the cut joints that anything acts in, as for ``EffectTable.of``.

    """

    def __init__(self, effects, model, machine, cuts=None, switched_off=()):
        self.records = dict(effects)
        self.enabled = {name: name not in switched_off for name in effects}
        self._model, self._machine, self._table, self._system = model, machine, None, None
        self._bare = (model.body.copy(), model.tree[:, [TYPE, VARIES]].copy(),
                      model.gravity.copy())
        elements = {name: record.element(machine) for name, record in effects.items()}
        self._linked = self._scene = None
        self._rows = [name for name, element in elements.items() if element is not None]
        self.elements = tuple(elements[name] for name in self._rows)
        self.cuts, states = cuts, states_of(self.elements, cuts)
        self.initial = np.array([state.initial for state in states], dtype=float)
        roles = np.array([state.role for state in states], dtype=int)
        self.roles = roles
        self.own, self.remembers = np.flatnonzero(roles == OWN), False
        self._update()
        self.restart()

    def bind(self, system):
        """Adopt the table that a system was built with from ``elements``, and keep it in line."""
        self._table, self._system = system.effects, system
        self._linked = joint_kernels.structure(self._model)
        # What the code of the scene is of, on whatever equations it works.
        self._scene = scene_code.known_structure(system.table)
        # By which determined directions friction was written last; None where others were, too.
        self._filled_by = None
        if self._table is None:
            self._table = EffectTable.of(system.model, system.model)
        self._fill([row for row, name in enumerate(self._rows) if not self.enabled[name]])
        return self._table

    def use_equations(self, model):
        """Go on with the model of other equations; the arrays of effects are shared."""
        self._model = model
        self._linked = joint_kernels.structure(self._model)
        # Their multipliers have other places.
        self._refill(MOTION)

    def _refill(self, role):
        """Rewrite the parameters of the effects in a role."""
        self._fill(np.flatnonzero(self._table.role == role).tolist())

    def _fill(self, rows):
        """Write the present parameters of effects, and whether they act, into the table."""
        table = self._table
        if rows:
            self._filled_by = None
            self._system.native.touch()
        for row in rows:
            name = self._rows[row]
            table.put(row, self.records[name].element(self._machine), self.enabled[name])
        if rows and self._system.is_unrolled:
            scene_code.update(self._model, table, self._system.table, self._scene)

    @property
    def by_name(self):
        """Return the rows of the table by the names of their effects."""
        return dict(zip(self._rows, self.elements))

    @property
    def directions_with_friction(self):
        """Return sums of freedoms with dry friction, as pairs of names and arms, each once."""
        return tuple({self.records[name].friction_direction: None for name, role in zip(
            self._rows, self._table.role) if role == FRICTION})

    def mark_determined(self, directions):
        """Mark sums with friction whose rates do not depend on the forces."""
        determined = self._machine.determined = frozenset(directions)
        if self._filled_by != determined:
            self._refill(FRICTION)
            self._filled_by = determined

    def _update(self):
        """Bring model constants, drives and instruments in line with the records."""
        model = self._model
        model.body[:], model.tree[:, [TYPE, VARIES]], model.gravity[:] = self._bare
        for record in self.records.values():
            record.reserve(model, self._machine)
        active = [record for name, record in self.records.items() if self.enabled[name]]
        for record in active:
            record.change(model, self._machine)
        if self._system is not None:
            self._system.native.touch()
            self._link()
        self.drives = {}
        for record in active:
            if record.drive() is not None:
                joint, delay = record.drive()
                self.drives[self._machine.joint(joint)] = delay
        self._timed = [row for row, name in enumerate(self._rows)
                       if self.records[name].clock(0.0) is not None]
        self.follows_time, self._clocks = bool(self._timed), (None, ())
        self.delays = any(self.drives.values())
        self.attends = self.delays or self.remembers

    def _link(self):
        """Link the system to the code for its bodies: a rotor makes another kind of one."""
        structure = joint_kernels.structure(self._model)
        if structure == self._linked:
            return
        joint_kernels.connect(self._model)
        if self._system.is_unrolled and self._system.effects is None:
            codegen.relink(self._model, self._system.table, self._system.joints)
        elif self._system.is_unrolled:
            codegen.relink(
                self._model, self._system.table, self._system.joints, codegen.OF_SCENE)
            scene_code.link(self._model, self._table, self._system.table)
            self._scene = scene_code.known_structure(self._system.table)
        self._linked = structure

    def vary(self, mechanism, records, set_masses):
        """
        Adopt the numbers of other records of the same effects, and of other bodies.

        The mechanism differs from the present one in masses alone, which ``set_masses`` writes
        into rows of ``Model.body``. Returns False where there is no room for these numbers;
        nothing has changed then.
        """
        # As when the scene is loaded.
        self._machine.determined = frozenset()
        elements, others = list(self.elements), [
            name for name, record in records.items() if self.records[name] is not record]
        for row, name in enumerate(self._rows):
            if name in others:
                element = records[name].element(self._machine)
                if _room_of(element) != _room_of(elements[row]):
                    return False
                elements[row] = element
        self._machine.mechanism = mechanism
        set_masses(self._bare[0])
        self.records, self.elements = dict(records), tuple(elements)
        self._update()
        changed = [row for row, name in enumerate(self._rows) if name in others]
        for row in changed:
            states, first = elements[row].states, self._table.first_state[row]
            self.initial[first:first + len(states)] = [state.initial for state in states]
        self._fill(changed)
        return True

    def element_of(self, record):
        """Return what a record, in the place of one of these, says of itself."""
        return record.element(self._machine)

    def restart(self):
        """Restart the instruments."""
        enabled = [record for name, record in self.records.items() if self.enabled[name]]
        self.sensors = Chain(enabled)
        # Noise of another sequence, so that the tree's is the same with and without.
        self.sensors_at_cuts = Chain(enabled, (1,))
        self.remembers = self.sensors.remembers
        self.attends = self.delays or self.remembers

    def checked(self, name, enabled, parameters):
        """
        Return the record that a change would give, or refuse the change with FieldError.

        None as ``enabled`` leaves that as it is; parameters are new values by the effect's keys.
        """
        with at('effects'):
            one_of(tuple(self.records), 'one of the effects listed in the scene')(name)
        with at('effects', name):
            if enabled is not None:
                with at('enabled'):
                    boolean(enabled)
            record = self.records[name]
            mapping(parameters, (), [key for keys in keys_of(type(record)) for key in keys])
            record = replace(record, **parameters)
            record.fit(self._machine.mechanism)
            self._require_room(name, record)
        with at('effects'):
            require_one_drive_each({**self.records, name: record})
        return record

    def _require_room(self, name, record):
        """Refuse more numbers than there is room for since the scene was loaded."""
        if name in self._rows:
            known = self.elements[self._rows.index(name)]
            element = record.element(self._machine)
            if not _has_code(known, element):
                raise FieldError('an effect of the kind that it had when the scene was loaded',
                                 'one of another shape or place, which has other code',
                                 'load a scene that has it')
            room, wanted = (len(one.joints) + len(one.bodies) for one in (known, element))
            if wanted > room:
                raise FieldError('an effect in no more joints and bodies than when the scene was '
                                 f'loaded ({room})', f'{wanted}', 'load a scene that has it')
            room, wanted = (len(one.numbers) for one in (known, element))
            if wanted > room:
                raise FieldError('a profile or curve of no more segments than it had when the '
                                 'scene was loaded', f'one that takes {wanted} numbers instead '
                                 f'of {room}', 'load a scene that has it')

    def change(self, name, enabled, parameters):
        """
        Switch an effect, or change its parameters; nothing changes where anything is refused.

        Returns the places of the own states that restart. FieldError.
        """
        record = self.checked(name, enabled, parameters)
        return self.put(name, record, self.enabled[name] if enabled is None else enabled)

    def put(self, name, record, enabled):
        """Put a record that fits in the place of an effect; see ``change``."""
        was = self.enabled[name]
        self.records[name], self.enabled[name] = record, enabled
        self._update()
        if record.instrument() is not None:
            self.restart()
        if name not in self._rows:
            return np.zeros(0, dtype=int)
        row = self._rows.index(name)
        self._fill([row])
        if was or not self.enabled[name]:
            return np.zeros(0, dtype=int)
        first = self._table.first_state[row]
        return np.intersect1d(np.arange(first, first + len(self.elements[row].states)), self.own)

    def trial(self):
        """
        Return a function that undoes what is changed, and evaluated, from now on.

        To the last bit: what sensors and drives remember, where cables are wound and which segment
        of a profile was found last, too.
        """
        attributes = {**vars(self), 'records': dict(self.records), 'enabled': dict(self.enabled)}
        numbers, table = self._system.snapshot(), self._table
        elements = list(table.elements)

        def undo():
            vars(self).update(attributes)
            self._system.native.touch()
            numbers.restore()
            table.elements[:] = elements

        return undo

    def reset_states(self, states):
        """Set the own states, not the energies, back to those of the start, in place."""
        states[self.own] = self.initial[self.own]
        self.sensors.forget()
        self.sensors_at_cuts.forget()

    def rates(self, q, qd):
        """Return the rates of all joints, behind them of cut joints that anything acts in."""
        if self.cuts is None:
            return qd
        cuts, nv = self._table.cuts, len(qd)
        self._system.native.touch()
        self._system.model.outward(q, qd, self._system.work)
        cuts.qd[:nv] = qd
        self._table.measure_cut_coordinates(self._system.work.body, cuts.q, cuts.qd)
        return cuts.qd.copy()

    def restart_angles(self, states):
        """Set the angles that count turns to those of the latest evaluation, in place."""
        cuts = self._table.cuts
        for k, row in enumerate(cuts.index):
            if row[FOLLOWED] >= 0:
                states[row[FOLLOWED]] = cuts.q[len(cuts.q) - len(cuts.index) + k]

    def begin_angle(self, name, angle):
        """Set the turn count of a cut joint's angle: within half a turn of another one [rad]."""
        if name in self._machine.cuts:
            place = self.cuts[0][self._machine.cuts.index(name), FOLLOWED]
            if place >= 0:
                self.initial[place] = angle

    def initialise_states(self, states, qd):
        """Initialise the own states from joint rates, as ``rates``; in place."""
        for row, name in enumerate(self._rows):
            if self.enabled[name] and self.records[name].ENDS_STEPS and self.elements[row].sticks:
                states[self._table.first_state[row]] = self.records[name].direction(
                    self._along(row, qd))

    def _along(self, row, joints):
        """Return the sum along which an effect in joints acts, from values of all joints."""
        found = self._table.row(row)
        along = joints[found.joints]
        return found.arms @ along if found.summed else along[0]

    def begin_at_time(self, states, time):
        """Initialise the own states of time-dependent effects at a time [s], in place."""
        if self._clocks[0] != time:
            # Python's own integers: numpy's take twice as long as places.
            clocks = {int(self._table.first_state[row]): self.records[self._rows[row]].clock(time)
                      for row in self._timed}
            self._clocks = time, [
                (first + k, value) for first, clock in clocks.items()
                for k, value in enumerate(clock)]
        for place, value in self._clocks[1]:
            states[place] = value

    def energies(self):
        """
        Return kinetic and stored energy of the effects at the latest evaluation [J].

        Kinetic is that of what is reflected at cut joints and along tendons.
        """
        if not len(self._table.role):
            return 0.0, 0.0
        stored, rotors = self._table.output[:, STORED], self._table.role == INERTIA
        kinetic = float(stored[rotors].sum())
        return kinetic, float(stored.sum()) - kinetic

    def hold_inertia(self, accelerations):
        """
        Set the forces of reflected inertia for given accelerations, or (None) restore its own.

        Shape (nv + nk,): of the joints, those of cut joints behind.
        """
        for row in np.flatnonzero(self._table.role == INERTIA):
            self._table.static_friction.hold[row] = 0.0 if accelerations is None else (
                -self._table.values[row, 0] * self._along(row, accelerations))

    def readings(self, name, states):
        """
        Return the readings of an effect at the latest evaluation.

        ``states``: shape (nz,); the effects' states.
        """
        with at('effects'):
            one_of(tuple(self.records), 'one of the effects listed in the scene')(name)
        if name not in self._rows:
            return {}
        row = self._rows.index(name)
        values = self._table.output[row]
        return {self.records[name].ENERGY: float(values[STORED]), **self._flows(row, states), **{
            key: float(value) for key, value in zip(self.records[name].READINGS, values[1:])}}

    @property
    def traced(self):
        """Names of the effects whose laws are users' code."""
        return [name for name in self._rows
                if self.enabled[name] and isinstance(self.records[name], TracedEffect)]

    def require_finite(self):
        """Refuse laws of users that have no finite value in the state that was evaluated."""
        for name in self.traced:
            row = self._rows.index(name)
            first = self._table.first_state[row]
            with at('effects', name):
                self.records[name].require_finite(
                    self._table.output[row],
                    self._table.rates[first:first + len(self.elements[row].states)])

    def winding_places(self):
        """
        Return where effects' data have how far cables are wound round pulleys, by cable and point.

        Of those that are switched on; the radius stands before each.
        """
        found = {}
        for row, (name, element) in enumerate(zip(self._rows, self.elements)):
            if self.enabled[name] and len(element.data):
                first = self._table.first_number[row]
                found.update({(name, point): first + place for point, place in
                              self.records[name].winding_places(len(element.data[0])).items()})
        return found

    def windings(self):
        """Return how far cables are wound round pulleys [rad], by cable and point."""
        data = self._table.data
        return {pulley: float(data[place] / abs(data[place - 1]))
                for pulley, place in self.winding_places().items()}

    def drive_rows(self):
        """Return the rows of the drives that are switched on, and the joints they drive."""
        rows = np.array([row for row, name in enumerate(self._rows)
                         if self.enabled[name] and self.records[name].drive() is not None],
                        dtype=int)
        return rows, self._table.places[self._table.first_place[rows]]

    def _flows(self, row, states):
        """Return the energy dissipated, or work done, by a row's effect, and the present power."""
        first = self._table.first_state[row]
        flows = {}
        for place in range(first, first + len(self.elements[row].states)):
            if self.roles[place] == DISSIPATED:
                flows['dissipated_energy'] = float(states[place])
                flows['dissipated_power'] = float(self._table.rates[place])
            elif self.roles[place] == WORK:
                flows['work'] = float(states[place])
        return flows

    def efforts(self, tau):
        """Write the actual efforts of the drives, at the latest evaluation, into joint torques."""
        rows, joints = self.drive_rows()
        tau[joints] = self._table.output[rows, 1]

    @property
    def passed(self):
        """Return the name of a contact that a step of fixed size has passed undetected."""
        return self._rows[int(self._table.contacts.passed[0])]

    def steady(self, q, qd):
        """Set the table's states to those of a steady motion, and switch the drives off."""
        self.initialise_states(self._table.states, self.rates(q, qd))
        rows, _ = self.drive_rows()
        self._table.enabled[rows] = 0

    def unsteady(self):
        """Switch the drives on again after ``steady``."""
        for row, name in enumerate(self._rows):
            self._table.enabled[row] = self.enabled[name]


def _has_code(known, element):
    """Return whether the law of an effect has code: that of a user is traced and compiled anew."""
    law = element.law
    return isinstance(law, TracedLaw) or law is known.law and len(
        element.bodies) == len(known.bodies)


def _room_of(element):
    """Return the data of an effect that decides the sizes of a system's tables."""
    return (element.law.name, element.law.parts(element), len(element.joints),
            len(element.bodies), len(element.numbers), len(element.states), element.law.role,
            bool(element.gap), [state.role for state in element.states])
