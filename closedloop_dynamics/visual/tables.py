# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tables for terminals, for Markdown and as CSV."""

import csv
import math


def short(value, form='.2g'):
    """Write a number, to two digits by default; a dash where there is none."""
    return '-' if math.isnan(value) else f'{value:{form}}'


def seconds(value):
    """Write a time with the unit that suits its size."""
    if math.isnan(value):
        return '-'
    for unit, factor in (('s', 1.0), ('ms', 1e3), ('us', 1e6)):
        if value * factor >= 0.995:
            break
    return f'{value * factor:.3g} {unit}'


def share(value):
    """Write a share of real time."""
    return f'{100.0 * value:.2g} % of real time'


def text_table(header, rows):
    """Return left-aligned columns as one string, without a final newline."""
    widths = [max(map(len, column)) for column in zip(header, *rows)]
    return '\n'.join('  '.join(f'{cell:{width}}' for cell, width in zip(row, widths)).rstrip()
                     for row in (header, *rows))


def markdown_table(header, rows):
    return '\n'.join(f'| {" | ".join(row)} |' for row in (
        header, ['---'] * len(header), *rows))


def write_csv(path, header, rows):
    """Write rows with all their digits into a file, replaced; empty cells for NaN."""
    with open(path, 'w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(header)
        for row in rows:
            writer.writerow(['' if isinstance(value, float) and math.isnan(value) else value
                             for value in row])
