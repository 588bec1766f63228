# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Visuals of the bodies and the world of an MJCF file.

MuJoCo reads the file a second time, with its defaults and materials, but without meshes, of which
only the names of the files count, and without textures.
"""

import numpy as np

from ..mechanism.mechanism import BOX, CYLINDER, MESH, SPHERE, Visual
from ..mechanism.rotations import of_quaternion, quaternion_of

# MuJoCo's viewer shows no groups from this one on: geometry for contacts.
HIDDEN = 3
# How thick a plane is drawn, and how wide one without an end, as shares of the model's extent.
THICK, WIDE = 0.005, 2.0
# The colour of shapes without one.
UNTOLD = (0.5, 0.5, 0.5)


def read_pictures(mujoco, text, folder, model, links):
    """
    Give the links of a model, and its ground, their visuals; return how many shapes may touch.

    ``text`` is MJCF that opens no other file of its ``folder`` as it is read; shapes that cannot
    be drawn are noted under ``model.ignored``; ``links`` are by the names of MuJoCo's bodies. 0
    where MuJoCo does not read them.
    """
    try:
        spec = mujoco.MjSpec.from_string(text)
        meshes, fields = _without_files(mujoco, spec, folder)
        geoms = list(spec.geoms)
        names = [geom.meshname for geom in geoms]
        for geom in geoms:
            if geom.meshname:
                # Its frame stays that of the file.
                geom.type, geom.meshname, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, '', (1, 0, 0)
        compiled = spec.compile()
    except (ValueError, RuntimeError, AttributeError, TypeError, mujoco.FatalError) as error:
        reason = ' '.join(str(error).split())
        model.ignored['shapes of bodies, drawn and touching'] = (
            f'MuJoCo does not read it: {reason}')
        return 0
    left_out = set()
    for geom, name in zip(geoms, names):
        number = geom.id
        body = int(compiled.geom_bodyid[number])
        link = model.ground_visual if body == 0 else links[mujoco.mj_id2name(
            compiled, mujoco.mjtObj.mjOBJ_BODY, body)].visual
        if compiled.geom_group[number] < HIDDEN:
            found = None if name and name not in meshes else _visuals(
                mujoco, compiled, number, meshes.get(name))
            if found is None:
                left_out.add('mesh' if name else mujoco.mjtGeom(
                    int(compiled.geom_type[number])).name.removeprefix('mjGEOM_').lower())
            link += found or ()
    if left_out:
        model.ignored[f'pictures of kind {", ".join(sorted(left_out))}'] = 'not drawn'
    return _touching(compiled, fields)


def _touching(compiled, fields):
    """Return how many shapes may touch others of other bodies, with the fields among them."""
    kinds, with_kinds, bodies = (
        compiled.geom_contype, compiled.geom_conaffinity, compiled.geom_bodyid)
    touch = fields * (kinds != 0)
    for kind, with_kind, body in {*zip(*(
            some.tolist() for some in (kinds, with_kinds, bodies)))}:
        touch = touch | ((kinds & with_kind | with_kinds & kind) != 0) & (bodies != body)
    found = int(np.count_nonzero(touch))
    return found + fields if found else 0


def _without_files(mujoco, spec, folder):
    """
    Remove elements that need other files.

    Returns path and scale of the meshes by name, and how many fields of heights and of distances
    there were.
    """
    meshes = {mesh.name: ((folder / spec.meshdir / mesh.file), tuple(map(float, mesh.scale)))
              for mesh in spec.meshes if mesh.file and not np.any(mesh.refpos)
              and tuple(mesh.refquat) == (1.0, 0.0, 0.0, 0.0)}
    fields = [geom for geom in spec.geoms if geom.type in (
        mujoco.mjtGeom.mjGEOM_HFIELD, mujoco.mjtGeom.mjGEOM_SDF)]
    for geom in fields:
        spec.delete(geom)
    for material in spec.materials:
        material.textures = [''] * len(material.textures)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    return meshes, len(fields)


def _visuals(mujoco, compiled, number, mesh):
    """Return the shapes that a geometry is drawn as; None: it is of another kind."""
    kinds, kind = mujoco.mjtGeom, compiled.geom_type[number]
    x, y, z = compiled.geom_size[number].tolist()
    w, *vector = compiled.geom_quat[number].tolist()
    center, turned = compiled.geom_pos[number].copy(), (*vector, w)
    axes = of_quaternion(turned)
    material = int(compiled.geom_matid[number])
    *color, opacity = (compiled.geom_rgba[number] if material < 0
                       else compiled.mat_rgba[material]).tolist()
    color = tuple(round(share, 4) for share in color)
    if material < 0 and np.allclose(color, UNTOLD):
        color = None

    def at(place, shape, size, file=None):
        return Visual(shape, size, tuple((center + axes @ place).tolist()),
                      quaternion_of(axes), file, color)

    nowhere = np.zeros(3)
    if not opacity > 0.0:
        return []
    if mesh is not None:
        file, scale = mesh
        return [at(nowhere, MESH, scale, str(file))]
    if kind == kinds.mjGEOM_BOX:
        return [at(nowhere, BOX, (2.0 * x, 2.0 * y, 2.0 * z))]
    if kind == kinds.mjGEOM_SPHERE:
        return [at(nowhere, SPHERE, (x,))]
    if kind == kinds.mjGEOM_CYLINDER:
        return [at(nowhere, CYLINDER, (x, 2.0 * y))]
    if kind == kinds.mjGEOM_CAPSULE:
        ends = (np.array([0.0, 0.0, side * y]) for side in (-1.0, 1.0))
        return [at(nowhere, CYLINDER, (x, 2.0 * y)), *(at(end, SPHERE, (x,)) for end in ends)]
    if kind == kinds.mjGEOM_PLANE:
        extent = float(compiled.stat.extent)
        thick = THICK * extent
        return [at(np.array([0.0, 0.0, -0.5 * thick]), BOX, (
            *(2.0 * half or WIDE * extent for half in (x, y)), thick))]
    return None
