# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""How machines move by themselves when they are shown: by a controller, or by drives."""

from pathlib import Path

from .messages import EXPRESSION, HELD, OWN, POSITION, SPEED, TORQUE
from ..control.files import Controller, read_controller, shipped_controller
from ..mechanism.checks import number, one_of, text
from ..mechanism.config import config_directory, shipped_path
from ..mechanism.document import Document
from ..mechanism.fields import at, FieldError, mapping
from ..scene.loading import SceneError

MODES = TORQUE, POSITION, SPEED, EXPRESSION


class OwnMotion:
    """
    The drives of a machine from the start: those of a controller, if any, or others in its place.

    ``starts``: mode and value of all drives that do something, by joint.
    """

    def __init__(self, controller=None, drives=None):
        self.controller = controller
        own = {} if controller is None else dict.fromkeys(
            controller.joints, (OWN, controller.name))
        self.starts = {**own, **(drives or {})}

    def start(self, joint):
        """Return mode and value of the drive of a joint; the position None: where it is."""
        return self.starts.get(joint, (TORQUE, 0.0))


def chosen(drives, which=OWN, file=None):
    """
    Return a function that gives the chosen motion of a scene and a controller's model.

    ``drives`` (mode and value by joint) come before anything else; ``which``: the own motion of
    the machine, all drives held, or free; ``file``: of a controller, in place of the machine's own
    motion.
    """
    def motion(scene, model=None):
        found = OwnMotion()
        if file is not None:
            found = OwnMotion(Controller(
                Path(file).stem, read_controller(file), scene if model is None else model))
        elif which == OWN:
            found = own_motion(scene, model)
        elif which == HELD:
            found = OwnMotion(drives=dict.fromkeys(_single(scene.mechanism), (POSITION, None)))
        return OwnMotion(found.controller, {
            **{joint: start for joint, start in found.starts.items() if start[0] != OWN},
            **drives})

    return motion


def _single(mechanism):
    """Return the driven freedoms of the tree that have one number."""
    names = mechanism.coordinates
    return [names.names[k] for k in names.actuated if names.place[k] >= 0]


def own_motion(scene, model=None):
    """
    Return the drives of a scene: a shipped controller, shipped drives, or its effects.

    ``model`` is what a controller knows of it, by default the scene.
    """
    controller = shipped_controller(scene, model)
    if controller is not None or scene.path != shipped_path('scenes', scene.name):
        return OwnMotion(controller)
    document = Document(config_directory() / 'drives.yaml', SceneError)
    with document.errors():
        return OwnMotion(drives={
            joint: _drive(joint, given)
            for joint, given in mapping(document.data).get(scene.name, {}).items()})


def _drive(joint, given):
    with at(joint):
        if len(mapping(given)) != 1:
            raise FieldError('a mode and its value', f'{len(given)} modes')
        (mode, value), = given.items()
        one_of(MODES)(mode)
        with at(mode):
            return mode, (text if mode == EXPRESSION else number)(value)
