# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The command ``closedloop``: one file for each of its commands.

It watches for signals before it imports its commands: that takes seconds, and Ctrl-C must not end
in a traceback there either.
"""

from ..simulation.signals import program_watch


def main(argv=None):
    """Run ``closedloop``."""
    from .commands import run
    return run(argv)


def program():
    """Run ``closedloop`` as this process; return its exit code."""
    program_watch.install()
    code = main()
    program_watch.ignore()
    return code
