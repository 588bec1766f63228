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
The command ``closedloop``: one file for each of its commands.

It watches for signals before it imports its commands: that takes seconds, and Ctrl-C must not end
in a traceback there either.

"""

from ..simulation.signals import program_watch


def main(argv=None):
    """
    Run ``closedloop``.

    Parameters
    ----------
    argv : list of str, optional
        Arguments without the program's name; ``sys.argv[1:]`` when not given.

    """
    from .commands import run
    return run(argv)


def program():
    """Run ``closedloop`` as this process; return its exit code."""
    program_watch.install()
    code = main()
    program_watch.ignore()
    return code
