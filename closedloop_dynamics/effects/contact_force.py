# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Forces of contacts, by the law of Hunt and Crossley with friction, for laws on symbols."""

from .force_law import force_law
from ..codegen.expression_graph import chosen, larger, square_root
from ..codegen.vectors import add, dot, scale


def contact_law(**keys):
    """Make a function of forces the law of a contact; ``keys`` are those of ``ForceLaw``."""
    # Some exponents need no power in the code.
    return force_law(
        terms=lambda row: (row.values[7] if row.values[7] in (1.0, 1.5) else 0.0,), **keys)


def press(forces, gap, rate, slip, scraping=None):
    """
    Return forces of a contact, zero where there is none, that push apart and along the sliding.

    ``rate``: of approach; ``slip``: of what slides along; ``scraping``: force per depth [N/m].
    """
    stiffness, exponent, damping, friction, slow = forces.values[6:11]
    inside = forces.touches(gap, -rate)
    sign = slip / square_root(slip * slip + slow * slow)
    power, = forces.terms or (0.0,)
    elastic = chosen(inside, _elastic_force(stiffness, exponent, power, gap), 0.0)
    normal = elastic * larger(0.0, 1.0 + damping * rate)
    along = rubbing = -(friction * normal * sign)
    depth = chosen(inside, -gap, 0.0)
    last = chosen(inside, slip, 0.0)
    if scraping is not None:
        last = -(scraping * depth * sign)
        along = rubbing + last
    forces.flow((normal - elastic) * rate - along * slip)
    forces.store(elastic * depth / (exponent + 1.0))
    forces.read(depth, normal, rubbing, last)
    return normal, along


def _elastic_force(stiffness, exponent, power, gap):
    """
    Return the elastic force k d^n of a contact.

    Beyond its end, until the step is cut there, a contact pulls: so the motion is smooth, and the
    end is located to rounding.
    """
    depth = abs(gap)
    if power == 1.0:
        return -(stiffness * gap)
    force = stiffness * (depth * square_root(depth)) if power == 1.5 else (
        stiffness * depth ** exponent)
    return chosen(gap > 0.0, -force, force)


def sliding(velocity, rate, out):
    """Return the sliding part of a velocity, and its speed."""
    slide = add(velocity, scale(out, rate))
    return slide, square_root(dot(slide, slide))


def contact_force(out, normal, along, slide, slip):
    """Return the force of a contact in space, of its parts along the normal and the sliding."""
    drag = chosen(slip > 0.0, along / chosen(slip > 0.0, slip, 1.0), 0.0)
    return add(scale(out, normal), scale(slide, drag))
