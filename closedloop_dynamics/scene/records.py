# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Records of a scene: frozen, checked when they are built."""

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
import hashlib
from pathlib import Path
from typing import Any, Dict, Optional, Tuple, Union

from .integrators import (
    ADAPTIVE, AUTO, BAUMGARTE, FORMER_INTEGRATORS, INTEGRATORS, STABILISATIONS)
from ..effects.effect_set import require_one_drive_each
from ..effects.registry import EFFECTS
from ..effects.traced_effect import TracedEffect
from ..mechanism.checks import freedom, list_of, name, number, one_of, positive, text
from ..mechanism.fields import among, at, FieldError, keys_of, mapping, normalise, shown
from ..mechanism.mechanism import Mechanism
from ..mechanism.validation import validate_mechanism


@dataclass(frozen=True)
class Initial:
    """
    The state that a simulation starts from, before the loops are closed.

    Attributes
    ----------
    position : tuple of nq floats
        Joint coordinates [rad or m]; approximate is enough. Of a spherical or free joint a
        mapping of `orientation` and, of a free one, `position`.
    velocity : tuple of nv floats
        Joint rates [rad/s or m/s]; of the held joints where any are held, else approximate. Of a
        spherical or free joint a mapping of `angular_velocity` and, of a free one, `velocity`.
    hold : tuple of str
        Joints whose position and velocity are kept as given; may be empty.
    turned : dict of str to float
        Of cut joints in space that turn, and whose turns are counted: angles that show how often
        they have turned round, within half a turn [rad]; in a file beside the positions.

    """

    position: Tuple[float, ...]
    velocity: Tuple[float, ...]
    hold: Tuple[str, ...] = ()
    turned: dict = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Refuse anything but lists of finite numbers, and joints held twice."""
        normalise(self, position=list_of(number), velocity=list_of(number), hold=list_of(freedom))
        for index, joint in enumerate(self.hold):
            if joint in self.hold[:index]:
                raise FieldError('every joint once', f'{joint!r} again', path=('hold', index))


def _integrator(value: Any) -> str:
    """Return the name of an integrator; of a former one, say what replaces it."""
    if isinstance(value, str) and value in FORMER_INTEGRATORS:
        raise FieldError(
            f'one of {among(INTEGRATORS)}', shown(value), "SciPy's solvers are not part of the "
            f'package any more: take {FORMER_INTEGRATORS[value]}')
    return one_of(tuple(INTEGRATORS))(value)


# Resolution of the stamps of messages [s].
SMALLEST_STEP = 1e-9


@dataclass(frozen=True)
class Method:
    """
    Method of the computation.

    Attributes
    ----------
    integrator : str
        Method of the time integration; ``'auto'`` keeps ``accuracy``.
    step_size : float
        Size of the steps, or, with an error-controlled integrator, the interval of the output
        grid [s]; at least 1e-9.
    stabilisation : str
        How the loops are kept closed.
    tolerance : float
        Local error that an error-controlled integrator allows per step [rad, m; rad/s, m/s].
    baumgarte_time_constant : float or None
        Of the decay of closure errors in Baumgarte's method [s], positive; ten steps where none
        is given.
    accuracy : float
        Error of positions after a second of motion [rad, m], that ``'auto'`` keeps.
    budget : float or None
        CPU time per second of real time that ``'auto'`` may take [1], positive: it keeps the
        best accuracy that this allows, which may be finer or coarser than ``accuracy``.

    """

    integrator: str = AUTO
    step_size: float = 0.001
    stabilisation: str = 'projection'
    tolerance: float = 1e-6
    baumgarte_time_constant: Optional[float] = None
    accuracy: float = 1e-6
    budget: Optional[float] = None

    def __post_init__(self) -> None:
        """Refuse unknown methods and impossible times."""
        normalise(self, integrator=_integrator, step_size=positive,
                  stabilisation=one_of(tuple(STABILISATIONS)), tolerance=positive,
                  accuracy=positive)
        if self.step_size < SMALLEST_STEP:
            raise FieldError(f'a number of at least {SMALLEST_STEP:g} [s]', shown(self.step_size),
                             path=('step_size',))
        if self.baumgarte_time_constant is not None:
            normalise(self, baumgarte_time_constant=positive)
        if self.budget is not None:
            normalise(self, budget=positive)

    @property
    def unused(self) -> Dict[str, str]:
        """Return the requirement of each key that has no effect here, by key."""
        adaptive = INTEGRATORS[self.integrator].kind == ADAPTIVE
        needs = {
            'accuracy': (self.integrator == AUTO, f'integrator: {AUTO}'),
            'budget': (self.integrator == AUTO, f'integrator: {AUTO}'),
            'tolerance': (adaptive and self.integrator != AUTO,
                          'an error-controlled integrator that is chosen by name'),
            'baumgarte_time_constant': (
                STABILISATIONS[self.stabilisation] == BAUMGARTE, 'stabilisation: baumgarte')}
        return {key: need for key, (used, need) in needs.items() if not used}

    @property
    def without_budget(self) -> 'Method':
        """Return the same with its accuracy alone, where the time of a run must not matter."""
        return replace(self, budget=None)

    @property
    def by_budget(self) -> bool:
        """Whether the accuracy follows a budget."""
        return self.budget is not None and self.integrator == AUTO

    @property
    def time_constant(self) -> float:
        """Time constant of Baumgarte's method [s]: as given, or tied to the step."""
        return self.baumgarte_time_constant or 10.0 * self.step_size


