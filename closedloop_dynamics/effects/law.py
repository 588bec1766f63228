# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A law of force that a scene writes as expressions.

    forces: {x: -k*x - c*v*abs(v)}

F(x, v, z, t) along coordinates x that it names: of joints, distances of two points, components of
the place of a point. z: states of its own, ``z' = g(x, v, z, t)``. What stands there is arithmetic
alone (``mechanism.expressions``). It is compiled once; parameters may change at any time. Where
neither energy nor dissipation is given, the law's power is work from outside; otherwise they are
all of it, which the energy balance proves. When: any force that no other effect has.
"""

from dataclasses import dataclass
import math
from numbers import Real
from typing import Dict, Optional, Tuple, Union

from .traced_effect import AXES, TracedEffect
from ..codegen.expression_graph import (
    arctangent, cosine, exponential, larger, logarithm, sine, smaller, square_root)
from ..mechanism.checks import freedom, listed, name, number, one_of, vector
from ..mechanism.expressions import CONSTANTS, FUNCTIONS, value_of
from ..mechanism.fields import at, FieldError, shown
from ..mechanism.mechanism import Vector

EXPECTED = 'an expression of the names of this law, t, numbers, + - * / **, brackets and functions'
ON_SYMBOLS = {
    'sin': sine, 'cos': cosine, 'tan': lambda x: sine(x) / cosine(x),
    'asin': lambda x: arctangent(x, square_root(1.0 - x * x)),
    'acos': lambda x: arctangent(square_root(1.0 - x * x), x),
    'atan': lambda x: arctangent(x, 1.0), 'sqrt': square_root, 'exp': exponential,
    'log': logarithm, 'radians': lambda x: x * (math.pi / 180.0),
    'degrees': lambda x: x * (180.0 / math.pi), 'abs': abs, 'atan2': arctangent,
    'hypot': lambda x, y: square_root(x * x + y * y), 'min': smaller, 'max': larger}


def _named(check):
    """Return a check for mappings of names to values that pass ``check``."""
    def check_mapping(value):
        if not isinstance(value, dict) or not value:
            raise FieldError('a mapping of names', shown(value))
        found = {}
        for key, item in value.items():
            with at(key):
                name(key)
                found[key] = check(item)
        return found
    return check_mapping


def _expression(value):
    """Return an expression as text; a number is one, too."""
    if isinstance(value, Real) and not isinstance(value, bool):
        return repr(number(value))
    if not isinstance(value, str):
        raise FieldError(EXPECTED, shown(value))
    return value


def _ends(value):
    """Return two ends: names of points, or places in the world."""
    found = listed(value, 'a list of 2 ends: names of points, or places in the world')
    if len(found) != 2:
        raise FieldError('a list of 2 ends: names of points, or places in the world',
                         f'{shown(value)}, of length {len(found)}')
    ends = []
    for index, end in enumerate(found):
        with at(index):
            ends.append(name(end) if isinstance(end, str) else vector(end))
    return tuple(ends)


def _component(value):
    """Return the name of a point, and of an axis."""
    found = listed(value, 'a list [point, axis]')
    if len(found) != 2:
        raise FieldError('a list [point, axis]', f'{shown(value)}, of length {len(found)}')
    with at(1):
        return name(found[0]), one_of(AXES)(found[1])


@dataclass(frozen=True)
class Law(TracedEffect):
    """
    A law of force, written as expressions.

    Attributes
    ----------
    forces : dict of str to str
        Force or torque along coordinates, in the direction in which they grow [N m; N].
    joints : dict of str to str, or None
        Coordinates: of joints of the tree [rad; m].
    distances : dict of str to ends, or None
        Coordinates: distances of two ends, named points or places in the world [m].
    components : dict of str to point and axis, or None
        Coordinates: components of the place of a named point in the world [m].
    rates : dict of str to str, or None
        Names of rates, and of the coordinates whose rates they are.
    parameters : dict of str to float, or None
        Numbers by name, 13 at most.
    states : dict of str to str, or None
        States of its own by name, and their rates.
    start : dict of str to float, or None
        Values of states at the start; 0 when not given.
    energy : str or None
        Stored energy [J].
    dissipation : str or None
        Dissipated power [W].
    event : dict of str to str, or None
        A name, which stands for 1 where the expression is less than zero and for 0 elsewhere; a
        step ends where its sign changes.
    readings : dict of str to str, or None
        Further readings beside its power, 3 at most.

    """

    CHECKS = {
        'forces': _named(_expression), 'joints': _named(freedom), 'distances': _named(_ends),
        'components': _named(_component), 'rates': _named(name), 'parameters': _named(number),
        'states': _named(_expression), 'start': _named(number), 'energy': _expression,
        'dissipation': _expression, 'event': _named(_expression), 'readings': _named(_expression)}

    forces: Dict[str, str]
    joints: Optional[Dict[str, str]] = None
    distances: Optional[Dict[str, Tuple[Union[str, Vector], ...]]] = None
    components: Optional[Dict[str, Tuple[str, str]]] = None
    rates: Optional[Dict[str, str]] = None
    parameters: Optional[Dict[str, float]] = None
    states: Optional[Dict[str, str]] = None
    start: Optional[Dict[str, float]] = None
    energy: Optional[str] = None
    dissipation: Optional[str] = None
    event: Optional[Dict[str, str]] = None
    readings: Optional[Dict[str, str]] = None

    def numbers(self):
        """Return the parameters of the law by name."""
        return self.parameters or {}

    @property
    def pushed(self):
        """Return the name of the one coordinate that it pushes along, as a tuple."""
        return tuple(self.forces) if len(self.forces) == 1 else ()

    def where(self, entry):
        """Return the keys of an entry of ``Tracing.entries``."""
        return [(key, each) for key in ('joints', 'distances', 'components')
                for each in getattr(self, key) or ()][entry]

    def trace(self, law):
        """State the law."""
        known, coordinates = {'t': law.time}, {}
        measures = {'joints': lambda one: law.joint(one),
                    'distances': lambda ends: law.distance(*ends),
                    'components': lambda ends: law.component(*ends)}
        for key, measure in measures.items():
            for each, what in (getattr(self, key) or {}).items():
                coordinates[each] = measure(what)
                _bind(known, (key, each), coordinates[each].value)
        for each, of in (self.rates or {}).items():
            with at('rates', each):
                one_of(tuple(coordinates), 'one of the coordinates')(of)
            _bind(known, ('rates', each), coordinates[of].rate)
        for each in self.numbers():
            _bind(known, ('parameters', each), law.parameter(each))
        for each in self.start or ():
            with at('start'):
                one_of(tuple(self.states or ()), 'one of the states')(each)
        for each in self.states or ():
            _bind(known, ('states', each), law.state(each, (self.start or {}).get(each, 0.0)))
        for each, text in (self.event or {}).items():
            law.event(_value(known, text, 'event', each))
            _bind(known, ('event', each), law.side)
        for each, text in self.forces.items():
            with at('forces'):
                one_of(tuple(coordinates), 'one of the coordinates')(each)
            coordinates[each].push(_value(known, text, 'forces', each))
        for each, text in (self.states or {}).items():
            law.rate(each, _value(known, text, 'states', each))
        for each, text in (self.readings or {}).items():
            law.reading(each, _value(known, text, 'readings', each))
        if self.energy is not None:
            law.store(_value(known, self.energy, 'energy'))
        if self.dissipation is not None:
            law.dissipate(_value(known, self.dissipation, 'dissipation'))


def _bind(known, path, symbol):
    """Bind a name to a symbol, unless it is bound already."""
    each = path[-1]
    if each in known or each in CONSTANTS or each in FUNCTIONS:
        raise FieldError('a name that is not in use', shown(each), path=path)
    known[each] = symbol


def _value(known, text, *path):
    """Return the value of an expression on symbols."""
    with at(*path):
        return value_of(text, known, ON_SYMBOLS, EXPECTED)
