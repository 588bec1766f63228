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

"""``closedloop check``: what a file was understood to be, or what is wrong with it."""

from .command import Command
from ..scene import load_scene_or_mechanism
from ..studies.check import describe


def _add_arguments(parser):
    parser.add_argument(
        'scene', metavar='FILE_OR_SCENE',
        help='a shipped scene or mechanism by its name, or a YAML file')


def _run(arguments):
    print(describe(load_scene_or_mechanism(arguments.scene)))
    return 0


COMMAND = Command(
    name='check',
    summary='read a mechanism or scene and show what was understood',
    description="""\
Read a mechanism or a scene and show what was understood: bodies, joints,
subsystems, cut joints, degrees of freedom, the elimination order, and what a
scene starts from. If something is wrong, say where and what was expected.
""",
    epilog="""\
examples:
  closedloop check four_bar
  closedloop check my/mechanism.yaml
""",
    add_arguments=_add_arguments,
    run=_run)
