# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Dry friction in a joint or along a tendon: its law, and the direction of sliding."""

import math

from .element import DISSIPATED, ForceElement, LOAD_TIME, OWN, State
from .force_law import force_law, FRICTION
from ..codegen.expression_graph import chosen, exponential
from ..codegen.live_scene import REST


def direction_of(rate):
    """Return the direction of a rate, 1 or -1; 0 at rest."""
    return math.copysign(1.0, rate) if abs(rate) > REST else 0.0


def friction_element(record, machine, values, load_time=0.0, **keys):
    """
    Return dry friction as a row of the table.

    Parameters
    ----------
    record : Effect
        Dry friction acts along its ``friction_direction``.
    machine : effect.NameResolver
        Names, resolved.
    values : sequence of floats
        F_c, s, v_s, and mu r.
    load_time : float
        T [s].
    keys : dict
        Of ``ForceElement``: where it acts.

    """
    values = (*values, float(record.friction_direction in machine.determined))
    return ForceElement(
        dry_friction, values=(*values, *(LOAD_TIME - len(values)) * (0.0,), load_time),
        states=(State(OWN), State(OWN, 10.0), State(DISSIPATED)), **keys)


@force_law(role=FRICTION, terms=lambda row: (bool(row.values[1] > 1.0),),
           engine_only='dry friction jumps where it comes to rest')
def dry_friction(forces):
    coulomb, ratio, slow, lever, determined = forces.values[:5]
    rate = forces.joint.rate
    most = coulomb + lever * forces.state(1)
    rises, = forces.terms or (ratio > 1.0,)
    if rises is not False:
        share = rate / slow
        more = most * (1.0 + (ratio - 1.0) * exponential(-(share * share)))
        most = chosen(rises, more, most)
    # Where loops and motions hold it at rest, no response decides.
    torque = forces.rub(most, chosen(determined > 0.0, 0.0, most))
    forces.joint.push(torque)
    forces.flow(0.0, 0.0, -(torque * rate))
    forces.read(torque)
    forces.read(most, first=3)
