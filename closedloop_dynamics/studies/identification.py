# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Parameters of a mechanism from a motion and the efforts of its drives.

Along a motion that closes the loops, with N(q) the motions of the joints of the spanning tree for
a unit rate of each independent coordinate, constraint forces drop out of inverse dynamics:

    N^T (Y p + e) = N^T tau

Y p is what masses, first moments and inertias p take (linear, ``inertial_parameters``), e what
known masses and effects take. Columns of N^T Y that depend on one another determine which sums of
parameters the motion shows (base parameters, Gautier and Khalil 1990), found by a QR factorisation
with pivoting. The sums follow from weighted least squares, whose weights are the inverse standard
deviations of what is left in each independent coordinate. All other numbers (lengths, coefficients
of effects) are varied around that: variable projection, whose gradient is that of the whole
problem (Golub and Pereyra 1973, Kaufman 1975). Derivatives by these numbers are central
differences of fourth order: exact to rounding where the torques are polynomials in a number (a
centre of mass, coefficients of most effects), and to some 1e-11 in lengths.
"""

from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Dict, NamedTuple, Optional, Tuple

import numpy as np

from .inertial_parameters import BodyParameters, numbers_of, pseudo_inertia, unit_rows
from ..codegen import space
from ..effects.element import OWN
from ..effects.force_law import FRICTION
from ..effects.registry import effect_type
from ..engine import types as t
from ..engine.ranks import rank_from
from ..kinematics.geometry import Geometry
from ..kinematics.modeling import extent
from ..kinematics.passive_joint_solver import PassiveJointError, PassiveJointSolver
from ..mechanism.differences import FIRST_4, FORWARD_4, nodes
from ..mechanism.errors import SimulationError
from ..mechanism.fields import among, FieldError
from ..mechanism.mechanism import MechanismError
from ..scene.key_paths import changed, numbers, resolve
from ..simulation.data import Data

# Columns, scaled to length one, are dependent below DEPENDENT; shares of others below NOTHING are
# rounding; parameters whose torques are below UNSEEN of those of the largest have no influence.
DEPENDENT, NOTHING, UNSEEN = 1e-8, 1e-7, 1e-11
# Where independent coordinates determine the others by less, the motion is refused.
UNDETERMINED = 1e-6
# A parameter is identified where its standard deviation is below this share of it.
IDENTIFIED = 0.1
# Probability with which intervals hold the true value.
CONFIDENCE = 0.95
# Weights are found again so many times; no standard deviation is below this share of the torques.
WEIGHTINGS, LEAST_DEVIATION = 3, 1e-12
# Differences by a number: the step, as a share of it; forward ones at the end of its range.
STEP, TRIED = 1e-3, ((FIRST_4, 1.0), (FORWARD_4, 1.0))
# Least squares end where numbers change by less than this share; evaluations of them at most.
CONVERGED, MOST_EVALUATIONS = 1e-13, 200
# Joints further from where they were seen are on another branch [rad, or of the size].
ELSEWHERE = 0.2
# Share of a body's mass and the mechanism's size below which its parameters are small.
SMALL = 0.1
BODY_KEYS = ('mass', 'center_of_mass', 'inertia')
# What of a scene decides which torques a motion takes.
VARIED = ('mechanism', 'effects', 'parameters')


class IdentificationError(ValueError):
    """Parameters that cannot be identified from the data; the message says why."""


class Estimate(NamedTuple):
    """
    A number that was identified.

    Attributes
    ----------
    value : float
        In the SI unit of its key.
    deviation : float
        Standard deviation; of efforts whose errors are independent of one another.
    freedom : float
        Degrees of freedom that it was found with: instants, less parameters by coordinate.

    """

    value: float
    deviation: float
    freedom: float

    @property
    def relative(self):
        """Return the standard deviation as a share of the value."""
        return self.deviation / abs(self.value) if self.value else math.inf

    @property
    def identified(self):
        """Return whether that is below 10 %."""
        return self.relative < IDENTIFIED

    @property
    def interval(self):
        """Return the ends of the interval that holds the true value in 95 % of all cases."""
        from scipy.special import stdtrit
        # Student's distribution, as the standard deviation is an estimate, too.
        size = stdtrit(self.freedom, 0.5 + 0.5 * CONFIDENCE) * self.deviation
        return self.value - size, self.value + size


class Combination(NamedTuple):
    """
    A sum of parameters of which only the sum has an influence on the motion.

    Attributes
    ----------
    terms : dict of str to float
        Factors by parameter; the first one is 1.
    estimate : Estimate or None
        Of the sum; None where a number is in it that the torques are not linear in: then the sum
        is that of small changes.

    """

    terms: Dict[str, float]
    estimate: Optional[Estimate]

    def __str__(self):
        """Return the sum as text."""
        text = ''
        for name, factor in self.terms.items():
            size = '' if f'{abs(factor):.6g}' == '1' else f'{abs(factor):.6g}*'
            sign = '-' if factor < 0.0 else '+'
            text += f' {sign} {size}{name}' if text else f'{"-" * (factor < 0.0)}{size}{name}'
        return text


@dataclass(frozen=True)
class Identification:
    """
    Estimates of parameters from a motion.

    Attributes
    ----------
    estimates : dict of str to Estimate
        By key path, of those that are known alone.
    combinations : tuple of Combination
        Sums that are known where their parts are not, and parameters of bodies that are known
        where the keys that they follow from are not.
    unknown : tuple of str
        Key paths that the motion does not identify alone.
    unseen : tuple of str
        Parameters without any influence on the motion.
    impossible : dict of str to float
        Bodies, with all their numbers known, that no distribution of mass has: the smallest
        eigenvalue of the pseudo-inertia matrix, as a share of the largest.
    deviations : dict of str to float
        Standard deviation of the residual efforts, by independent coordinate [N m or N].
    residuals : ndarray, shape (n, number of independent coordinates)
        Torques of the identified parameters less the recorded ones [N m or N].
    samples : ndarray of int, shape (n,)
        Which of the instants given these are: the others have a joint with dry friction at rest.
    condition : float
        Of the base parameters' regressor, its columns scaled to length one.

    """

    estimates: Dict[str, Estimate]
    combinations: Tuple[Combination, ...]
    unknown: Tuple[str, ...]
    unseen: Tuple[str, ...]
    impossible: Dict[str, float]
    deviations: Dict[str, float]
    residuals: np.ndarray
    samples: np.ndarray
    condition: float


def identify(scene, keys, motion, effort, others=None):
    """
    Identify parameters of a mechanism.

    Parameters
    ----------
    scene : scene_records.Scene
        The mechanism as far as it is known; numbers that vary begin as they are there.
    keys : sequence of str
        What varies, by key path: ``'mechanism.bodies.crank.mass'``, ``'effects.grease.
        coefficient'``, ``'parameters.length'``; ``'mechanism.bodies.crank'`` stands for all of
        mass, centre of mass and inertia, ``'mechanism.bodies'`` for those of all bodies.
    motion : mapping of str to array_like, shape (3, n)
        Positions, rates and accelerations of measured joints [rad or m, and per s and s^2]: they
        have to determine all others, whose motion follows from the loops.
    effort : mapping of str to array_like, shape (n,)
        Of every joint of the tree that a drive acts in [N m or N].
    others : mapping of str to array_like, shape (n,), optional
        Positions that other joints were seen at: they show that the mechanism stayed on the branch
        of the scene's start, and are used for nothing else.

    Returns
    -------
    Identification

    Raises
    ------
    IdentificationError
        Where effects or drives are such that inverse dynamics does not know them, or nothing can
        be learnt.
    PassiveJointError
        Where the motion does not follow from the measured joints.
    ValueError
        For keys, joints and arrays that do not fit.

    """
    return Identifier(scene, keys, motion, others).solve(effort)


def measured_joints(scene):
    """Return the names of joints that determine the motion of all: driven ones, or else all."""
    bare, driven = _without_motions(scene)
    names = bare.mechanism.coordinates.single_names
    chosen = tuple(name for name in driven if name in names)
    try:
        PassiveJointSolver(bare.mechanism, chosen, Data(bare).position)
    except ValueError:
        return tuple(names)
    return chosen


def driven_joints(scene):
    """Return the joints of the tree that a drive acts in: actuated, or moved as prescribed."""
    return _without_motions(scene)[1]


class Identifier:
    """
    The equations of a motion: efforts go in, parameters come out.

    What depends on the motion alone is computed once.

    Parameters
    ----------
    scene, keys, motion, others
        As for ``identify``.

    Attributes
    ----------
    independent : tuple of str
        Coordinates that the equations are those of: driven ones where possible.
    driven : tuple of str
        Joints whose efforts are needed.

    Raises
    ------
    PassiveJointError, IdentificationError, ValueError

    """

    def __init__(self, scene, keys, motion, others=None):
        self._scene, self.driven = _without_motions(scene)
        self._keys = _expanded(self._scene, keys)
        joints, motion = _arrays(motion, 3, 'motion')
        self._linear = {}
        for key in self._keys:
            words = key.split('.')
            if words[:2] == ['mechanism', 'bodies'] and words[3] in BODY_KEYS:
                self._linear.setdefault(words[2], []).append('.'.join(words[3:]))
        self._along = _Along(self._scene, self._linear, joints, motion, self.driven)
        _refuse(self._along.data)
        self._require_branch(others or {})
        linear = {f'mechanism.bodies.{body.name}.{key}' for body in self._along.bodies
                  for key in body.depends}
        self._nonlinear = [key for key in self._keys if key not in linear]
        self._paths = {key: resolve(self._scene, key) for key in self._nonlinear}
        self._start = np.array([numbers(self._scene)[key] for key in self._nonlinear])
        size = extent(self._scene.mechanism)
        self._scales = np.array([
            abs(value) or (size if key.startswith('mechanism') else 1.0)
            for key, value in zip(self._nonlinear, self._start)])
        self._latest = self._start, self._along
        self.independent = self._along.independent
        self._samples = _moving(self._along)

    def _require_branch(self, others):
        """Refuse a motion on another branch than the one that other joints were seen on."""
        joints, values = _arrays(others, 1, 'others')
        mechanism = self._scene.mechanism
        coordinates, size = mechanism.coordinates, extent(mechanism)
        positions = np.array([position for position, _, _ in self._along.states])
        for name, seen in zip(joints, values[0].T):
            if name not in coordinates.single_names or len(seen) != len(positions):
                raise ValueError(f'others: {name}: expected {len(positions)} positions of one of '
                                 f'{", ".join(coordinates.single_names)}, got {len(seen)}')
            place = coordinates.index[name]
            apart = seen - positions[:, coordinates.place[place]]
            if coordinates.lengths[place]:
                apart = apart / size
            else:
                apart = np.abs((apart + np.pi) % (2.0 * np.pi) - np.pi)
            if np.abs(apart).max() > ELSEWHERE:
                sample = int(np.argmax(np.abs(apart) > ELSEWHERE))
                raise IdentificationError(
                    f'motion: sample {sample}: expected {name} where the loops put it, at '
                    f'{positions[sample, coordinates.place[place]]:.4g}, got {seen[sample]:.4g}: '
                    'the mechanism has passed a singular position, or began on another branch '
                    'than the scene; take another part, another start or other measured joints')

    @property
    def regressor(self):
        """
        Torques of a unit of each linear parameter, shape (n, independent, parameters).

        Of the samples in which no joint with dry friction rests.
        """
        return self._along.regressor[self._samples]

    @property
    def parameters(self):
        """Linear parameters, a tuple of ``inertial_parameters.Parameter``."""
        return self._along.parameters

    def influence(self):
        """
        Return the torques of usual parameters along the motion, around the scene [N m or N].

        Shape (n, number of independent coordinates, parameters): linear ones, then the others.
        """
        along = self._along
        found = [along.regressor[self._samples] * along.typical]
        if self._nonlinear:
            found.append(self._slopes(self._start, along.values) * self._scales)
        return np.concatenate(found, axis=2)

    def solve(self, effort):
        """Identify the parameters from efforts, as for ``identify``."""
        torque = self._generalized(effort)
        rows = torque.size
        if rows <= len(self._keys):
            raise IdentificationError(
                f'motion: expected more equations than the {len(self._keys)} numbers that vary, '
                f'got {rows}: {len(torque)} instants of {len(self.independent)} coordinates')
        numbers_now, along, slopes = self._start, self._along, None
        size = np.sqrt(np.mean(np.square(torque + along.size[self._samples]), axis=0)).max()
        deviations = np.full(torque.shape[1], size or 1.0)
        for _ in range(WEIGHTINGS):
            if self._nonlinear:
                numbers_now = self._nonlinear_fit(numbers_now, torque, deviations)
                along = self._at(numbers_now)
            wanted = self._wanted(along, torque)
            if along.parameters and not (
                    np.abs(wanted).max() > UNSEEN * np.abs(along.size).max()):
                raise IdentificationError(
                    'effort: expected a torque, or a known mass or force that acts beside what '
                    'varies, got none: the parameters are then known but for a common factor')
            fit = _Linear(along.regressor[self._samples], wanted, deviations,
                          along.values, along.typical)
            if self._nonlinear:
                slopes = self._slopes(numbers_now, fit.values)
                fit = _Linear(
                    np.concatenate([along.regressor[self._samples], slopes], axis=2),
                    # At the present numbers the residual is linear in their change.
                    wanted + slopes @ numbers_now, deviations,
                    np.concatenate([fit.values, numbers_now]),
                    np.concatenate([along.typical, self._scales]))
            found = fit.deviations
            deviations = np.maximum(found, LEAST_DEVIATION * (size or 1.0))
        return self._identification(along, fit, found)

    def _generalized(self, effort):
        """Return the efforts in the independent coordinates, shape (n, independent)."""
        joints, values = _arrays(effort, 1, 'effort')
        if set(joints) != set(self.driven):
            raise ValueError(f'effort: expected those of {", ".join(self.driven) or "no joint"}, '
                             f'got {", ".join(joints) or "none"}')
        levers = self._along.levers
        if not joints:
            values = np.zeros((1, len(levers), 0))
        if values.shape[1] != len(levers):
            raise ValueError(f'effort: expected {len(levers)} values, as many as the motion has, '
                             f'got {values.shape[1]}')
        order = [joints.index(name) for name in self.driven]
        found = np.einsum('nda,na->nd', levers, values[0][:, order])
        return found[self._samples]

    def _wanted(self, along, torque):
        """Return the torques to explain by the linear parameters."""
        return torque - along.known[self._samples]

    def _at(self, values):
        """Return the torques of the scene with other numbers along the motion."""
        if not np.array_equal(self._latest[0], values):
            self._latest = values.copy(), self._along.of(self._scene_of(values), self._nonlinear)
        return self._latest[1]

    def _scene_of(self, values):
        """Return the scene of other numbers."""
        return changed(self._scene, {
            self._paths[key]: float(value) for key, value in zip(self._nonlinear, values)})

    def _slopes(self, values, parameters):
        """Return the derivatives of the torques by the nonlinear numbers, (n, d, numbers)."""
        along, found = self._at(values), []
        for key, unit, step in zip(
                self._nonlinear, np.eye(len(values)),
                STEP * np.maximum(self._scales, np.abs(values))):
            found.append(sum(weight * torques for weight, torques in nodes(
                lambda change, key=key, unit=unit: self._torques(along.of(
                    self._scene_of(values + change * unit), [key]), parameters),
                step, TRIED, (FieldError, MechanismError))))
        return np.stack(found, axis=2)

    def _torques(self, along, parameters):
        return (along.regressor @ parameters + along.known)[self._samples]

    def _nonlinear_fit(self, start, torque, deviations):
        """Return the nonlinear numbers of least squares, the linear ones being those of each."""
        from scipy.optimize import least_squares
        scales = self._scales

        def project(along):
            matrix = _flat(along.regressor[self._samples], deviations)
            vector = _flat(self._wanted(along, torque), deviations)
            return (matrix, *_least(matrix, vector))

        def residual(shares):
            try:
                along = self._at(start + shares * scales)
            except (FieldError, IdentificationError, MechanismError, SimulationError):
                # Too far: a shorter step is tried.
                return np.full(torque.size, 1e3 * worst)
            matrix, parameters, _ = project(along)
            return matrix @ parameters - _flat(self._wanted(along, torque), deviations)

        def slopes(shares):
            values = start + shares * scales
            _, parameters, basis = project(self._at(values))
            found = _flat(self._slopes(values, parameters), deviations) * scales
            return found - basis @ (basis.T @ found)

        first = self._at(start)
        matrix, parameters, _ = project(first)
        worst = 1.0 + np.abs(
            matrix @ parameters - _flat(self._wanted(first, torque), deviations)).max()
        result = least_squares(
            residual, np.zeros(len(start)), slopes, x_scale='jac', ftol=CONVERGED, xtol=CONVERGED,
            gtol=CONVERGED, max_nfev=MOST_EVALUATIONS)
        if not result.success:
            raise IdentificationError(
                f'keys: expected {", ".join(self._nonlinear)} to settle, got none that do within '
                f'{MOST_EVALUATIONS} steps; begin nearer to them')
        return start + result.x * scales

    def _identification(self, along, fit, deviations):
        """Return estimates, standard deviations and sums by key."""
        linear = [one.name for one in along.parameters]
        names = linear + self._nonlinear
        alone, combined = {}, []
        for place, terms in fit.sums.items():
            if len(terms) == 1:
                alone[names[place]] = place
            else:
                estimate = fit.estimate(place) if all(
                    other < len(linear) for other in terms) else None
                combined.append(Combination(
                    {names[other]: factor for other, factor in terms.items()}, estimate))
        estimates, unknown, used = {}, [], set()
        by_key = {f'mechanism.bodies.{body.name}.{key}': (body, key, depends)
                  for body in along.bodies for key, depends in body.depends.items()}
        for key in self._keys:
            body, inner, depends = by_key.get(key, (None, None, (key,)))
            if not all(name in alone for name in depends):
                unknown.append(key)
                continue
            used.update(depends)
            estimates[key] = fit.estimate(alone[key]) if body is None else fit.estimate_of(
                lambda values, body=body, inner=inner: body.values(values)[inner],
                {name: alone[name] for name in depends})
        single = [Combination({name: 1.0}, fit.estimate(place)) for name, place in alone.items()
                  if name not in used]
        return Identification(
            estimates, tuple(single + combined), tuple(unknown),
            tuple(names[place] for place in fit.unseen), self._impossible(along, estimates),
            dict(zip(self.independent, deviations.tolist())), fit.residuals, self._samples,
            fit.condition)

    def _impossible(self, along, estimates):
        """Return the bodies, known as a whole, that cannot exist; see ``Identification``."""
        bodies = {body.name: body for body in along.scene.mechanism.bodies}
        found = {}
        for name, inner in self._linear.items():
            keys = {key: f'mechanism.bodies.{name}.{key}' for key in inner}
            if not all(key in estimates for key in keys.values()):
                continue
            values = {key: estimates[path].value for key, path in keys.items()}
            eigenvalues = np.linalg.eigvalsh(pseudo_inertia(_with_numbers(bodies[name], values)))
            if not eigenvalues[0] > 0.0:
                found[name] = float(eigenvalues[0] / np.abs(eigenvalues).max())
        return found


class _Along:
    """
    Torques of a scene along a motion, by linear parameters and the rest.

    Attributes
    ----------
    parameters : tuple of Parameter
    values, typical : ndarray, shape (parameters,)
        Of the scene, and sizes that such parameters have.
    regressor : ndarray, shape (n, d, parameters)
        Torques of a unit of each in the independent coordinates.
    known : ndarray, shape (n, d)
        Efforts of the remaining terms.
    size : ndarray, shape (n, d)
        All torques of the scene.
    levers : ndarray, shape (n, d, driven)
        Generalized forces in the independent coordinates for unit efforts of the drives.

    """

    def __init__(self, scene, linear, joints, motion, driven, own=None):
        self._linear, self._joints, self._motion, self._driven = linear, joints, motion, driven
        self._take(scene)
        self._geometry = Geometry(scene.mechanism)
        self.states = self._completed()
        self._find_tangents(own)
        self._find_unit_torques()
        self._find_size()
        self._find_torques()

    def _take(self, scene):
        """Set the numbers of a scene."""
        self.data = Data(scene)
        self._gravity = self.data.system.model.gravity.copy()
        self._take_bodies(scene)

    def _take_bodies(self, scene):
        """Set the numbers of bodies of a scene."""
        self.scene, mechanism = scene, scene.mechanism
        self.bodies = tuple(
            BodyParameters(body, self._linear[body.name]) for body in mechanism.bodies
            if body.name in self._linear)
        self.parameters = tuple(one for body in self.bodies for one in body.parameters)
        self.values = np.array([one.value for one in self.parameters])
        masses, size = {body.name: body.mass for body in mechanism.bodies}, extent(mechanism)
        self.typical = np.array([
            max(abs(one.value), SMALL * masses[one.body] * size ** one.power)
            for one in self.parameters])

    def of(self, scene, keys):
        """Return the same of another scene that differs in some keys alone."""
        if not all(key.startswith(('effects.', 'mechanism.bodies.')) for key in keys):
            return _Along(scene, self._linear, self._joints, self._motion, self._driven, self.own)
        other = object.__new__(_Along)
        other.__dict__.update(self.__dict__)
        if all(key.startswith('mechanism.bodies.') for key in keys):
            other._take_bodies(scene)
            # Linear in numbers of bodies: nothing else is to be evaluated.
            for before, body in zip(self.scene.mechanism.bodies, scene.mechanism.bodies):
                if body != before:
                    other.size = other.size + self._units[body.name] @ (
                        numbers_of(body) - numbers_of(before))
        else:
            other._take(scene)
            if not np.array_equal(other._gravity, self._gravity):
                other._find_unit_torques()
            other._find_size()
        other._find_torques()
        return other

    @cached_property
    def independent(self):
        """Names of the independent coordinates."""
        names = self.scene.mechanism.coordinates.names
        return tuple(names[place] for place in self.own)

    def _completed(self):
        """Return positions, rates and accelerations of all joints, of every instant."""
        completion = PassiveJointSolver(
            self.scene.mechanism, self._joints, self.data.position)
        found = []
        for k, (position, rate, acceleration) in enumerate(self._motion.transpose(1, 0, 2)):
            completion.complete(position, rate)
            if completion.passed:
                raise PassiveJointError(
                    f'motion: sample {k} touches a singular position, where branches meet: '
                    f'{", ".join(self._joints)} do not determine the one on which it goes on')
            found.append((completion.position.copy(), completion.velocity.copy(),
                          completion.accelerations(acceleration)))
        return found

    def _find_tangents(self, own):
        """Find N of every instant, and the independent coordinates where they are not given."""
        index = self.scene.mechanism.coordinates.index
        places = [index[name] for name in self._driven]
        self.own, tangents = own, []
        for k, (q, _, _) in enumerate(self.states):
            basis = self._geometry.equations.move(q).free_motions().T
            if not basis.size:
                raise IdentificationError(
                    f'{self.scene.mechanism.name}: expected a mechanism that moves, got one '
                    'without degrees of freedom')
            if self.own is None:
                self._require_determined(basis)
                self.own = _choose(basis, places)
            part = basis[self.own]
            if part.shape[0] != part.shape[1] or np.linalg.svd(
                    part, compute_uv=False)[-1] < UNDETERMINED:
                raise IdentificationError(
                    f'motion: sample {k} is in a singular position: '
                    f'{", ".join(self.independent)} do not determine the motion of the others '
                    'there')
            tangents.append(basis @ np.linalg.inv(part))
        self._tangents = np.array(tangents)
        self.levers = self._tangents[:, places].transpose(0, 2, 1)

    def _require_determined(self, basis):
        """Refuse a mechanism in which parts move freely, whatever the measured joints do."""
        index = self.scene.mechanism.coordinates.index
        measured = basis[[index[name] for name in self._joints]]
        open_ones = basis.shape[1] - rank_from(np.linalg.svd(measured, compute_uv=False))
        if open_ones:
            raise IdentificationError(
                f'motion: expected joints that determine the motion of all others, got '
                f'{", ".join(self._joints)}, which leave {open_ones} of {basis.shape[1]} degrees '
                'of freedom open, such as the spin of a rod between two spherical joints: put a '
                'universal joint at one end')

    def _find_size(self):
        """Find all torques of the scene."""
        need = np.array([self.data.tree_torque(*state) for state in self.states])
        self.size = np.einsum('nvd,nv->nd', self._tangents, need)

    def _find_torques(self):
        """Find the linear parameters' torques, and the remainder."""
        self.regressor = np.stack(
            [self._units[one.body] @ one.numbers for one in self.parameters], axis=2) if (
                self.parameters) else np.zeros((*self.size.shape, 0))
        self.known = self.size - self.regressor @ self.values

    def _find_unit_torques(self):
        """Find the torques of a unit of mass, first moments and inertia of each body, by name."""
        planar = self.scene.mechanism.planar
        columns = [t.MASS, t.MASS_X, t.MASS_Y, t.INERTIA] if planar else [
            *range(space.MASS, space.INERTIA + 6)]
        equations, rows = self._geometry.equations, self._geometry.rows
        constants = equations.model.body
        equations.model.gravity[:] = self._gravity
        keep = constants.copy()
        # Numbers of which none is zero or equals another, so that no code for special bodies is
        # generated; their torques are taken off again.
        constants[1:, columns] = 1e-3 * np.random.default_rng(0).uniform(
            1.0, 2.0, (len(constants) - 1, len(columns)))
        base = self._inverse(equations)
        self._units = {}
        for name in self._linear:
            row = constants[rows[name]]
            before, found = row.copy(), []
            for unit in unit_rows(self._geometry.placements[name], planar):
                row[columns] += unit
                found.append(self._inverse(equations) - base)
                row[:] = before
            self._units[name] = np.stack(found, axis=2)
        constants[:] = keep

    def _inverse(self, equations):
        """Return the torques of the bodies alone, shape (n, d)."""
        need = np.zeros((len(self.states), equations.nv))
        for (q, qd, qdd), out in zip(self.states, need):
            equations.move(q, qd)
            equations.model.tree_torque(equations.work, qdd, out)
        return np.einsum('nvd,nv->nd', self._tangents, need)


