# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Laws of force that are traced: run once on symbols, then compiled.

A law measures coordinates: of joints, distances between points, components of the places of
points. What it pushes with along a coordinate x does the power ``F x'``. Its parameters are inputs
of the code, so that a change of them compiles nothing.
"""

from dataclasses import fields
from functools import cached_property, partial
import math

from .effect import Effect, require_point
from .element import DISSIPATED, ForceElement, OWN, State, WORK
from .force_law import EVENT, ForceLaw, NO_GAP
from .points import line_between, push_apart
from .user_code import defined, definition
from ..codegen.differentiation import differentiated
from ..codegen.expression_graph import chosen, ExpressionGraph, LOAD, needed_for, replayed, Symbol
from ..codegen.function_table import VALUE_COLUMNS
from ..codegen.vectors import dot
from ..mechanism.checks import name as name_check, one_of, vector2, vector3
from ..mechanism.fields import at, FieldError, shown

# Inputs of the arithmetic: parameters; what is measured; own states.
PARAMETERS, MEASURED, STATES = range(3)
# What is measured: the time; 1 where the gap of the event is less than zero; each coordinate and
# its rate.
TIME, SIDE, FIRST_COORDINATE = range(3)
# What a coordinate is.
JOINT, DISTANCE, COMPONENT = range(3)
AXES = ('x', 'y', 'z')
MOST_COORDINATES, MOST_STATES, MOST_READINGS = 16, 16, 3


class Coordinate:
    """
    A coordinate that a law measures and exerts a force along.

    Attributes
    ----------
    value, rate : Symbol
        [rad; m] and their rates.
    force : Symbol or float
        Sum of the applied forces [N m; N].

    """

    def __init__(self, value, rate):
        self.value, self.rate, self.force = value, rate, 0.0

    def push(self, force):
        """Add a force: in the direction in which the coordinate grows."""
        self.force = self.force + force


class Tracing:
    """
    Inputs and outputs of a law while it is traced.

    Parameters
    ----------
    parameters : sequence of str
        Names of the law's numbers.

    Attributes
    ----------
    coordinates : list of Coordinate
        In the order in which they were asked for.
    entries : list of tuple
        What each of them is: JOINT and its name; DISTANCE and two ends, names of points or places
        in the world; COMPONENT, a point and an axis.
    states : dict of str to State
        By name.
    gap : Symbol or None
        Of the event.

    """

    def __init__(self, parameters):
        self.graph, self._parameters = ExpressionGraph(), tuple(parameters)
        self.coordinates, self.entries, self.states = [], [], {}
        self.gap = None
        self.rates, self.readings, self.energy, self.dissipation = {}, {}, None, None

    def parameter(self, name):
        """Return the symbol of a number of the effect, by its key."""
        return self.graph.put(LOAD, PARAMETERS, self._parameters.index(name))

    @property
    def time(self):
        """Return the symbol of the time [s]."""
        return self.graph.put(LOAD, MEASURED, TIME)

    def joint(self, name):
        """Return the coordinate of a joint of the tree [rad; m]."""
        return self._coordinate(JOINT, name)

    def distance(self, one, other):
        """Return the distance of two ends: names of points, or places in the world [m]."""
        return self._coordinate(DISTANCE, one, other)

    def component(self, point, axis):
        """Return a component, ``x``, ``y`` or ``z``, of the place of a named point [m]."""
        return self._coordinate(COMPONENT, point, axis)

    def _coordinate(self, *entry):
        place = FIRST_COORDINATE + 2 * len(self.entries)
        self.entries.append(entry)
        self.coordinates.append(Coordinate(
            self.graph.put(LOAD, MEASURED, place), self.graph.put(LOAD, MEASURED, place + 1)))
        return self.coordinates[-1]

    def state(self, name, start=0.0, scale=1.0):
        """
        Return the symbol of a new state of the effect.

        Parameters
        ----------
        name : str
            For ``rate``.
        start : float
            Its value at the start.
        scale : float
            Its size, for error control.

        """
        self.states[name] = State(OWN, scale, start)
        return self.graph.put(LOAD, STATES, len(self.states) - 1)

    def event(self, gap):
        """
        Return whether a gap is less than zero, for ``chosen``.

        Methods with error control end a step where the gap changes its sign. Within a step the
        side is the one on which it began: the law of each side is to go on beyond its end.

        Parameters
        ----------
        gap : Symbol
            Of coordinates, states, the time and parameters [m; rad; 1].

        """
        if self.gap is not None:
            raise FieldError('at most 1 event', 'another one', path=('event',))
        self.gap = gap
        return self.side > 0.5

    @property
    def side(self):
        """Return the symbol that is 1 where the gap of the event is less than zero, else 0."""
        return self.graph.put(LOAD, MEASURED, SIDE)

    @property
    def gap_rate(self):
        """Return the rate of the event's gap."""
        seed = {one.value.place: one.rate for one in self.coordinates}
        seed.update({self.graph.put(LOAD, STATES, place).place: self.rates[name]
                     for place, name in enumerate(self.states)})
        seed[self.graph.put(LOAD, MEASURED, TIME).place] = 1.0
        return differentiated(self.graph, [self.gap], seed)[0]

    def rate(self, name, value):
        """Set the rate of a state."""
        self.rates[name] = value

    def store(self, energy):
        """Set the energy that the effect stores [J]."""
        self.energy = energy

    def dissipate(self, power):
        """Set the power that the effect dissipates [W]."""
        self.dissipation = power

    def reading(self, name, value):
        """Publish a number as one of ``Simulation.effect_readings``; three at most."""
        self.readings[name] = value

    @cached_property
    def follows_time(self):
        """Whether any result depends on the time."""
        operations = self.graph.operations
        needed = needed_for(operations, [
            value.place for value in self.results if isinstance(value, Symbol)])
        return any(operations[place] == (LOAD, MEASURED, TIME) for place in needed)

    @cached_property
    def results(self):
        """
        Return the results of the arithmetic: a list of Symbol or float.

        Forces, rates of states, stored energy, dissipated power, readings, then the gap of an
        event and its rate.
        """
        readings = list(self.readings.values())
        return [*(one.force for one in self.coordinates),
                *(self.rates[name] for name in self.states),
                *(0.0 if one is None else one for one in (self.energy, self.dissipation)),
                *readings, *(MOST_READINGS - len(readings)) * (0.0,),
                *(() if self.gap is None else (self.gap, self.gap_rate))]

    @property
    def is_booked(self):
        """Whether the law says what it stores or dissipates: then nothing is work from outside."""
        return self.energy is not None or self.dissipation is not None

    @cached_property
    def arithmetic(self):
        """Return all that the code of the law depends on, as text."""
        return repr((self.graph.operations, [
            value.place if isinstance(value, Symbol) else float(value) for value in self.results]))


