# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""All quantities of a mechanism that follow from a belief, with their standard deviations."""

from typing import Any, List, Sequence

import numpy as np

from .filtering import Now
from .measuring import View
from .motion_code import MotionCode
from .plant import Plant
from .results import Belief, Estimate, Estimated, named


class Everything:
    """Positions, rates, accelerations, points and forces in joints of a plant."""

    def __init__(self, plant: Plant) -> None:
        self._plant, self._code, self._of = plant, None, None
        mechanism, simulation = plant.scene.mechanism, plant.simulation
        placements = simulation.loop_model.placements
        self._size = 2 if mechanism.planar else 3
        self._points = [point for point in mechanism.points if point.body in placements]
        self._places: List[Any] = []
        for point in self._points:
            placement, place = placements[point.body], np.zeros(3)
            place[:self._size] = point.position
            self._places.append((placement.row, placement.place(place)))
        joints, _ = simulation.force_places()
        self._joints = (*joints, *(cut.name for cut in mechanism.cut_joints
                                   if simulation.cut_rows))
        self._wrench = [2, 3, 4] if mechanism.planar else list(range(6))

    def code(self) -> MotionCode:
        """Return the generated code for the present system."""
        if self._of is not self._plant.simulation.system.model:
            self._of = self._plant.simulation.system.model
            self._code = MotionCode(
                self._plant.simulation, self._plant.arrays, self._places, bool(self._joints))
        assert self._code is not None
        return self._code

    def estimate_by_points(self, points: Sequence[Now], belief: Belief,
                           count: int) -> Estimate:
        """Return everything for a belief, by states around its mean, which is the first."""
        plant, size = self._plant, self._size
        coordinates, found = plant.simulation.coordinates, []
        for one in points:
            forward = plant.evaluate(one.time, one.q, one.qd, one.values[:count], one.command)
            forces = [plant.simulation.force(name) for name in self._joints]
            found.append((
                coordinates.apart(one.q, points[0].q), one.qd, forward,
                plant.kinematic.measure_cut_joints(one.q, one.qd)[0],
                np.array([plant.simulation.point(point.name)[:size] for point in self._points]),
                np.array(forces).reshape(len(forces), -1)))
        found[0] = (coordinates.by_freedom(points[0].q), *found[0][1:])
        names = plant.simulation.joint_names
        spreads = [np.sqrt(np.mean(np.square(np.array(each[1:]) - (
            0.0 if n == 0 else each[0])), axis=0)) for n, each in enumerate(zip(*found))]
        return Estimate(belief.time, *(
            Estimated(tuple(name), value, spread) for name, value, spread in zip((
                names, names, names, plant.scene.mechanism.cut_coordinates.names,
                [point.name for point in self._points], self._joints), found[0], spreads)),
            belief.unknowns, belief.state)

    def estimate(self, view: View, belief: Belief, covariance: np.ndarray,
                 kept: np.ndarray) -> Estimate:
        """Return everything in a view of a belief; the covariance is of the columns kept."""
        nv, seen, simulation = len(view.qd), view.seen, self._plant.simulation
        names, cuts = simulation.joint_names, simulation.mechanism.cut_coordinates.names
        position, _, by_tree = view.cuts
        size, basis = self._size, view.basis[:, kept]
        return Estimate(
            belief.time,
            named(names, simulation.coordinates.by_freedom(view.q), basis[:nv], covariance),
            named(names, view.qd, basis[nv:], covariance),
            named(names, view.acceleration, seen.acceleration[:, kept], covariance),
            named(cuts, position, by_tree @ basis[:nv], covariance),
            named([point.name for point in self._points], seen.place[0][:, :size],
                  seen.place[1][:, :size, kept], covariance),
            named(self._joints, seen.wrench[0][:, self._wrench],
                  seen.wrench[1][:, self._wrench][..., kept], covariance)
            if self._joints else Estimated((), np.zeros((0, len(self._wrench))),
                                           np.zeros((0, len(self._wrench)))),
            belief.unknowns, belief.state)
