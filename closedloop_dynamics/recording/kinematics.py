# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Motion, drive torques and joint forces of a mechanism that is driven at constant rates."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from .quantities import coordinate
from .run import headings, row
from ..effects.prescribed_motion import PrescribedMotion
from ..kinematics.assemblies import find_assemblies
from ..kinematics.assembly import Assembler
from ..kinematics.driven import BranchEndError, DrivenKinematics
from ..kinematics.geometry import Geometry
from ..kinematics.motions import with_motions
from ..kinematics.second_order import scene_as_it_moves
from ..mechanism.differences import FIRST_4, SECOND_4
from ..mechanism.errors import SimulationError
from ..mechanism.fields import at, FieldError
from ..mechanism.kinematics import named_paths
from ..simulation.model import Model

# Behind the dot of a driven point.
AXES = 'xyz'
# Displacement in a step of the differences by which points and masses accelerate [rad, m].
STEP = 1e-2


class Drive(NamedTuple):
    """Start and end of a driven joint or point."""

    #: ``start``, ``end``: [rad or m]; the same where it is held.
    start: float
    end: float


class DrivenRun:
    """
    A mechanism that is driven from value to value.

    Parameters
    ----------
    scene : scene_records.Scene
        Whose start is on the branch.
    drives : mapping of str to Drive
        By joint, or by point and axis, as ``tool.x``; as many as there are degrees of freedom.
        Drives of the same joints in the scene are left out.
    count : int
        Of poses, 2 or more.
    speed : float
        Of the first drive that moves [rad/s or m/s]; the others take the same time.
    branch : int, optional
        Number of the assembly at the first pose, from 1 on, as ``assemblies`` lists them; the
        branch of the scene's start when not given.

    Attributes
    ----------
    scene : scene_records.Scene
        Where joints alone are driven, with these motions prescribed: it begins at the first pose.
    mechanism : mechanism.mechanism.Mechanism
    time : ndarray, shape (n,)
        Of the poses [s]; n is less than ``count`` where the branch ends.
    position, velocity, acceleration : ndarray, shape (n, nq), (n, nv), (n, nv)
    driven : dict of str to ndarray, shape (n,)
        Driven values, by name [rad or m].
    idle : int
        Degrees of freedom that only turn rods about themselves, and need no drive.
    end : simulation.driven.BranchEnd or None
        Where the branch ends.

    Raises
    ------
    BranchEndError
        Where the first pose is not reached from the scene's start.
    AssemblyError
        Where the loops cannot be closed there.
    ValueError
        For unknown names, and more or fewer drives than there are degrees of freedom.

    """

    def __init__(self, scene, drives, count, speed, branch=None):
        moves = [abs(drive.end - drive.start) for drive in drives.values()
                 if drive.end != drive.start]
        if not moves:
            raise ValueError('expected a drive that moves, got '
                             f'{", ".join(drives) or "none"} at rest')
        duration = moves[0] / speed
        self._by_joints = all(name.rpartition('.')[2] not in AXES or _is_freedom(scene, name)
                              for name in drives)
        scene = scene_as_it_moves(scene)
        moved = _driven_scene(scene, drives, duration)
        mechanism = with_motions(moved)
        if len(mechanism.motions) != len(drives):
            raise ValueError('expected a scene that prescribes no motions of its own, got '
                             f'{", ".join(one.name for one in mechanism.motions)}')
        start = start_position(scene)
        if branch is not None:
            start = _assembly(mechanism, start, [each.start for each in drives.values()], branch)
        kinematics = DrivenKinematics(mechanism, start)
        shares = np.linspace(0.0, 1.0, count)
        self.count, self._drives, self._duration = count, drives, duration
        values = self._values(shares)
        try:
            kinematics.go_to(values[0, :, 0])
        except BranchEndError as error:
            raise BranchEndError(error.end._replace(reason=(
                f"On the way from the scene's start to the first pose: {error}")), 0) from None
        motion = kinematics.follow(values)
        self.idle = kinematics.idle
        self.position, self.velocity, self.acceleration, self.end = motion
        found = len(self.position)
        self.time = duration * shares[:found]
        self.driven = {name: values[:found, k, 0] for k, name in enumerate(drives)}
        begun = replace(moved.initial, position=tuple(self.position[0].tolist()),
                        velocity=tuple(self.velocity[0].tolist()), hold=())
        self.scene = replace(moved if self._by_joints else scene, initial=begun)
        self.mechanism = with_motions(self.scene)
        self._kinematics = kinematics

    def _values(self, shares):
        """Return driven values, their rates and accelerations at shares of the way, (n, m, 3)."""
        values = np.zeros((len(shares), len(self._drives), 3))
        values[..., 0] = [[(1.0 - share) * drive.start + share * drive.end
                           for drive in self._drives.values()] for share in shares]
        values[..., 1] = [(drive.end - drive.start) / self._duration
                          for drive in self._drives.values()]
        return values

    @property
    def drive(self):
        """Return the first drive that moves, a ``Quantity``."""
        return next(coordinate(self.mechanism, name, values)
                    for name, values in self.driven.items()
                    if len(values) < 2 or np.ptp(values) > 0.0)

    def drive_at(self, share):
        """Return the value of the first drive that moves at a share of the way [rad or m]."""
        drive = next(drive for drive in self._drives.values() if drive.end != drive.start)
        return (1.0 - share) * drive.start + share * drive.end

    def solve(self, share):
        """
        Return position, rates and accelerations at a share of the way, 0 to 1.

        BranchEndError where the branch ends before it.
        """
        nearest = min(round(share * (self.count - 1)), len(self.position) - 1)
        self._kinematics.start_at(self.position[nearest])
        motion = self._kinematics.follow(self._values([share]))
        if motion.end is not None:
            raise BranchEndError(motion.end, 0)
        return motion.position[0], motion.velocity[0], motion.acceleration[0]

    def table(self, show=None):
        """
        Return the columns of ``simulate --forces all``, their names and rows, for every pose.

        ``show`` is called with the number of each pose. SimulationError where the actuated joints
        cannot move a driven point so.
        """
        model = Model(self.scene)
        names, rows = None, []
        for k, time in enumerate(self.time):
            state = model.state(self.position[k], self.velocity[k], time=time)
            torque = None
            if not self._by_joints:
                try:
                    torque = model.inverse(state, self.acceleration[k]).torque
                except SimulationError as error:
                    raise SimulationError(f'pose {k}: {error}') from None
            readings = model.readings(state, torque)
            names = names or headings(readings, True)
            rows.append(row(readings, float(time), True))
            if show is not None:
                show(k)
        more, columns = self._point_rates()
        return [*names, *more], np.hstack([np.array(rows), columns])

    def _point_rates(self):
        """Return names and columns of velocities and accelerations of the named points."""
        names, columns = [], np.zeros((len(self.time), 0))
        none = np.zeros((len(self.time), 0))
        rates = self.rates(lambda position: np.concatenate(
            [*named_paths(self.mechanism, position).values(), none], axis=1))
        for what, values in zip(('velocity', 'acceleration'), rates[1:]):
            names += [f'point_{what}.{point.name}.{axis}' for point in self.mechanism.points
                      for axis in AXES[:len(point.position)]]
            columns = np.hstack([columns, values])
        return names, columns

    def rates(self, of):
        """
        Return a quantity of positions at all poses, and its first and second time derivatives.

        ``of`` takes positions, shape (n, nq). The derivatives are differences of the fourth order,
        of a step that is short for the motion.
        """
        fastest = np.abs(self.velocity).max()
        step = STEP / max(fastest, np.sqrt(np.abs(self.acceleration).max()), 1e-12)
        coordinates = self.mechanism.coordinates
        around = np.array([of(coordinates.moved(
            self.position, n * step * self.velocity + 0.5 * (n * step) ** 2 * self.acceleration))
            for n in SECOND_4])
        return around[list(SECOND_4).index(0)], *(np.tensordot(
            [stencil.get(n, 0.0) / step ** order for n in SECOND_4], around, 1)
            for order, stencil in ((1, FIRST_4), (2, SECOND_4)))