class TracedEffect(Effect):
    """
    An effect whose law is a method ``trace``; a frozen dataclass.

    Where the law states neither ``store`` nor ``dissipate``, its power is work from outside.
    Otherwise these two are all of it, and the energy balance shows whether that is so.
    """

    READINGS = ('power',)

    def __post_init__(self):
        """Check the fields, and trace the law."""
        super().__post_init__()
        tracing = Tracing(self.numbers())
        self.trace(tracing)
        _require_complete(tracing)
        object.__setattr__(self, 'traced', tracing)
        object.__setattr__(self, 'READINGS', ('power', *tracing.readings))

    def __reduce_ex__(self, protocol):
        """Return how another process builds it: by the file of a user that defines it."""
        found = definition(type(self))
        if found is None:
            return super().__reduce_ex__(protocol)
        return _built, (*found, {field.name: getattr(self, field.name) for field in fields(self)})

    def trace(self, law):
        """
        State the law.

        Parameters
        ----------
        law : Tracing
            What the law sees and does; for branches there is
            ``codegen.expression_graph.chosen``.

        """
        raise NotImplementedError

    def numbers(self):
        """Return the parameters of the law by name: fields that are numbers."""
        return {field.name: getattr(self, field.name) for field in fields(self)
                if type(getattr(self, field.name)) is float}

    @property
    def pushed(self):
        """Return the name of the one coordinate that it pushes along, as a tuple."""
        return ()

    def where(self, entry):
        """Return the keys of an entry of ``Tracing.entries``."""
        return ()

    def fit(self, mechanism):
        """Refuse a mechanism without the joints and points of the law."""
        super().fit(mechanism)
        axes = AXES[:2] if mechanism.planar else AXES
        for place, (kind, *ends) in enumerate(self.traced.entries):
            with at(*self.where(place)):
                if kind == JOINT:
                    one_of(mechanism.coordinates.single_names, 'one of the joints of the tree')(
                        *ends)
                elif kind == COMPONENT:
                    require_point(mechanism, 0, ends[0])
                    with at(1):
                        one_of(axes)(ends[1])
                else:
                    for index, end in enumerate(ends):
                        if isinstance(end, str):
                            require_point(mechanism, index, end)
                        else:
                            with at(index):
                                (vector2 if mechanism.planar else vector3)(end)

    def element(self, machine):
        """Return the effect as a row of the table."""
        law = self.traced
        clock = (State(OWN),) if law.follows_time else ()
        joints, bodies, data = [], [], []
        for kind, *ends in law.entries:
            if kind == JOINT:
                joints.append(machine.joint(*ends))
                continue
            for end in ends[:1] if kind == COMPONENT else ends:
                row, place = machine.point(end) if isinstance(end, str) else (0, end)
                bodies.append(row)
                data.append(tuple(place))
        return ForceElement(
            TracedLaw(law), tuple(joints), tuple(bodies), tuple(self.numbers().values()),
            (*clock, *law.states.values(), State(DISSIPATED if law.is_booked else WORK)),
            tuple(data), gap=NO_GAP if law.gap is None else EVENT)

    def clock(self, time):
        """Return the time, if the law depends on it."""
        return (time,) if self.traced.follows_time else None

    def require_finite(self, output, rates):
        """Refuse a law that is not finite."""
        law = self.traced
        own = rates[int(law.follows_time):]
        # At rest the power is zero, but not of an infinite force.
        named = [(('forces', *self.pushed), output[1]), (('energy',), output[0]),
                 *((('readings', key), value) for key, value in zip(law.readings, output[2:])),
                 *((('states', key), value) for key, value in zip(law.states, own)),
                 (('dissipation',), own[len(law.states)])]
        for path, value in named:
            if not math.isfinite(value):
                raise FieldError('a finite value in the present state', f'{value}', path=path)


