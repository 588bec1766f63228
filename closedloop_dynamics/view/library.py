# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Machines that a page can open, small pictures of them, and where it can save."""

from contextlib import suppress
import json
import os
from pathlib import Path
import re

import numpy as np

from .effect_shapes import circle, effect_lines, wires
from .messages import SHIPPED, YOURS
from ..mechanism.checks import NAME_PATTERN
from ..mechanism.config import shipped_path
from ..mechanism.document import Document
from ..mechanism.fields import FieldError, shown
from ..mechanism.kinematics import body_poses, pose_of, world_points
from ..mechanism.mechanism import GROUND, MechanismError
from ..scene.loading import load_scene, scene_names, scene_of_yaml, SceneError
from ..visual.appearance import body_colors, CONTACT_COLOR, marked_points, solid
from ..visual.transmissions import outlines as wheel_outlines, transmissions
from ..visual.wheels import on_wheel

# Files of the user's own that are looked at.
MOST_FILES, LARGEST_FILE = 200, 200_000
# Size of a picture and its margin [pixels]; how a machine in space is looked at [rad].
WIDTH, HEIGHT, MARGIN, OUTLINE = 150, 100, 10, 1.2
YAW, PITCH, GRAY = 0.6, 0.35, '#8b929c'
PICTURE = re.compile(r'/picture/(shipped|yours)/([A-Za-z0-9][A-Za-z0-9_-]{0,60})\.svg')


class Library:
    """
    Shipped scenes, and those in one folder.

    Files are opened and saved there, and nowhere else; by default nothing is.
    """

    def __init__(self, folder=None):
        self._folder = None if folder is None else Path(folder).resolve()
        self._pictures, self._saved = {}, set()
        # Descriptions by path and time of the last change.
        self._known_files = {}

    def machines(self):
        """Return the machines that can be opened: kind, name and description, as JSON."""
        every = [(SHIPPED, shipped_path('scenes', name)) for name in scene_names()]
        every += [(YOURS, path) for path in self._files()]
        return [{'kind': kind, 'name': path.stem, 'text': text} for kind, path in every
                if (text := self._description(path)) is not None]

    def _files(self):
        if self._folder is None:
            return []
        found = sorted(self._folder.glob('*.yaml'))[:MOST_FILES]
        return [path for path in found if NAME_PATTERN.fullmatch(path.stem)
                and self._description(path) is not None]

    def _description(self, path):
        """Return the description of a scene's file; None where it is not one, or has gone."""
        try:
            key = path, path.stat().st_mtime_ns
            if key not in self._known_files:
                self._known_files[key] = _description(path) if path.is_file() else None
        except OSError:
            return None
        return self._known_files[key]

    def scene(self, name, kind):
        """Return a scene by its name; raise FieldError, SceneError or MechanismError."""
        if kind == SHIPPED:
            return load_scene(shipped_path('scenes', self._known(name, scene_names())))
        return load_scene(self._path(self._known(name, [path.stem for path in self._files()])))

    def read(self, name, text):
        """Return the scene of a text, as a file of that name in the folder would be."""
        return scene_of_yaml(text, self._path(name))

    def save(self, name, text):
        """
        Write a scene; return the path.

        FieldError where there is no folder, or a file of that name that was not saved here before.
        """
        if self._folder is None:
            raise FieldError('a folder to save in', 'none', path=('save',))
        path = self._path(name)
        unfinished = path.with_name(f'.{name}.{os.getpid()}.unfinished')
        try:
            # Whole or not at all, whoever reads it meanwhile.
            unfinished.write_text(text, encoding='utf-8')
            (os.replace if path in self._saved else os.link)(unfinished, path)
        except FileExistsError:
            raise FieldError('a name that no file has yet', shown(path.name),
                             path=('save',)) from None
        except OSError as error:
            raise FieldError(f'a file that can be written, {path}', error.strerror,
                             path=('save',)) from None
        finally:
            with suppress(OSError):
                unfinished.unlink(missing_ok=True)
        self._saved.add(path)
        return path

    def _path(self, name):
        return (self._folder or Path()) / f'{name}.yaml'

    @staticmethod
    def _known(name, names):
        if name not in names:
            raise FieldError('one of the machines', shown(name), path=('open',))
        return name

    def resource(self, path):
        """Return kind and bytes of the list of machines, or of a picture; None for others."""
        if path == '/machines.json':
            return 'application/json', json.dumps(self.machines()).encode()
        match = PICTURE.fullmatch(path)
        if match is None:
            return None
        kind, name = match.groups()
        if (kind, name) not in self._pictures or kind == YOURS:
            try:
                text = picture(self.scene(name, kind))
            except (SceneError, MechanismError, FieldError, OSError):
                return None
            self._pictures[kind, name] = text.encode()
        return 'image/svg+xml', self._pictures[kind, name]