def require_no_budget(method: Method, what: str) -> None:
    """
    Refuse a budget for a task whose result does not depend on its time.

    Raises
    ------
    FieldError

    """
    if method.by_budget:
        raise FieldError(f'no budget for {what}, whose steps do not depend on their cost',
                         shown(method.budget), f'an accuracy, such as {method.accuracy:g}',
                         ('method', 'budget'))


def _contents(record: Any) -> str:
    """Return the values of a record, those of a mechanism in it, too."""
    return f'{type(record).__name__}(' + ', '.join(
        f'{one.name}={_contents(value) if isinstance(value, Mechanism) else repr(value)}'
        for one in fields(record) if one.repr for value in (getattr(record, one.name),)) + ')'


@dataclass(frozen=True, repr=False)
class Scene:
    """
    A mechanism, its start, its effects and the method.

    Attributes
    ----------
    name : str
    path : pathlib.Path or None
        The file it was read from; None where it was built in Python.
    description : str
    mechanism : Mechanism
    initial : Initial
    effects : dict of str to record
        One record of ``effects.registry`` for each effect, by its free name.
    switched_off : tuple of str
        Those of them that do not act at the start.
    method : Method
    parameters : dict of str to float
        What expressions were computed with: the scene's own and its mechanism's.
    source : tuple or None
        The data that it was read from, parameters given beside them, and the mechanism as read.

    """

    name: str
    path: Optional[Path]
    description: str
    mechanism: Mechanism
    initial: Initial
    effects: dict = field(default_factory=dict)
    method: Method = Method()
    parameters: dict = field(default_factory=dict, compare=False, repr=False)
    source: Optional[tuple] = field(default=None, compare=False, repr=False)
    switched_off: Tuple[str, ...] = ()

    def __repr__(self) -> str:
        """Show mechanism, effects and method."""
        effects = f'; effects: {", ".join(self.effects)}' if self.effects else ''
        return (f'<Scene {self.name} of {self.mechanism.name}: {self.method.integrator}, '
                f'steps of {self.method.step_size:g} s{effects}>')

    def digest(self) -> str:
        """Return a hash of all values that a run depends on, wherever the file is."""
        return hashlib.sha256(_contents(replace(self, path=None)).encode()).hexdigest()[:16]

    def __post_init__(self) -> None:
        """Refuse an initial state or an effect that does not fit the mechanism."""
        normalise(self, description=text, mechanism=validate_mechanism, effects=mapping)
        coordinates = self.mechanism.coordinates
        with at('initial'):
            coordinates.require_lengths(self.initial.position, self.initial.velocity)
        if len(coordinates.balls):
            with at('initial', 'position'):
                position = tuple(coordinates.unit(self.initial.position).tolist())
            object.__setattr__(self, 'initial', replace(self.initial, position=position))
        for joint, angle in self.initial.turned.items():
            with at('initial', 'position', joint):
                one_of(self.mechanism.turning_cuts, 'one of the cut joints that turn in space')(
                    joint)
                number(angle)
        for index, joint in enumerate(self.initial.hold):
            with at('initial', 'hold', index):
                one_of(coordinates.can_be_held, 'one of the joints')(joint)
        for key, effect in self.effects.items():
            with at('effects', key):
                name(key)
                if type(effect) not in EFFECTS.values() and not isinstance(effect, TracedEffect):
                    raise FieldError('a record of effects.registry, or of a class with trace',
                                     shown(effect))
                effect.fit(self.mechanism)
        with at('effects'):
            require_one_drive_each(self.effects)
        for key in self.switched_off:
            with at('effects'):
                one_of(tuple(self.effects), 'one of the effects')(key)
            if self.effects[key].motion(key) is not None:
                raise FieldError('a prescribed motion that acts from the start', 'false',
                                 'leave it out of the scene', ('effects', key, 'enabled'))

    def with_method(self, method: Union[str, Mapping[str, Any], Method]) -> 'Scene':
        """
        Return the scene with another method.

        Parameters
        ----------
        method : str, mapping or Method
            An integrator's name, what changes by the keys of ``Method``, where None changes
            nothing, or all of it.

        Raises
        ------
        ValueError
            For a name or value that no scene could have there.

        """
        if isinstance(method, Method):
            return replace(self, method=method)
        with at('method'):
            given = mapping({'integrator': method} if isinstance(method, str) else method,
                            *keys_of(Method))
            wanted = replace(self.method, **{
                key: value for key, value in given.items() if value is not None})
            if given.get('budget') is not None and not wanted.by_budget:
                raise FieldError(f'integrator: {AUTO} with a budget', shown(wanted.integrator),
                                 path=('integrator',))
            return replace(self, method=wanted)
