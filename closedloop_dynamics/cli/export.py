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

"""``closedloop export``: a mechanism with its loops in MJCF or URDF."""

from dataclasses import asdict
from pathlib import Path

from .command import Command, require_free, UsageError
from ..effects.registry import effect_type
from ..formats.writing import JOINT_EFFECTS, WRITERS
from ..simulation.scene import load_scene_or_mechanism


def _add_arguments(parser):
    parser.add_argument('scene', metavar='SCENE',
                        help='a shipped scene or mechanism by its name, a YAML file, or a model')
    parser.add_argument('--output', metavar='FILE', type=Path, required=True,
                        help=f'where to write it; a name that ends with {", ".join(WRITERS)} '
                             'tells the format')
    parser.add_argument('--overwrite', action='store_true', help='replace FILE if it exists')


def _run(arguments):
    write = WRITERS.get(arguments.output.suffix.lower())
    if write is None:
        raise UsageError(f'--output: expected a name that ends with one of {", ".join(WRITERS)}, '
                         f'got {str(arguments.output)!r}')
    require_free(arguments, arguments.output)
    subject = load_scene_or_mechanism(arguments.scene)
    mechanism = getattr(subject, 'mechanism', subject)
    effects = {name: {'type': effect_type(effect), **asdict(effect)}
               for name, effect in getattr(subject, 'effects', {}).items()}
    text = write(mechanism, effects)
    arguments.output.write_text(text, encoding='utf-8')
    print(f'{arguments.output}: {len(mechanism.bodies)} bodies, {len(mechanism.joints)} joints, '
          f'{len(mechanism.cut_joints)} that close loops')
    left_out = [name for name, values in effects.items()
                if values['type'] not in ('gravity', *JOINT_EFFECTS)]
    if left_out:
        print(f'left out: the effects {", ".join(left_out)}')
    return 0


COMMAND = Command(
    name='export',
    summary='write a mechanism with its loops in another format (MJCF, URDF)',
    description="""\
Write a mechanism for other programs: MJCF, whose equalities close the loops in
MuJoCo, or URDF with elements loop and constraint (URDF+, and proposed for URDF).
Joints of several freedoms that a format does not have become several joints. Of the
effects of a scene, gravity and what acts on joints is written. For a robot
description without loops, to show it, see closedloop urdf.
""",
    epilog="""\
examples:
  closedloop export three_rrr --output three_rrr.xml
  closedloop export my_robot.yaml --output my_robot.urdf
""",
    add_arguments=_add_arguments,
    run=_run)