class _Linear:
    """
    Weighted least squares without the unidentifiable columns.

    Attributes
    ----------
    values : ndarray, shape (p,)
        A solution: that in which dependent parameters have the values given.
    sums : dict of int to dict of int to float
        By the place of each base parameter: factors by the places of what is in its sum.
    unseen : list of int
        Places of parameters without influence.
    residuals : ndarray, shape (n, d)
        Matrix times values less the right-hand side.
    deviations : ndarray, shape (d,)
        Their standard deviations.
    condition : float

    """

    def __init__(self, matrix, wanted, deviations, given, typical):
        flat = _flat(matrix, deviations)
        lengths = np.linalg.norm(flat, axis=0)
        sizes = lengths * typical
        seen = sizes > UNSEEN * sizes.max(initial=0.0)
        self.unseen = np.flatnonzero(~seen).tolist()
        places = np.flatnonzero(seen)
        scaled = flat[:, places] / lengths[places]
        self.sums, self.condition = {}, math.nan
        self._base, self._covariance = np.zeros(0, dtype=int), np.zeros((0, 0))
        self.values = np.array(given, dtype=float)
        if len(places):
            self._solve(scaled, places, lengths, flat, _flat(wanted, deviations))
        self.residuals = matrix @ self.values - wanted
        self._freedom = len(wanted) - len(self._base) / wanted.shape[1]
        self.deviations = np.sqrt(np.sum(self.residuals ** 2, axis=0) / self._freedom)

    def _solve(self, scaled, places, lengths, flat, wanted):
        from scipy.linalg import qr, solve_triangular
        orthogonal, upper, order = qr(scaled, mode='economic', pivoting=True)
        diagonal = np.abs(np.diag(upper))
        rank = int(np.sum(diagonal > DEPENDENT * diagonal[0]))
        base, rest = places[order[:rank]], places[order[rank:]]
        upper, shares = upper[:rank, :rank], solve_triangular(upper[:rank, :rank],
                                                              upper[:rank, rank:])
        self.condition = float(np.linalg.cond(upper))
        shares[np.abs(shares) < NOTHING] = 0.0
        factors = shares * lengths[rest] / lengths[base][:, np.newaxis]
        for place, row in sorted(zip(base.tolist(), factors), key=lambda pair: pair[0]):
            self.sums[place] = {place: 1.0, **{
                other: float(factor) for other, factor in zip(rest.tolist(), row) if factor}}
        inverse = solve_triangular(upper, np.eye(rank)) / lengths[base][:, np.newaxis]
        self.values[base] = inverse @ (orthogonal[:, :rank].T @ (
            wanted - flat[:, rest] @ self.values[rest]))
        # Once more, to remove rounding errors.
        self.values[base] += inverse @ (orthogonal[:, :rank].T @ (wanted - flat @ self.values))
        self._base, self._covariance = base, inverse @ inverse.T

    def estimate(self, place):
        """Return the sum of a base parameter."""
        value = sum(factor * self.values[other] for other, factor in self.sums[place].items())
        inner = self._base.tolist().index(place)
        return Estimate(
            float(value), math.sqrt(self._covariance[inner, inner]), self._freedom)

    def estimate_of(self, function, places):
        """Return a function of some base parameters, by name, each known alone."""
        values = {name: self.values[place] for name, place in places.items()}
        inner = [self._base.tolist().index(place) for place in places.values()]
        gradient = np.array([np.imag(function(
            {**values, name: values[name] + 1e-30j})) / 1e-30 for name in places])
        variance = gradient @ self._covariance[np.ix_(inner, inner)] @ gradient
        return Estimate(
            float(np.real(function(values))), math.sqrt(max(variance, 0.0)), self._freedom)


