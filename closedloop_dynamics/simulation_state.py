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

"""What a simulation is made of, and all that may be asked of its present state."""

import math

import numpy as np

from .assembly import Assembler
from .core import energy, kinematics
from .core import types as t
from .core.formulations import AUGMENTED, SUBSYSTEM, SYSTEM
from .core.loop_closure import largest
from .effects.accounts import Accounts
from .effects.composition import Composition
from .effects.machine import Machine
from .errors import SimulationError
from .health import health_of
from .integration.system import build_system, evaluate, number_of_states
from .mechanism.decomposition import decompose
from .mechanism.mechanism import CUT_JOINT_EQUATIONS, PRISMATIC, REVOLUTE
from .method_choice import resolved
from .modeling import body_rows, build_model, extent

FORMULATIONS = {'subsystem': SUBSYSTEM, 'system': SYSTEM, 'augmented': AUGMENTED}


class SimulationState:
    """
    One mechanism, what acts on it, and its present state; the base of ``Simulation``.

    Parameters
    ----------
    scene : scene.Scene
        The initial state is assembled: positions and velocities close the loops.

    Raises
    ------
    AssemblyError
        Where the loops cannot be closed from the scene's initial state.

    """

    def __init__(self, scene):
        """Build the model, assemble the initial state."""
        scene, self.method_report = resolved(scene, type(self))
        self.scene = scene
        self.mechanism = scene.mechanism
        self.decomposition = decompose(self.mechanism)
        self._rows = body_rows(self.mechanism, self.decomposition)
        model = build_model(self.mechanism, decomposition=self.decomposition)
        self._effects = Composition(scene.effects, model, Machine(self.mechanism, self._rows))
        method = scene.method
        baumgarte = 1.0 / method.time_constant if method.stabilisation == 'baumgarte' else 0.0
        size = extent(self.mechanism)
        self.system = build_system(
            model, FORMULATIONS[method.formulation], baumgarte, size,
            method.stabilisation == 'independent', self._effects.laws)
        self._table = self._effects.bind(self.system)
        self._accounts = Accounts(self._effects)
        nv = len(self.mechanism.joints)
        self._state = np.zeros(number_of_states(self.system))
        self._q, self._qd = self._state[:nv], self._state[nv:2 * nv]
        self._own = self._state[2 * nv:]
        self._assembler = Assembler(self.mechanism, model, self.system.work, size)
        self._actuated = np.array([k for k, joint in enumerate(self.mechanism.joints)
                                   if joint.actuated], dtype=int)
        self._passive = np.array([k for k, joint in enumerate(self.mechanism.joints)
                                  if not joint.actuated], dtype=int)
        self._points = {point.name: point for point in self.mechanism.points}
        self._initial = self._assembled(
            scene.initial.position, scene.initial.velocity, scene.initial.hold)
        if method.stabilisation == 'independent':
            self._assembler.require_independent(self._initial[0])
        self._time_base, self._steps, self._fresh = 0.0, 0, False

    # Names and sizes.

    @property
    def joint_names(self):
        """Names of the joints, in the order of positions and velocities."""
        return self.mechanism.joint_names

    @property
    def actuated_joints(self):
        """Names of the actuated joints, in the order of torque sequences."""
        return self.mechanism.actuated_joints

    @property
    def cut_joints(self):
        """Return the cut joints, in the order of the constraint forces."""
        return self.mechanism.cut_joints

    @property
    def step_size(self):
        """Step size [s]."""
        return self.scene.method.step_size

    # The state.

    @property
    def time(self):
        """Time since the start or the last reset [s]."""
        # Counted, not summed: an hour of steps adds up to an hour.
        return self._time_base + self._steps * self.step_size

    @property
    def position(self):
        """Joint coordinates, shape (nv,) [rad or m]."""
        return self._q.copy()

    @property
    def velocity(self):
        """Joint rates, shape (nv,) [rad/s or m/s]."""
        return self._qd.copy()

    @property
    def effort(self):
        """Joint torques applied last, behind the drives, shape (nv,) [N m or N]."""
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
        """Lagrange multipliers of the present state, shape (nc,) [N, N m]."""
        self._evaluate()
        return self.system.lam.copy()

    @property
    def constraint_forces(self):
        """
        Wrenches at the cut joints, shape (number of cuts, 3): moment, force x, force y.

        What body B exerts on body A, in world axes, at body A's cut point [N m, N].

        """
        self._evaluate()
        out = np.zeros((len(self.cut_joints), 3))
        first = 0
        for wrench, cut in zip(out, self.cut_joints):
            lam = self.system.lam[first:first + CUT_JOINT_EQUATIONS[cut.type]]
            first += len(lam)
            if cut.type == PRISMATIC:
                angle = self.system.work.body[self._rows[cut.body_b], t.ALPHA] + cut.angle
                wrench[:] = lam[1], -math.sin(angle) * lam[0], math.cos(angle) * lam[0]
            else:
                wrench[1:] = lam[:2]
                wrench[0] = 0.0 if cut.type == REVOLUTE else lam[2]
        return out

    @property
    def closure(self):
        """Largest closure error of positions [m or rad]."""
        self._evaluate()
        return float(largest(self.system.work.closure))

    @property
    def energy(self):
        """Kinetic energy and energy stored in gravity and effects [J]."""
        return sum(self._energies())

    @property
    def energy_balance(self):
        """Energy balance since the last reset, an ``effects.accounts.EnergyBalance`` [J]."""
        self._open_accounts()
        self._accounts.settle(self._q, self.system.tau)
        return self._accounts.balance(self._own, *self._energies())

    def _open_accounts(self):
        """Find the energy at the start, when it is needed for the first time."""
        if self._accounts.started:
            return
        present = self._state.copy()
        self._q[:], self._qd[:] = self._initial
        self._own[:] = self._effects.initial
        self._fresh = False
        self._accounts.start(self.energy)
        self._state[:] = present
        self._fresh = False

    def _feel_loads(self):
        """Let effects that are driven by the reaction in a joint start with what it is."""
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
        model, work = self.system.model, self.system.work
        return (energy.kinetic_energy(model, work, self._qd),
                energy.potential_energy(model, work) + self._effects.stored())

    @property
    def body_poses(self):
        """Poses of the bodies, shape (nb, 3): x, y [m], angle [rad], in the bodies' order."""
        self._evaluate()
        rows = [self._rows[body.name] for body in self.mechanism.bodies]
        return self.system.work.body[np.ix_(rows, (t.PX, t.PY, t.ALPHA))]

    def point(self, name):
        """Return the world place of a named point, shape (2,) [m]."""
        point = self._named_point(name)
        self._evaluate()
        out = np.zeros(2)
        kinematics.point_position(self.system.work, self._rows[point.body], *point.position, out)
        return out

    def _named_point(self, name):
        if name not in self._points:
            raise SimulationError(
                f'There is no point {name!r} on {self.mechanism.name}; its points: '
                f'{", ".join(self._points) or "none"}.')
        return self._points[name]

    @property
    def health(self):
        """How well posed the equations of motion are in the present state: a ``Health``."""
        self._evaluate()
        return health_of(
            self.system.model, self.system.work, self._q, self._qd, self._passive)

    def measured(self):
        """
        Return what the scene's sensors show of the present state; the true one without any.

        Returns
        -------
        position, velocity : ndarray, shape (nv,)

        """
        position, velocity = self._effects.measure(self.time, self._q, self._qd)
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

    def _assembled(self, position, velocity, hold):
        nv = len(self.joint_names)
        q = vector('position', position, nv)
        qd = np.zeros(nv) if velocity is None else vector('velocity', velocity, nv)
        # The assembler works in the same workspace, whether it succeeds or not.
        self._fresh = False
        q = self._assembler.positions(q, hold)
        return q, self._assembler.velocities(q, qd, hold)

    def _evaluate(self):
        """Evaluate the present state once for all that is asked of it."""
        if not self._fresh:
            self._table.states[:] = self._own
            evaluate(self.system, self._q, self._qd)
            self._fresh = True


def vector(name, values, length):
    """
    Return finite numbers as a new array.

    Parameters
    ----------
    name : str
        What they are, for the error message.
    values : sequence
        Of numbers.
    length : int
        How many are expected.

    Returns
    -------
    ndarray, shape (length,)

    Raises
    ------
    ValueError

    """
    array = np.array(values, dtype=float, order='C')
    # The sum of squares is finite where all are, and quicker to tell; it may overflow alone.
    if array.shape != (length,) or not (
            math.isfinite(array.dot(array)) or np.isfinite(array).all()):
        raise ValueError(f'{name}: expected {length} finite numbers, got {values!r}')
    return array
