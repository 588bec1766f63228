# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Rows of numbers for a page: poses, arrows and plotted quantities, of one instant each.

A row of a running simulation, of a recording and of a saved file is the same.
"""

from dataclasses import dataclass, field, replace
from typing import Optional

import numpy as np

from .effect_shapes import face_normal, normal_of, outline_of
from ..effects.body_contact import BodyContact
from ..effects.cable import Cable
from ..effects.contact import Contact
from ..effects.external_force import BODY, ExternalForce
from ..effects.force_table import ForceTable
from ..effects.point_spring import PointSpring
from ..effects.prescribed_force import PrescribedForce
from ..engine.types import SMALLEST_PIVOT
from ..mechanism.coordinates import QUANTITIES
from ..mechanism.kinematics import body_poses, body_velocities, named_paths, POSE, poses_in_space
from ..mechanism.mechanism import GROUND, Mechanism
from ..mechanism.rotations import in_three, of_quaternion, turned
from ..simulation.health import WARN_BELOW
from ..visual.trajectory import force_of, magnitudes

# Numbers of an arrow: its foot [m], its force [N].
ARROW = 6
# Sine of the angle to a parallel singularity below which its direction is shown.
NEAR = 0.05
# Readings of effects with arrows or lines that are plotted.
READINGS = {Contact: {'normal_force': 'normal', 'friction_force': 'friction'},
            BodyContact: {'normal_force': 'normal', 'friction_force': 'friction'},
            PointSpring: {'tension': 'tension'}, Cable: {'tension': 'tension'},
            ForceTable: {'force': 'force'}}
# How far the direction moves what moves most, as a share of the mechanism's size.
SHOWN = 0.15
# Groups of plots whose quantities an estimator estimates, too.
ESTIMATED = ('joint position', 'joint velocity')


@dataclass
class Plot:
    """One column that is plotted."""

    group: str
    name: str
    unit: str = ''
    # Whether it is shown before anybody asks for it.
    shown: bool = True
    # What it is called in files.
    column: str = ''
    # Whether its logarithm is drawn.
    log: bool = False
    # Whether it is about the method that computes the motion, not about the motion.
    method: bool = False
    # For an estimate: the column of its standard deviation, counted from the first plot.
    deviation: Optional[int] = None


@dataclass
class Columns:
    """Columns of a row, in this order; NaN where a value is unknown."""

    mechanism: Mechanism  # Poses of its bodies; forces on body A of its cut joints, without feet
    #: Forces of effects: name and kind (force, normal force or friction); an arrow each (list of
    #: dict).
    loads: list = field(default_factory=list)
    direction: bool = False  # Whether poses moved along the singular direction follow
    #: The state's other numbers, which are in files only, follow: those of orientations, and
    #: efforts of joints that are not driven (list of Plot).
    plots: list = field(default_factory=list)
    #: Whether there are estimated poses, too, before the direction, and at the end the standard
    #: deviations of the plots that are estimates.
    estimated: bool = False

    @property
    def starts(self):
        """Return the first column of each part, by its name."""
        bodies, cuts = len(self.mechanism.bodies), len(self.mechanism.cut_joints)
        names = self.mechanism.coordinates
        others = np.count_nonzero(_is_other(names)[0]) + np.count_nonzero(_is_other(names)[1])
        widths = (POSE * bodies, 3 * cuts, ARROW * len(self.loads),
                  POSE * bodies * self.estimated, POSE * bodies * self.direction,
                  len(self.plots), others, len(self._estimates))
        return dict(zip(('poses', 'forces', 'loads', 'estimate', 'direction', 'plots', 'others',
                         'deviations', 'width'), np.cumsum([0, *widths]).tolist()))

    @property
    def _estimates(self):
        return [plot for plot in self.plots if plot.deviation is not None]

    @property
    def layout(self):
        """Return the first column of each part, plotted quantities and names, as JSON."""
        return {'columns': self.starts, 'loads': self.loads,
                'plots': [vars(plot) for plot in self.plots], 'files': self._files()}

    def _files(self):
        """Return the names of the columns in files, with units; empty: in none."""
        planar, bodies = self.mechanism.planar, self.mechanism.bodies
        axes = ['x [m]', 'y [m]', 'z [m]']
        found = [f'pose.{body.name}.{part}' for body in bodies for part in (
            *axes, 'qx', 'qy', 'qz', 'qw')]
        found += ['' if planar and axis == 'z' else f'force.{cut.name}.{axis} [N]'
                  for cut in self.mechanism.cut_joints for axis in 'xyz']
        found += [f'{load["kind"]}.{load["name"]}.{part}' for load in self.loads for part in (
            *(f'at.{axis}' for axis in axes), *(f'{axis} [N]' for axis in 'xyz'))]
        found += [''] * (POSE * len(bodies) * (self.estimated + self.direction))
        return [*found, *(f'{plot.column} [{plot.unit}]' for plot in self.plots),
                *_other_columns(self.mechanism.coordinates),
                *(f'deviation.{plot.column} [{plot.unit}]' for plot in self._estimates)]

    @property
    def width(self):
        """Return the number of columns."""
        return self.starts['width']


def joint_plots(mechanism):
    """Return the plots of joints and cut joints, which recordings have, too."""
    names = mechanism.coordinates
    position, velocity, effort = map(names.columns, ('position', 'velocity', 'effort'))
    freedoms = [(name, bool(length), place in names.actuated) for place, (name, length) in (
        enumerate(zip(names.names, names.lengths)))]
    # The numbers of an orientation mean nothing one by one.
    plots = [Plot('joint position', name, QUANTITIES['position'][length], driven, position[place])
             for (name, length, driven), place in zip(freedoms, names.place) if place >= 0]
    plots += [Plot('drive torque or force', name, QUANTITIES['effort'][length], column=column)
              for (name, length, driven), column in zip(freedoms, effort) if driven]
    plots += [Plot('drive power', name, 'W', column=f'power.{name}')
              for name, _, driven in freedoms if driven]
    plots += [Plot('force where loops close', cut.name, 'N', column=f'cut_force.{cut.name}')
              for cut in mechanism.cut_joints]
    plots += [Plot('points', f'{point.name} {axis}', 'm', column=f'point.{point.name}.{axis}')
              for point in mechanism.points for axis in 'xyz'[:len(point.position)]]
    return plots + [Plot('joint velocity', name, QUANTITIES['velocity'][length], driven, column)
                    for (name, length, driven), column in zip(freedoms, velocity)]


def _joint_values(names, position, velocity, effort, forces, points):
    """Return the values of ``joint_plots``, of one instant or of several."""
    driven = list(names.actuated)
    power = effort[..., driven] * velocity[..., driven]
    return [position[..., names.place[names.place >= 0]], effort[..., driven], power,
            magnitudes(forces), points, velocity]


def _is_other(names):
    """Return which numbers of a position, and of its efforts, are not plotted: bool."""
    position, effort = np.ones(names.nq, dtype=bool), np.ones(names.nv, dtype=bool)
    position[names.place[names.place >= 0]] = False
    effort[list(names.actuated)] = False
    return position, effort


def _other_columns(names):
    """Return the columns of orientations, and of efforts of joints that are not driven."""
    position, effort = _is_other(names)
    return [names.columns('position')[place] for place in np.flatnonzero(position)] + [
        f'{names.columns("effort")[place]} [{names.units("effort")[place]}]'
        for place in np.flatnonzero(effort)]


def motion_columns(mechanism, estimated=False):
    """Return the columns of a recording or of topics, with those of an estimator or without."""
    plots, names = joint_plots(mechanism), mechanism.coordinates
    estimates = [plot for plot in plots if estimated and plot.group in ESTIMATED]
    behind = len(plots) + len(estimates) + sum(map(np.count_nonzero, _is_other(names)))
    return Columns(mechanism, plots=plots + [
        replace(plot, name=f'{plot.name}, estimated', column=f'estimated.{plot.column}',
                deviation=int(behind) + k)
        for k, plot in enumerate(estimates)], estimated=estimated)


def motion_thinning_values(columns, motion, rows):
    """
    Return the values for ``thinning.Thinning`` in the rows of a motion.

    Shape (n, 3 points + plots): places of the named points [m], what is plotted.
    """
    places = named_paths(motion.mechanism, motion.position).values()
    starts = columns.starts
    return np.hstack([*(np.pad(place, ((0, 0), (0, 3 - place.shape[1]))) for place in places),
                      rows[:, starts['plots']:starts['others']]])


def motion_rows(motion, estimate=None):
    """
    Return the rows of a ``Trajectory``: float32, shape (instants, width).

    ``estimate``: another one beside it, of estimates, and the standard deviations of its positions
    and velocities, shapes (instants, nq) and (instants, nv).
    """
    names, count = motion.mechanism.coordinates, len(motion.time)
    turns, undriven = _is_other(names)
    poses = poses_in_space(body_poses(motion.mechanism, motion.position))
    points = [*named_paths(motion.mechanism, motion.position).values(), np.zeros((count, 0))]
    places, values, deviations = np.zeros((3, count, 0))
    if estimate is not None:
        other, *spread = estimate
        places = poses_in_space(body_poses(motion.mechanism, other.position)).reshape(count, -1)
        values, deviations = (np.hstack([position[:, names.place[names.place >= 0]], velocity])
                              for position, velocity in ((other.position, other.velocity), spread))
    return np.hstack([
        poses.reshape(count, -1), in_three(force_of(motion.forces)).reshape(count, -1), places,
        *_joint_values(names, motion.position, motion.velocity, motion.effort, motion.forces,
                       np.hstack(points)), values,
        motion.position[:, turns], motion.effort[:, undriven], deviations]).astype(np.float32)


class SimulationRows:
    """
    The rows of a running simulation, which is read, not advanced.

    ``hidden``: names of effects whose arrows are not shown; ``points``: number of the first named
    points whose paths are drawn.
    """

    def __init__(self, simulation, hidden=(), points=0):
        self._simulation, self._points = simulation, points
        mechanism = simulation.mechanism
        shown = {name: record for name, record in simulation.effects.items()
                 if name not in hidden}
        self._loads = {name: record for name, record in shown.items() if isinstance(
            record, (BodyContact, Contact, ExternalForce, PointSpring))
            or isinstance(record, PrescribedForce) and record.point is not None}
        self._outlines = {name: outline_of(record) for name, record in self._loads.items()
                          if isinstance(record, BodyContact) and mechanism.planar}
        self._rows = {body.name: k for k, body in enumerate(mechanism.bodies)}
        self._places = {point.name: point for point in mechanism.points}
        names = mechanism.coordinates
        self._names, (self._turns, self._undriven) = names, _is_other(names)
        # Behind these come the places where a hand may take hold of the machine.
        plots = joint_plots(replace(mechanism, points=mechanism.points[:points]))
        self._read = [(name, reading) for name, record in shown.items()
                      for reading in READINGS.get(type(record), ())]
        self._telling = dict.fromkeys([*self._loads, *(name for name, _ in self._read)])
        plots += [Plot('force of effects', f'{name}, {READINGS[type(shown[name])][reading]}', 'N',
                       column=f'effect.{name}.{reading}') for name, reading in self._read]
        plots += [Plot('energy', name, 'J', column=f'energy.{name}')
                  for name in ('kinetic', 'stored', 'dissipated', 'work')]
        methods = [Plot('closure error', 'largest', 'm or rad', column='closure', log=True),
                   Plot('error of the energy balance', 'balance', 'J', column='energy.error',
                        log=True),
                   Plot('angle from a singularity', 'loops', 'sine', column='singularity.loops',
                        log=True)]
        if not np.isnan(self._sine()):
            methods.append(Plot('angle from a singularity', 'held drives', 'sine',
                                column='singularity.drives', log=True))
        methods += [Plot('estimated error', 'largest of a step', 'rad or m', column='error.step',
                         log=True),
                    Plot('estimated error', 'within a second', 'rad or m', column='error.second',
                         log=True),
                    Plot('estimated error', 'accuracy kept', 'rad or m', column='error.accuracy',
                         log=True),
                    Plot('cost', 'computing', '% of real time', column='cost'),
                    Plot('evaluations', 'in a simulated second', '1/s', column='evaluations')]
        plots += [replace(plot, method=True) for plot in methods]
        self.columns = Columns(
            mechanism, [{'name': name, 'kind': kind} for name, record in self._loads.items()
                        for kind in _kinds(record)], True, plots)
        starts = self.columns.starts
        self._plotted = slice(starts['plots'], starts['others'])
        self._for_thinning = np.zeros(3 * points + len(plots))
        self._has_drives = any(plot.name == 'held drives' for plot in plots)
        self._costly = np.full(6, np.nan)
        self._direction = np.full(POSE * len(mechanism.bodies), np.nan)
        self._cost = None
        self.refresh()

    def refresh(self):
        """
        Update the costly values: errors, cost, motions freed by a singularity.

        Returns the simulation's ``RunReport``.
        """
        simulation = self._simulation
        report = simulation.report()
        before, self._cost = self._cost, (report.time, report.compute_time, report.evaluations)
        share = evaluations = np.nan
        if before is not None and report.time > before[0]:
            _, share, evaluations = np.subtract(self._cost, before) / (report.time - before[0])
        sine = self._sine()
        self._costly[:] = (sine, report.local_error, report.error_bound, report.accuracy,
                           100.0 * share, evaluations)
        self._direction[:] = np.nan
        if self._pivot() < WARN_BELOW or abs(sine) < NEAR:
            self._direction[:] = self._moved(abs(sine) < NEAR)
        return report

    def _pivot(self):
        return float(self._simulation.data.system.work.health[SMALLEST_PIVOT])

    def _sine(self):
        """Return how far held drives are from leaving the mechanism loose; NaN where unknown."""
        return self._simulation.health.drive_sine

    def _moved(self, held):
        """Return poses displaced in the direction that loops and held drives resist least."""
        simulation = self._simulation
        jac = simulation.constraint_jacobian.copy()
        if held:
            jac[:, simulation.data.actuated_in_tree] = 0.0
            jac = np.vstack([jac, np.eye(jac.shape[1])[simulation.data.actuated_in_tree]])
        if not len(jac):
            return np.nan
        # Rates of joints, less those of the freedoms there are anyway.
        freedoms = max(jac.shape[1] - len(jac), 0)
        direction = np.linalg.svd(jac)[2][-1 - freedoms]
        mechanism, q = simulation.mechanism, simulation.position
        poses = [poses_in_space(body_poses(
            mechanism, mechanism.coordinates.moved(q, 1e-4 * sign * direction)))
                 for sign in (1.0, -1.0)]
        rate = 0.5e4 * (poses[0] - poses[1])
        fastest = np.abs(rate[:, :3]).max(initial=0.0)
        if not fastest > 0.0:
            return np.nan
        moved = poses_in_space(simulation.body_poses) + SHOWN * self._size() / fastest * rate
        return moved.ravel()

    def _size(self):
        places = self._simulation.body_poses[:, :2]
        return float(np.ptp(places, axis=0).max()) or 1.0

    def row(self):
        """Return the present state, float32, shape (width,)."""
        simulation = self._simulation
        forces = simulation.constraint_forces
        poses = poses_in_space(simulation.body_poses)
        balance, readings = simulation.energy_balance, self._own_readings()
        pivot = max(self._pivot(), 0.0)
        sine, *costly = self._costly
        return np.concatenate([
            poses.ravel(), in_three(force_of(forces)).ravel(), self._arrows(readings).ravel(),
            self._direction, *_joint_values(
                self._names, simulation.position, simulation.velocity, simulation.effort, forces,
                simulation.points[:self._points].ravel()), self._readings(readings),
            [balance.kinetic, balance.stored, balance.dissipated, balance.work,
             simulation.closure, abs(balance.residual), np.sqrt(pivot)],
            [abs(sine)] * self._has_drives, costly, simulation.position[self._turns],
            simulation.effort[self._undriven]]).astype(np.float32)

    def thinning_values(self, row):
        """Return the values for ``thinning.Thinning`` of the present state, whose row is given."""
        places = self._simulation.points[:self._points]
        values = self._for_thinning.copy()
        values[:3 * self._points].reshape(-1, 3)[:, :places.shape[1]] = places
        values[3 * self._points:] = row[self._plotted]
        return values

    def _own_readings(self):
        """Return the effects' own readings, by name; nothing of those switched off."""
        enabled = self._simulation.data.enabled_effects
        return {name: self._simulation.effect_readings(name)
                for name in self._telling if name in enabled}

    def _readings(self, readings):
        """Return the plotted readings of effects; NaN for those that are switched off."""
        return [readings[name][reading] if name in readings else np.nan
                for name, reading in self._read]

    def _arrows(self, readings):
        """Return foot and force of each load, shape (number of loads, 6)."""
        arrows = np.full((len(self.columns.loads), ARROW), np.nan)
        row = 0
        for name, record in self._loads.items():
            first, row = row, row + len(_kinds(record))
            if name not in readings:
                continue
            foot = self._simulation.point(getattr(record, 'point', None) or record.point_a)
            record = self._simulation.effects[name]
            feet, forces = self._force(name, record, foot, readings[name])
            arrows[first:row] = 0.0
            arrows[first:row, :len(foot)] = feet
            arrows[first:row, 3:3 + len(foot)] = forces
        return arrows

    def _force(self, name, record, foot, readings):
        """Return where the forces of an effect act, and the forces, one or two."""
        if isinstance(record, ExternalForce):
            return foot, self._in_world(record, record.force)
        if isinstance(record, Contact):
            return foot, self._contact(record, readings)
        if isinstance(record, PrescribedForce):
            direction = np.array(record.direction) / np.linalg.norm(record.direction)
            return foot, self._in_world(record, readings['force'] * direction)
        if isinstance(record, BodyContact):
            return self._body_contact(name, record, readings, foot)
        end = (np.array(record.anchor) if record.point_b is None
               else self._simulation.point(record.point_b))
        length = readings['length']
        return foot, readings['tension'] * (end - foot) / length if length > 0.0 else 0.0 * foot

    def _in_world(self, record, force):
        """Return a force at an effect's point in world axes."""
        if record.axes != BODY:
            return force
        return self._turn(self._places[record.point].body)[:len(force), :len(force)] @ force

    def _turn(self, body):
        """Return the axes of a body, or of the ground, in the world, shape (3, 3)."""
        if body == GROUND:
            return np.eye(3)
        pose = poses_in_space(self._simulation.body_poses[self._rows[body]])
        return of_quaternion(pose[3:])

    def _contact(self, record, readings):
        """Return the normal force and the force along the line or plane."""
        normal = readings['normal_force']
        along = readings['friction_force'] + readings['scraping_force']
        if record.normal is None:
            return turned(record.angle, np.array([[0.0, normal], [along, 0.0]]))
        out = np.array(record.normal)
        point = self._places[record.point]
        return np.array([normal * out, along * self._sliding(
            out, self._simulation.point(record.point), point.body) if normal > 0.0 else 0.0 * out])

    def _body_contact(self, name, record, readings, center):
        """Return where a roller touches, and the normal force and friction on it."""
        other = self._places[record.other]
        turn, away = self._turn(other.body), center - self._simulation.point(record.other)
        if not self._simulation.mechanism.planar:
            out = turn @ normal_of(record, turn.T @ away)
            foot, friction = center - record.radius * out, np.zeros(3)
            if readings['friction_force']:
                friction = readings['friction_force'] * self._sliding(
                    out, foot, self._places[record.point].body, other.body)
            return foot, np.array([readings['normal_force'] * out, friction])
        turn = turn[:2, :2]
        if record.shape == 'face':
            out = self._turn(self._places[record.point].body)[:2, :2] @ face_normal(record)
            outline = self._outlines[name] @ turn.T
            foot = center - away + outline[np.argmin(outline @ out)]
            out = -out
        else:
            out = turn @ normal_of(record, turn.T @ away, self._outlines[name])
            foot = center - record.radius * out
        return foot, np.array([
            readings['normal_force'] * out, readings['friction_force'] * out[::-1] * (1.0, -1.0)])

    def _sliding(self, normal, place, body, other=GROUND):
        """Return the direction in which a body slides on another at a place, across a normal."""
        simulation = self._simulation
        names = [name for name in (body, other) if name != GROUND]
        found = body_velocities(simulation.mechanism, simulation.position,
                                simulation.velocity[np.newaxis], names)[0]
        velocity = np.zeros(3)
        for name, twist in zip(names, found):
            arm = place - simulation.body_poses[self._rows[name]][:3]
            velocity += (1.0 if name == body else -1.0) * (
                twist[:3] + np.cross(twist[3:], arm))
        velocity -= (velocity @ normal) * normal
        return velocity / (np.linalg.norm(velocity) or 1.0)


def _kinds(record):
    """Return the kinds of an effect's arrows."""
    return ('normal', 'friction') if isinstance(record, (BodyContact, Contact)) else ('force',)
