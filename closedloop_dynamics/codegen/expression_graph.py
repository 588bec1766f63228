# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Trace an evaluation for one topology: run it on symbols and record the arithmetic.

Recursions and loops over a mechanism, run with symbols in the place of numbers, leave behind the
list of additions and multiplications that this one mechanism needs: no loop, no index, no zero
added.
"""

from contextlib import contextmanager
import math
import operator

# Operations. A LOAD names an input and the place in it; a SINE and a COSINE their angle. Those
# from the square root on are in laws of force alone. A CALL asks a function of the engine: it
# names its place in the function table, the effect, where its entries begin and how many numbers
# they are, a flag and two numbers; a TAKE is a further result of such a call.
(LOAD, ADD, SUBTRACT, MULTIPLY, DIVIDE, NEGATE, SINE, COSINE, LESS, GREATER_EQUAL, CHOOSE,
 BOTH, SQUARE_ROOT, EXPONENTIAL, LOGARITHM, ARCTANGENT, POWER, CALL, TAKE) = range(19)
# Those whose result is no number.
CONDITIONS = LESS, GREATER_EQUAL, BOTH
# Whole exponents up to this one are multiplications.
LARGEST_PRODUCT = 16
# Inputs beside those of a function table: coordinates and rates.
Q, QD = -1, -2


class TooManyOperations(Exception):
    """More operations than may be recorded."""


class ExpressionGraph:
    """
    Recorded arithmetic, each operation once, ``most`` operations at most (``TooManyOperations``).

    ``operations`` are (operation, operands...); an operand is the place of an earlier operation or
    a float. ``guard``, a Symbol or None: what must hold for the results to be right: the branches
    that were taken. ``branches``: from which place on which branch is
    recorded, its number, its name, and the names of the values that it takes, by place.
    """

    def __init__(self, most=math.inf):
        self.operations, self.guard, self._known, self._most = [], None, {}, most
        self.branches = []

    def put(self, *operation):
        """Return the symbol of an operation, an old one where there is the same already."""
        # The number 2.0 is not the result of operation 2.
        key = operation, *map(type, operation)
        place = self._known.setdefault(key, len(self.operations))
        if place == len(self.operations):
            if place >= self._most:
                raise TooManyOperations
            self.operations.append(operation)
        return Symbol(self, place)


@contextmanager
def branch(name, values, number=None):
    """
    Say that what is recorded meanwhile is in one of several branches that do the same.

    Equal names and orders of values mean the same in each of them. The context is the number of
    the branch, a new one by default.
    """
    graph, labels = graph_of(values), {}
    for place, value in enumerate(values):
        if isinstance(value, Symbol):
            one = value._negated() if value._operation() == NEGATE else value
            labels[one.place] = name, place
    number = len(graph.branches) if number is None else number
    graph.branches.append((len(graph.operations), number, name, labels))
    yield number
    graph.branches.append((len(graph.operations), None, None, {}))


def graph_of(values):
    """Return the graph of the first symbol among values, an empty one where all are numbers."""
    return next((one.graph for one in values if isinstance(one, Symbol)), ExpressionGraph())


class Routine:
    """
    Arithmetic of a graph with its inputs and outputs, and the name of its machine code's symbol.

    ``outputs``: (input, place, value): what is stored where. An input is the place of an array's
    address in the function table, Q or QD, or a row of a kernel. ``otherwise``: the Routine that
    does the same where the guard of this one does not hold; this one stores nothing then.
    """

    def __init__(self, name, graph, outputs, otherwise=None):
        self.name, self.graph, self.outputs, self.otherwise = name, graph, outputs, otherwise

    def needed(self):
        """
        Return which operations the outputs and the guard depend on.

        Returns
        -------
        set of int

        """
        values = [value for _, _, value in self.outputs] + [self.graph.guard]
        return needed_for(
            self.graph.operations, [value.place for value in values if hasattr(value, 'place')])


def with_others(routines):
    """Return routines, each after that which does the same otherwise."""
    return [one for routine in routines for one in (routine.otherwise, routine) if one is not None]


def needed_for(operations, places, within=None):
    """
    Return all places on which given ones depend, themselves included.

    What operations that are not ``within`` some places depend on is left out.
    """
    found, rest = set(), list(places)
    while rest:
        place = rest.pop()
        if place not in found:
            found.add(place)
            if operations[place][0] != LOAD and (within is None or place in within):
                rest.extend(o for o in operations[place][1:] if isinstance(o, int))
    return found


def _operand(value):
    return value.place if isinstance(value, Symbol) else float(value)


def _is(value, number):
    return not isinstance(value, Symbol) and value == number


class Symbol:
    """The result of an operation of an expression graph, at a place."""

    __slots__ = ('place', 'graph')

    def __init__(self, graph, place):
        self.graph, self.place = graph, place

    def _put(self, operation, *operands):
        return self.graph.put(operation, *map(_operand, operands))

    def __add__(self, other):
        if _is(other, 0.0):
            return self
        if isinstance(other, Symbol) and other._operation() == NEGATE:
            return self - other._negated()
        return self._put(ADD, self, other)

    def __radd__(self, other):
        return self + other

    def __sub__(self, other):
        if _is(other, 0.0):
            return self
        if isinstance(other, Symbol) and other._operation() == NEGATE:
            return self + other._negated()
        return self._put(SUBTRACT, self, other)

    def __rsub__(self, other):
        return -self if _is(other, 0.0) else self._put(SUBTRACT, other, self)

    def __mul__(self, other):
        """Multiply; a zero or a one decides alone."""
        if _is(other, 0.0):
            return 0.0
        if _is(other, 1.0):
            return self
        if _is(other, -1.0):
            return -self
        if self._operation() == NEGATE:
            return -(self._negated() * other)
        if isinstance(other, Symbol) and other._operation() == NEGATE:
            return -(self * other._negated())
        first, second = _operand(self), _operand(other)
        if isinstance(second, int) and second < first:
            first, second = second, first
        return self.graph.put(MULTIPLY, first, second)

    def __rmul__(self, other):
        return self * other

    def __truediv__(self, other):
        return self._put(DIVIDE, self, other)

    def __rtruediv__(self, other):
        return self._put(DIVIDE, other, self)

    def __neg__(self):
        return self._negated() if self._operation() == NEGATE else self._put(NEGATE, self)

    def __pos__(self):
        return self

    def __abs__(self):
        return chosen(self < 0.0, -self, self)

    def __pow__(self, exponent):
        """Raise to a power; whole ones that are small are products."""
        if isinstance(exponent, Symbol) or exponent != int(exponent) or (
                abs(exponent) > LARGEST_PRODUCT):
            return self._put(POWER, self, exponent)
        product = 1.0
        for digit in f'{abs(int(exponent)):b}':
            product = product * product * (self if digit == '1' else 1.0)
        return product if exponent >= 0.0 else 1.0 / product

    def __rpow__(self, base):
        return self._put(POWER, base, self)

    def __lt__(self, other):
        return self._put(LESS, self, other)

    def __gt__(self, other):
        return self._put(LESS, other, self)

    def __ge__(self, other):
        """Compare; false for a NaN, as always."""
        return self._put(GREATER_EQUAL, self, other)

    def __le__(self, other):
        return self._put(GREATER_EQUAL, other, self)

    def __bool__(self):
        """Choose the branch, and record that the results hold only there."""
        guard = self.graph.guard
        self.graph.guard = self if guard is None else guard._put(BOTH, guard, self)
        return True

    def _operation(self):
        return self.graph.operations[self.place][0]

    def _negated(self):
        return Symbol(self.graph, self.graph.operations[self.place][1])


def hold_nowhere(symbol):
    """Record that results are never right, whatever the inputs; of any symbol among these."""
    bool(0.0 - symbol * symbol >= 1.0)


def sine(angle):
    """Return the sine of a number or a symbol."""
    return angle._put(SINE, angle) if isinstance(angle, Symbol) else math.sin(angle)


def cosine(angle):
    """Return the cosine of a number or a symbol."""
    return angle._put(COSINE, angle) if isinstance(angle, Symbol) else math.cos(angle)


def square_root(value):
    """Return the square root of a number or a symbol."""
    return value._put(SQUARE_ROOT, value) if isinstance(value, Symbol) else math.sqrt(value)


def exponential(value):
    """Return e to a number or a symbol."""
    return value._put(EXPONENTIAL, value) if isinstance(value, Symbol) else math.exp(value)


def logarithm(value):
    """Return the natural logarithm of a number or a symbol."""
    return value._put(LOGARITHM, value) if isinstance(value, Symbol) else math.log(value)


def arctangent(y, x):
    """Return the angle of (x, y), numbers or symbols."""
    graph = next((one.graph for one in (y, x) if isinstance(one, Symbol)), None)
    return math.atan2(y, x) if graph is None else graph.put(ARCTANGENT, *map(_operand, (y, x)))


def chosen(condition, yes, no):
    """Return one of two values, without a branch; both are computed."""
    if isinstance(condition, bool):
        return yes if condition else no
    return condition._put(CHOOSE, condition, yes, no)


def with_one_sign(one, other):
    """Return a sum, that of two negative terms as the negative sum: with others it is one."""
    negative = all(isinstance(term, Symbol) and term._operation() == NEGATE
                   for term in (one, other))
    return -(-one + -other) if negative else one + other


def smaller(first, second):
    """Return the smaller of two numbers, as ``min`` does."""
    return chosen(second < first, second, first)


def larger(first, second):
    """Return the larger of two numbers, as ``max`` does."""
    if first is second or not (isinstance(first, Symbol) or isinstance(second, Symbol)):
        return max(first, second)
    return chosen(second > first, second, first)


# Each operation on symbols or numbers, but for inputs and calls.
AGAIN = {
    ADD: operator.add, SUBTRACT: operator.sub, MULTIPLY: operator.mul, DIVIDE: operator.truediv,
    NEGATE: operator.neg, SINE: sine, COSINE: cosine, LESS: operator.lt,
    GREATER_EQUAL: operator.ge, CHOOSE: chosen, SQUARE_ROOT: square_root,
    EXPONENTIAL: exponential, LOGARITHM: logarithm, ARCTANGENT: arctangent, POWER: operator.pow}


def replayed(graph, values, load):
    """
    Compute values of a graph without a guard again from other inputs.

    ``load`` returns an input, a symbol of another graph or a number, by input and place.
    """
    known, places = {}, [value.place for value in values if isinstance(value, Symbol)]
    for place in sorted(needed_for(graph.operations, places)):
        kind, *operands = graph.operations[place]
        known[place] = load(*operands) if kind == LOAD else AGAIN[kind](
            *(known[one] if isinstance(one, int) else one for one in operands))
    return [known[value.place] if isinstance(value, Symbol) else value for value in values]