def _flat(array, deviations):
    """Return equations, shape (n, d, ...), as rows, each in units of its standard deviation."""
    weighted = array / deviations.reshape(-1, *(array.ndim - 2) * (1,))
    return weighted.reshape(array.shape[0] * array.shape[1], *array.shape[2:])


def _least(matrix, vector):
    """Return the solution of least squares, and an orthonormal basis of the columns."""
    if not matrix.shape[1]:
        return np.zeros(0), np.zeros((len(matrix), 0))
    lengths = np.linalg.norm(matrix, axis=0)
    lengths[lengths == 0.0] = 1.0
    left, singular, right = np.linalg.svd(matrix / lengths, full_matrices=False)
    rank = int(np.sum(singular > DEPENDENT * singular[0]))
    basis = left[:, :rank]
    return right[:rank].T @ (basis.T @ vector / singular[:rank]) / lengths, basis


def _choose(basis, driven):
    """Return independent coordinates, driven ones before others."""
    from scipy.linalg import qr
    weight = np.ones(len(basis))
    weight[driven] = 10.0
    _, _, order = qr((weight[:, np.newaxis] * basis).T, mode='economic', pivoting=True)
    return sorted(order[:basis.shape[1]].tolist())


def _moving(along):
    """Return the samples in which nothing with dry friction rests."""
    data, effects = along.data, along.data.effect_set
    frictions = [effects.records[name] for name, element in effects.by_name.items()
                 if element.law.role == FRICTION and effects.enabled[name]]
    if not frictions:
        return np.arange(len(along.states))

    def moves(q, qd):
        rates = dict(zip(data.torque_names, effects.rates(q, qd)))
        return all(one.direction(sum(arm * rates[name] for name, arm in one.friction_direction))
                   for one in frictions)

    found = np.flatnonzero([moves(q, qd) for q, qd, _ in along.states])
    if not len(found):
        raise IdentificationError('motion: expected joints with dry friction to move, got all '
                                  'samples with one at rest, where any friction may act')
    return found


