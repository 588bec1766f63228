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

"""What an accuracy study found, for people: a table, a CSV file, the diagram, a title."""

import math

from .tables import markdown_table, seconds, short, text_table, write_csv
from .work_precision_picture import work_precision

HEADER = ('integrator', 'stabilisation', 'formulation', 'step or tol.', 'positions', 'velocities',
          'forces', 'closure', 'energy [J]', 'evaluations/s', 'CPU time/s')
CSV_HEADER = (
    'integrator', 'stabilisation', 'formulation', 'step_size', 'tolerance', 'position_error',
    'velocity_error', 'force_error', 'closure', 'energy_error', 'evaluations_per_second',
    'cpu_time_per_second', 'failure')


def title(study):
    """Return what was studied, on one line."""
    driven = ', '.join(f'{joint} = {value:g}' for joint, value in study.torque.items() if value)
    return f'{study.scene.name}, {study.duration:g} s, ' + (
        f'driven by {driven} N m' if driven else 'without torques')


def table(study, rows=None, markdown=False):
    """
    Return the rows of a study as a table.

    Parameters
    ----------
    study : Study
        What has been measured.
    rows : list of Row, optional
        Some of its rows; all of them when not given.
    markdown : bool
        For a document instead of a terminal.

    Returns
    -------
    str

    """
    make = markdown_table if markdown else text_table
    return make(HEADER, [_cells(row) for row in (study.rows if rows is None else rows)])


def _cells(row):
    line = row.line
    value = f'{row.setting.value:g}' + ('' if line.adaptive else ' s')
    start = (line.integrator, line.stabilisation, line.formulation, value)
    if row.failure:
        # The first sentence says what happened.
        return (*start, row.failure.split('; ')[0].split('. ')[0], *[''] * 6)
    return (*start, short(row.position_error), short(row.velocity_error),
            short(row.force_error), short(row.closure), short(row.energy_error),
            f'{row.evaluations:.0f}', seconds(row.cost))


def write(study, csv_path, picture_path):
    """
    Write the rows and the work-precision diagram.

    Parameters
    ----------
    study : Study
        What has been measured.
    csv_path, picture_path : pathlib.Path
        Replaced if they exist.

    """
    write_csv(csv_path, CSV_HEADER, [_csv_row(row) for row in study.rows])
    work_precision(study, title(study)).savefig(picture_path)


def _csv_row(row):
    line, nothing = row.line, math.nan
    return (line.integrator, line.stabilisation, line.formulation,
            nothing if line.adaptive else row.setting.value,
            row.setting.value if line.adaptive else nothing, row.position_error,
            row.velocity_error, row.force_error, row.closure, row.energy_error, row.evaluations,
            row.cost, row.failure)
