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

"""What a study of the formulations found: a table, a CSV file, the picture."""

import math

from .formulations import exponent, FAMILIES
from .formulations_picture import growth
from .tables import markdown_table, seconds, short, text_table, write_csv

HEADER = ('mechanism', 'size', 'joints', 'equations', 'formulation', 'time', 'accelerations',
          'forces')
CSV_HEADER = ('mechanism', 'size', 'joints', 'equations', 'formulation', 'time',
              'acceleration_error', 'force_error')


def table(rows, markdown=False):
    """
    Return the rows of a study as a table.

    Parameters
    ----------
    rows : list of formulations.Row
        What has been measured.
    markdown : bool
        For a document instead of a terminal.

    Returns
    -------
    str

    """
    make = markdown_table if markdown else text_table
    return make(HEADER, [_cells(row) for row in rows])


def growth_text(rows):
    """Return the fitted exponents, one line for each family and formulation."""
    lines = []
    for family in FAMILIES:
        for name in dict.fromkeys(row.formulation for row in rows):
            chosen = [row for row in rows if (row.family, row.formulation) == (family, name)]
            power = exponent(chosen)
            if not math.isnan(power):
                lines.append(f'{family}, {name}: time ~ N^{power:.2f} over the largest tenfold')
    return '\n'.join(lines)


def write(rows, csv_path, picture_path):
    """
    Write the rows and the picture.

    Parameters
    ----------
    rows : list of formulations.Row
        What has been measured.
    csv_path, picture_path : pathlib.Path
        Replaced if they exist.

    """
    write_csv(csv_path, CSV_HEADER, [
        (row.family, row.size, row.joints, row.equations, row.formulation, row.time,
         row.acceleration_error, row.force_error) for row in rows])
    growth(rows).savefig(picture_path)


def _cells(row):
    made = seconds(row.time) if not math.isnan(row.time) else 'not made: too long'
    return (row.family, str(row.size), str(row.joints), str(row.equations), row.formulation, made,
            short(row.acceleration_error), short(row.force_error))
