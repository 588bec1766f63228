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

"""Hard cases: springs, dampers and contacts far too stiff for the step."""

from dataclasses import replace
import math

from .hard_case import Case
from .hard_machines import bar, G, gravity, hinge
from ..effects.contact import Contact
from ..effects.joint_damping import JointDamping
from ..effects.joint_spring import JointSpring
from ..mechanism.mechanism import Body, Mechanism, Point
from ..simulation.errors import StiffnessError
from ..simulation.scene_records import Initial, Method, Scene
from ..simulation.simulation import Simulation

GROUP = 'Stiffness'
STEP = 1e-3
# Energy that may appear, relative.
BOUNDED = 1e-2


def _pendulum(bodies, joints, method, effects, points=()):
    mechanism = Mechanism('pendulum', bodies, joints, points=points)
    at_rest = (0.0,) * len(joints)
    return Simulation(Scene('pendulum', None, '', mechanism, Initial(at_rest, at_rest),
                            {**gravity(0.0), **effects}, method))


def _nearly_rigid(effect):
    """Let two bars, joined by something very stiff, swing like one for a second."""
    def run(method, quick):
        upper, lower = bar('upper', 1.0, 1.0), bar('lower', 2.0, 0.5)
        pivot = hinge('pivot', 'ground', 'upper')
        both = _pendulum((upper, lower), (pivot, hinge('knee', 'upper', 'lower', 1.0)),
                         replace(method, step_size=STEP, tolerance=1e-5), {'stiff': effect})
        center = (0.5 + 2.0 * 1.25) / 3.0
        inertia = (upper.inertia + (0.5 - center) ** 2
                   + lower.inertia + 2.0 * (1.25 - center) ** 2)
        one = _pendulum((Body('upper', 3.0, (center, 0.0), inertia),), (pivot,),
                        Method(step_size=STEP), {})
        worst = 0.0
        for _ in range(50):
            both.step(duration=0.02)
            one.step(duration=0.02)
            worst = max(worst, abs(both.position[0] - one.position[0]))
        return worst
    return run


def _bounded(method, quick):
    """
    Let a bar swing on springs for which a step is 0.1 to 100 radians: no energy may appear.

    Refused where any of them is: the worst of the others must be no more than stable then.

    """
    worst, refusal = 0.0, None
    for radians in (0.1, 1.0, 10.0, 100.0):
        # The bar's inertia about its end is 1/3 kg m^2.
        spring = JointSpring('pivot', (radians / STEP) ** 2 / 3.0, 1e-3)
        try:
            simulation = _pendulum(
                (bar('bar', 1.0, 1.0),), (hinge('pivot', 'ground', 'bar'),),
                replace(method, step_size=STEP, tolerance=1e-5), {'spring': spring})
        except StiffnessError as error:
            refusal = error
            continue
        start = simulation.energy
        for _ in range(50):
            simulation.step(duration=0.02)
            worst = max(worst, (simulation.energy - start) / (G + spring.stiffness * 1e-6))
    if refusal is not None and worst <= BOUNDED:
        raise refusal
    return worst


def _touch_down(method, quick):
    """Let a bar fall on a hard floor, and come to rest there."""
    simulation = _pendulum(
        (bar('bar', 1.0, 1.0),), (hinge('pivot', 'ground', 'bar'),),
        replace(method, step_size=STEP, tolerance=1e-5),
        {'floor': Contact('tip', (0.0, -0.5), 1e9, damping=2.0)},
        (Point('tip', 'bar', (1.0, 0.0)),))
    simulation.step(duration=3.0)
    return abs(simulation.position[0] + math.pi / 6.0)


CASES = (
    Case('spring 1e9 N m/rad', GROUP,
         'Two bars joined by a spring of 1e9 N m/rad swing like one, within 1 %, in steps of 1 '
         'ms.',
         'error of the slow motion [rad]', 1e-2, 0.1,
         _nearly_rigid(JointSpring('knee', 1e9, 0.0))),
    Case('damper 1e6 N m s/rad', GROUP,
         'The same with a damper of 1e6 N m s/rad.',
         'error of the slow motion [rad]', 1e-2, 0.1,
         _nearly_rigid(JointDamping('knee', 1e6))),
    Case('contact 1e9 N/m', GROUP,
         'A bar falls on a floor of 1e9 N/m and comes to rest on it, steps of 1 ms.',
         'error of the angle at rest [rad]', 1e-2, 0.1, _touch_down),
    Case('step of 0.1 to 100 rad', GROUP,
         'A bar on springs so stiff that a step of 1 ms is 0.1, 1, 10 and 100 radians of its '
         'swing: no energy appears.',
         'energy that appeared, relative', 1e-3, BOUNDED, _bounded),
)
