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

"""
Simulated motions as arrays, and the one that errors are measured against.

The motions that prove the reference share as little as possible with it: another integrator, which
beside singular configurations looks at other places of the branch; and independent coordinates,
where they get through.

"""

from dataclasses import dataclass, replace
import time

import numpy as np

from ..integration.registry import ADAPTIVE, INTEGRATORS
from ..integration.system import ASIDE
from ..simulation.errors import SimulationError
from ..simulation.simulation import Simulation


class TooSlow(SimulationError):
    """A run that was given up because it took too long."""


@dataclass(frozen=True)
class Trajectory:
    """A motion at even times."""

    # Shape (outputs, nv) [rad or m], [rad/s or m/s].
    position: np.ndarray
    velocity: np.ndarray
    # Shape (outputs, nc): multipliers: forces and moments at the cut joints [N, N m].
    force: np.ndarray
    closure: float  # Largest closure error of positions at the outputs [m or rad]
    energy_error: float  # Largest residual of the energy balance at the outputs [J]

    def every(self, stride):
        """Return every ``stride``-th output alone, the first one counted as ``stride``."""
        part = slice(stride - 1, None, stride)
        return Trajectory(self.position[part], self.velocity[part], self.force[part],
                          self.closure, self.energy_error)


@dataclass(frozen=True)
class Difference:
    """Largest differences of two motions: positions, velocities, constraint forces."""

    position: float
    velocity: float
    force: float


def difference(one, other):
    """Compare two motions."""
    return Difference(*(
        float(np.abs(getattr(one, name) - getattr(other, name)).max(initial=0.0))
        for name in ('position', 'velocity', 'force')))


def record(simulation, tau, steps, outputs, patience=float('inf')):
    """
    Advance from the initial state and keep the state at even times.

    Parameters
    ----------
    simulation : Simulation
        Reset here.
    tau : ndarray, shape (nv,)
        Constant joint torques [N m or N].
    steps : int
        Whole steps from one output to the next.
    outputs : int
        How often.
    patience : float
        Give up after this time of computing [s].

    Raises
    ------
    SimulationError
        ``TooSlow`` among them.

    """
    # Compiling, half a minute in a new installation, does not count as computing time.
    simulation.reset()
    simulation.advance(tau, 0)
    position, velocity, force, closure, energy_error = [], [], [], 0.0, 0.0
    begin = time.perf_counter()
    for _ in range(outputs):
        simulation.advance(tau, steps)
        position.append(simulation.position)
        velocity.append(simulation.velocity)
        force.append(simulation.multipliers)
        closure = max(closure, simulation.closure)
        energy_error = max(energy_error, abs(simulation.energy_balance.residual))
        if time.perf_counter() - begin > patience:
            raise TooSlow(f'given up at t = {simulation.time:.3g} s after {patience:g} s of '
                          'computing')
    return Trajectory(np.array(position), np.array(velocity), np.array(force), closure,
                      energy_error)


# The first that succeeds is the reference, the second one proves it: an integrator, and its
# tolerance or its share of the time between two outputs as step size.
CANDIDATES = (('dop853', 1e-13), ('dopri5', 1e-13), ('rk4', 1e-3), ('rodas4', 1e-11))
# Distance of the places that a proof looks at beside a singular configuration, against that of
# the reference.
NEARER = 0.7
PATIENCE = 10.0


@dataclass(frozen=True)
class Reference:
    """A motion computed as exactly as it goes."""

    trajectory: Trajectory
    # Larger one of the differences from the motions that prove it: its own error is of this
    # size.
    error: Difference
    description: str  # What it was computed with, in sentences


def compute_reference(scene, torque, interval, outputs):
    """
    Compute the reference of a scene under constant torques.

    Parameters
    ----------
    scene : Scene
        Its start and its effects; its method is replaced.
    torque : mapping or None
        As for ``Simulation.step``.
    interval : float
        Time between two outputs [s].
    outputs : int
        Instants to compare at.

    Raises
    ------
    SimulationError
        Where no two methods get through.

    """
    found, failures = [], []
    for integrator, value in CANDIDATES:
        if integrator not in INTEGRATORS or len(found) == 2:
            continue
        try:
            found.append(((integrator, value), _motion(
                scene, torque, interval, outputs, integrator, value, 'projection',
                NEARER if found else 1.0)))
        except SimulationError as error:
            failures.append(f'{_named(integrator, value, interval)}: {error}')
    if len(found) < 2:
        raise SimulationError(
            'There is nothing to measure errors against: fewer than two methods get through '
            f'{interval * outputs:g} s of this scene at tight tolerance. Take a shorter duration '
            'or smaller torques.\n' + '\n'.join(failures))
    (name, value), reference = found[0]
    proofs = {_named(*found[1][0], interval): difference(reference, found[1][1])}
    try:
        proofs['independent coordinates'] = difference(reference, _motion(
            scene, torque, interval, outputs, name, value, 'independent', NEARER))
    except SimulationError as error:
        failures.append(f'{_named(name, value, interval)}, independent: {error}')
    own = Difference(*(max(getattr(proof, each) for proof in proofs.values())
                       for each in ('position', 'velocity', 'force')))
    lines = [
        f'Reference: {_named(name, value, interval)}; proven by {" and ".join(proofs)}: they '
        f'differ by {own.position:.1e} rad or m, {own.velocity:.1e} rad/s or m/s, '
        f'{own.force:.1e} N or N m. Smaller errors cannot be told.', *failures]
    return Reference(reference, own, '\n'.join(lines))


def _named(integrator, value, interval):
    if INTEGRATORS[integrator].kind == ADAPTIVE:
        return f'{integrator} at tolerance {value:g}'
    return f'{integrator} in steps of {value * interval:g} s'


def _motion(scene, torque, interval, outputs, integrator, value, stabilisation, aside):
    """Return the trajectory of one method at its tightest."""
    adaptive = INTEGRATORS[integrator].kind == ADAPTIVE
    steps = 1 if adaptive else round(1.0 / value)
    method = replace(
        scene.method, integrator=integrator, step_size=interval / steps,
        tolerance=value if adaptive else scene.method.tolerance, stabilisation=stabilisation,
        formulation='subsystem', baumgarte_time_constant=None)
    simulation = Simulation(replace(scene, method=method))
    simulation.system.settings[ASIDE] *= aside
    return record(simulation, simulation.joint_torques(torque), steps, outputs, PATIENCE)