def _with_numbers(body, values):
    """Return a body with other numbers, unchecked."""
    center = [values.get(f'center_of_mass.{n}', value)
              for n, value in enumerate(body.center_of_mass)]
    inertia = values.get('inertia', body.inertia)
    if isinstance(inertia, tuple):
        inertia = tuple(values.get(f'inertia.{n}', value) for n, value in enumerate(inertia))
    return replace(body, mass=values.get('mass', body.mass), center_of_mass=tuple(center),
                   inertia=inertia)


def _without_motions(scene):
    """Return a scene whose joints move freely, and the joints of the tree with a drive."""
    mechanism = scene.mechanism
    driven, effects = list(mechanism.actuated_joints), dict(scene.effects)
    for name, record in scene.effects.items():
        motion = record.motion(name)
        if motion is None:
            continue
        if motion.freedom not in mechanism.coordinates.index:
            raise IdentificationError(
                f'effects.{name}: expected motions of joints of the tree, whose efforts are '
                'recorded, got that of a point or of a joint that closes a loop')
        if name not in scene.switched_off and motion.freedom not in driven:
            driven.append(motion.freedom)
        del effects[name]
    bad = [name for name in driven if name not in mechanism.coordinates.index]
    if bad:
        raise IdentificationError(
            f'{bad[0]}: expected drives in joints of the tree, got one in a joint that closes a '
            'loop; cut the loop elsewhere')
    order = mechanism.coordinates.index
    bare = replace(scene, effects=effects, switched_off=tuple(
        name for name in scene.switched_off if name in effects))
    return bare, tuple(sorted(driven, key=order.__getitem__))


