# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Elements of URDF and SDF that are not read: those that move bodies, with their size.

What nobody knows in a link, joint, inertial or frame may move them elsewhere, and is refused.
"""

from collections import Counter
import math
import re

from .model import Omission
from ..mechanism.fields import among
from ..mechanism.mechanism import MechanismError

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
# Programs that act on bodies, join, couple or drive them, by their names; programs that only
# watch; and keys of programs that name what they act on.
PROGRAMS = re.compile(
    'hydrodynamic|buoyan|drag|wind|thrust|propel|rotor|force|torque|spring|damp|attach|detach|'
    'mimic|grasp|grip|vacuum|suction|magnet|weld|fasten|coupl|constrain|joint|link|driv|steer|'
    'motor|wheel|track|actuat|control|disable|convey|velocity|trajector|lift|elevator|break|'
    'ackermann|mecanum|move|teleport|pose', re.IGNORECASE)
WATCHING = re.compile(
    'publish|sensor|camera|imu|laser|lidar|(^|[-_])ray|gps|navsat|p3d|odometry|state|bumper|'
    'altimeter|magnetometer|logger|logging|monitor', re.IGNORECASE)
ACTED_ON = re.compile('joint|link', re.IGNORECASE)
# Elements whose children say where bodies are and how they move, if they are in one of ABOVE.
SPEAKING = ('link', 'joint', 'inertial', 'frame', 'loop', 'constraint', 'loop_joint', 'coupling')
ABOVE = ('link', 'robot', 'model', 'world', 'gazebo', 'sdf')
# Children of these that move nothing, beside those that a reader gives a reason for.
HARMLESS = frozenset((
    'audio_sink', 'audio_source', 'battery', 'light', 'particle_emitter', 'projector', 'sensor',
    'must_be_base_link', 'static', 'self_collide', 'self_collision_checking', 'collision_checking',
    'collision_group', 'self_filter', 'drake:collision_filter_group', 'density',
    'auto_inertia_params', 'contact', 'physics', 'simbody', 'plugin', 'visual', 'collision',
    'material', 'verbose', 'compliance',
    'capsule', 'convex', 'drake:proximity_properties', 'drake:visual', 'hardwareInterface',
    'actuator', 'transmission', 'safety_controller', 'calibration', 'joint_properties', 'log',
    'soft_limits', 'soft_limit', 'surface', 'description', 'comment', 'group', 'meta'))
NUMBER = re.compile(r'[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?')
POSES = ('origin', 'pose')
# Children that are read where something depends on them, and are not where nothing does.
WHERE_NEEDED = {
    'frame': ('pose',),
    'joint': ('axis', 'axis2', 'dynamics', 'gearbox_ratio', 'gearbox_reference_body', 'limit',
              'pose', 'screw_thread_pitch', 'thread_pitch', 'drake:gear_ratio', 'drake:mimic',
              'drake:rotor_inertia', 'mimic')}
OFF = ('', 'false')
# What has numbers, but no size.
WITHOUT_SIZE = ('plugin', 'state')
# Elements that are reported by their names.
OWNERS = ('link', 'joint', 'gazebo', 'model')


def leave_out(model, root, reasons, ignore=()):
    """
    Report the parts of a file that were not read as left out of a model.

    ``root``: the outermost element, after all has been read; ``reasons``: by tag, the reason for
    omitting an element without influence on the motion; ``ignore``: tags that are left out
    whatever they mean. MechanismError where there is another element that may move bodies.
    """
    counts, asked, related = Counter(), Counter(), 'not known, though it names links or joints'
    for label, value, above in root.unasked():
        tag, _, key = label.partition('@')
        if not key and tag in ignore:
            asked[tag] += 1
            continue
        reason = MOVING.get(label)
        if not key and reason is None and tag not in reasons and _speaks(value, above):
            raise value.error(
                f'an element of <{above[-1].tag}> that this reader knows', f'<{tag}>',
                'it may change how bodies lie or move; --ignore '
                f'{tag}, or ignore: [{tag}] in a scene, leaves it out')
        if key and tag == 'dynamics' or above[-1].tag == 'dynamics':
            reason = 'not known to this reader'
        elif label == 'plugin' and _acts(value):
            reason = 'programs are not run'
        elif not key and reason is None and tag not in reasons and _relates(value, model):
            reason = related
        words = value if key else ' '.join(_words(value))
        sizes = () if label in WITHOUT_SIZE else map(abs, map(float, NUMBER.findall(words)))
        size = max(sizes, default=math.inf)
        if reason is None or reason != related and (
                not size or label != 'plugin' and words.strip() in OFF):
            counts[label] += 1
            continue
        owner = next((one for one in reversed(above) if one.tag in OWNERS), above[-1])
        name = owner.attributes.get('name') or owner.attributes.get('reference') or model.name
        model.omitted.append(Omission(key or tag, owner.tag, name, reason, size))
    model.ignore(counts, reasons)
    model.ignore(asked, dict.fromkeys(asked, 'as it was asked for'))
    for tag in ignore:
        if tag not in asked:
            raise MechanismError(f'{model.path}: ignore: expected elements of the file that are '
                                 f'not read, got {tag!r} (not read: {among(counts) or "none"})')


def _speaks(element, above):
    """Return whether an element that is not known may change how bodies lie or move."""
    tag, parent = element.tag, above[-1].tag
    if parent not in SPEAKING or len(above) < 2 or above[-2].tag not in ABOVE or (
            tag in HARMLESS or tag in WHERE_NEEDED.get(parent, ())):
        return False
    # A pose where none belongs says nothing if it is zero.
    numbers = ' '.join((element.text, *element.attributes.values()))
    return tag not in POSES or any(map(float, NUMBER.findall(numbers)))


def _relates(element, model):
    """Return whether an element that is not known names two links or joints: it may join them."""
    if 'collision' in element.tag or element.tag in HARMLESS:
        return False
    words = {*_words(element), *_attributes(element)}
    return len(words & {*model.links, *model.joints}) > 1


def _attributes(element):
    """Yield the attributes of an element and of those in it."""
    yield from element.attributes.values()
    for child in element.children:
        yield from _attributes(child)


def _acts(plugin):
    """Return whether a program acts on bodies, by its names and by what it names."""
    called = ' '.join(plugin.attributes.values())
    return not WATCHING.search(called) and bool(PROGRAMS.search(called) or any(
        ACTED_ON.search(child.tag) for child in plugin.children))


def _words(element):
    """Yield the contents of an element, text or attributes ``value``."""
    yield element.text
    yield element.attributes.get('value', '')
    for child in element.children:
        yield from _words(child)
