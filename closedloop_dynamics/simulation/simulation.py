# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""A scene brought to life: the Python interface that users script with."""

from dataclasses import replace
from functools import partial
import math
from time import perf_counter_ns
import warnings

import numpy as np

from .assembly import angle_notes, Assembler
from .cable_guard import explain, leapt, LOOK_EVERY as CABLE_LOOK_EVERY
from .cut_joints import acted_in, coordinate_arrays, coupling_moments, CutJoints
from .errors import (
    AssemblyError, ClosureError, MotionError, NumericalError, SimulationError, StiffnessError)
from .guards import (
    CLOSING, CLOSURE_LOOK_EVERY, EnergyGuard, EQUATIONS_FIRST_LOOK, EQUATIONS_LOOK_EVERY,
    LARGEST_MOTION, OPEN, opened_loops, StiffnessGuard, USUAL_TORQUE)
from .health import health_of
from .inverse_dynamics import InverseDynamics
from .modeling import coupling_scales, extent
from .monitor import Monitor
from .motions import Motions, moving, require_actuated, with_motions
from .redundancy import find_redundancy, geometry_of
from .rollout import rollout
from .scene import load_scene
from .scene_records import Method, Scene
from ..core import types as t
from ..core.formulations import AUGMENTED, SUBSYSTEM, SYSTEM
from ..effects.delay_line import DelayLine
from ..effects.effect import Machine
from ..effects.effect_set import EffectSet
from ..effects.energy_balance import Energies, EnergyBalance
from ..engine import native
from ..integration import guarded_run
from ..integration.control import (
    CONTACT_PASSED, DONE, INTERRUPTED, MOST_EVALUATIONS, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS,
    TOO_MUCH_WORK)
from ..integration.drivers import build_driver
from ..integration.evaluation import Evaluator, QUANTITIES, request
from ..integration.guarded_run import COMMAND
from ..integration.left_out import LENIENT, OPENED
from ..integration.registry import INTEGRATORS, SCIPY
from ..integration.system import (
    BAUMGARTE_GAIN, build_system, CLOSURE_LIMIT, parts_of_state, Probe, refine, with_equations,
    with_partition)
from ..mechanism.couplings import measured
from ..mechanism.decomposition import decompose
from ..mechanism.fields import at, FieldError, keys_of, mapping

FORMULATIONS = {'subsystem': SUBSYSTEM, 'system': SYSTEM, 'augmented': AUGMENTED}
# How much further from dependent equations must be to be exchanged for others.
BETTER = 3.0
# Gravity's acceleration, to compare forces with weights [m/s^2].
EARTH = 9.81


