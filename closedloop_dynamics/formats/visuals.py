# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Visuals of links in URDF and SDF files: boxes, cylinders, spheres and meshes."""

from dataclasses import replace
import os
from pathlib import Path

import numpy as np

from ..mechanism.mechanism import BOX, CYLINDER, MechanismError, MESH, SPHERE, Visual
from ..mechanism.rotations import of_quaternion, quaternion_of

# Variables of the environment that list folders of packages and models.
SEARCHED = ('AMENT_PREFIX_PATH', 'ROS_PACKAGE_PATH', 'GZ_SIM_RESOURCE_PATH')


def visuals(link, folder, pose_of, values_of, color_of, ignored):
    """
    Read the visuals of a link, a list of Visual; those that cannot be drawn are left out.

    Of an element ``visual``, ``pose_of`` returns the pose in the link's frame, ``color_of`` the
    colour as ``Visual`` has it, and ``values_of`` numbers of an element by key and count, or text
    where the count is None; None where there are none. Paths of meshes begin from the folder.
    Omissions are noted in ``ignored``, with the reason; nothing that is drawn moves a body.
    """
    found = []
    for visual in link.all('visual'):
        try:
            found += _shapes(visual, folder.resolve(), pose_of, values_of, color_of)
        except MechanismError as error:
            reason = str(error).rpartition('>: ')[-1]
            ignored[f'a visual of {link.get("name")} ({reason})'] = 'not drawn'
    return found


def _shapes(visual, folder, pose_of, values_of, color_of):
    """Return the shapes of an element visual."""
    found, geometry = [], visual.child('geometry')
    if geometry is None:
        return found
    pose = pose_of(visual)
    placed_at = tuple(pose.position.tolist()), quaternion_of(pose.rotation)
    color = color_of(visual)
    for kind, keys in ((BOX, (('size', 3),)), (SPHERE, (('radius', 1),)),
                       (CYLINDER, (('radius', 1), ('length', 1)))):
        shape = geometry.child(kind)
        if shape is not None:
            size = [number for key, count in keys
                    for number in _positive(shape, key, values_of(shape, key, count))]
            found.append(Visual(kind, tuple(size), *placed_at, color=color))
    mesh = geometry.child(MESH)
    if mesh is not None:
        scale = values_of(mesh, 'scale', 3)
        if scale is not None and 0.0 in scale:
            raise mesh.error('scale without zeros', 'others')
        found.append(Visual(
            MESH, (1.0, 1.0, 1.0) if scale is None else tuple(map(float, scale)), *placed_at,
            _path(values_of(mesh, 'uri' if mesh.get('filename') is None else 'filename', None)
                  or '', folder), color))
    return found


def color_in(text):
    """Return red, green and blue in a text that begins with them; None: that has no such."""
    try:
        found = tuple(map(float, (text or '').split()[:3]))
    except ValueError:
        return None
    return found if len(found) == 3 and all(0.0 <= share <= 1.0 for share in found) else None


def _positive(shape, key, values):
    if values is None or not min(values) > 0.0:
        raise shape.error(f'{key} to be positive', 'none' if values is None else 'other numbers')
    return map(float, values)


def _path(uri, folder):
    """Return the path of a mesh; where it is not found, one that is missing."""
    scheme, found, rest = uri.partition('://')
    if not found:
        return str(folder / uri)
    if scheme == 'file':
        return rest
    return str(next((place / rest for place in places_of_packages(folder)
                     if _is_file(place / rest)), folder / rest))


def places_of_packages(folder):
    """Return the folders that packages may be in, for a file in a folder, a list of Path."""
    found = [folder, *folder.parents]
    for variable in SEARCHED:
        for place in filter(None, os.environ.get(variable, '').split(os.pathsep)):
            found += [Path(place), Path(place, 'share')]
    return found


def _is_file(path):
    """Return whether there is a file; a name that is too long names none."""
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False


def placed(visual, pose):
    """Return shapes of one frame in another, in which it has a pose."""
    rotation = pose.rotation @ of_quaternion(visual.orientation)
    return replace(visual, center=tuple(pose.place(np.array(visual.center)).tolist()),
                   orientation=quaternion_of(rotation))
