# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A torque or force in a joint, or a force at a point, whose profile over time is given.

    tau = y(t)          in a joint
    F = y(t) e          at a named point, along a direction e in world axes or in the body's

work done on the mechanism: the integral of tau qd, or of F . v. Profiles y(t): ``profile``. In a
joint it acts beside what is commanded, behind the drive. When: a press or a cutter with a known
force, a motor with a known torque, a shaker, a measured load.
"""

from dataclasses import dataclass
import math
from typing import Optional, Tuple

from . import expression, profile
from .effect import BODY, Effect, WORLD
from .element import ForceElement, OWN, State, WORK
from .force_law import force_law, PROFILE
from .points import of_body_or_world
from ..codegen.vectors import dot, scale
from ..mechanism.checks import (
    freedom, list_of, name, not_negative, number, one_of, positive, text, vector)
from ..mechanism.fields import at, FieldError, shown
from ..mechanism.mechanism import Vector


@dataclass(frozen=True)
class PrescribedForce(Effect):
    """
    A torque or force in a joint, or a force at a point, given over time.

    Attributes
    ----------
    shape : str
        ``constant``, ``sine``, ``trapezoid``, ``cycloid``, ``table`` or ``expression``.
    joint : str or None
        Where it acts: a joint, or
    point : str or None
        a named point.
    direction : tuple of 2 floats, or 3 in space, or None
        Of the force at a point; its length does not matter.
    axes : str or None
        Of the direction: ``world`` (when not given) or ``body``.
    amplitude : float or None
        Value of a constant, height of a sine, of a trapezoid or of a cycloid [N m; N].
    offset : float or None
        Added; a trapezoid or cycloid rises from there [N m; N]; 0 when not given.
    frequency : float or None
        Of a sine, positive [Hz].
    phase : float or None
        Of a sine [rad]; 0 when not given.
    start : float or None
        When a trapezoid or cycloid begins to rise, zero or more [s]; 0 when not given.
    rise : float or None
        How long it rises, zero or more [s].
    hold : float or None
        How long it stays there, zero or more [s]; for good when not given.
    fall : float or None
        How long it falls, zero or more [s]; as long as it rises when not given.
    period : float or None
        After which a trapezoid, cycloid or table repeats, positive [s]; never when not given.
    times : tuple of floats or None
        Of a table, growing [s]; before and after it its ends hold.
    values : tuple of floats or None
        At these times [N m; N].
    interpolation : str or None
        Of a table: ``linear`` (when not given), ``cubic`` (a spline) or ``step``.
    expression : str or None
        Of the time ``t`` [s], such as ``2*sin(3*t)`` [N m; N].

    """

    CHECKS = {
        'joint': freedom, 'point': name, 'direction': vector,
        'shape': one_of(tuple(profile.SHAPES)),
        'axes': one_of((WORLD, BODY)), 'amplitude': number, 'offset': number,
        'frequency': positive, 'phase': number, 'start': not_negative, 'rise': not_negative,
        'hold': not_negative, 'fall': not_negative, 'period': positive, 'times': list_of(number),
        'values': list_of(number), 'interpolation': one_of(profile.INTERPOLATIONS),
        'expression': text}
    FILES = {'file': ('times', 'values')}
    VECTORS = ('direction',)
    STIFFENS = False
    READINGS = ('force', 'power')

    shape: str
    joint: Optional[str] = None
    point: Optional[str] = None
    direction: Optional[Vector] = None
    axes: Optional[str] = None
    amplitude: Optional[float] = None
    offset: Optional[float] = None
    frequency: Optional[float] = None
    phase: Optional[float] = None
    start: Optional[float] = None
    rise: Optional[float] = None
    hold: Optional[float] = None
    fall: Optional[float] = None
    period: Optional[float] = None
    times: Optional[Tuple[float, ...]] = None
    values: Optional[Tuple[float, ...]] = None
    interpolation: Optional[str] = None
    expression: Optional[str] = None

    def __post_init__(self):
        """Refuse a force in no place or in two, and invalid profiles."""
        super().__post_init__()
        profile.require_joint_or_point(
            self, 'a direction for a force at a point, and for no other')
        if self.axes is not None and self.point is None:
            raise FieldError('this key only beside point', shown(self.axes), path=('axes',))
        profile.require_keys(self)
        object.__setattr__(self, '_data', self._profile())

    def _profile(self):
        """Return the entries of the table: segments, or an expression."""
        if self.shape != 'expression':
            return profile.segments(self)
        with at('expression'):
            return (expression.program(self.expression),)

    @property
    def COMMANDS(self):  # noqa: N802
        """Whether a joint is pushed."""
        return self.joint is not None

    @property
    def ENDS_STEPS(self):  # noqa: N802
        """Whether the profile has corners."""
        return len(self._data) > 1 or self.period is not None

    def clock(self, time):
        """Return the time, and which segment of the profile is the present one."""
        return time, profile.present(self._data, self.period, time)

    def element(self, machine):
        """Return the effect as a row of the table."""
        written = float(self.shape == 'expression')
        states = State(OWN), State(OWN, 1.0, self.clock(0.0)[1]), State(WORK)
        if self.joint is not None:
            return ForceElement(
                torque_over_time, joints=(machine.joint(self.joint),),
                values=(self.period or 0.0, written), states=states, data=self._data)
        row, place = machine.point(self.point)
        length, turns = math.hypot(*self.direction), float(self.axes == BODY)
        direction = tuple(one / length for one in self.direction)
        if turns and not machine.mechanism.planar:
            direction = machine.placement(machine.carrier(self.point)).axes @ direction
        return ForceElement(
            force_over_time, bodies=(row,),
            values=(self.period or 0.0, written, *place, *direction, turns), states=states,
            data=self._data)


FOLLOWS_TIME = 'it follows the time'


@force_law(role=PROFILE, terms=profile.terms, engine_only=FOLLOWS_TIME,
           in_lanes=False, in_balls=True)
def torque_over_time(forces):
    torque = profile.value(forces)
    forces.joint.push(torque)
    power = torque * forces.joint.rate
    forces.flow(1.0, 0.0, power)
    forces.read(torque, power)


@force_law(role=PROFILE, terms=profile.terms, engine_only=FOLLOWS_TIME,
           in_lanes=False)
def force_over_time(forces):
    (body,), size, values = forces.bodies, forces.size, forces.values
    force = profile.value(forces)
    offset = forces.turned(body, values[2:2 + size])
    direction = of_body_or_world(
        forces, body, values[2 + size:2 + 2 * size], values[2 + 2 * size])
    forces.push(body, offset, scale(direction, force))
    power = force * dot(direction, forces.place(body, offset)[1])
    forces.flow(1.0, 0.0, power)
    forces.read(force, power)
