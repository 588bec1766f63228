# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Readings of the present state: accelerations, forces, energies and places."""

from functools import partial
from typing import Any, Dict, List, Optional, Sequence, Tuple

import numpy as np

from .cut_joints import coupling_moments
from .data import Data
from .evaluation import Evaluation
from .health import Health, health_of
from ..codegen.equations import Equations
from ..engine import native
from ..engine.types import CUT_NUMBER
from ..kinematics.assembly import angle_notes, degree_notes, MOST_EQUATIONS
from ..kinematics.redundancy import find_redundancy, Redundancy
from ..kinematics.state import State
from ..mechanism.couplings import coupling_scales, measured
from ..mechanism.digits import suspicions
from ..mechanism.errors import SimulationError
from ..mechanism.named_array import NamedArray, Place
from ..scene.records import Scene

# Gravity's acceleration, to compare forces with weights [m/s^2].
EARTH = 9.81


def readings_of(given: Any) -> 'Readings':
    """Return the readings of a simulation, or readings as they are."""
    return given if isinstance(given, Readings) else given.data


class Readings(Data):
    """
    Quantities of the present state, evaluated once for all.

    Attributes
    ----------
    acts_in_cuts : bool
        Whether anything acts along the coordinates of cut joints.

    """

    def __init__(self, scene: Scene) -> None:
        super().__init__(scene)
        self._coupling_scales = coupling_scales(self.mechanism)
        self._coupled = coupling_moments(self.mechanism)
        self._couples = bool(self._coupled[0].any())
        self.acts_in_cuts = len(self.acted) > 0 or self._couples or any(
            measured(self.mechanism, coupling) for coupling in self.mechanism.couplings)
        # Records of the quantities of an evaluation, by name.
        records: Dict[str, Sequence[Any]] = {
            'joint_forces': self.mechanism.joints, 'constraint_forces': self.cut_joints,
            'points': self.mechanism.points, 'body_poses': self.mechanism.bodies,
            'coupling_forces': self.mechanism.couplings, 'motion_forces': self.mechanism.motions}
        self._places_of: Dict[str, Dict[str, Place]] = {
            what: {record.name: place for place, record in enumerate(each)}
            for what, each in records.items()}
        self._passive = np.setdiff1d(np.arange(self.coordinates.nv), self.actuated)

    @property
    def mass(self) -> float:
        """Mass of all bodies [kg]."""
        return sum(body.mass for body in self.mechanism.bodies)

    def _bind(self) -> None:
        """Bind the evaluations of points and forces in the present state, too."""
        super()._bind()
        system, geometry = self.system, self.loop_model
        row, point = geometry.named_points
        self._points_found = np.zeros((len(row), 2 if self.mechanism.planar else 3))
        self._find_points = native.bind(
            'points_in_state', system.native, self.integrated, row, point, self._points_found)
        row, point, _ = geometry.joint_places
        self._joint_forces_found = np.zeros((len(row), system.work.wrench.shape[1]))
        self._find_joint_forces = native.bind(
            'find_joint_forces', system.native, self.integrated, self._lam, row, point,
            np.zeros_like(system.work.force), self._joint_forces_found)

    @property
    def cut_position(self) -> np.ndarray:
        """
        Coordinates of the cut joints, shape (nq of ``Mechanism.cut_coordinates``,) [rad or m].

        Those that the same joint of a tree has, with body A as the child and body B as the parent:
        of one that turns the angle of body A in body B, of one that slides how far point A is
        from point B along the axis. In space an angle is followed where a drive or an effect acts
        along it; others are between -pi and pi. Of a spherical joint a unit quaternion x, y, z, w,
        w not negative.
        """
        return self.cut_state[0]

    @property
    def cut_velocity(self) -> np.ndarray:
        """Rates of ``cut_joint_names``, shape (number of them,) [rad/s or m/s]."""
        return self.cut_state[1]

    @property
    def cut_acceleration(self) -> np.ndarray:
        """Accelerations of ``cut_joint_names`` under the last torques [rad/s^2 or m/s^2]."""
        if not self.cuts.count:
            return np.zeros(0)
        return self.cuts.accelerations(self._moved_equations(), self.system.qdd)

    @property
    def cut_effort(self) -> np.ndarray:
        """Efforts of commands, as ``effort``, in the order of ``cut_joint_names``."""
        effort = np.zeros(self.cuts.count)
        effort[self.cuts.acted] = self._efforts()[len(self.joint_names):]
        self._add_motions(effort)
        return effort

    def _add_motions(self, effort: np.ndarray) -> None:
        """Add the efforts of prescribed motions of cut joints, in place."""
        for motion in self.mechanism.motions:
            place = self.cuts.place(motion.freedom)
            if place is not None:
                effort[place] += self.motion_forces[motion.name]

    def _cut_efforts(self) -> np.ndarray:
        """Return all that acts along the freedoms of cut joints [N m; N]."""
        effort = np.zeros(self.cuts.count)
        if len(self.cuts.acted):
            effort[self.cuts.acted] = self.table.applied[len(self.qd):]
        self._add_motions(effort)
        for coupling, force, scale in zip(
                self.mechanism.couplings, self.coupling_forces, self._coupling_scales):
            for cut in measured(self.mechanism, coupling):
                effort[self.cuts.place(cut.name)] += scale * force
        return effort

    @property
    def cut_state(self) -> Tuple[np.ndarray, np.ndarray]:
        """Coordinates and rates of the cut joints, found together."""
        if not self.cuts.count:
            return np.zeros(0), np.zeros(0)
        self.evaluate()
        position, velocity = self.cuts.measure(self.system.work.body)
        if len(self.cuts.acted):
            position[self.cuts.acted] = self.table.cuts.q[len(self.qd):]
        return self.cuts.whole(self.system.work.body, position), velocity

    @property
    def effort(self) -> np.ndarray:
        """Joint torques applied last, behind the drives, shape (nv,) [N m or N]."""
        tau = self._efforts()[:len(self.joint_names)]
        for motion in self.mechanism.motions:
            if motion.freedom in self.coordinates.index:
                tau[self.coordinates.index[motion.freedom]] = self.motion_forces[motion.name]
        return tau

    def _efforts(self) -> np.ndarray:
        """Return the torques applied last, behind the drives, those of cut joints last."""
        tau = self.system.tau.copy()
        if self.effect_set.drives:
            self.evaluate()
            self.effect_set.efforts(tau)
        return tau

    @property
    def acceleration(self) -> np.ndarray:
        """Joint accelerations of the present state under the last torques, shape (nv,)."""
        self.evaluate()
        return self.system.qdd.copy()

    @property
    def multipliers(self) -> np.ndarray:
        """
        Lagrange multipliers of the present state, shape (nc,) [N, N m].

        Of all equations that do not always hold. Where some repeat others, those of the forces
        that are least in all joints together (engine/least_forces.hpp).
        """
        self.find_multipliers()
        return self._lam.copy()

    @property
    def constraint_forces(self) -> np.ndarray:
        """
        Wrenches at the cut joints, shape (number of cuts, 3): moment, force x, force y.

        What body B exerts on body A, in world axes, at body A's cut point [N m, N]: the reaction,
        and what the joint's drive, springs, dampers and friction hand over. In space of shape
        (number of cuts, 6): moment x, y, z, force x, y, z.
        """
        self.find_multipliers()
        wrenches = self.equations.cut_wrenches(self._lam, self.system.work.body)
        found = wrenches[:len(self.cut_joints)]
        if self.acts_in_cuts:
            self.cuts.add_efforts(self.system.work.body, self._cut_efforts(), found)
            if self._couples:
                found[:, 0] += self._coupled[0] @ self.coupling_forces
        return found

    def _moved_equations(self) -> Equations:
        """Return the equations in the present state, which is evaluated, too."""
        self.evaluate()
        return self.equations.move(self.q, self.qd)

    def redundancy(self) -> Redundancy:
        """Find which equations repeat others in the present position, and which forces share."""
        return find_redundancy(self.mechanism, self.q)

    @property
    def shared_forces(self) -> Tuple[str, ...]:
        """Names of joints and couplings whose forces are not unique: see ``multipliers``."""
        return self.redundancy().shared

    @property
    def coupling_forces(self) -> np.ndarray:
        """
        Generalized forces of the couplings, shape (number of couplings,).

        Times a joint's factor: the torque [N m] or force [N] of the coupling in that joint.
        """
        self.find_multipliers()
        lam = self._lam
        first = len(lam) - len(self.mechanism.couplings) - len(self.mechanism.motions)
        return lam[first:first + len(self.mechanism.couplings)] / self._coupling_scales

    @property
    def motion_forces(self) -> Dict[str, float]:
        """
        Torques and forces that the prescribed motions take, by the names of these effects.

        In a joint what its drive exerts [N m; N], at a point the force along the direction [N];
        ``effect_readings`` gives their power and work, too.
        """
        self.evaluate()
        count = len(self.mechanism.motions)
        return {motion.name: float(force) for motion, force in zip(
            self.mechanism.motions, self.system.lam[len(self.system.lam) - count:])}

    @property
    def tooth_forces(self) -> np.ndarray:
        """
        Tooth or belt forces, shape (number of couplings,) [N]; NaN where no radius is given.

        The torque of the coupling in its first joint over the radius of the wheel there, with the
        torque's sign.
        """
        ratios = [np.nan if coupling.radius is None else
                  next(iter(coupling.joints.values())) / coupling.radius
                  for coupling in self.mechanism.couplings]
        return np.array(ratios, dtype=float) * self.coupling_forces

    def equation_forces(self) -> Dict[str, Dict[str, float]]:
        """
        Return the forces of equations other than those of cut joints, by kind and name.

        Returns
        -------
        dict of str to dict of str to float
            ``coupling_forces``, ``tooth_forces`` [N] and ``motion_forces``, as far as there are
            couplings, couplings with a radius, and prescribed motions.

        """
        names = [coupling.name for coupling in self.mechanism.couplings]
        toothed = [coupling.name for coupling in self.mechanism.couplings
                   if coupling.radius is not None]
        found = {}
        if names:
            found['coupling_forces'] = dict(zip(names, self.coupling_forces.tolist()))
        if toothed:
            forces = dict(zip(names, self.tooth_forces.tolist()))
            found['tooth_forces'] = {name: forces[name] for name in toothed}
        if self.mechanism.motions:
            found['motion_forces'] = self.motion_forces
        return found

    @property
    def joint_forces(self) -> np.ndarray:
        """
        Wrenches in the joints, shape (nv, 3): moment, force x, force y.

        What the parent exerts on the child, in world axes, at the child's origin [N m, N]: the
        reaction, and what the joint's drive, springs, dampers and friction hand over. In space of
        shape (number of joints, 6): moment x, y, z, force x, y, z; NaN in fixed joints.
        """
        self._find_joint_forces()
        found = self._joint_forces_found.copy()
        if self._couples:
            found[:, 0] += self._coupled[1] @ self.coupling_forces
        return found

    def force_places(self) -> Tuple[List[str], Tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """
        Return the places of the forces in joints, as far as the multipliers determine them.

        Returns
        -------
        joints : list of str
            All that are not fixed; none where forces are not unique or couplings pass some on.
        places : tuple of ndarrays
            Rows of their children, and origins and axes of these in the frames of the rows.

        """
        row, point, axes = self.loop_model.joint_places
        if self.has_redundant_constraints or self._couples:
            row = np.zeros_like(row)
        moving = row > 0
        return ([joint.name for joint, moves in zip(self.mechanism.joints, moving) if moves],
                (row[moving], point[moving], axes[moving]))

    @property
    def cut_rows(self) -> Tuple[Tuple[int, ...], ...]:
        """
        Rows of each cut joint in the model, followed by those of couplings of its freedoms.

        None where forces are not unique or couplings pass some on.
        """
        if self.has_redundant_constraints or self._couples:
            return ()
        rows = {number: row for row, number in enumerate(
            self.system.model.cut[:, CUT_NUMBER].tolist())}
        numbers = {cut.name: [number] for number, cut in enumerate(self.mechanism.cut_joints)}
        for number, coupling in enumerate(self.mechanism.couplings, start=len(numbers)):
            for cut in measured(self.mechanism, coupling):
                numbers[cut.name].append(number)
        return tuple(tuple(rows[one] for one in own) for own in numbers.values())

    def force(self, name: str) -> np.ndarray:
        """
        Return the wrench in a joint or cut joint, shape (3,): moment, force x, force y.

        Parameters
        ----------
        name : str
            Of a joint, as in ``joint_forces``, or of a cut joint, as in ``constraint_forces``.

        """
        joints = [joint.name for joint in self.mechanism.joints]
        if name in joints:
            return self.joint_forces[joints.index(name)]
        cuts = [cut.name for cut in self.cut_joints]
        if name not in cuts:
            raise SimulationError(
                f'There is no joint {name!r} on {self.mechanism.name}; its joints: '
                f'{", ".join([*joints, *cuts])}.')
        return self.constraint_forces[cuts.index(name)]

    @property
    def closure(self) -> float:
        """Largest closure error of positions [m or rad]."""
        if self.has_redundant_constraints:
            return self._closure_of_all()
        self.evaluate()
        return native.largest(self.system.work.closure)

    @property
    def constraint_jacobian(self) -> np.ndarray:
        """Return the derivatives of the closure equations by the coordinates, shape (nc, nv)."""
        return self.assembler.jacobian(self.q)

    def _closure_of_all(self) -> float:
        """Return the largest closure error, of equations that are left out among others."""
        return self.equations.move(self.q).closure_error()

    @property
    def inertia(self) -> np.ndarray:
        """Return the generalized inertia matrix of the spanning tree, shape (nv, nv)."""
        return self.assembler.inertia(self.q)

    @property
    def energy(self) -> float:
        """Kinetic energy and energy stored in gravity and effects [J]."""
        return sum(self._energies())

    def _energies(self) -> Tuple[float, float]:
        """Return kinetic and stored energy of the present state."""
        self.evaluate()
        found = np.empty(2)
        self.system.model.energies(self.system.work, self.qd, found)
        (own, potential), (kinetic, stored) = found.tolist(), self.effect_set.energies()
        return own + kinetic, potential + stored

    @property
    def body_poses(self) -> np.ndarray:
        """
        Poses of the bodies, shape (nb, 3): x, y [m], angle [rad], in the bodies' order.

        In space of shape (nb, 7): x, y, z [m], unit quaternion x, y, z, w.
        """
        self.evaluate()
        return self.loop_model.poses_among(self.system.work)

    def point(self, name: str) -> np.ndarray:
        """Return the world place of a named point, shape (2,), in space (3,) [m]."""
        self._named_point(name)
        return self.points[list(self._points).index(name)]

    @property
    def points(self) -> np.ndarray:
        """Places of all named points, shape (number of points, 2), in space 3 [m]."""
        self._find_points()
        return self._points_found.copy()

    def evaluation(self, state: Optional[State] = None) -> Evaluation:
        """
        Return all that follows from the present state and torques, as one value.

        Parameters
        ----------
        state : State, optional
            The present one, where it is known already.

        """
        kinetic, stored = self._energies()
        return Evaluation(
            self.snapshot() if state is None else state, self.system.tau.copy(),
            self.acceleration, self.multipliers, self.effort,
            self.named('joint_forces', self.joint_forces),
            self.named('constraint_forces', self.constraint_forces),
            self.named('points', self.points),
            self.named('body_poses', self.body_poses),
            self.named('coupling_forces', self.coupling_forces),
            self.named('motion_forces', np.array(list(self.motion_forces.values()))),
            kinetic, stored, self.closure)

    def named(self, what: str, array: np.ndarray) -> NamedArray:
        """
        Return an array of a quantity with the names of its rows, by joint, cut joint or point.

        Shape (rows,), or (..., rows, columns), which nobody else holds.
        """
        return NamedArray(what, self._places_of[what], array, -2 if array.ndim > 1 else -1)

    @property
    def health(self) -> Health:
        """How well posed the equations of motion are in the present state: a ``Health``."""
        return health_of(
            self.system.model, self.system.work, self._moved_equations(), self._passive)

    def measured(self) -> Tuple[np.ndarray, np.ndarray]:
        """
        Return sensor readings of joint positions and velocities; exact without sensors.

        Returns
        -------
        position : ndarray, shape (nq,)
        velocity : ndarray, shape (nv,)

        """
        position, velocity = self.effect_set.sensors.measure(self.time, self.q, self.qd)
        return position.copy(), velocity.copy()

    def measured_cut_joints(self) -> Tuple[np.ndarray, np.ndarray]:
        """
        Return the same of the cut joints.

        Returns
        -------
        position, velocity : ndarray
            As ``cut_position`` and ``cut_velocity``.

        """
        position, velocity = self.effect_set.sensors_at_cuts.measure(self.time, *self.cut_state)
        return position.copy(), velocity.copy()

    def effect_readings(self, name: str) -> Dict[str, float]:
        """
        Return the readings of an effect in the present state.

        Parameters
        ----------
        name : str
            Of an effect that the scene lists.

        Returns
        -------
        dict of str to float
            Stored energy; energy dissipated and its power, or work done, since the last reset,
            where the effect has such; the effect's own readings, such as forces; SI units.

        """
        self.evaluate()
        return self.effect_set.readings(name, self.own)

    def windings(self) -> Dict[Tuple[str, str], float]:
        """
        Return how far cables are wound round their pulleys in the present state.

        Returns
        -------
        dict of (str, str) to float
            By cable and point of the pulley [rad].

        """
        self.evaluate()
        return self.effect_set.windings()

    def start_notes(self) -> List[str]:
        """
        Return notes of the start: its ``assembly_notes``, digits, angles beyond 2 pi, effects.

        Returns
        -------
        list of str

        """
        weight = EARTH * sum(body.mass for body in self.mechanism.bodies)
        effects = [note for name, record in self.scene.effects.items() for note in
                   record.start_notes(name, partial(self.effect_readings, name), weight)]
        held = self.second_order.notes() if self.second_order is not None else []
        angles = angle_notes(self.mechanism, self.scene.initial.position)
        # Some of those angles are noted where the start was assembled, too.
        known = (*angles, *degree_notes(self.mechanism, self.scene.initial.position))
        return ([*self.mechanism.rounded, *self._suspicions()] + angles + held
                + self.motions.notes()
                + [note for note in self.assembly_notes() if note not in known]
                + effects + self.load_notes())

    def _suspicions(self) -> List[str]:
        """Return notes on rounded digits where equations that repeat others depend on these."""
        found, coordinates = suspicions(self.mechanism), self.mechanism.coordinates
        if found and self.assembler.nc <= MOST_EQUATIONS:
            freedoms = self.degrees_of_freedom()
            if freedoms and coordinates.nv - freedoms == self.assembler.nc:
                return []
        return found

    def assembly_notes(self) -> List[str]:
        """
        Return notes of changes that the last assembly made to a start or a state.

        Returns
        -------
        list of str
            Sentences, where it may not be what was meant: joints moved far, another branch, a
            change point, other velocities.

        """
        return self.assembler.notes(*self._assembly)

    def load_notes(self) -> List[str]:
        """
        Return which effects depend on forces that are not unique in the present position.

        Returns
        -------
        list of str
            A sentence for each effect that is switched on and reads such a force.

        """
        loaded = {name: record for name, record in self.effect_set.records.items()
                  if record.depends_on_reactions and self.effect_set.enabled[name]}
        if not loaded:
            return []
        components = self.redundancy().components
        return [
            f'{name} depends on the force in {joint}, which is not unique: closure equations '
            f'repeat others ({", ".join(parts)} in world axes). The friction is that of the '
            'least forces in all joints together. Replace a joint by one that leaves the loop '
            'more degrees of freedom, or friction_coefficient by coulomb.'
            for name, record in loaded.items() for joint, parts in components.items()
            if (record.joint == joint or record.joint.startswith(f'{joint}.'))
            and any(part.startswith('force') for part in parts)]

    def degrees_of_freedom(self) -> int:
        """
        Count the degrees of freedom at the present position and near it.

        Returns
        -------
        int
            Joints less the closure equations that do not depend on the others.

        """
        return self.assembler.degrees_of_freedom(self.q)
