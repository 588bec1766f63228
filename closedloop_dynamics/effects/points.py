# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Forces at points of bodies, for laws on symbols.

``forces`` are those of ``codegen.scene_routines``; bodies are their rows, places are in the
frames of these, all else is in world axes.
"""

from ..codegen.expression_graph import chosen, square_root
from ..codegen.vectors import dot, in_space, scale, subtract


def push_apart(forces, bodies, offsets, direction, force):
    """Push two bodies apart, along the line between two of their points."""
    for body, offset, sign in zip(bodies, offsets, (-1.0, 1.0)):
        forces.push(body, offset, scale(direction, sign * force))


def line_between(forces, bodies, places):
    """Return offsets of two points, the direction from one to the other, length and its rate."""
    offsets = [forces.turned(body, place) for body, place in zip(bodies, places)]
    (place_a, rate_a), (place_b, rate_b) = map(forces.place, bodies, offsets)
    gap = subtract(place_b, place_a)
    length = square_root(dot(gap, gap))
    # Where the points meet the gap is zero, and so is the force.
    direction = scale(gap, 1.0 / chosen(length > 0.0, length, 1.0))
    return offsets, direction, length, dot(direction, subtract(rate_b, rate_a))


def two_places(forces, first):
    """Return the places of two points, from a number of the effect on."""
    middle = first + forces.size
    return forces.values[first:middle], forces.values[middle:middle + forces.size]


def pull_together(forces, places, tension):
    """
    Pull two points together.

    Parameters
    ----------
    forces : Forces
        Whose turn is that of an effect between two bodies.
    places : tuple of 2 sequences
        Of the points.
    tension : callable
        Returns the tension of the length and its rate [N], the energy stored [J], and the power
        dissipated [W], or None where nothing is.

    """
    offsets, direction, length, rate = line_between(forces, forces.bodies, places)
    pull, stored, lost = tension(length, rate)
    push_apart(forces, forces.bodies, offsets, direction, -pull)
    forces.store(stored)
    if lost is not None:
        forces.flow(lost)
    forces.read(chosen(length > 0.0, pull, 0.0), length)


def of_body_or_world(forces, body, vector, turns):
    """Return a vector that is of a body's axes where ``turns`` is positive."""
    vector = in_space(vector)
    return tuple(x if one is x else chosen(turns > 0.0, x, one) for x, one in zip(
        forces.turned(body, vector), vector))
