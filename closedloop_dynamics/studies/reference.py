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

"""The motion that errors are measured against, proven by a second method."""

from dataclasses import dataclass, replace

from .trajectory import Difference, difference, record, Trajectory
from ..errors import SimulationError
from ..integration.registry import ADAPTIVE, INTEGRATORS, STABILISATIONS
from ..simulation import Simulation

# The first that succeeds is the reference, the second one proves it: an integrator, and its
# tolerance or its share of the time between two outputs as step size.
CANDIDATES = (('dop853', 1e-13), ('dopri5', 1e-13), ('rk4', 1e-3), ('rodas4', 1e-11))
# An independent way to keep the loops closed, compared for information.
OTHER_STABILISATION = 'independent'
PATIENCE = 10.0


@dataclass(frozen=True)
class Reference:
    """
    A motion computed as exactly as it goes.

    Attributes
    ----------
    trajectory : Trajectory
    error : Difference
        From the motion of the second method: its own error is of this size.
    description : str
        What it was computed with, in sentences.

    """

    trajectory: Trajectory
    error: Difference
    description: str


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

    Returns
    -------
    Reference

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
            found.append((_named(integrator, value, interval), _motion(
                scene, torque, interval, outputs, integrator, value, 'projection')))
        except SimulationError as error:
            failures.append(f'{_named(integrator, value, interval)}: {error}')
    if len(found) < 2:
        raise SimulationError(
            'There is nothing to measure errors against: fewer than two methods get through '
            f'{interval * outputs:g} s of this scene at tight tolerance. Take a shorter duration '
            'or smaller torques.\n' + '\n'.join(failures))
    (name, reference), (other, proof) = found
    own = difference(reference, proof)
    lines = [
        f'Reference: {name}; proven by {other}: they differ by {own.position:.1e} rad or m, '
        f'{own.velocity:.1e} rad/s or m/s, {own.force:.1e} N or N m. Smaller errors cannot be '
        'told.', *_other_stabilisation(
            scene, torque, interval, outputs, reference, name), *failures]
    return Reference(reference, own, '\n'.join(lines))


def _other_stabilisation(scene, torque, interval, outputs, reference, name):
    """Say how much another stabilisation changes, where it gets through."""
    if OTHER_STABILISATION not in STABILISATIONS:
        return []
    integrator, value = next(item for item in CANDIDATES if name.startswith(item[0]))
    try:
        other = _motion(scene, torque, interval, outputs, integrator, value, OTHER_STABILISATION)
    except SimulationError:
        return []
    change = difference(reference, other)
    return [f'With {OTHER_STABILISATION} instead of projection it changes by '
            f'{change.position:.1e} rad or m.']


def _named(integrator, value, interval):
    if INTEGRATORS[integrator].kind == ADAPTIVE:
        return f'{integrator} at tolerance {value:g}'
    return f'{integrator} in steps of {value * interval:g} s'


def _motion(scene, torque, interval, outputs, integrator, value, stabilisation):
    """Return the trajectory of one method at its tightest."""
    adaptive = INTEGRATORS[integrator].kind == ADAPTIVE
    steps = 1 if adaptive else round(1.0 / value)
    method = replace(
        scene.method, integrator=integrator, step_size=interval / steps,
        tolerance=value if adaptive else scene.method.tolerance, stabilisation=stabilisation,
        formulation='subsystem', baumgarte_time_constant=None, accuracy=None)
    simulation = Simulation(replace(scene, method=method))
    return record(simulation, simulation.joint_torques(torque), steps, outputs, PATIENCE)