def assemblies(scene, drives):
    """Return the assemblies at the first pose, a ``kinematics.assemblies.Assembled``."""
    scene = scene_as_it_moves(scene)
    mechanism = with_motions(_driven_scene(scene, drives, 1.0))
    return _assembled(mechanism, start_position(scene), [each.start for each in drives.values()])


def held(scene):
    """
    Return drives that hold a scene where it starts, by joint.

    They are those that the scene holds, its actuated joints where it holds none.
    """
    coordinates, position = scene.mechanism.coordinates, start_position(scene)
    names = scene.initial.hold or scene.mechanism.actuated_joints
    values = {name: float(position[coordinates.place[coordinates.index[name]]])
              for name in names if name in coordinates.single_names}
    return {name: Drive(value, value) for name, value in values.items()}


def start_position(scene):
    """Return the position of a scene's start, assembled."""
    assembler = Assembler(scene.mechanism, Geometry(scene.mechanism).equations)
    return assembler.positions(scene.initial.position, scene.initial.hold)


def _assembled(mechanism, start, values):
    return find_assemblies(mechanism, Geometry(mechanism).equations, values, start)


def _assembly(mechanism, start, values, number):
    """Return the position of one of the assemblies."""
    found = _assembled(mechanism, start, values)
    if not 1 <= number <= len(found.positions):
        raise ValueError(f'branch: expected the number of an assembly, got {number} of {found}')
    return found.positions[number - 1]


def _is_freedom(scene, name):
    """Return whether a name is that of a joint or a freedom of a cut joint."""
    return name in _freedoms(scene.mechanism)


def _freedoms(mechanism):
    """Return the names of coordinates of joints and cut joints that a motion may drive."""
    return [coordinates.names[k] for coordinates in (
        mechanism.coordinates, mechanism.cut_coordinates) for k in coordinates.single]


def _driven_scene(scene, drives, duration):
    """Return a scene that prescribes motions at constant rates."""
    # What drives these joints in the scene is replaced by the motion.
    effects = {key: record for key, record in scene.effects.items() if not (
        getattr(record, 'joint', None) in drives and (record.drive() or record.COMMANDS))}
    mechanism = scene.mechanism
    size = 2 if mechanism.planar else 3
    points = [point.name for point in mechanism.points]
    for name, drive in drives.items():
        point, _, axis = name.rpartition('.')
        motion = {'offset': drive.start, 'speed': (drive.end - drive.start) / duration}
        if _is_freedom(scene, name):
            motion['joint'] = name
        elif point in points and axis in AXES[:size]:
            motion.update(point=point, direction=tuple(
                float(axis == other) for other in AXES[:size]))
        else:
            example = f', {points[0]}.x' if points else ''
            raise ValueError(
                f'{name}: expected a joint ({", ".join(_freedoms(mechanism))}) or a point with '
                f'its axis{example} ({", ".join(points) or "none"})')
        key = f'drive_{name.replace(".", "_")}'
        while key in effects:
            key += '_'
        try:
            with at('effects', key):
                effects[key] = PrescribedMotion('constant_speed', **motion)
                effects[key].fit(mechanism)
        except FieldError as error:
            raise ValueError(str(error)) from None
    return replace(scene, effects=effects)
