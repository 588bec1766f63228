# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Meanings and units of a record's fields, from its docstring."""

import inspect
import re


def documented(record_type):
    """
    Return the type and the meaning of each field in a numpydoc docstring.

    Empty where Python has left the docstrings out (``-OO``).
    """
    text = (inspect.getdoc(record_type) or '').partition('----------\n')[2]
    found = {}
    for names, kind, below in re.findall(r'^(\w[\w, ]*) : (.*)\n((?:    .*\n?)*)', text, re.M):
        for name in names.split(', '):
            found[name] = kind, ' '.join(below.split())
    return found


def unit_in(meaning):
    """Return the first unit that a meaning names in brackets, such as ``N/m``; '' without one."""
    found = re.search(r'\[([^\]]*)\]', meaning)
    return found.group(1) if found else ''
