# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Columns of numbers from a CSV file that a scene names."""

import csv
from pathlib import Path

from .checks import text
from .fields import FieldError, shown
from .files import read_file

MOST_BYTES = 4_000_000


def read_columns(value, directory, count):
    """
    Return so many columns of a CSV file, tuples of floats.

    ``value`` is its path, from the directory on of the file that names it. A first line of words
    is a heading; empty lines and what follows a # are left out. FieldError names file and line.
    """
    path = Path(directory) / text(value)
    try:
        content = read_file(path, MOST_BYTES)
        lines = content.decode('utf-8-sig').splitlines()
    except (OSError, ValueError) as error:
        raise FieldError('a CSV file that can be read', f'{path}: {error}') from None
    if len(content) > MOST_BYTES:
        raise FieldError(f'a file of at most {MOST_BYTES} bytes', f'a larger one: {path}')
    rows = []
    for number, line in enumerate(lines, 1):
        line = line.partition('#')[0].strip()
        if not line:
            continue
        words = [word.strip() for word in next(csv.reader([line]))]
        try:
            row = tuple(map(float, words))
        except ValueError:
            if rows or number > 1:
                raise FieldError(f'{count} numbers', f'{shown(line)} in {path}:{number}') from None
            continue
        if len(row) != count:
            raise FieldError(f'{count} numbers in a line', f'{len(row)} in {path}:{number}')
        rows.append(row)
    if not rows:
        raise FieldError(f'a file with lines of {count} numbers', f'none in {path}')
    return tuple(zip(*rows))
