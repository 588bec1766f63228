# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Of the recursions in space nothing is left, for planar mechanisms, but the planar ones."""

import copy

from closedloop_dynamics.codegen import expression_graph as graph, routines
from closedloop_dynamics.codegen.function_table import EVALUATION
from closedloop_dynamics.codegen.plane import possible
from closedloop_dynamics.codegen.vectors import is_zero
from closedloop_dynamics.engine.types import (
    CUT_FIXED, CUT_PRISMATIC, CUT_REVOLUTE, CUT_TYPE, KEPT, SMALLEST_PIVOT)
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.simulation.system import build_system
import numpy as np
import pytest

from ..reference import cases
from ..reference.compare import assert_agree, IDENTITY

ARITHMETIC = ('ADD', 'SUBTRACT', 'MULTIPLY', 'DIVIDE', 'NEGATE')
# Additions, multiplications, divisions and negations for accelerations and multipliers that
# recursions written for the plane alone, unrolled, come to.
PLANAR = {'three_rrr': 781, 'carpet_scraper': 891, 'hoeken_pantograph_leg': 891, 'four_bar': 223,
          'slider_crank': 223}


def unrolling(name):
    """Return the unrolling of a case, not yet run."""
    _, mechanism, _, _ = cases.drawn(name)
    return routines.MechanismTrace(build_model(mechanism, (0.0, -9.81)))


@pytest.mark.parametrize('name', cases.SHIPPED)
def test_planar_mechanisms_take_the_operations_of_planar_recursions(name):
    routine = unrolling(name).routine(EVALUATION)
    kinds = {getattr(graph, kind) for kind in ARITHMETIC}
    operations = [routine.graph.operations[place] for place in routine.needed()]
    assert sum(kind in kinds for kind, *_ in operations) <= 1.03 * PLANAR[name]
    # One sine and one cosine serve all that turns with a body.
    sines = sum(kind == graph.SINE for kind, *_ in operations)
    assert sines == len(cases.drawn(name)[1].bodies)


@pytest.mark.parametrize('name', cases.SHIPPED)
def test_planar_motion_has_no_third_dimension(name):
    one = unrolling(name)
    one.outward()
    for motion in one.recursion.motion[1:]:
        assert is_zero((motion.origin[2], motion.velocity[2], motion.acceleration[2]))
        assert is_zero((*motion.spin[:2], *motion.spin_rate))
        assert motion.frame[2] == (0.0, 0.0, 1.0)


@pytest.mark.parametrize('kind, left', [(CUT_REVOLUTE, 2), (CUT_PRISMATIC, 2), (CUT_FIXED, 3)])
def test_equations_out_of_the_plane_fall_away(kind, left):
    _, mechanism, _, _ = cases.drawn('four_bar')
    model = build_model(mechanism)
    cut = model.cut.copy()
    cut[:, CUT_TYPE], cut[:, KEPT] = kind, possible(kind)
    model = model.replaced(cut=cut)
    one = routines.MechanismTrace(model)
    one.outward()
    held = one.recursion.cuts[0]
    # In space five, five and six.
    assert len(held.along) + len(held.perpendicular) == (6 if kind == CUT_FIXED else 5)
    assert len(one.recursion.closures(model, 0)) == left


@pytest.mark.parametrize('name', cases.SHIPPED)
def test_planar_results_are_those_of_planar_loops(name):
    for seed in range(5):
        rng, mechanism, q, qd = cases.drawn(name, seed)
        tau, results = rng.normal(size=len(q)), []
        model = build_model(mechanism, (0.3, -9.81))
        for unrolled in (True, False):
            system = build_system(copy.deepcopy(model), unrolled=unrolled)
            system.tau[:] = tau
            system.native.evaluate(q, qd)
            results.append((system.qdd, system.lam))
        # Elimination multiplies rounding by the reciprocal of its smallest pivot.
        rounding = 100.0 * np.finfo(float).eps / system.work.health[SMALLEST_PIVOT]
        for space, plane in zip(*results):
            assert_agree(space, plane, max(rounding, IDENTITY))
