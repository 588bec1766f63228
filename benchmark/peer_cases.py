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
What all simulators are given: a mechanism, a start, torques; and the answer they should give.

Everything is read from the shipped scenes, nothing is copied by hand.

"""

from dataclasses import dataclass, replace
import sys
from typing import Callable

from machine import ROOT
import numpy as np

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.core import kinematics, loop_closure, types as t  # noqa: E402,I100
from closedloop_dynamics.integration.system import evaluate  # noqa: E402
from closedloop_dynamics.simulation.scene import load_scene  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402

# What computes the answer, and what confirms it: an integrator and its tolerance.
REFERENCES = (('dop853', 1e-13), ('dopri5', 1e-13))


@dataclass(frozen=True)
class Case:
    """
    A motion to be computed.

    Attributes
    ----------
    name : str
    scene : scene.Scene
        With gravity as its only effect.
    tau : ndarray, shape (nv,)
        Constant joint torques [N m].
    duration : float
        [s].
    q, qd : ndarray, shape (nv,)
        Start: assembled, the loops closed to rounding.
    end : ndarray, shape (nv,)
        Joint coordinates at the end, as exactly as it goes [rad].
    uncertainty : float
        What two methods disagree by at the end [rad].

    """

    name: str
    scene: object
    tau: np.ndarray
    duration: float
    q: np.ndarray
    qd: np.ndarray
    end: np.ndarray
    uncertainty: float


@dataclass(frozen=True)
class Run:
    """
    One way to compute a motion.

    Attributes
    ----------
    engine, line, setting : str
        Simulator; integrator and how it is called; step size or tolerance.
    execute : callable
        Computes the motion from its start, returns the joint coordinates at its end.
    prepare : callable, optional
        Called before each ``execute``, not timed.

    """

    engine: str
    line: str
    setting: str
    execute: Callable
    prepare: Callable = None


def gravity(scene):
    """Return the acceleration of gravity of a scene that has no other effect [m/s^2]."""
    effects = list(scene.effects.values())
    if [type(effect).__name__ for effect in effects] != ['Gravity']:
        raise ValueError(f'{scene.name}: expected gravity alone, got {list(scene.effects)}')
    return effects[0].acceleration


def simulation(scene, integrator, value, duration, adaptive=True):
    """Return a simulation with one method: a tolerance, or a step size [s]."""
    keys = {'step_size': duration, 'tolerance': value} if adaptive else {'step_size': value}
    return Simulation(replace(
        scene, method=replace(scene.method, integrator=integrator, **keys)))


def build_case(name, scene_name, torque, duration):
    """Return a case with its answer, computed by two methods."""
    scene = load_scene(scene_name)
    gravity(scene)
    ends = []
    for integrator, tolerance in REFERENCES:
        run = simulation(scene, integrator, tolerance, duration)
        start = run.position, run.velocity
        tau = run.joint_torques(torque)
        run.advance(tau, 1)
        ends.append(run.position)
    return Case(name, scene, tau, duration, *start, ends[0],
                float(np.abs(ends[0] - ends[1]).max()))


def random_states(scene, count, seed=1):
    """
    Return assembled states around a scene's start, with random rates and torques.

    Parameters
    ----------
    scene : scene.Scene
        Where the states are near.
    count : int
        How many.
    seed : int
        Of the choice.

    Returns
    -------
    list of (q, qd, tau), each of shape (nv,)

    """
    rng = np.random.default_rng(seed)
    run = Simulation(scene)
    nv = len(run.joint_names)
    states = []
    for _ in range(count):
        guess = np.array(scene.initial.position) + rng.uniform(-0.1, 0.1, nv)
        run.set_state(guess, rng.uniform(-2.0, 2.0, nv))
        states.append((run.position, run.velocity, rng.uniform(-5.0, 5.0, nv)))
    return states


class Referee:
    """Our own view of any simulator's state: closure error, poses, accelerations."""

    def __init__(self, scene):
        """Build the mechanism."""
        self.simulation = Simulation(scene)
        self.mechanism = scene.mechanism

    def acceleration(self, q, qd, tau):
        """Return our joint accelerations, shape (nv,)."""
        system = self.simulation.system
        system.tau[:] = tau
        evaluate(system, q, qd)
        return system.qdd.copy()

    def closure(self, q):
        """Return the largest closure error [m]."""
        system = self.simulation.system
        kinematics.outward(system.model, q, np.zeros(len(q)), system.work)
        loop_closure.update(system.model, system.work, loop_closure.NO_RESPONSES)
        return float(np.abs(system.work.closure).max())

    def poses(self, q, qd):
        """Return {body: (pose, velocity)} of the centres of mass: x, y, angle each."""
        system = self.simulation.system
        kinematics.outward(system.model, q, qd, system.work)
        result, row = {}, 0
        for j in self.simulation.decomposition.joint_order:
            row += 1
            name = self.mechanism.joints[j].child
            x, y = next(b.center_of_mass for b in self.mechanism.bodies if b.name == name)
            b = system.work.body[row]
            rx, ry = b[t.COS] * x - b[t.SIN] * y, b[t.SIN] * x + b[t.COS] * y
            result[name] = (
                (b[t.PX] + rx, b[t.PY] + ry, b[t.ALPHA]),
                (b[t.VX] - b[t.OMEGA] * ry, b[t.VY] + b[t.OMEGA] * rx, b[t.OMEGA]))
        return result