def _built(path, name, values):
    return defined(path, name)(**values)


def _require_complete(law):
    """Refuse a law with branches, states without rates, or more than there is room for."""
    if law.graph.guard is not None:
        raise FieldError('a law without if, min and max of Python on what it measures', 'a branch',
                         'take chosen, smaller and larger of codegen.expression_graph')
    for name in {**law.states, **law.rates}:
        name_check(name)
        if name not in law.rates or name not in law.states:
            raise FieldError(f'a rate of each state, and of no other ({", ".join(law.states)})',
                             f'none of {name}' if name in law.states else f'one of {name}')
    for what, found, most in (
            ('coordinates', law.entries, MOST_COORDINATES), ('states', law.states, MOST_STATES),
            ('readings', law.readings, MOST_READINGS),
            ('parameters', law._parameters, VALUE_COLUMNS)):
        if len(found) > most:
            raise FieldError(f'at most {most} {what}', f'{len(found)}', path=(what,))
    if law.gap is not None:
        _require_gap(law)
    for value in law.results:
        if not isinstance(value, (Symbol, float, int)):
            raise FieldError('arithmetic on symbols and numbers', shown(value))


def _require_gap(law):
    """Refuse an event that depends on values without a rate before the accelerations."""
    with at('event'):
        if not isinstance(law.gap, Symbol):
            raise FieldError('a gap that depends on measured coordinates', shown(law.gap))
        known = {one.value.place for one in law.coordinates}
        for place in needed_for(law.graph.operations, [law.gap.place]):
            operation = law.graph.operations[place]
            if operation[:2] == (LOAD, MEASURED) and operation[2] != TIME and place not in known:
                raise FieldError('a gap of coordinates, states, the time and parameters',
                                 'one of a rate, or of the event itself')