def _refuse(data):
    """Refuse effects whose forces do not follow from position, rate and acceleration."""
    effects = data.effect_set
    for name, element in effects.by_name.items():
        record = effects.records[name]
        if not effects.enabled[name] or record.drive() is not None:
            continue
        reason = (
            'depends on the force in its joint' if record.depends_on_reactions else
            'follows the time' if record.clock(0.0) is not None else
            'has states of its own' if element.law.role != FRICTION and any(
                state.role == OWN for state in element.states) else None)
        if reason is not None:
            raise IdentificationError(
                f'effects.{name}: expected a force that follows from the motion, got '
                f'{effect_type(record)}, which {reason}')


def _expanded(scene, keys):
    """Return the key paths that vary, bodies and vectors of theirs written out."""
    known, found = numbers(scene), []
    if isinstance(keys, str) or not len(keys):
        raise IdentificationError(f'keys: expected a list of key paths, got {keys!r}')
    for given in keys:
        words = str(given).split('.')
        below = [key for key, value in known.items()
                 if key.startswith(f'{given}.') and value is not None
                 and key.split('.')[3] in BODY_KEYS] if (
                     words[:2] == ['mechanism', 'bodies']) else []
        if words[0] not in VARIED:
            raise IdentificationError(
                f'{given}: expected a key path that begins with {among(VARIED)}, got '
                f'{words[0]!r}')
        for key in below or ['.'.join(resolve(scene, given))]:
            if known[key] is None:
                raise IdentificationError(f'{key}: expected a number in the scene to begin with, '
                                          'got none')
            if key in found:
                raise IdentificationError(f'{key}: expected once, got it twice')
            found.append(key)
    massless = {body.name for body in scene.mechanism.bodies if body.massless}
    for key in found:
        words = key.split('.')
        if words[:2] == ['mechanism', 'bodies'] and words[2] in massless:
            raise IdentificationError(f'{key}: expected a body with mass, got a massless one')
    return found


def _arrays(given, size, name):
    """Return names, and finite numbers as an array of shape (size, n, names)."""
    names, arrays = list(given), [np.array(each, dtype=float) for each in given.values()]
    arrays = [array.reshape(1, -1) if array.ndim == 1 and size == 1 else array
              for array in arrays]
    for joint, array in zip(names, arrays):
        if array.ndim != 2 or array.shape[0] != size or array.shape[1] != arrays[0].shape[1]:
            expected = '(n,)' if size == 1 else f'({size}, n)'
            raise ValueError(f'{name}: {joint}: expected shape {expected}, the same for all '
                             f'joints, got {np.shape(given[joint])}')
        if not np.isfinite(array).all():
            raise ValueError(f'{name}: {joint}: expected finite numbers')
    count = arrays[0].shape[1] if arrays else 0
    return names, np.array(arrays).reshape(len(names), size, count).transpose(1, 2, 0)
