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
How many operations an evaluation takes with machine elements that are rows, and without them.

Counted before anything is compiled: additions, subtractions, multiplications, divisions and
negations of the unrolled evaluation. A mechanism without an element takes what it took before
there were any.

"""

from dataclasses import replace
import sys

from machine import ROOT

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.mechanism.mechanism import (  # noqa: E402,I100
    DISTANCE, POINT_ON_LINE)
from closedloop_dynamics.simulation.scene import load_scene  # noqa: E402
from closedloop_dynamics.simulation.tree_choice import count_operations  # noqa: E402
from closedloop_dynamics.visual.tables import text_table  # noqa: E402

SCENES = ('planetary_gear', 'rack_press', 'geared_five_bar', 'scissor_lift', 'differential')


def bare(mechanism):
    """Return a mechanism without couplings, rods and pins in slots."""
    return replace(mechanism, couplings=(), cut_joints=tuple(
        cut for cut in mechanism.cut_joints if cut.type not in (DISTANCE, POINT_ON_LINE)))


def rows():
    """Return name, rows of elements, operations with and without them, and those of each row."""
    found = []
    for name in SCENES:
        mechanism = load_scene(name).mechanism
        without = bare(mechanism)
        elements = mechanism.number_of_equations - without.number_of_equations
        counts = [count_operations(one) for one in (mechanism, without)]
        found.append((name, str(elements), *map(str, counts),
                      f'{(counts[0] - counts[1]) / elements:.0f}'))
    return found


if __name__ == '__main__':
    print(text_table(('mechanism', 'rows', 'operations', 'without', 'for each row'), rows()))
