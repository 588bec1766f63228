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

"""The variables of a sweep's results: the same names, shapes and units in every kind of file."""

from dataclasses import dataclass, field
import json
import math
from typing import Optional, Tuple

import numpy as np

from .batch import DONE, FAILED
from .plan import Plan
from .. import __version__

SAMPLE, TIME, JOINT, CUT, COMPONENT = 'sample', 'time', 'joint', 'cut_joint', 'component'
POINT, AXIS = 'point', 'axis'
COMPONENTS, AXES = ('moment', 'x', 'y'), ('x', 'y')
STATUS, REASON, LONGEST_REASON = 'status', 'reason', 400
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


@dataclass(frozen=True)
class Variable:
    """
    One array of a file of results.

    Attributes
    ----------
    name : str
    dimensions : tuple of str
        Names; the sample comes first where there is one value for each.
    attributes : dict
        Unit and meaning, by the conventions of NetCDF.
    kind : type
        float, int (of 8 bits) or str.
    length : int
        Most characters of a text.
    values : sequence, optional
        What it holds from the beginning.

    """

    name: str
    dimensions: Tuple[str, ...]
    attributes: dict = field(default_factory=dict)
    kind: type = float
    length: int = 1
    values: Optional[object] = None


class Layout:
    """
    The variables of a sweep, and the sizes and names of their dimensions.

    Attributes
    ----------
    plan : Plan
    batch : int
        Samples that are written at once.
    identity : dict of str to str
        What a file must have in common with the plan to be continued.
    samples : int
    variables : tuple of Variable
    results : tuple of str
        Names of those that a batch brings.
    sizes : dict of str to int
        Of all dimensions but the sample.

    """

    def __init__(self, plan: Plan, batch):
        """Collect names and sizes."""
        mechanism = plan.scene.mechanism
        self.plan, self.batch, self.identity = plan, batch, plan.identity()
        self.samples = plan.samples
        names = {JOINT: mechanism.joint_names,
                 CUT: tuple(cut.name for cut in mechanism.cut_joints), COMPONENT: COMPONENTS}
        if 'points' in plan.keep:
            names |= {POINT: tuple(point.name for point in mechanism.points), AXIS: AXES}
        self.sizes = {TIME: plan.schedule.instants,
                      **{name: len(places) for name, places in names.items()}}
        longest = max((len(word) for words in names.values() for word in words), default=1)
        kept = {**{name: MOTION[name] for name in plan.keep}, **SUMMARY}
        self._keys, self.results = tuple(each.key for each in plan.variations), tuple(kept)
        self.variables = (
            Variable(TIME, (TIME,), {'units': 's', 'long_name': 'time since the start'},
                     values=plan.times),
            *(Variable(name, (name,), {}, str, longest, words) for name, words in names.items()),
            Variable(REASON, (SAMPLE,), {'long_name': 'why a sample failed'}, str,
                     LONGEST_REASON),
            *(Variable(key, (SAMPLE,), {'long_name': f'varied: {key}'}) for key in self._keys),
            *(Variable(name, (SAMPLE, *dimensions), {'units': unit, 'long_name': meaning})
              for name, (dimensions, unit, meaning) in kept.items()),
            Variable(STATUS, (SAMPLE,), {
                'flag_values': np.array([DONE, FAILED], dtype=np.int8),
                'flag_meanings': 'done failed',
                'long_name': '1 done, 2 failed, all else: not run'}, int))

    def columns(self, batch):
        """Return what a batch brings beside its status, by the names of variables."""
        columns = dict(zip(self._keys, self.plan.values(batch.samples).T))
        columns.update((name, batch.values[name]) for name in self.results)
        if any(batch.reasons):
            columns[REASON] = batch.reasons
        return columns

    def attributes(self):
        """Return what a file says of itself as a whole."""
        scene = self.plan.scene
        return {
            'title': f'sweep of {scene.name}: {scene.description}'.strip(': '),
            'source': f'closedloop_dynamics {__version__}',
            'mechanism': scene.mechanism.name,
            'sweep': json.dumps(self.identity)}

    def bytes_per_sample(self):
        """Return how much the results of one sample take in memory [B]."""
        return sum(8 * math.prod(self.sizes[name] for name in variable.dimensions[1:])
                   for variable in self.variables if variable.name in self.results)