class Simulation:
    """
    One mechanism, its state, and the method that advances it.

    Parameters
    ----------
    scene : scene.Scene
        The initial state is assembled: positions and velocities close the loops.

    Attributes
    ----------
    scene : scene.Scene
    mechanism : mechanism.mechanism.Mechanism
    decomposition : mechanism.decomposition.Decomposition
    coordinates : mechanism.coordinates.Coordinates
        Names and places of the numbers of positions and velocities.
    acts_in_cuts : bool
        Whether anything acts along the coordinates of cut joints.

    Raises
    ------
    AssemblyError
        Where the loops cannot be closed from the scene's initial state.

    """

    def __init__(self, scene):
        """Assemble the initial state, ready to move."""
        self.scene = scene
        self.mechanism = with_motions(scene)
        self.decomposition = decompose(self.mechanism)
        self._numbers = np.zeros(guarded_run.NUMBERS)
        self._counts = np.zeros(guarded_run.COUNTS, dtype=np.int64)
        self._set_time(0.0, 0)
        self._points = {point.name: point for point in self.mechanism.points}
        self._geometry = geometry_of(self.mechanism, self.decomposition)
        self._rows, placements = self._geometry.rows, self._geometry.placements
        self._prescribe(scene)
        if self._may_leave_out(scene.method):
            self._geometry.leave_out_repeated(np.array(scene.initial.position))
            self._motions.look_up(self._geometry.model)
        model, self._equations = self._geometry.model, self._geometry.equations
        acted = acted_in(self.mechanism, scene.effects)
        machine = Machine(self.mechanism, self._rows, placements, self._motions.rows, acted)
        self._effects = EffectSet(scene.effects, model, machine, coordinate_arrays(
            self.mechanism, model, self._rows, placements, acted, True) if acted else None,
            scene.switched_off)
        self._cuts = CutJoints(self.mechanism, model, self._rows, placements, acted)
        self._mass = sum(body.mass for body in self.mechanism.bodies)
        self._coupling_scales = coupling_scales(self.mechanism)
        self._coupled = coupling_moments(self.mechanism)
        self._couples = bool(self._coupled[0].any())
        self.acts_in_cuts = len(acted) > 0 or self._couples or any(
            measured(self.mechanism, coupling) for coupling in self.mechanism.couplings)
        for name, angle in scene.initial.turned.items():
            self._effects.begin_angle(name, angle)
        method = scene.method
        baumgarte = 1.0 / method.time_constant if method.stabilisation == 'baumgarte' else 0.0
        size = extent(self.mechanism)
        self.system = build_system(
            model, FORMULATIONS[method.formulation], baumgarte, size,
            method.stabilisation == 'independent', self._effects.elements,
            cuts=self._effects.cuts, joints=self._geometry.joint_points)
        self._table = self._effects.bind(self.system)
        self._motions.records = self._effects.records
        self._balance = EnergyBalance(self._effects.roles, len(self.system.tau))
        self.coordinates = self.mechanism.coordinates
        *parts, states = parts_of_state(self.system)
        self._parts, self._state = tuple(parts), np.zeros(states)
        self._q, self._qd, self._own = (self._state[part] for part in parts)
        self._assembler = Assembler(self.mechanism, self._equations)
        self._places = {name: place for place, name in enumerate(self.torque_names)}
        self._actuated = np.array(
            [self._places[name] for name in self.actuated_joints], dtype=int)
        # Those that take a torque: no joints whose motion is prescribed.
        prescribed = {motion.freedom for motion in self.mechanism.motions}
        self._allowed = np.array([
            -1 if name in prescribed else self._places[name] for name in self.actuated_joints],
            dtype=np.int64)
        self._passive = np.setdiff1d(np.arange(self.coordinates.nv), self._actuated)
        self._initial = self._assembled(
            scene.initial.position, scene.initial.velocity, scene.initial.hold)
        self._motions.require_independent(self._assembler, self._initial[0])
        self._find_decided()
        if method.stabilisation == 'independent':
            self._assembler.require_independent(self._initial[0])
        self._fresh = False
        self._require_known_steps(method)
        self._driver = Monitor(build_driver(self.system, method), self.system, method,
                               self._numbers, self._counts)
        self._set_guards(StiffnessGuard(self.system, method, self._effects.own), method)
        self._inverse = self._inverse_dynamics()
        self._set_probes()
        self._set_run()
        # How often the equations that the elimination works on were exchanged.
        self.exchanges = 0
        self.reset()
        refine(self.system, self._state)
        self._fresh = False

    def _find_decided(self):
        """Find the joints with friction that loops and motions move, or hold, by themselves."""
        names = self._effects.freedoms_with_friction
        if not names:
            return
        in_tree = [name for name in names if name in self.coordinates.index]
        in_cuts = [name for name in names if name not in self.coordinates.index]
        units = np.eye(len(self.joint_names))[[self.coordinates.index[name] for name in in_tree]]

        def derivatives(position):
            moved = self._equations.move(position)
            return np.concatenate(
                (units, self._cuts.jacobian(moved.model, moved.work, in_cuts)))

        decided = self._assembler.decided(self._initial[0], derivatives)
        self._effects.decide(np.array(in_tree + in_cuts)[decided].tolist())

    def _inverse_dynamics(self):
        """Return what solves for the torques of a motion, of the present equations."""
        return InverseDynamics(self.mechanism, self.system, self._effects, self._table,
                               self._equations, self._cuts, self._actuated)

    def _set_probes(self):
        """Evaluate the present state, and any other, of the present system."""
        system, geometry = self.system, self._geometry
        self._present = Probe(system, self._state)
        self._probe = Probe(system)
        asked = request(system, self._own, self._allowed)
        self._evaluate_given = native.bind('evaluate_given', system.native, asked)
        # Of all equations, in the present state and in that one.
        self._lam, self._lam_given = system.lam, system.lam
        if system.leaves_out:
            self._lam, self._lam_given = np.zeros(len(asked.lam)), asked.lam
            self._find_all_multipliers = native.bind(
                'find_all_multipliers', system.native, self._q, self._qd, self._lam)
        body, (row, point) = system.work.body, geometry.named_points
        self._points_found = np.zeros((len(row), 2 if self.mechanism.planar else 3))
        self._place_points = native.bind('place_points', body, row, point, self._points_found)
        row, point = geometry.joint_places
        self._joint_forces_found = np.zeros((len(row), system.work.wrench.shape[1]))
        self._find_joint_forces = native.bind(
            'find_joint_forces', system.native, self._state, self._lam, row, point,
            np.zeros_like(system.work.force), self._joint_forces_found)
        self._energies_found, self._balance_found = np.empty(2), np.empty(5)
        account = self._balance.account
        # The work of the torques held up to here.
        self._add_work = native.bind('add_held_work', system.native, account, self._state)
        self._draw_balance = native.bind(
            'fill_balance', system.native, account, self._state, self._balance_found)
        self._find_energies = native.bind(
            'energies', system.model, system.work, self._qd, self._energies_found)
        self._spread = np.zeros(len(system.tau))
        self._spread_torques = native.bind('spread_torques', self._allowed, self._spread)
        model, work = self._equations.model, self._equations.work
        self._wrenches_found = np.empty((len(model.cut), work.wrench.shape[1]))
        self._find_cut_wrenches = native.bind(
            'cut_wrenches', model.cut, model.cut_point, work.cut_piece, body, self._lam,
            work.share, self._wrenches_found)

    def _may_leave_out(self, method):
        """
        Return whether equations that repeat others may be left out.

        In the plane not where loops drift apart, as these equations drift, too.

        """
        return not self.mechanism.planar or method.stabilisation in CLOSING

    def _prescribe(self, scene):
        """Look up the equations of prescribed motions; let them start."""
        self._motions = Motions(
            scene, self.mechanism, self._geometry.model, self.place, self._cut_place)
        self._motions.follow(0.0)

    def _cut_place(self, name, position):
        """Return the coordinate of a freedom of a cut joint in a position of the joints."""
        equations = self._geometry.equations
        cuts = CutJoints(
            self.mechanism, equations.model, self._rows, self._geometry.placements, ())
        found, _ = cuts.measure(equations.move(position).work.body)
        return float(found[cuts.place(name)])

    @classmethod
    def from_scene(cls, scene, motion=None, **method):
        """
        Build a simulation from a scene.

        Parameters
        ----------
        scene : str, pathlib.Path or scene.Scene
            A shipped scene's name, a scene file's path, or what was read already.
        motion : mapping of str to str or PrescribedMotion, optional
            Motions that are prescribed beside what the scene does: by joint, an expression in the
            time ``t`` [rad; m], or an effect.
        **method
            Overrides of the scene's method, by the keys a scene has there (``integrator``,
            ``step_size``, ``stabilisation``, ``formulation``, ...); None leaves the scene's.

        Returns
        -------
        Simulation

        Raises
        ------
        SceneError, AssemblyError
        ValueError
            For an override that no scene could have there.

        Warns
        -----
        RuntimeWarning
            Where the start that was assembled may not be the one that was meant.

        """
        with at('method'):
            mapping(method, *keys_of(Method))
        scene = scene if isinstance(scene, Scene) else load_scene(scene)
        scene = moving(scene, motion or {})
        overrides = {key: value for key, value in method.items() if value is not None}
        with at('method'):
            scene = replace(scene, method=replace(scene.method, **overrides))
        simulation = cls(scene)
        for note in simulation.start_notes():
            warnings.warn(note, RuntimeWarning, stacklevel=2)
        return simulation

    # Names and sizes.

    @property
    def joint_names(self):
        """
        Names of the joints, in the order of velocities and torques.

        A joint of several freedoms has a name for each: ``hip.1``, ``ball.rx``.

        """
        return self.coordinates.names

    @property
    def actuated_joints(self):
        """Names of the actuated joints, in the order of torque sequences; see ``joint_names``."""
        return self.mechanism.actuated_joints

    @property
    def cut_joints(self):
        """Return the cut joints, in the order of the constraint forces."""
        return self.mechanism.cut_joints

    @property
    def cut_joint_names(self):
        """
        Names of the freedoms of cut joints, as in the tree: ``guide.1``, ``ball.rx``.

        In the order of their velocities and efforts; ``Mechanism.cut_coordinates`` has them.

        """
        return self._cuts.names

    @property
    def torque_names(self):
        """
        Names of the entries of the torques that ``advance`` takes.

        Those of ``joint_names``, then the freedoms of cut joints that a drive or an effect acts
        along.

        """
        return (*self.joint_names, *(self._cuts.names[place] for place in self._cuts.acted))

    @property
    def motion_names(self):
        """Names of the effects that prescribe motions, in the scene's order."""
        return tuple(motion.name for motion in self.mechanism.motions)

    @property
    def step_size(self):
        """Step size [s]."""
        return self.scene.method.step_size

    # The state.

    @property
    def time(self):
        """Time since the start or the last reset [s]."""
        # Counted, not summed: an hour of steps adds up to an hour.
        return (float(self._numbers[guarded_run.TIME_BASE])
                + int(self._counts[guarded_run.STEPS]) * self.step_size)

    def _set_time(self, base, steps):
        """Let the time be so many steps after another one [s]."""
        self._numbers[guarded_run.TIME_BASE], self._counts[guarded_run.STEPS] = base, steps

    @property
    def position(self):
        """
        Joint coordinates, shape (nq,) [rad or m].

        nq is nv, the number of joint rates, and one more for each spherical and each free joint:
        orientations are unit quaternions x, y, z, w. ``coordinates.columns`` names them.

        """
        return self._q.copy()

    @property
    def velocity(self):
        """
        Joint rates, shape (nv,) [rad/s or m/s].

        Of an orientation the angular velocity relative to the parent, about the child's axes.

        """
        return self._qd.copy()

    @property
    def cut_position(self):
        """
        Coordinates of the cut joints, shape (nq of ``Mechanism.cut_coordinates``,) [rad or m].

        Those that the same joint of a tree has, with body A as the child and body B as the parent:
        of one that turns the angle of body A in body B, of one that slides how far point A is
        from point B along the axis. In space an angle is followed where a drive or an effect acts
        along it; others are between -pi and pi. Of a spherical joint a unit quaternion x, y, z, w,
        w not negative.

        """
        return self._cut_state()[0]

    @property
    def cut_velocity(self):
        """Rates of ``cut_joint_names``, shape (number of them,) [rad/s or m/s]."""
        return self._cut_state()[1]

    @property
    def cut_acceleration(self):
        """Accelerations of ``cut_joint_names`` under the last torques [rad/s^2 or m/s^2]."""
        if not self._cuts.count:
            return np.zeros(0)
        return self._cuts.accelerations(self._moved_equations(), self.system.qdd)

    @property
    def cut_effort(self):
        """Efforts of commands, as ``effort``, in the order of ``cut_joint_names``."""
        effort = np.zeros(self._cuts.count)
        effort[self._cuts.acted] = self._efforts()[len(self.joint_names):]
        self._add_motions(effort)
        return effort

    def _add_motions(self, effort):
        """Add what moves cut joints as prescribed to their efforts, in place."""
        for motion in self.mechanism.motions:
            place = self._cuts.place(motion.freedom)
            if place is not None:
                effort[place] += self.motion_forces[motion.name]

    def _cut_efforts(self):
        """Return all that acts along the freedoms of cut joints [N m; N]."""
        effort = np.zeros(self._cuts.count)
        if len(self._cuts.acted):
            effort[self._cuts.acted] = self._table.applied[len(self._qd):]
        self._add_motions(effort)
        for coupling, force, scale in zip(
                self.mechanism.couplings, self.coupling_forces, self._coupling_scales):
            for cut in measured(self.mechanism, coupling):
                effort[self._cuts.place(cut.name)] += scale * force
        return effort

    def _cut_state(self):
        """Return coordinates and rates of cut joints."""
        if not self._cuts.count:
            return np.zeros(0), np.zeros(0)
        self._evaluate()
        position, velocity = self._cuts.measure(self.system.work.body)
        if len(self._cuts.acted):
            position[self._cuts.acted] = self._table.cuts.q[len(self._qd):]
        return self._cuts.whole(self.system.work.body, position), velocity

    @property
    def state(self):
        """
        Whole state: joint coordinates, joint rates, the effects' own states, the method's memory.

        A run that is started from it by ``restore`` goes on in the same way to the last bit, with
        error control from where a command changes.

        """
        return np.concatenate((self._state, *self._driver.memory))

    # For what integrates many states by compiled loops of its own.

    @property
    def integrated(self):
        """
        Joint coordinates, rates and the effects' own states, shape (ns,): not a copy.

        Who writes it calls ``touch`` then.

        """
        return self._state

    def touch(self):
        """Note that the state or the system's arrays were changed from outside."""
        self._fresh = False

    @property
    def leaves_out(self):
        """Whether equations that repeat others are left out, and watched."""
        return self._geometry.leaves_out

    @property
    def takes_closed_states(self):
        """Whether nothing else is asked of a state to start from than that it closes the loops."""
        return not (self._motions or self.leaves_out or self.system.is_independent
                    or self._assembler.is_light or self._table.loaded[0])

    @property
    def effect_set(self):
        """Return the effects as the kernels have them, an ``effects.effect_set.EffectSet``."""
        return self._effects

    @property
    def actuated(self):
        """Return the places of the actuated joints among ``torque_names``, in their order."""
        return self._actuated

    @property
    def actuated_in_tree(self):
        """Return those among ``joint_names`` alone: of actuated joints that are not cut."""
        return self._actuated[self._actuated < len(self.joint_names)]

    @property
    def point_rows(self):
        """Rows of the bodies of the named points, and the places in them, shape (n, 2 or 3)."""
        return self._geometry.named_points[:2]

    def body_row(self, name):
        """Return the row of a body in the arrays of ``system``."""
        return self._rows[name]

    @property
    def command_delay(self):
        """Longest time that a command is on its way to a drive [s]."""
        return max(self._effects.drives.values(), default=0.0)

    @property
    def effort(self):
        """Joint torques applied last, behind the drives, shape (nv,) [N m or N]."""
        tau = self._efforts()[:len(self.joint_names)]
        for motion in self.mechanism.motions:
            if motion.freedom in self.coordinates.index:
                tau[self.coordinates.index[motion.freedom]] = self.motion_forces[motion.name]
        return tau

    def _efforts(self):
        """Return the torques applied last, behind the drives, those of cut joints last."""
        tau = self.system.tau.copy()
        if self._effects.drives:
            self._evaluate()
            self._effects.efforts(tau)
        return tau

    @property
    def acceleration(self):
        """Joint accelerations of the present state under the last torques, shape (nv,)."""
        self._evaluate()
        return self.system.qdd.copy()

    @property
    def multipliers(self):
        """
        Lagrange multipliers of the present state, shape (nc,) [N, N m].

        Of all equations that do not always hold. Where some repeat others, those of the forces
        that are least in all joints together (engine/least_forces.hpp).

        """
        return self._all_multipliers().copy()

    @property
    def constraint_forces(self):
        """
        Wrenches at the cut joints, shape (number of cuts, 3): moment, force x, force y.

        What body B exerts on body A, in world axes, at body A's cut point [N m, N]: the reaction,
        and what the joint's drive, springs, dampers and friction hand over. In space of shape
        (number of cuts, 6): moment x, y, z, force x, y, z.

        """
        self._all_multipliers()
        self._find_cut_wrenches()
        found = self._wrenches_found[:len(self.cut_joints)].copy()
        if self.acts_in_cuts:
            self._cuts.add_efforts(self.system.work.body, self._cut_efforts(), found)
            if self._couples:
                found[:, 0] += self._coupled[0] @ self.coupling_forces
        return found

    def _all_multipliers(self):
        """Return the multipliers of all equations in the present state."""
        self._evaluate()
        if self._lam is not self.system.lam:
            self._find_all_multipliers()
            # Readings of effects are those on other bodies now.
            self._fresh = self.system.effects is None
        return self._lam

    def _moved_equations(self):
        """Return the equations in the present state, which is evaluated, too."""
        self._evaluate()
        return self._equations.move(self._q, self._qd)

    @property
    def shared_forces(self):
        """Names of joints and couplings whose forces are not unique: see ``multipliers``."""
        return find_redundancy(self.mechanism, self._q).shared

    @property
    def coupling_forces(self):
        """
        Generalized forces of the couplings, shape (number of couplings,).

        Times a joint's factor: the torque [N m] or force [N] of the coupling in that joint.

        """
        lam = self._all_multipliers()
        first = len(lam) - len(self.mechanism.couplings) - len(self.mechanism.motions)
        return lam[first:first + len(self.mechanism.couplings)] / self._coupling_scales

    @property
    def motion_forces(self):
        """
        Torques and forces that the prescribed motions take, by the names of these effects.

        In a joint what its drive exerts [N m; N], at a point the force along the direction [N];
        ``effect_readings`` tells their power and work, too.

        """
        self._evaluate()
        count = len(self.mechanism.motions)
        return {motion.name: float(force) for motion, force in zip(
            self.mechanism.motions, self.system.lam[len(self.system.lam) - count:])}

    @property
    def tooth_forces(self):
        """
        Tooth or belt forces, shape (number of couplings,) [N]; NaN where no radius is given.

        The torque of the coupling in its first joint over the radius of the wheel there, with the
        torque's sign.

        """
        ratios = [np.nan if coupling.radius is None else
                  next(iter(coupling.joints.values())) / coupling.radius
                  for coupling in self.mechanism.couplings]
        return np.array(ratios, dtype=float) * self.coupling_forces

    def equation_forces(self):
        """
        Return the forces of equations that are no cut joint's, by what they are and by name.

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
    def joint_forces(self):
        """
        Wrenches in the joints, shape (nv, 3): moment, force x, force y.

        What the parent exerts on the child, in world axes, at the child's origin [N m, N]: the
        reaction, and what the joint's drive, springs, dampers and friction hand over. In space of
        shape (number of joints, 6): moment x, y, z, force x, y, z; NaN in fixed joints.

        """
        self._all_multipliers()
        self._find_joint_forces()
        self._fresh = False
        found = self._joint_forces_found.copy()
        if self._couples:
            found[:, 0] += self._coupled[1] @ self.coupling_forces
        return found

    def force(self, name):
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
    def closure(self):
        """Largest closure error of positions [m or rad]."""
        if self.leaves_out:
            return self._closure_of_all()
        self._evaluate()
        return native.largest(self.system.work.closure)

    @property
    def constraint_jacobian(self):
        """Return the derivatives of the closure equations by the coordinates, shape (nc, nv)."""
        return self._assembler.jacobian(self._q)

    def _closure_of_all(self):
        """Return the largest closure error, of equations that are left out among others."""
        return self._equations.move(self._q).closure_error()

    @property
    def inertia(self):
        """Return the generalized inertia matrix of the spanning tree, shape (nv, nv)."""
        return self._assembler.inertia(self._q)

    @property
    def energy(self):
        """Kinetic energy and energy stored in gravity and effects [J]."""
        return sum(self._energies())

    @property
    def energy_balance(self):
        """Energy balance since the last reset, an ``effects.energy_balance.Energies`` [J]."""
        self._start_balance()
        self._draw_balance()
        self._fresh = True
        return Energies(*self._balance_found.tolist())

    @property
    def energy_scale(self):
        """Return work of weights and torques over the mechanism's length, and at 1 rad/s [J]."""
        return self.passive_energy_scale + (
            max(self._assembler.extent, 1.0) * native.sum_of_sizes(self.system.applied))

    @property
    def passive_energy_scale(self):
        """Return work of weights over the mechanism's length, and the energy at 1 rad/s [J]."""
        length = self._assembler.extent
        # With the energy of a rate: at rest without weight there is no other scale.
        return self._mass * (
            length * math.hypot(*self.system.model.gravity.tolist()) + length ** 2)

    @property
    def run(self):
        """Return what the engine makes steps of, a ``guarded_run.GuardedRun``."""
        return self._run

    @property
    def at_start(self):
        """Whether nothing has moved or been changed since the start or the last reset."""
        return self._balance.at_start is None and self.time == 0.0

    @property
    def energy_at_start(self):
        """Energy balance of the initial state, an ``effects.energy_balance.Energies`` [J]."""
        self._start_balance()
        return self._balance.at_start

    def _by_freedom(self):
        """Return the coordinate of each freedom, behind them those of ``torque_names``."""
        own, manifold = self._q, self.system.manifold
        if manifold is not None:
            native.fill_numbers(manifold, own)
            own = manifold.number
        if not len(self._cuts.acted):
            return own
        # Nor are these to be believed where only states beside the present one were looked at.
        self._fresh = False
        self._evaluate()
        self._fresh = False
        return np.concatenate((own, self._table.cuts.q[len(own):]))

    def _start_balance(self):
        """Find the energy at the start, when it is needed for the first time."""
        if self._balance.at_start is not None:
            return
        present = self._state.copy()
        self._q[:], self._qd[:] = self._initial
        self._own[:] = self._effects.initial
        moved = not np.array_equal(self._state, present)
        self._fresh = self._fresh and not moved
        self._balance.start(*self._energies())
        if moved:
            self._state[:] = present
            self._fresh = False

    def _feel_loads(self):
        """Let effects start with the rates and the reactions of their joints as they are."""
        if self._effects.cuts is not None:
            self._fresh = False
            self._evaluate()
            self._effects.follow_angles(self._own)
            self._fresh = False
        self._effects.follow(self._own, self._effects.rates(self._q, self._qd))
        self._effects.follow_time(self._own, self.time)
        if self._table.loaded[0] > 0:
            # A fixed point: friction changes the reactions a little.
            for _ in range(20):
                self._fresh = False
                self._evaluate()
                places, values = self._effects.loads()
                self._own[places] = values
            self._fresh = False

    def _energies(self):
        """Return kinetic and stored energy of the present state."""
        self._evaluate()
        self._find_energies()
        (own, potential), (kinetic, stored) = self._energies_found.tolist(), (
            self._effects.energies())
        return own + kinetic, potential + stored

    @property
    def body_poses(self):
        """
        Poses of the bodies, shape (nb, 3): x, y [m], angle [rad], in the bodies' order.

        In space of shape (nb, 7): x, y, z [m], unit quaternion x, y, z, w.

        """
        self._evaluate()
        return self._geometry.poses_among(self.system.work.body)

    def point(self, name):
        """Return the world place of a named point, shape (2,), in space (3,) [m]."""
        self._named_point(name)
        return self.points[list(self._points).index(name)]

    def place(self, name, position):
        """
        Return the place of a named point in another position of the joints.

        Parameters
        ----------
        name : str
            Of the point.
        position : ndarray, shape (nv,)
            Joint coordinates, which need not close the loops [rad or m].

        Returns
        -------
        ndarray, shape (2,), in space (3,)
            [m].

        """
        point = self._named_point(name)
        return self._geometry.point(position, point.body, point.position)

    @property
    def points(self):
        """Places of all named points, shape (number of points, 2), in space 3 [m]."""
        self._evaluate()
        self._place_points()
        return self._points_found.copy()

    def _named_point(self, name):
        if name not in self._points:
            raise SimulationError(
                f'There is no point {name!r} on {self.mechanism.name}; its points: '
                f'{", ".join(self._points) or "none"}.')
        return self._points[name]

    @property
    def health(self):
        """How well posed the equations of motion are in the present state: a ``Health``."""
        return health_of(
            self.system.model, self.system.work, self._moved_equations(), self._passive)

    def measured(self):
        """
        Return what the scene's sensors show of the present state; the true one without any.

        Returns
        -------
        position : ndarray, shape (nq,)
        velocity : ndarray, shape (nv,)

        """
        position, velocity = self._effects.sensors.measure(self.time, self._q, self._qd)
        return position.copy(), velocity.copy()

    def measured_cut_joints(self):
        """
        Return the same of the cut joints.

        Returns
        -------
        position, velocity : ndarray
            As ``cut_position`` and ``cut_velocity``.

        """
        position, velocity = self._effects.sensors_at_cuts.measure(self.time, *self._cut_state())
        return position.copy(), velocity.copy()

    def effect_readings(self, name):
        """
        Return what an effect says of itself in the present state.

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
        self._evaluate()
        return self._effects.readings(name, self._own)

    def windings(self):
        """
        Return how far cables are wound round their pulleys in the present state.

        Returns
        -------
        dict of (str, str) to float
            By cable and point of the pulley [rad].

        """
        self._evaluate()
        return self._effects.windings()

    def _assembled(self, position, velocity, hold):
        nv = self.coordinates.nv
        q = self._taken(position)
        qd = np.zeros(nv) if velocity is None else vector('velocity', velocity, nv)
        # The assembler works in the same workspace, whether it succeeds or not.
        self._fresh = False
        self._motions.begin(self._assembler, self.time, q, qd)
        try:
            self._assembly = self._closed(q, qd, hold)
        except AssemblyError:
            if not (self._motions and hold):
                raise
            # What is held may leave the motions no room.
            self._assembly = self._closed(q, qd, ())
        return self._assembly[2:4]

    def _closed(self, q, qd, hold):
        """Return a guess, the state that closes the loops near it, and the joints held."""
        closed = self._assembler.positions(q, hold)
        return q, qd, closed, self._assembler.velocities(closed, qd, hold), hold

    def _taken(self, position):
        """Return joint coordinates as an array, quaternions of norm 1."""
        q = vector('position', position, self.coordinates.nq)
        if self.system.manifold is None:
            return q
        with at('position'):
            return self.coordinates.unit(q)

    def _by_joint(self, what, values, present):
        """Return a mapping by joint name as an array, anything else as it is."""
        if not hasattr(values, 'items'):
            return values
        with at(what):
            return self.coordinates.filled(what, values, present)

    def assembly_notes(self):
        """
        Tell what the last assembly, of the start or of a state set, made of what was given.

        Returns
        -------
        list of str
            Sentences, where it may not be what was meant: joints moved far, another branch, a
            change point, other velocities.

        """
        self._fresh = False
        return self._assembler.notes(*self._assembly)

    def start_notes(self):
        """
        Tell of the start of a new simulation: its ``assembly_notes``, angles beyond 2 pi, effects.

        Returns
        -------
        list of str

        """
        weight = EARTH * sum(body.mass for body in self.mechanism.bodies)
        effects = [note for name, record in self.scene.effects.items() for note in
                   record.start_notes(name, partial(self.effect_readings, name), weight)]
        return (angle_notes(self.mechanism, self.scene.initial.position) + self._motions.notes()
                + self.assembly_notes() + effects + self.load_notes())

    def load_notes(self):
        """
        Tell which effects depend on forces that are not unique in the present position.

        Returns
        -------
        list of str
            A sentence for each effect that is switched on and reads such a force.

        """
        loaded = {name: record for name, record in self._effects.records.items()
                  if record.feels_reactions and self._effects.enabled[name]}
        if not loaded:
            return []
        components = find_redundancy(self.mechanism, self._q).components
        return [
            f'{name} depends on the force in {joint}, which is not unique: closure equations '
            f'repeat others ({", ".join(parts)} in world axes). The friction is that of the '
            'least forces in all joints together. Replace a joint by one that leaves the loop '
            'more freedoms, or friction_coefficient by coulomb.'
            for name, record in loaded.items() for joint, parts in components.items()
            if (record.joint == joint or record.joint.startswith(f'{joint}.'))
            and any(part.startswith('force') for part in parts)]

    def degrees_of_freedom(self):
        """
        Count the degrees of freedom at the present position and near it.

        Returns
        -------
        int
            Joints less the closure equations that do not depend on the others.

        """
        self._fresh = False
        return self._assembler.degrees_of_freedom(self._q)

    def _evaluate(self):
        """Evaluate the present state once for all that is asked of it."""
        if not self._fresh:
            self._present.evaluate()
            self._fresh = True

    # Motion.

    def _require_known_steps(self, method):
        """Refuse solvers and coordinates that the effects leave no room for."""
        if self._motions and method.stabilisation == 'independent':
            raise SimulationError(
                f'The scene prescribes motions ({", ".join(self.motion_names)}): '
                'stabilisation: independent knows none. Take stabilisation: projection.')
        names = self._effects.ending_steps
        if names and INTEGRATORS[method.integrator].family == SCIPY:
            own = [name for name, one in INTEGRATORS.items() if one.family != SCIPY]
            raise SimulationError(
                f'The scene lists dry friction, or forces whose course over time has corners '
                f'({", ".join(names)}): steps must end where a joint comes to rest and at '
                f'corners, and {method.integrator} does not tell where its steps end. Take '
                f'another integrator ({", ".join(own)}), or leave them out.')

    def step(self, torque=None, duration=None):
        """
        Advance by ``duration`` under constant torques.

        Parameters
        ----------
        torque : mapping, sequence or None
            Joint torques [N m or N]: by joint name, or for all actuated joints in their
            order; joints that are not named get none.
        duration : float, optional
            [s]; one step when not given. Covered by whole steps, and one shorter step at the
            end where it is no multiple of the step size.

        Raises
        ------
        NumericalError, ClosureError
            The state before the failing step is kept.
        ValueError
            For a torque or duration that makes no sense.

        """
        if duration is None:
            tau = self._spread if self._spread_torques(torque) else self.joint_torques(torque)
            return self.advance(tau, 1)
        tau, size = self.joint_torques(torque), self.step_size
        if not (math.isfinite(duration) and duration >= 0.0):
            raise ValueError(f'duration: expected a finite number >= 0 [s], got {duration!r}')
        whole = math.floor(duration / size * (1.0 + 1e-12) + 1e-9)
        self._order(tau, whole)
        rest = duration - whole * size
        if rest > 1e-9 * size:
            self._make(rest, 1)
        self._make(size, 0, whole + 1)

    def advance(self, tau, steps):
        """
        Advance by whole steps under constant joint torques; the fast path of ``step``.

        Parameters
        ----------
        tau : ndarray, shape (number of ``torque_names``,)
            Joint torques [N m or N], finite.
        steps : int
            Number of steps.

        Raises
        ------
        NumericalError, ClosureError
            The state before the failing step is kept.

        """
        if self._effects.attends or self._delay_line.pending:
            self._order(tau, steps)
            self._make(self.step_size, 0, steps)
            return
        self._fresh = False
        pause = self._advance_run(tau, steps)
        if pause == COMMAND:
            self._command(tau)
        if pause:
            self._go_on(pause)

    def _order(self, tau, steps):
        """Advance by whole steps; drives follow torques with their delays."""
        if not (self._delay_line.pending or self._effects.delays):
            self._command(tau)
            self._make_all(steps)
            return
        self._delay_line.order(self.time, tau, self._effects.drives, self.system.tau)
        while True:
            self._command(self._delay_line.due(
                self.time, 1e-9 * self.step_size, self.system.tau))
            if steps <= 0:
                break
            count = self._delay_line.steps_until_next(self.time, self.step_size, steps)
            self._make_all(count)
            steps -= count

    def _command(self, tau):
        """Let joint torques act from now on."""
        if (tau == self.system.tau).all():
            return
        self.require_bearable(tau)
        self._add_work()
        self._driver.restart()
        self.system.tau[:] = tau
        self._fresh = False

    def _make_all(self, steps):
        """Make whole steps; sensors that remember see every state."""
        if not self._effects.remembers:
            self._make(self.step_size, steps)
            return
        self._look()
        for _ in range(steps):
            self._make(self.step_size, 1)
            self._look()

    def _look(self):
        """Let sensors that remember see the present state."""
        self.measured()
        self.measured_cut_joints()

    def _make(self, size, steps, call=0):
        """Make steps of one size [s], the end of a call of so many steps where that is told."""
        counts = self._counts
        counts[guarded_run.DUE] = counts[guarded_run.HANDED] = 0
        counts[guarded_run.LEFT], counts[guarded_run.CALL] = steps, call
        self._numbers[guarded_run.SIZE] = size
        self._go_on(COMMAND)

    def _go_on(self, pause):
        """Do what the engine pauses for, and let it go on, until all steps are made."""
        while pause:
            if pause == guarded_run.START_ENERGY:
                self._start_balance()
            elif pause == guarded_run.SAMPLE:
                self._driver.sample(self._state, self.step_size)
            elif pause == guarded_run.FAILURE or pause == guarded_run.HAND_OVER:
                self._make_portion(pause == guarded_run.FAILURE)
            elif pause == guarded_run.CHOICE:
                if self.leave_out_again():
                    self._counts[guarded_run.EQUATIONS_BETWEEN] = min(
                        2 * self._counts[guarded_run.EQUATIONS_BETWEEN], EQUATIONS_LOOK_EVERY)
            elif pause != COMMAND:
                self._tell(pause)
            self._fresh = False
            pause = self._resume_run()

    def _tell(self, pause):
        """Warn of, or raise, what the guards have found; the latest good state is kept."""
        numbers, guard = self._numbers, self.energy_guard
        if pause == guarded_run.INACCURATE:
            guard.warn()
        elif pause == guarded_run.ENERGY_LOST:
            problem = guard.problem(self)
            self.restore(self._run.kept, *numbers[
                [guarded_run.LOOK_TIME, guarded_run.PRESENT - 1]].tolist())
            raise problem
        elif pause == guarded_run.CABLE_LEAPT:
            before = dict(zip(self._effects.winding_places(), self._run.windings.tolist()))
            place = max(before, key=lambda each: abs(self.windings()[each] - before[each]))
            self.restore(self._run.kept_by_cables, *numbers[
                [guarded_run.CABLE_TIME, guarded_run.CABLE_RESIDUAL]].tolist())
            raise leapt(place, before[place], self.time)
        else:
            raise opened_loops(self)

    def look_at_energy(self):
        """
        Look at the energy balance now: warn where it is a little off.

        Raises
        ------
        NumericalError, StiffnessError
            Where it is far off; the latest state that was well is kept.

        """
        self._start_balance()
        pause = self._look_at_energy()
        if pause:
            self._tell(pause)

    def _set_guards(self, stiffness, method):
        """Let a run by a method be watched."""
        self._stiffness = stiffness
        self.energy_guard = EnergyGuard(
            method, stiffness.rate, self._numbers, self._counts, stiffness.limit,
            stiffness.among_laws, self._geometry.may_leave_out)
        self._restart_guards()

    def _restart_guards(self):
        """Let the guards begin."""
        self.energy_guard.restart()
        counts = self._counts
        counts[guarded_run.CABLES_LOOKED] = counts[guarded_run.EQUATIONS_SINCE] = 0
        counts[guarded_run.EQUATIONS_BETWEEN] = EQUATIONS_FIRST_LOOK

    def _watch(self):
        """Return the numbers by which the engine watches the run."""
        guard, method = self.energy_guard, self.scene.method
        places, size = self._effects.winding_places().values(), extent(self.mechanism)
        drifts = method.stabilisation not in CLOSING
        return guarded_run.Watch(
            guard.first, guard.rarely, guard.call, guard.whole, self._geometry.may_leave_out,
            min(CABLE_LOOK_EVERY if places else guarded_run.NEVER,
                CLOSURE_LOOK_EVERY if drifts else guarded_run.NEVER),
            OPEN * size if drifts else math.inf, method.stabilisation == 'none', self._mass, size,
            USUAL_TORQUE, np.array([*places], dtype=np.int64))

    def _set_run(self):
        """Let the engine make steps by the present method, system and guards."""
        before = getattr(self, '_run', None)
        self._numbers[guarded_run.STEP_SIZE] = self.step_size
        run = guarded_run.guarded_run(
            self._driver.driver.stepper, self._watch(), self._balance.account, self._state,
            sum(map(np.size, self._driver.memory)), self._numbers, self._counts)
        if before is not None and len(before.kept) == len(run.kept) and (
                np.array_equal(before.watch.windings, run.watch.windings)):
            # Where the guards have seen it.
            run = run._replace(kept=before.kept, kept_by_cables=before.kept_by_cables,
                               windings=before.windings)
        self._run, engine = run, self.system.native
        self._advance_run, self._resume_run, self._look_at_energy = (
            native.bind(name, engine, run)
            for name in ('advance_run', 'resume_run', 'look_at_energy'))

    def _choose_equations(self, status):
        """
        Choose the equations that the elimination works on anew, after a step that failed.

        Parameters
        ----------
        status : int
            Of ``integration.advance``.

        Returns
        -------
        bool
            Whether to go on from the present state; not where no equations are left out, so that
            it failed for another reason.

        """
        if (not self.leaves_out or self.scene.method.stabilisation not in CLOSING
                or status == CONTACT_PASSED):
            return False
        numbers = self.system.whole.numbers
        opened = status != POOR_EQUATIONS or numbers[OPENED] == 1.0
        model = self._geometry.closed_anew(self._q, BETTER, opened)
        if model is None:
            if status == POOR_EQUATIONS and numbers[LENIENT] == 0.0 and not (
                    opened and not self._geometry.serves(self._q)):
                numbers[LENIENT] = 1.0
                return True
            # What is left out may be what holds it together.
            model = self._geometry.keep(None)
        self._exchange(model)
        return True

    def leave_out_again(self):
        """
        Leave out equations that repeat others, where all were taken again.

        Returns
        -------
        bool
            Whether some are left out from now on that were not.

        """
        if self.leaves_out or self.scene.method.stabilisation not in CLOSING:
            return False
        model = self._geometry.choose(self._q)
        if not self.leaves_out:
            return False
        self._exchange(model)
        return True

    def _exchange(self, model):
        """Evaluate with other closure equations, from the same state."""
        self._take(with_equations(self.system, model))
        self._driver.take(self.system)
        self._stiffness.move(self.system)
        self._set_run()
        self._fresh = False
        self.exchanges += 1

    def _take(self, system):
        """Evaluate by a system that works on the equations that are kept."""
        self.system, self._equations = system, self._geometry.equations
        self._motions.look_up(system.model)
        self._effects.move(system)
        self._assembler = Assembler(self.mechanism, self._equations)
        self._inverse = self._inverse_dynamics()
        self._set_probes()

    @property
    def fastest_rate(self):
        """Estimate of the fastest rate of the motion in the present state [1/s]."""
        return self._stiffness.rate(self._state)

    def judge(self):
        """
        Check the energy balance of the run so far, as is done from time to time during a run.

        Raises
        ------
        NumericalError, StiffnessError
            Where the motion is none; the latest state that was well is kept.

        """
        self._start_balance()
        pause = self._look_at_energy()
        if pause == guarded_run.ENERGY_LOST:
            self._tell(pause)

    def _make_portion(self, failed):
        """Make steps that the engine does not: those of other solvers, or after a failure."""
        numbers, counts, driver = self._numbers, self._counts, self._driver.driver
        size, portion = float(numbers[guarded_run.SIZE]), int(counts[guarded_run.HANDED])
        grid = self.time, 0
        if size == self.step_size:
            grid = float(numbers[guarded_run.TIME_BASE]), int(counts[guarded_run.STEPS])
        status, elapsed = None, 0.0
        if failed:
            status, elapsed = int(counts[guarded_run.STATUS]), float(numbers[guarded_run.ELAPSED])
            driver.made = int(counts[guarded_run.MADE])
        begin = perf_counter_ns()
        try:
            while status != DONE:
                if status == INTERRUPTED:
                    # Another thread was.
                    raise KeyboardInterrupt
                if status is not None:
                    if not self._choose_equations(status):
                        break
                    driver.go_on()
                status, elapsed = driver.advance(self._state, *grid, size, portion)
        except BaseException:
            # Ctrl-C, within steps that count as not made.
            self._state[:] = self._run.before
            self._driver.restart(moved=True)
            raise
        numbers[guarded_run.COST_NANOSECONDS] += perf_counter_ns() - begin
        if status == DONE:
            return
        self._driver.count(elapsed, size)
        numbers[guarded_run.TIME_BASE] += elapsed
        self._fresh = False
        beyond = self._motions.advice_on_stopping(
            self._assembler, self._q, self.time, self.step_size)
        if beyond:
            raise MotionError(
                f'The motion cannot go on at t = {self.time:.9g} s; the state before is kept. '
                f'{beyond}')
        # What stopped it may be a cable at its limit, or steps that cannot be stable.
        explain(self)
        self._stiffness.check(self._state, size)
        raise self._stopped(status, size)

    def _stopped(self, status, size):
        """Return the error to raise where a step [s] could not be made."""
        if status == NOT_FINITE:
            return NumericalError(
                f'The state left the finite numbers at t = {self.time:.9g} s; the last finite '
                f'state is kept. Take a smaller step than {size:g} s, or smaller torques '
                f'(largest now {np.abs(self.system.tau).max(initial=0.0):g}).')
        if status == OPEN_LOOP:
            error = self.system.work.health[t.CLOSURE]
            advice = self._assembler.advice_on_opening(self._q) or (
                f'Take a smaller step than {size:g} s: the motion in one step is too large.')
            return ClosureError(
                f'The loops could not be closed after the step at t = {self.time:.9g} s (error '
                f'{error:.3g}); the state before it is kept. {advice}')
        if status == TOO_MUCH_WORK:
            return NumericalError(
                f'The motion at t = {self.time:.9g} s takes more than {MOST_EVALUATIONS} '
                f'evaluations for {size:g} s; the last good state is kept. Take smaller torques '
                f'(largest now {np.abs(self.system.tau).max(initial=0.0):g}), allow a larger '
                'error, or leave out what is so fast.')
        if status == CONTACT_PASSED:
            return NumericalError(
                f'A contact ({self._effects.passed}) was passed within a step of {size:g} s at '
                f't = {self.time:.9g} s, between evaluations that felt nothing of it; the state '
                'before is kept. Take a smaller step, or a method with error control, such as '
                'integrator: auto.')
        return NumericalError(
            f'No step at t = {self.time:.9g} s is small enough to keep the error that is '
            'allowed; the last good state is kept. The motion is not smooth there: allow '
            'more, or take a fixed step.')

    def joint_torques(self, torque):
        """
        Return joint torques as an array from any form that ``step`` takes, by ``torque_names``.

        Parameters
        ----------
        torque : mapping, sequence or None
            By joint name, or in the order of the actuated joints.

        Raises
        ------
        ValueError

        """
        if self._spread_torques(torque):
            return self._spread.copy()
        tau = np.zeros(len(self._places))
        if hasattr(torque, 'items'):
            require_actuated(self.mechanism, torque)
            for name, value in torque.items():
                tau[self._places[name]] = value
        else:
            values = np.array(torque, dtype=float)
            if values.shape != (len(self._actuated),):
                raise ValueError(
                    f'torque: expected {len(self._actuated)} values, for '
                    f'{", ".join(self.actuated_joints)}; got shape {values.shape}')
            tau[self._actuated] = values
            if self.mechanism.motions:
                require_actuated(
                    self.mechanism, [self.torque_names[place] for place in np.flatnonzero(tau)])
        if not _are_finite(tau):
            raise ValueError(f'torque: expected finite numbers, got {torque!r}')
        return tau

    def require_bearable(self, tau):
        """
        Refuse joint torques that no step from the present state can follow.

        Parameters
        ----------
        tau : ndarray, shape (number of ``torque_names``,)
            From ``joint_torques``.

        Raises
        ------
        NumericalError
            Where a joint would move by more than LARGEST_MOTION within a step; nothing is changed.

        """
        largest_torque = np.abs(tau).max(initial=0.0)
        if largest_torque <= USUAL_TORQUE:
            return
        system, before = self.system, self.system.tau.copy()
        system.tau[:] = tau
        self._present.evaluate()
        system.tau[:], self._fresh = before, False
        motion = np.abs(system.qdd).max(initial=0.0) * self.step_size ** 2
        if not (motion <= LARGEST_MOTION and np.isfinite(self._table.rates).all()):
            raise NumericalError(
                f'torque: expected torques that a step of {self.step_size:g} s can follow, got '
                f'up to {largest_torque:.3g} (N m or N), by which a joint would move by '
                f'{motion:.3g} rad or m; at most {LARGEST_MOTION:g} can be followed. The state '
                'and the torques before are kept.')

    def reset(self):
        """Return to the initial state, time zero and no torque."""
        if self.exchanges:
            self._exchange(self._geometry.as_at_first() if self._may_leave_out(self.scene.method)
                           else self._geometry.keep(None))
        self.exchanges = 0
        self._set_time(0.0, 0)
        if self._motions:
            for name, record in self._motions.forget_commands(self.scene.effects).items():
                self._effects.put(name, record, True)
            # They may have been changed since.
            initial = self.scene.initial
            self._initial = self._assembled(initial.position, initial.velocity, initial.hold)
        self._q[:], self._qd[:] = self._initial
        self._own[:] = self._effects.initial
        self._driver.rewind()
        self._effects.restart()
        self._delay_line = DelayLine()
        self.system.tau[:] = 0.0
        self._fresh = False
        health = self.system.work.health
        health[:] = 0.0
        health[t.SMALLEST_PIVOT] = health[t.SMALLEST_PIVOT_EVER] = 1.0
        self._feel_loads()
        if self.system.manifold is not None:
            self._state[-1] = 0.0
        self._balance.restart(self._by_freedom())
        self._restart_guards()
        self._stiffness.check(self._state, self.step_size)

    def set_step_size(self, step_size):
        """
        Change the step size while running; time and state go on.

        Parameters
        ----------
        step_size : float
            [s], positive.

        Raises
        ------
        ValueError
            Where it is no positive number; the present one stays.
        StiffnessError
            Where the scene is too stiff for it; the present one stays.

        """
        method = replace(self.scene.method, step_size=step_size)
        self._stiffness.check(self._state, method.step_size)
        self._take_method(method, self._stiffness)

    def prepare_method(self, **changes):
        """
        Check and prepare another method, leaving everything as it is.

        Parameters
        ----------
        **changes
            By the keys that a scene has under ``method``, except ``formulation``.

        Returns
        -------
        callable
            Lets the method take effect, from the next step on; time and state go on, the
            account of cost and local error starts anew.

        Raises
        ------
        ValueError
            Where a name or value makes no sense.
        SimulationError
            Where the scene is too stiff for the method, or its closure equations here too
            dependent or its loops too far open.

        """
        method = replace(self.scene.method, **changes)
        if method.formulation != self.scene.method.formulation:
            raise ValueError('method: the formulation is chosen when a scene is loaded, and stays')
        self._require_known_steps(method)
        self._require_closable(method.stabilisation)
        before, anew = self.system, self.leaves_out and not self._may_leave_out(method)
        system = with_equations(before, self._geometry.of(None)[0]) if anew else before
        system = with_partition(system, method.stabilisation == 'independent')
        guard = StiffnessGuard(system, method, self._effects.own)
        guard.check(self._state, method.step_size)
        driver = build_driver(system, method)
        driver.advance(self._state.copy(), self.time, 0, 1e-9, 1)
        driver.rewind()
        self._fresh = False

        def take_effect():
            if self.system is not before:
                # Equations, or the method, have been exchanged since.
                self.prepare_method(**changes)()
                return
            if anew:
                self._geometry.keep(None)
                self._take(system)
                self.exchanges += 1
            self.system = system
            self._driver = Monitor(driver, system, method, self._numbers, self._counts)
            self._take_method(method, guard)

        return take_effect

    def _require_closable(self, stabilisation):
        """Refuse a stabilisation that cannot start from the present state."""
        if stabilisation != 'none' and self.closure > self.system.settings[CLOSURE_LIMIT]:
            raise ClosureError(
                f'The loops have drifted apart by {self.closure:.3g} m or rad: more than '
                f'{stabilisation} may be asked to close. Reset, or set a state, first.')
        if stabilisation == 'independent':
            self._fresh = False
            self._assembler.require_independent(self._q)

    def _jump(self):
        """Compare nothing with what was before."""
        self._fresh = False
        self.energy_guard.jump()
        self._counts[guarded_run.CABLES_LOOKED] = 0

    def _take_method(self, method, stiffness):
        self._set_time(self.time, 0)
        self.scene = replace(self.scene, method=method)
        self._set_guards(stiffness, method)
        self._set_run()
        self.system.settings[BAUMGARTE_GAIN] = (
            1.0 / method.time_constant if method.stabilisation == 'baumgarte' else 0.0)
        self._driver.restart()
        self._jump()

    def set_state(self, position, velocity=None, hold=None):
        """
        Move to another state, assembled.

        Parameters
        ----------
        position : mapping, or sequence of shape (nq,)
            Approximate joint coordinates [rad or m]; in a mapping by joint name, those of the
            joints that are not named stay as they are. Of spherical and free joints as a scene
            has them: ``{'ball': {'orientation': {'rpy': (0.0, 0.0, 1.0)}}}``.
        velocity : mapping, or sequence of shape (nv,), optional
            Approximate joint rates [rad/s or m/s], likewise; zero when not given.
        hold : sequence of str, optional
            Joints kept as given; none when not given: the nearest closed state is taken. They must
            be as many as there are degrees of freedom, but for mechanisms with spherical or free
            joints in the tree.

        Raises
        ------
        AssemblyError
            Where no such state closes the loops, or not even a step can be made from it; the
            present state is kept.
        ValueError
            Where it is no state: other numbers, names, or no unit quaternion.

        """
        with np.errstate(all='ignore'):
            state = self._assembled(
                self._by_joint('position', position, self._q),
                self._by_joint('velocity', velocity, self._qd), hold or ())
        if self.leaves_out and not self._geometry.serves(state[0]):
            self._exchange(self._geometry.choose(state[0]))
        if self.scene.method.stabilisation == 'independent':
            self._assembler.require_independent(state[0])
        self._require_step_from(*state)
        self._add_work()
        self._start_balance()
        before = self.energy
        self._q[:], self._qd[:] = state
        self._effects.start_anew(self._own)
        self._driver.restart(moved=True)
        self._jump()
        self._feel_loads()
        self._jump_balance(self.energy - before)

    def _jump_balance(self, energy):
        """Leave the energy of a change from outside out of the balance."""
        self._balance.jump(self._by_freedom(), energy)

    def _require_step_from(self, position, velocity):
        """Refuse a state from which a step cannot be made."""
        fastest = np.abs(velocity).max(initial=0.0)
        if not fastest * self.step_size <= LARGEST_MOTION:
            raise AssemblyError(
                f'The largest velocity is {fastest:.3g} rad/s or m/s, so that a joint would move '
                f'by {fastest * self.step_size:.3g} rad or m in a step of {self.step_size:g} s; '
                f'at most {LARGEST_MOTION:g} can be followed.')
        trial, health = self._state.copy(), self.system.work.health.copy()
        places, rates, own = (trial[part] for part in self._parts)
        own[self._effects.own] = self._effects.initial[self._effects.own]
        places[:], rates[:] = position, velocity
        status = NOT_FINITE
        if np.isfinite(trial).all():
            status = self._try_step(trial, self.step_size)
        self.system.work.health[:] = health
        if status != DONE:
            raise AssemblyError(
                f'From this state not even a step of {self.step_size:g} s can be made: '
                + ('the numbers grow beyond all bounds'
                   if status == NOT_FINITE else 'the loops cannot be closed after it'
                   if status == OPEN_LOOP else 'it takes too many evaluations'
                   if status == TOO_MUCH_WORK else 'no part of it keeps the tolerance')
                + f'. Take smaller velocities (largest now {fastest:.3g} rad/s or m/s), or a '
                'smaller step.')

    def restore(self, state, time, residual=None):
        """
        Take a state of another run of the same scene, bit for bit; torques stay.

        Parameters
        ----------
        state : sequence
            From ``state``; not assembled.
        time : float
            Of that state [s].
        residual : float, optional
            Of the energy balance in that state [J]; the present one when not given.

        Raises
        ------
        ValueError
            Where it is no state of this scene.

        """
        state = vector('state', state, len(self.state))
        if residual is None:
            residual = self.energy_balance.residual
        self._start_balance()
        steps = round(time / self.step_size)
        exact = steps * self.step_size == time
        self._set_time(*((0.0, steps) if exact else (time, 0)))
        self._effects.restart()
        self._recall(state)
        self._driver.restart()
        self._jump()
        self._jump_balance(self.energy_balance.residual - residual)

    def _recall(self, state):
        """Take back what ``state`` was."""
        self._state[:] = state[:len(self._state)]
        self._driver.recall(state[len(self._state):])

    def _try_step(self, state, size):
        """Make a step from a copy of a state, leaving all else as it is; return its status."""
        before = self.state
        self._driver.restart(moved=True)
        status, _ = self._driver.driver.advance(state, self.time, 0, size, 1)
        self._recall(before)
        self._driver.restart()
        self._fresh = False
        return DONE if status in (POOR_EQUATIONS, CONTACT_PASSED) else status

    @property
    def monitor(self):
        """Return what keeps account of cost and local error, a ``monitor.Monitor``."""
        return self._driver

    def report(self):
        """
        Tell what the run has cost since the start or the last reset, and how far off it may be.

        Returns
        -------
        monitor.RunReport

        """
        self._start_balance()
        native.note_energy(self.system.native, self._run, self._balance_found)
        balance = Energies(*self._balance_found.tolist())
        return self._driver.report(
            self.closure, self.energy_guard.missed(balance), self.energy_guard,
            tuple(self.load_notes()))

    def rollout(self, torques=None, initial_position=None, initial_velocity=None, *, hold=None,
                duration=None, steps=None, every=1, parameters=None,
                quantities=('position', 'velocity'), threads=None):
        """
        Run many simulations of this scene from its start, in parallel.

        This simulation stays as it is. Every result is the same, bit for bit, as that of a
        simulation of its own that is advanced by ``step``, whatever the number of threads.

        Parameters
        ----------
        torques : array_like, shape (samples, rows, number of actuated joints)
            Torques of the actuated joints [N m or N], one row after the other, each for the
            same number of steps. Without the first axis for all samples; a single row stays
            for the whole run; none when not given.
        initial_position : array_like, shape (samples, nq) or (nq,)
            To start from instead of the scene's start, as for ``set_state``.
        initial_velocity : array_like, shape (samples, nv) or (nv,)
            Likewise.
        hold : sequence of str, optional
            As for ``set_state``; those of the scene where only velocities are given.
        duration, steps : float, int
            Length of a run [s], or in steps; one step a row when neither is given.
        every : int
            Steps from one instant of the results to the next.
        parameters : mapping of str to array_like, shape (samples,)
            Numbers of the scene by key path, such as ``'mechanism.bodies.crank.mass'``,
            ``'effects.gravity.acceleration.1'``, ``'initial.position.crank_joint'``.
        quantities : sequence of str
            What to return: names of the fields of ``rollout.Rollout``.
        threads : int, optional
            As many as there are processors, when not given.

        Returns
        -------
        rollout.Rollout
            A sample that fails is told of in ``failures``; its numbers are NaN from then on.
            One whose energy balance misses more than a thousandth of what moved is told of
            there, too, with its numbers kept.

        Raises
        ------
        ValueError
            For arguments that make no sense, whatever the sample.

        """
        return rollout(
            self, torques, initial_position, initial_velocity, hold=hold, duration=duration,
            steps=steps, every=every, parameters=parameters, quantities=quantities,
            threads=threads)

    # Effects.

    @property
    def effects(self):
        """Return the listed effects, with their present parameters: records by name."""
        return dict(self._effects.records)

    @property
    def enabled_effects(self):
        """Names of the effects that are switched on."""
        return tuple(name for name, enabled in self._effects.enabled.items() if enabled)

    def set_effect(self, name, enabled=None, **parameters):
        """
        Switch an effect on or off, or change its parameters, from the next step on.

        Parameters
        ----------
        name : str
            Of an effect that the scene lists.
        enabled : bool, optional
            As it is, when not given.
        **parameters
            New values by the effect's keys.

        Raises
        ------
        ValueError
            Where a name or value makes no sense; nothing is changed.
        StiffnessError
            Where the steps would be too large for it in the present state; nothing is changed.

        Notes
        -----
        An energy that appears or vanishes with the change (a spring that is switched on
        stretched) is not booked as work: the energy balance goes on from the new energy.

        """
        self._add_work()
        self._start_balance()
        before = self.energy
        anew = self._try_effect(name, enabled, parameters)
        self._own[anew] = self._effects.initial[anew]
        self._set_run()
        self._effects.follow_time(self._own, self.time)
        if self.leaves_out and not self._may_leave_out(self.scene.method):
            self._exchange(self._geometry.keep(None))
        self._driver.restart()
        self._jump()
        if len(anew):
            self._feel_loads()
        self._jump_balance(self.energy - before)
        if self._effects.records[name].feels_reactions:
            for note in self.load_notes():
                warnings.warn(note, RuntimeWarning, stacklevel=2)

    @property
    def commanded_motions(self):
        """
        Names that ``command_motion`` takes: of joints, and of effects that move points.

        Of prescribed motions of the shape ``commanded``, in the scene's order.

        """
        return tuple(self._motions.commanded)

    def command_motion(self, commands):
        """
        Let motions that are commanded go on through other points, from the present state.

        Parameters
        ----------
        commands : mapping of str to tuple
            By name of ``commanded_motions``: times [s], from ``time`` on, and positions
            [rad; m] of the points, optional rates, and beside these optional accelerations.
            Motions that are not named go on as before.

        Raises
        ------
        ValueError
            For what no motion can follow: unknown names, times in the past, numbers that are not
            finite, jumps of position or rate; nothing is changed.

        """
        courses = self._motions.courses(commands, self.time)
        for name, keys in courses.items():
            record = self._effects.checked(name, None, keys)
            fastest = max(abs(record.at(time)[1]) for time in instants(keys['times']))
            if not fastest * self.step_size <= LARGEST_MOTION:
                with at('effects', name):
                    raise FieldError(
                        f'a rate of at most {LARGEST_MOTION / self.step_size:g} rad/s or m/s',
                        f'{fastest:.3g}', path=('rates',))
        for name, keys in courses.items():
            self.set_effect(name, **keys)

    def check_effect(self, name, enabled=None, **parameters):
        """
        Refuse, as ``set_effect`` would, a change that makes no sense; change nothing.

        Parameters
        ----------
        name, enabled, **parameters
            As for ``set_effect``.

        Raises
        ------
        ValueError, StiffnessError

        """
        effects = self._effects
        effects.checked(name, enabled, parameters)
        was = effects.records[name], effects.enabled[name]
        self._try_effect(name, enabled, parameters)
        effects.put(name, *was)

    def _try_effect(self, name, enabled, parameters):
        """Change an effect, unless steps that can be stable now could not be with it."""
        effects = self._effects
        self._motions.require_continued(
            name, effects.checked(name, enabled, parameters), enabled, self.time)
        was = effects.records.get(name), effects.enabled.get(name)
        anew = effects.change(name, enabled, parameters)
        self._fresh = False
        if effects.records[name].STIFFENS:
            self._require_stable(name, was)
        return anew

    def _require_stable(self, name, was):
        try:
            self._stiffness.check(self._state, self.step_size)
        except StiffnessError:
            changed = self._effects.records[name], self._effects.enabled[name]
            self._effects.put(name, *was)
            if self._stiffness.stable(self._state, self.step_size):
                raise
            # It has been too stiff before: a change may be for the better.
            self._effects.put(name, *changed)

    # Dynamics of any state.

    def forward_dynamics(self, position, velocity, torque=None):
        """
        Compute accelerations and multipliers of a state that closes the loops.

        Parameters
        ----------
        position : sequence, shape (nq,)
            Closing the loops.
        velocity : sequence, shape (nv,)
            Keeping them closed.
        torque : mapping, sequence or None
            As for ``step``.

        Returns
        -------
        acceleration : ndarray, shape (nv,)
        multipliers : ndarray, shape (nc,)

        """
        self._fresh = False
        if self._evaluate_given(position, velocity, torque):
            return self.system.qdd.copy(), self._lam_given.copy()
        nv, system = len(self.joint_names), self.system
        probe = self._probe
        probe.q[:] = self._taken(position)
        probe.qd[:] = vector('velocity', velocity, nv)
        tau, applied = self.joint_torques(torque), system.tau.copy()
        system.tau[:] = tau
        self._table.states[:] = self._own
        self._effects.follow(self._table.states, self._effects.rates(probe.q, probe.qd))
        probe.own[:] = self._table.states
        probe.evaluate_only()
        lam = system.lam
        if self.leaves_out:
            lam = self._multipliers_elsewhere(probe)
        system.tau[:] = applied
        self._fresh = False
        return system.qdd.copy(), lam.copy()

    def evaluator(self, *quantities: str) -> Evaluator:
        """
        Return what computes ``forward_dynamics`` of state after state at the least cost.

        Parameters
        ----------
        *quantities : str
            What is wanted: ``'acceleration'``, ``'multipliers'``; both when not given.

        Returns
        -------
        integration.evaluation.Evaluator
            In the present state without torques; it works on a copy of the mechanism and of the
            effects, as they are now.

        Raises
        ------
        ValueError
            For an unknown quantity.

        Examples
        --------
        >>> evaluate = simulation.evaluator('acceleration')
        >>> evaluate.q[:], evaluate.qd[:], evaluate.tau[:] = q, qd, tau
        >>> evaluate()
        >>> evaluate.acceleration

        """
        made = Evaluator(
            self.system, self._geometry.of(None)[0] if self.leaves_out else self.system.model,
            self._own, self._allowed, quantities or QUANTITIES, self._refuse)
        made.q[:], made.qd[:] = self._q, self._qd
        return made

    def _refuse(self, q, qd, torque):
        """Raise where a state or torques are none."""
        self._taken(q)
        vector('velocity', qd, len(self.joint_names))
        self.joint_torques(torque)

    def _multipliers_elsewhere(self, probe):
        """Return the multipliers of all equations, which are solved where those kept do not do."""
        lam = np.zeros(len(self.system.whole.lam))
        if native.find_all_multipliers(self.system.native, probe.q, probe.qd, lam):
            return lam
        whole = with_equations(self.system, self._geometry.of(None)[0])
        other = Probe(whole)
        other.q[:], other.qd[:], other.own[:] = probe.q, probe.qd, probe.own
        other.evaluate_only()
        return whole.lam

    def inverse_dynamics(self, position, velocity, acceleration):
        """
        Compute the torques and constraint forces that a motion needs.

        Parameters
        ----------
        position, velocity, acceleration : sequence, shape (nv,)
            Consistent with the loops.

        Returns
        -------
        torque : ndarray, shape (number of actuated joints,)
            The least ones where the mechanism is actuated redundantly [N m or N].
        multipliers : ndarray, shape (nc,)

        Raises
        ------
        SimulationError
            Where the actuated joints cannot produce the motion, or it opens the loops.

        Notes
        -----
        Solves tau + tau_effects + J^T lambda = I qdd + c, tau zero at the joints that are not
        actuated. The torques are those at the joints, after limits and lags of the drives; dry
        friction is that of a steady motion, none where a joint rests.

        """
        self._fresh = False
        self._effects.follow_time(self._table.states, self.time)
        found = self._inverse.solve_given(position, velocity, acceleration)
        if found is not None:
            return found
        nv = len(self.joint_names)
        q = self._taken(position)
        qd, qdd = (vector(name, values, nv) for name, values in (
            ('velocity', velocity), ('acceleration', acceleration)))
        return self._inverse.solve(q, qd, qdd)


def instants(times):
    """Return times and some between them [s]."""
    times = np.array(times)
    between = [times[:-1] + share * np.diff(times) for share in (0.0, 0.25, 0.5, 0.75)]
    return np.concatenate([*between, times[-1:]])


def vector(name, values, length):
    """
    Return finite numbers as a new array, shape (length,).

    Parameters
    ----------
    name : str
        What they are, for the error message.
    values : sequence
        Of numbers.
    length : int
        How many are expected.

    Raises
    ------
    ValueError

    """
    array = np.array(values, dtype=float, order='C')
    if array.shape != (length,) or not _are_finite(array):
        raise ValueError(f'{name}: expected {length} finite numbers, got {values!r}')
    return array


def _are_finite(array):
    """Return whether all numbers are finite."""
    # Their sum is where all are, and quicker to tell; it may overflow alone.
    return math.isfinite(array.sum()) or np.isfinite(array).all()
