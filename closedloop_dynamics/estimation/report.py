# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Estimates as columns of numbers with standard deviations, as tables and as messages of a bag."""

import numpy as np

from .unknowns import Wrench
from ..recording.forces import MessageBag
from ..visual.tables import short, text_table
from ..visual.trajectory import wrench_parts

# Behind the name of a column: its standard deviation.
DEVIATION = '.deviation'
# An unknown whose standard deviation stays above this share of that at the start is not observed.
OBSERVED = 0.9


def columns(estimate, mechanism):
    """Return names, values and standard deviations of all numbers of an estimate."""
    coordinates, axes = mechanism.coordinates, 'xyz'
    deviation = np.full(coordinates.nq, np.nan)
    single = coordinates.single
    deviation[coordinates.place[single]] = estimate.positions.deviation[single]
    parts = [(coordinates.columns('position'), estimate.state.q, deviation)]
    parts += [(coordinates.columns(quantity), found.value, found.deviation)
              for quantity, found in (('velocity', estimate.rates),
                                      ('acceleration', estimate.accelerations))]
    cut = estimate.cut_positions
    parts.append(([f'position.{name}' for name in cut.names], cut.value, cut.deviation))
    for kind, found, components in (('point', estimate.points, axes), (
            'force', estimate.joint_forces, wrench_parts(mechanism))):
        parts.append(([f'{kind}.{name}.{component}' for name in found.names
                       for component in components[:found.value.shape[1]]],
                      found.value.ravel(), found.deviation.ravel()))
    parts.append((estimate.unknowns.names, estimate.unknowns.value, estimate.unknowns.deviation))
    return ([name for names, *_ in parts for name in names],
            *(np.concatenate([part[k] for part in parts]) for k in (1, 2)))


def unknowns_table(estimate, unknowns):
    """Return the unknowns as a table, and the names of those that are not observable."""
    begun = [deviation for one in unknowns for deviation in one.deviations]
    found, rows, unobserved = estimate.unknowns, [], []
    for name, value, deviation, before in zip(
            found.names, found.value, found.deviation, begun):
        observed = deviation < OBSERVED * before
        unobserved += [name] * (not observed)
        rows.append((name, f'{value:.6g}', f'{deviation:.2g}',
                     f'{value - 2.0 * deviation:.5g} to {value + 2.0 * deviation:.5g}',
                     '' if observed else 'not observable in this record'))
    return text_table(('unknown', 'value', 'standard deviation', '95 %', ''), rows), unobserved


def sensors_table(consistency):
    """Return how the sensors have fared as a table."""
    return text_table(
        ('sensor', 'used', 'outliers', 'late', 'refused', 'NIS', 'expected', ''),
        [(name, str(one.accepted), str(one.gated), str(one.late), str(one.refused),
          short(one.nis, '.3g'), f'{one.bounds[0]:.2g} to {one.bounds[1]:.2g}',
          'silent' if one.silent else '' if one.consistent else 'not consistent')
         for name, one in consistency.sensors.items()])


class EstimateBag(MessageBag):
    """
    Writes estimates into a new bag, on the topics of ``closedloop_estimator``.

    A context; ``path`` is its directory, which must not exist.
    """

    def __init__(self, path, mechanism, unknowns):
        super().__init__(path)
        self._mechanism = mechanism
        self._cuts = {cut.name for cut in mechanism.cut_joints}
        self._loads = [one for one in unknowns if isinstance(one, Wrench)]

    def write(self, stamp, estimate):
        """Write an estimate, with a stamp [ns]; bags have none of times before zero."""
        if stamp < 0:
            return
        coordinates = self._mechanism.coordinates
        single = coordinates.single
        for topic, position, velocity in (
                ('states', estimate.state.q[coordinates.place[single]], estimate.rates.value),
                ('deviations', estimate.positions.deviation[single], estimate.rates.deviation)):
            self.state(f'/estimated_joint_{topic}', stamp, coordinates.single_names, position,
                       velocity[single], np.zeros(len(single)))
        for name, wrench in zip(estimate.joint_forces.names, estimate.joint_forces.value):
            kind = 'constraint' if name in self._cuts else 'joint'
            self.wrench(f'/{kind}_forces/{name}', stamp, wrench)
        for one in self._loads:
            self.wrench(f'/estimated_loads/{one.name}', stamp, load(
                one, estimate.unknowns, self._mechanism.planar))


def load(unknown, found, planar):
    """Return an unknown wrench, moments first: in the plane torque, x and y."""
    value = {name.removeprefix(f'{unknown.name}.'): found.of(name)[0]
             for name in unknown.components}
    return np.array([value.get(part, 0.0) for part in (('torque', 'x', 'y') if planar else (
        'torque_x', 'torque_y', 'torque_z', 'x', 'y', 'z'))])
