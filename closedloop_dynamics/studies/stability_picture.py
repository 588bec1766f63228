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

"""The stability atlas as a picture: hard case by method, coloured by outcome."""

from matplotlib.figure import Figure
from matplotlib.patches import Patch, Rectangle

from .hard_cases import ACCURATE, CASES, DEGRADED, REFUSED, SKIPPED, UNSTABLE
from .stability import METHODS
from ..visual.pictures import DOTS_PER_INCH

# Told apart by colour-blind readers, and by the words in the cells.
OUTCOME_COLORS = {ACCURATE: '#8fd0b5', DEGRADED: '#f3dc82', REFUSED: '#b9c4d4',
                  UNSTABLE: '#d9613c', SKIPPED: '#f4f4f4'}


def stability_atlas(atlas, cases=CASES, methods=METHODS):
    """Draw the atlas."""
    figure = Figure(figsize=(1.35 * len(methods) + 3.4, 0.34 * len(cases) + 2.2),
                    dpi=DOTS_PER_INCH, layout='constrained')
    axes = figure.subplots()
    names = list(methods)
    heights, height, groups = {}, 0.0, {}
    for case in cases:
        if case.group not in groups:
            height += 0.35
            groups[case.group] = height
            height += 0.65
        heights[case.name] = height
        height += 1.0
    for case in cases:
        for column, name in enumerate(names):
            _cell(axes, column, heights[case.name], atlas[case.name, name])
    for group, place in groups.items():
        axes.text(-0.5, place - 0.05, group, fontweight='bold', fontsize=9, va='center',
                  ha='left')
    axes.set_xlim(-0.52, len(names) - 0.48)
    axes.set_ylim(height - 0.45, -0.2)
    axes.set_xticks(range(len(names)), names, fontsize=9)
    axes.xaxis.tick_top()
    axes.set_yticks([heights[case.name] for case in cases], [case.name for case in cases],
                    fontsize=9)
    axes.tick_params(length=0)
    for side in axes.spines.values():
        side.set_visible(False)
    figure.suptitle('Stability atlas: the worst figure of each hard case (meanings: '
                    'doc/stability.md)', fontsize=11)
    figure.legend(handles=[Patch(facecolor=color, label=status)
                           for status, color in OUTCOME_COLORS.items()],
                  loc='outside lower center', ncols=len(OUTCOME_COLORS), frameon=False, fontsize=9)
    return figure


def _cell(axes, column, row, outcome):
    """Draw one cell: a coloured box with the figure in it."""
    axes.add_patch(Rectangle((column - 0.48, row - 0.45), 0.96, 0.9, linewidth=0,
                             facecolor=OUTCOME_COLORS[outcome.status]))
    text = {REFUSED: 'refused', SKIPPED: '-'}.get(outcome.status, f'{outcome.figure:.1e}')
    axes.text(column, row, text, ha='center', va='center', fontsize=8,
              color='white' if outcome.status == UNSTABLE else 'black')
