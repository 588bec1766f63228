# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Elements of URDF and SDF that are not read: those that move bodies, with their size."""

from collections import Counter
import math
import re

from .model import Omission

# Tags of elements that affect the motion, and why they are left out.
MOVING = {
    'velocity_decay': 'damping of velocities acts on no real body',
    'dampingFactor': 'damping of velocities acts on no real body',
    'fluid_added_mass': 'no effect has the inertia of a fluid',
    'kinematic': 'forces move every body that is not static',
    'initial_position': 'a scene states where joints start',
    'state': 'a scene states where joints start',
    'enable_wind': 'a file has no wind of its own',
    'drake:linear_bushing_rpy': 'bushings close no loops',
    'drake:controller_gains': 'commands are torques and forces of joints'}
# Programs that act on bodies by themselves, by their names.
PROGRAMS = re.compile('hydrodynamic|buoyan|drag|wind|thrust|propel|rotor|force|torque|spring|damp',
                      re.IGNORECASE)
NUMBER = re.compile(r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?')
OFF = ('', 'false')
# What has numbers, but no size.
WITHOUT_SIZE = ('plugin', 'state')
# Elements that are reported by their names.
OWNERS = ('link', 'joint', 'gazebo', 'model')


def leave_out(model, root, reasons):
    """
    Report the parts of a file that were not read as left out of a model.

    ``root``: the outermost element, after all has been read; ``reasons``: by tag, the reason for
    omitting an element without influence on the motion.
    """
    counts = Counter()
    for label, value, above in root.unasked():
        tag, _, key = label.partition('@')
        reason = MOVING.get(label)
        if key and tag == 'dynamics' or above[-1].tag == 'dynamics':
            reason = 'not known to this reader'
        elif label == 'plugin' and PROGRAMS.search(' '.join(value.attributes.values())):
            reason = 'programs are not run'
        words = value if key else ' '.join(_words(value))
        sizes = () if label in WITHOUT_SIZE else map(abs, map(float, NUMBER.findall(words)))
        size = max(sizes, default=math.inf)
        if reason is None or not size or label != 'plugin' and words.strip() in OFF:
            counts[label] += 1
            continue
        owner = next((one for one in reversed(above) if one.tag in OWNERS), above[-1])
        name = owner.attributes.get('name') or owner.attributes.get('reference') or model.name
        model.omitted.append(Omission(key or tag, owner.tag, name, reason, size))
    model.ignore(counts, reasons)


def _words(element):
    """Yield the contents of an element, text or attributes ``value``."""
    yield element.text
    yield element.attributes.get('value', '')
    for child in element.children:
        yield from _words(child)