def _description(path):
    """Return the description of a scene's file; None where it is not one."""
    if path.stat().st_size > LARGEST_FILE:
        return None
    try:
        data = Document(path, SceneError).data
    except SceneError:
        return None
    if not isinstance(data, dict) or 'mechanism' not in data:
        return None
    return str(data.get('description', ''))


def picture(scene):
    """Return a small picture of a scene where it starts, SVG."""
    mechanism = scene.mechanism
    poses = body_poses(mechanism, np.array(scene.initial.position))
    size, wheels = 2 if mechanism.planar else 3, transmissions(mechanism)[0]
    rows = {GROUND: -1, **{body.name: k for k, body in enumerate(mechanism.bodies)}}
    heights, names = dict.fromkeys(rows, 0.0), {row: name for name, row in rows.items()}
    colors, lines, joints = body_colors(mechanism), [], []

    def seen(body, places):
        return _seen(world_points(pose_of(mechanism, poses, body), np.array(places)[:, :size]))

    for body in mechanism.bodies:
        points = marked_points(mechanism, body.name)
        world = seen(body.name, points)
        edges = [] if on_wheel(wheels, body.name, points) or len(points) < 2 else solid(points)[0]
        lines += [(world[a], world[b], colors[body.name]) for a, b in edges]
        joints += list(world)
    found = [(names[wire['body']], wire['places']) for wire in wires(
        mechanism, scene.effects, rows, heights, 0.0)]
    found += [(body, outline) for body, outline, _ in wheel_outlines(mechanism)]
    outlines = [(seen(body, places), colors.get(body, GRAY)) for body, places in found]
    for rope in effect_lines(mechanism, scene.effects, rows, heights, 0.0):
        ends = [seen(names[row], [place])[0] for row, place in rope['ends']]
        lines += [(start, end, CONTACT_COLOR) for start, end in zip(ends, ends[1:])]
        outlines += [(end + circle(abs(radius)), GRAY)
                     for end, radius in zip(ends, rope.get('radii', ())) if radius]
    places = [*joints, *(place for world, _ in outlines for place in world),
              *(place for line in lines for place in line[:2])]
    ground = [_seen(np.array([joint.position]))[0] for joint in mechanism.joints
              if joint.parent == GROUND]
    every = np.array([*places, *ground])
    low, high = every.min(axis=0), every.max(axis=0)
    span = np.maximum(high - low, 1e-9)
    scale = min((WIDTH - 2 * MARGIN) / span[0], (HEIGHT - 2 * MARGIN) / span[1])
    middle = 0.5 * (low + high)

    def at(place):
        x, y = (place - middle) * scale * (1.0, -1.0) + (WIDTH / 2, HEIGHT / 2)
        return f'{x:.1f}', f'{y:.1f}'

    drawn = [f'<line x1="{a[0]}" y1="{a[1]}" x2="{b[0]}" y2="{b[1]}" stroke="{color}" '
             f'stroke-width="{1.6 if color == CONTACT_COLOR else 4}" stroke-linecap="round"/>'
             for a, b, color in ((at(start), at(end), color) for start, end, color in lines)]
    drawn = [f'<polyline points="{" ".join(",".join(at(place)) for place in world)}" '
             f'fill="{color}" fill-opacity="0.25" stroke="{color}" stroke-width="{OUTLINE}"/>'
             for world, color in outlines] + drawn
    drawn += [f'<path d="M{x} {y}l-6 9h12z" fill="{GRAY}"/>' for x, y in map(at, ground)]
    drawn += [f'<circle cx="{x}" cy="{y}" r="2.2" fill="#fff" stroke="#555"/>'
              for x, y in sorted(set(map(at, joints)))]
    return (f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}">'
            + ''.join(drawn) + '</svg>')


def _seen(places):
    """Return places, shape (n, 2 or 3), as they are seen, shape (n, 2)."""
    if places.shape[1] == 2:
        return places
    x, y, z = places.T
    across, depth = np.cos(YAW) * x - np.sin(YAW) * y, np.sin(YAW) * x + np.cos(YAW) * y
    return np.column_stack([across, np.cos(PITCH) * z + np.sin(PITCH) * depth])
