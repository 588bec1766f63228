# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Names of the joints of a scene, in the orders in which numbers come."""

from typing import Tuple

from .cut_joints import acted_in
from .motions import with_motions
from .scene_records import Scene
from ..mechanism.coordinates import Coordinates
from ..mechanism.mechanism import CutJoint, Mechanism


class Names:
    """
    Names of a scene's joints.

    Attributes
    ----------
    scene : scene_records.Scene
    mechanism : mechanism.mechanism.Mechanism
        With the equations of the motions that the scene prescribes.
    coordinates : mechanism.coordinates.Coordinates
        Names and places of the numbers of positions and velocities.
    acted : tuple of str
        Freedoms of cut joints that a drive or an effect acts along.

    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.mechanism: Mechanism = with_motions(scene)
        self.coordinates: Coordinates = self.mechanism.coordinates
        self.acted: Tuple[str, ...] = acted_in(self.mechanism, scene.effects)

    @property
    def joint_names(self) -> Tuple[str, ...]:
        """
        Names of the joints, in the order of velocities and torques.

        A joint of several degrees of freedom has a name for each: ``hip.1``, ``ball.rx``.
        """
        return self.coordinates.names

    @property
    def actuated_joints(self) -> Tuple[str, ...]:
        """Names of the actuated joints, in the order of torque sequences; see ``joint_names``."""
        return self.mechanism.actuated_joints

    @property
    def cut_joints(self) -> Tuple[CutJoint, ...]:
        """Return the cut joints, in the order of the constraint forces."""
        return self.mechanism.cut_joints

    @property
    def cut_joint_names(self) -> Tuple[str, ...]:
        """
        Names of the freedoms of cut joints, as in the tree: ``guide.1``, ``ball.rx``.

        In the order of their velocities and efforts; ``Mechanism.cut_coordinates`` has them.
        """
        return self.mechanism.cut_coordinates.names

    @property
    def torque_names(self) -> Tuple[str, ...]:
        """
        Names of the entries of the torques that ``advance`` takes.

        Those of ``joint_names``, then the freedoms of cut joints that a drive or an effect acts
        along.
        """
        return (*self.joint_names, *self.acted)

    @property
    def motion_names(self) -> Tuple[str, ...]:
        """Names of the effects that prescribe motions, in the scene's order."""
        return tuple(motion.name for motion in self.mechanism.motions)