class TracedLaw(ForceLaw):
    """
    A law that was traced, on the symbols of other code: it measures coordinates, and pushes.

    Parameters
    ----------
    traced : Tracing

    """

    def __init__(self, traced):
        super().__init__(partial(_act, traced), in_balls=True)
        object.__setattr__(self, 'traced', traced)

    @property
    def name(self):
        return 'traced_law'

    def parts(self, row):
        """Return its arithmetic, and what it measures."""
        law = self.traced
        return law.arithmetic, len(law.states), law.gap is not None, law.is_booked, *(
            (kind, *ends[1:]) if kind == COMPONENT else kind for kind, *ends in law.entries)

    @property
    def follows_time(self):
        return self.traced.follows_time

    def refusal(self, instant, along):
        """Return why it has no derivatives: its time, states and events."""
        law = self.traced
        return ('its force may jump at its event, within a step'
                if along and law.gap is not None else
                'it follows the time' if law.follows_time and not instant else
                'it has states of its own' if law.states else None)

    def __reduce__(self):
        return TracedLaw, (self.traced,)

    def __deepcopy__(self, _):
        return self


def _act(law, forces):
    """Apply a traced law."""
    clock = int(law.follows_time)
    inputs = {PARAMETERS: forces.values, MEASURED: FIRST_COORDINATE * [None],
              STATES: [forces.state(clock + n) for n in range(len(law.states))]}
    measured, pushes = inputs[MEASURED], []
    if clock:
        measured[TIME] = forces.state(0) if forces.held is None else forces.held
    joints, bodies, size, place = iter(forces.joints), iter(forces.bodies), forces.size, 0
    for kind, *ends in law.entries:
        if kind == JOINT:
            joint = next(joints)
            measured += [joint.value, joint.rate]
            pushes.append(joint.push)
        elif kind == COMPONENT:
            body, axis = next(bodies), AXES.index(ends[1])
            offset = forces.turned(body, forces.entries(place, size))
            measured += [each[axis] for each in forces.place(body, offset)]
            pushes.append(partial(_push_along, forces, axis, body, offset))
            place += size
        else:
            both = next(bodies), next(bodies)
            offsets, direction, length, rate = line_between(
                forces, both, [forces.entries(place + size * n, size) for n in range(2)])
            measured += [length, rate]
            pushes.append(partial(push_apart, forces, both, offsets, direction))
            place += 2 * size

    def found(results):
        return replayed(law.graph, results, lambda source, place: inputs[source][place])

    if law.gap is not None:
        # The gap is the same on both sides of the event.
        measured[SIDE] = chosen(forces.touches(*found(law.results[-2:])), 1.0, 0.0)
    results = found(law.results)
    for push, force in zip(pushes, results):
        push(force)
    count, own = len(pushes), len(law.states)
    power = dot(results[:count], measured[FIRST_COORDINATE + 1::2])
    stored, lost, *readings = results[count + own:count + own + 2 + MOST_READINGS]
    forces.store(stored)
    forces.flow(*clock * (1.0,), *results[count:count + own], lost if law.is_booked else power)
    forces.read(power, *readings)


def _push_along(forces, axis, body, offset, force):
    forces.push(body, offset, tuple(force if k == axis else 0.0 for k in range(3)))
