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

"""What a sweep's results are made of: the same names, shapes and units in every kind of file."""

from dataclasses import dataclass
import json
from typing import Tuple

from .plan import Plan
from .. import __version__

SAMPLE, TIME, JOINT, CUT, COMPONENT = 'sample', 'time', 'joint', 'cut_joint', 'component'
POINT, AXIS = 'point', 'axis'
COMPONENTS, AXES = ('moment', 'x', 'y'), ('x', 'y')
JOINTWISE = 'rad or m'

# Variable -> dimensions after the sample, unit, what it is.
MOTION = {
    'position': ((TIME, JOINT), JOINTWISE, 'joint coordinates'),
    'velocity': ((TIME, JOINT), 'rad/s or m/s', 'joint rates'),
    'acceleration': ((TIME, JOINT), 'rad/s^2 or m/s^2', 'joint accelerations'),
    'effort': ((TIME, JOINT), 'N m or N', 'joint torques, behind the drives'),
    'constraint_forces': ((TIME, CUT, COMPONENT), 'N m, N, N',
                          'what body B exerts on body A at the cut joints, world axes'),
    'joint_forces': ((TIME, JOINT, COMPONENT), 'N m, N, N',
                     'what the parent exerts on the child in the joints, world axes'),
    'points': ((TIME, POINT, AXIS), 'm', 'places of the named points'),
    'closure': ((TIME,), JOINTWISE, 'largest closure error of the loops'),
    'energy': ((TIME,), 'J', 'kinetic and stored energy'),
}
SUMMARY = {
    'final_position': ((JOINT,), JOINTWISE, 'joint coordinates at the end'),
    'final_velocity': ((JOINT,), 'rad/s or m/s', 'joint rates at the end'),
    'initial_energy': ((), 'J', 'kinetic and stored energy at the start'),
    'final_energy': ((), 'J', 'kinetic and stored energy at the end'),
    'peak_force': ((CUT,), 'N', 'largest force at the cut joints, over the instants'),
    'peak_moment': ((CUT,), 'N m', 'largest moment at the cut joints, over the instants'),
    'peak_effort': ((JOINT,), 'N m or N', 'largest joint torques, over the instants'),
    'peak_closure': ((), JOINTWISE, 'largest closure error of the loops, over the instants'),
}
LONGEST_REASON = 400


@dataclass(frozen=True)
class Variable:
    """
    One variable of the results, a number for each sample and each place of its dimensions.

    Attributes
    ----------
    name : str
    dimensions : tuple of str
        After the sample.
    unit, meaning : str

    """

    name: str
    dimensions: Tuple[str, ...]
    unit: str
    meaning: str


class Layout:
    """
    The variables of a sweep, and the sizes and names of their dimensions.

    Parameters
    ----------
    plan : Plan
        Of the sweep.
    batch : int
        Samples that are written at once.

    Attributes
    ----------
    plan : Plan
    batch : int
    identity : dict of str to str
        What a file must have in common with the plan to be continued.
    samples : int
    keys : tuple of str
        The varied key paths, each a variable of one number a sample.
    variables : tuple of Variable
        The results.
    names : dict of str to tuple of str
        Of the places of the dimensions joint, cut_joint and component, and of point and axis
        where points are kept.
    sizes : dict of str to int
        Of all dimensions but the sample.

    """

    def __init__(self, plan: Plan, batch):
        """Collect names and sizes."""
        mechanism = plan.scene.mechanism
        self.plan, self.batch, self.identity = plan, batch, plan.identity()
        self.samples = plan.samples
        self.keys = tuple(each.key for each in plan.variations)
        kept = {**{name: MOTION[name] for name in plan.keep}, **SUMMARY}
        self.variables = tuple(Variable(name, *about) for name, about in kept.items())
        self.names = {JOINT: mechanism.joint_names,
                      CUT: tuple(cut.name for cut in mechanism.cut_joints),
                      COMPONENT: COMPONENTS}
        if 'points' in plan.keep:
            self.names |= {POINT: tuple(point.name for point in mechanism.points), AXIS: AXES}
        self.sizes = {TIME: plan.schedule.instants, **{
            name: len(places) for name, places in self.names.items()}}

    def shape(self, variable):
        """Return the shape of a variable for one sample."""
        return tuple(self.sizes[name] for name in variable.dimensions)

    def attributes(self):
        """Return what a file says of itself as a whole."""
        scene = self.plan.scene
        return {
            'title': f'sweep of {scene.name}: {scene.description}'.strip(': '),
            'source': f'closedloop_dynamics {__version__}',
            'mechanism': scene.mechanism.name,
            'sweep': json.dumps(self.identity)}

    def bytes_per_sample(self):
        """Return how much one sample takes in memory [B]."""
        total = 0
        for variable in self.variables:
            size = 8
            for length in self.shape(variable):
                size *= length
            total += size
        return total
