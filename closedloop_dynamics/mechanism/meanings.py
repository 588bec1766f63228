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

"""Meanings and units of a record's fields, from its docstring."""

import inspect
import re


def documented(record_type):
    """
    Return the type and the meaning of each field in a numpydoc docstring.

    Returns
    -------
    dict of str to tuple of str
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
