# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Equations of motion in the joints' coordinates give the motion of articulated bodies."""

from closedloop_dynamics.codegen import (
    forward_dynamics, function_table as calls, joint_space, routines, space)
from closedloop_dynamics.codegen.scheduling import longest_chain
from closedloop_dynamics.engine import types as t
import numpy as np
import pytest

from .spatial_engine import _array, _inputs, inputs_with_forces, interpret
from .test_arms import drawn
from ..reference.compare import assert_agree

# Axes across one another and at any angle, parallel ones in space, slides, spherical joints.
SCENES = ('bricard', 'bennett', 'excavator_arm', 'rssr_four_bar', 'double_wishbone',
          'stewart_platform', 'four_bar', 'slider_crank', 'carpet_scraper', 'rope_hoist')
# With a rotor on a moving body.
ROTOR = (1e-3, -2e-3, 3e-3)


def trace(model, by):
    """Return a trace of accelerations by a module, whichever is the shortest."""
    found = routines.MechanismTrace(model, with_arms=False, by=by)
    found.embeds = lambda: False
    return found


def results(model, by, which, inputs, kind=float):
    """Return outputs of a routine by a module, interpreted."""
    outputs, good = interpret(trace(model, by).routine(which), {
        source: np.asarray(array, dtype=kind) for source, array in inputs.items()})
    assert good
    nv, nc = len(model.tree) - 1, len(model.column) - 1
    return {source: _array(outputs, source, size) for source, size in (
        (calls.QDD, nv), (calls.LAM, nc), (calls.CLOSURE, nc), (calls.CLOSURE_RATE, nc),
        (calls.CORRECTIONS, 2 * nv),
        (calls.HEALTH, t.HEALTH_COLUMNS))}


@pytest.mark.parametrize('name', SCENES)
@pytest.mark.parametrize('rotors', [False, True])
def test_motion_forces_and_pivots_are_those_of_articulated_bodies(name, rotors):
    model, q, qd, tau = drawn(name)
    if rotors and space.is_spatial(model):
        plain = model.tree[1:, t.TYPE] != t.BALL
        model.body[1:, space.ARMATURE] = 0.01 * plain
        model.body[1:, space.ROTOR:space.ROTOR + 3] = np.outer(
            plain & (model.tree[1:, t.PARENT] > 0), ROTOR)
    inputs = _inputs(model, q, qd, tau)
    inputs[calls.BAUMGARTE] = np.full(len(inputs[calls.BAUMGARTE]), 3.0)
    for which in (calls.EVALUATION, calls.CORRECTION):
        found = results(model, joint_space, which, inputs)
        expected = results(model, forward_dynamics, which, inputs, np.longdouble)
        for source, values in expected.items():
            assert_agree(found[source], values, 1e-12)


@pytest.mark.parametrize('name', ['bricard', 'excavator_arm'])
def test_forces_of_effects_are_added(name):
    model, q, qd, tau = drawn(name)
    inputs = inputs_with_forces(model, q, qd, tau)
    found, expected = (results(model, by, calls.ACCELERATION, inputs)
                       for by in (joint_space, forward_dynamics))
    for source, values in expected.items():
        assert_agree(found[source], values, 1e-11)


def test_the_faster_one_is_taken():
    for name, by in ('bennett', joint_space), ('rssr_four_bar', forward_dynamics):
        model = drawn(name)[0]
        assert routines.MechanismTrace(model, with_arms=False).method() is by
        costs = {}
        for one in joint_space, forward_dynamics:
            routine = trace(model, one).traced(calls.MOTION)
            costs[one] = routines.count_operations(routine) + longest_chain(routine)
        assert min(costs, key=costs.get) is by
