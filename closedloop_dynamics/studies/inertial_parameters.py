# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The numbers of bodies that the equations of motion are linear in.

Inverse dynamics is linear in the mass m of a body, its first moments h = m c, and its inertia
about the origin of its frame, J = I + m (|c|^2 1 - c c^T), c being the centre of mass and I the
inertia about it. Which of these are unknown follows from the keys that vary:

* where all of the inertia varies, m, h and J as far as mass and centre do;
* where the centre of mass is known, m (which carries h and a part of J with it) and elements of I;
* otherwise the centre of mass enters by its square, too, and is not a linear parameter.
"""

from typing import NamedTuple

import numpy as np

from ..mechanism.inertia import inertia_matrix, second_moments

AXES = 'xyz'
# Elements of an inertia in the order of their keys.
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))


class Parameter(NamedTuple):
    """A number that the equations of motion are linear in, as a unit added to a body."""

    #: ``crank.mass``, ``crank.first_moment.x``, ``crank.inertia_about_origin.xx``; without axes in
    #: the plane, and ``crank.inertia`` where it is about the centre of mass.
    name: str
    body: str
    value: float  # Of the scene [kg, kg m, kg m^2]
    power: int  # Of the length in its unit
    #: Shape (4,), in space (10,): Mass, first moments, inertia about the origin (xx, yy, zz, xy,
    #: xz, yz).
    numbers: np.ndarray


class BodyParameters:
    """
    The linear parameters of one body.

    ``keys``, those that vary, are below the body: ``mass``, ``center_of_mass.0``, ``inertia``,
    ``inertia.3``; those that are not linear parameters become ``nonlinear``; ``depends``: which
    parameters a key follows from.
    """

    def __init__(self, body, keys):
        self.name = body.name
        self._body, self._planar = body, len(body.center_of_mass) == 2
        self._center = np.append(body.center_of_mass, 0.0) if self._planar else np.array(
            body.center_of_mass)
        # The inertia of the plane is that about z.
        self._inertia = np.diag((0.0, 0.0, body.inertia)) if self._planar else (
            inertia_matrix(body.inertia))
        self._elements = {'inertia': (2, 2)} if self._planar else {
            f'inertia.{n}': pair for n, pair in enumerate(PAIRS[:len(body.inertia)])}
        centers = [f'center_of_mass.{n}' for n in range(len(body.center_of_mass))]
        self._varies = frozenset(keys)
        all_inertia = len(self._elements) in (1, 6) and self._varies >= set(self._elements)
        centers_vary = [key for key in centers if key in self._varies]
        self._about_origin = all_inertia
        self.nonlinear = () if all_inertia else tuple(centers_vary)
        found, self.depends = [], {}
        held = np.array([0.0 if all_inertia and key in self._varies else value
                         for key, value in zip((*centers, None), self._center)])
        if 'mass' in self._varies:
            spread = np.zeros((3, 3)) if all_inertia else _shifted(self._center)
            found.append(self._parameter('mass', body.mass, 0, 1.0, held, spread))
        if all_inertia:
            for n, key in enumerate(centers):
                if key in self._varies:
                    found.append(self._parameter(
                        f'first_moment.{AXES[n]}', body.mass * self._center[n], 1, 0.0,
                        np.eye(3)[n], np.zeros((3, 3))))
        about = self._inertia + (body.mass * _shifted(self._center) if all_inertia else 0.0)
        for key, (m, n) in self._elements.items():
            if key in self._varies:
                unit = np.zeros((3, 3))
                unit[m, n] = unit[n, m] = 1.0
                name = 'inertia_about_origin' if all_inertia else 'inertia'
                found.append(self._parameter(
                    name if self._planar else f'{name}.{AXES[m]}{AXES[n]}', about[m, n], 2, 0.0,
                    np.zeros(3), unit))
        self.parameters = tuple(found)
        self._collect(centers_vary)

    def _parameter(self, name, value, power, mass, moment, inertia):
        unit = (mass, *moment[:2], inertia[2, 2]) if self._planar else (
            mass, *moment, *(inertia[pair] for pair in PAIRS))
        return Parameter(
            f'{self.name}.{name}', self.name, float(value), power, np.array(unit))

    def _collect(self, centers_vary):
        """Find the parameters that determine a key."""
        names = [one.name for one in self.parameters]
        mass = [name for name in names if name.endswith('.mass')]
        moments = [name for name in names if '.first_moment.' in name]
        inertias = [name for name in names if '.inertia' in name]
        if mass:
            self.depends['mass'] = tuple(mass)
        if self._about_origin:
            for key, name in zip(centers_vary, moments):
                self.depends[key] = (*mass, name)
        for key, name in zip(
                (key for key in self._elements if key in self._varies), inertias):
            self.depends[key] = (*mass, *moments, name) if self._about_origin else (name,)

    def values(self, parameters):
        """
        Return the numbers of the keys, of parameters by name, those not given being the scene's.

        Complex ones are for derivatives by complex steps.
        """
        name, body = self.name, self._body
        parameters = {**{one.name: one.value for one in self.parameters}, **parameters}
        mass = parameters.get(f'{name}.mass', body.mass)
        center = self._center.astype(complex)
        for n, axis in enumerate(AXES):
            moment = parameters.get(f'{name}.first_moment.{axis}')
            if moment is not None:
                center[n] = moment / mass
        found = {'mass': mass, **{f'center_of_mass.{n}': center[n] for n in range(3)}}
        shifted = mass * _shifted(center)
        for key, (m, n) in self._elements.items():
            kind = 'inertia_about_origin' if self._about_origin else 'inertia'
            value = parameters.get(
                f'{name}.{kind}' if self._planar else f'{name}.{kind}.{AXES[m]}{AXES[n]}')
            if value is not None:
                found[key] = value - shifted[m, n] if self._about_origin else value
        return {key: found[key] for key in self.depends}


def _shifted(center):
    """Return the inertia of a unit mass at a place about the origin, shape (3, 3)."""
    return center @ center * np.eye(3) - np.outer(center, center)


def numbers_of(body) -> np.ndarray:
    """Return mass, first moments and inertia about the origin, as ``Parameter.numbers``."""
    center = np.array(body.center_of_mass)
    if len(center) == 2:
        return np.array([body.mass, *(body.mass * center),
                         body.inertia + body.mass * (center @ center)])
    about = inertia_matrix(body.inertia) + body.mass * _shifted(center)
    return np.array([body.mass, *(body.mass * center), *(about[pair] for pair in PAIRS)])


def pseudo_inertia(body) -> np.ndarray:
    """
    Return the pseudo-inertia matrix of a body, positive definite where it can exist.

    Shape (3, 3), in space (4, 4): [[S, m c], [m c^T, m]], S the integral of x x^T dm from the
    origin: ``second_moments`` and m c c^T; in the plane positive definite where mass and inertia
    are positive.
    """
    center = np.array(body.center_of_mass)
    moment = body.mass * center
    return np.block([[second_moments(body) + np.outer(moment, center), moment[:, np.newaxis]],
                     [moment[np.newaxis], np.array([[body.mass]])]])


def unit_rows(placement, planar):
    """
    Return the change of a body's row of ``Model.body`` by units of its numbers, shape (k, k).

    A row for each number of ``Parameter.numbers``; columns: mass, first moments, inertia about the
    origin; k is 4 in the plane, where all placements have the same, 10 in space.
    """
    if planar:
        return np.eye(4)
    axes, origin, found = placement.axes, placement.origin, []
    for mass, *numbers in np.eye(10):
        moment, inertia = axes @ numbers[:3], inertia_matrix(numbers[3:])
        second = 0.5 * np.trace(inertia) * np.eye(3) - inertia
        second = axes @ second @ axes.T + np.outer(moment, origin) + np.outer(origin, moment) + (
            mass * np.outer(origin, origin))
        about = np.trace(second) * np.eye(3) - second
        found.append([mass, *(moment + mass * origin), *(about[pair] for pair in PAIRS)])
    return np.array(found)
