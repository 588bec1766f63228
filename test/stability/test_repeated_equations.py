# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Loops whose equations repeat one another but for the last digits of lengths.

A link and two rods between the ground and a plate, as in the necks and knees of legged robots:
with equal lengths the rods say the same twice, and the plate goes round without turning. With
others it is locked, strictly; next to where it is drawn the loops hardly open.

"""

from dataclasses import replace
import math

from closedloop_dynamics import AssemblyError, Body, ClosureError, CutJoint, Joint, Mechanism
from closedloop_dynamics.mechanism.mechanism import GROUND, REVOLUTE
import numpy as np
import pytest

from ..reference.scenes import simulated

LENGTH, ARM = 1.0, 0.2
PLANE_AND_SPACE = pytest.mark.parametrize('space', [False, True], ids=['plane', 'space'])


def neck(space, turned, apart, start):
    """
    Return a plate on a link and two rods, and where it is drawn.

    Parameters
    ----------
    space : bool
        Whether it is in space.
    turned : float
        How far the plate is turned against the ground as drawn [rad]; the rods' lengths fit.
    apart : float
        Angle between the rods' pivots on the ground, seen from the link's [rad].
    start : float
        Direction of the link as drawn; it is flat at 0 and pi [rad].

    """
    def place(x, y=0.0):
        return (x, y, 0.0) if space else (x, y)

    def inertia(value):
        return (value, value, value, 0.0, 0.0, 0.0) if space else value

    cosine, sine = math.cos(turned), math.sin(turned)
    turn = np.array([[cosine, -sine], [sine, cosine]])
    axis = {'axis': (0.0, 0.0, 1.0)} if space else {}
    axes = {'axis_a': (0.0, 0.0, 1.0), 'axis_b': (0.0, 0.0, 1.0)} if space else {}
    bodies = [Body('link', 1.0, place(0.5 * LENGTH), inertia(LENGTH ** 2 / 12.0)),
              Body('plate', 1.0, place(0.0, 0.05), inertia(0.02))]
    joints = [Joint('hip', REVOLUTE, GROUND, 'link', place(0.0), actuated=True, **axis),
              Joint('knee', REVOLUTE, 'link', 'plate', place(LENGTH), **axis)]
    cuts, q = [], [start, turned - start]
    for name, angle in (('front', 0.0), ('back', apart)):
        pivot = ARM * np.array([math.cos(angle), math.sin(angle)])
        rod = LENGTH * np.array([math.cos(start), math.sin(start)]) + turn @ pivot - pivot
        length = math.hypot(*rod)
        bodies.append(Body(name, 0.3, place(0.5 * length), inertia(0.025)))
        joints.append(Joint(f'{name}_rod', REVOLUTE, GROUND, name, place(*pivot), **axis))
        cuts.append(CutJoint(
            f'{name}_pin', REVOLUTE, name, 'plate', place(length), place(*pivot), **axes))
        q.append(math.atan2(rod[1], rod[0]))
    return Mechanism('neck', tuple(bodies), tuple(joints), tuple(cuts)), q


def beside(one, other):
    """Return two machines as one."""
    (first, place), (second, other_place) = one, other

    def renamed(record, **changes):
        return replace(record, name=f'other_{record.name}', **{
            key: name if name == GROUND else f'other_{name}' for key, name in changes.items()})

    return Mechanism(
        'both', first.bodies + tuple(map(renamed, second.bodies)),
        first.joints + tuple(renamed(joint, parent=joint.parent, child=joint.child)
                             for joint in second.joints),
        first.cut_joints + tuple(renamed(cut, body_a=cut.body_a, body_b=cut.body_b)
                                 for cut in second.cut_joints)), [*place, *other_place]


def simulate(mechanism, q):
    """Return a simulation that starts at rest, under gravity."""
    down = (0.0, -9.81) if mechanism.planar else (0.0, -9.81, 0.0)
    return simulated(mechanism, q, gravity=down)


@PLANE_AND_SPACE
@pytest.mark.parametrize('turned', [1e-8, 1e-6])
def test_rods_of_nearly_equal_lengths_leave_the_motion_of_equal_ones(space, turned):
    def motion(turned):
        simulation = simulate(*neck(space, turned, math.pi / 2.0, 0.3))
        for _ in range(200):
            simulation.step({'hip': 10.0 * math.sin(2.0 * math.pi * simulation.time)}, 0.01)
        assert simulation.health.rank == 3 and not simulation.report().findings
        assert simulation.energy_balance.residual == pytest.approx(0.0, abs=1e-5)
        return simulation

    near, exact = motion(turned), motion(0.0)
    assert 1e-10 < near.closure < 1e-5
    np.testing.assert_allclose(near.position, exact.position, rtol=0, atol=10.0 * turned + 1e-6)


@PLANE_AND_SPACE
@pytest.mark.parametrize('turned, apart', [(1e-8, math.pi / 2.0), (3e-3, math.pi)])
def test_loops_stay_as_closed_as_elsewhere_where_others_pass_a_change_point(space, turned, apart):
    simulation = simulate(*beside(
        neck(space, turned, apart, 0.6), neck(space, 0.0, math.pi, 0.3)))
    left, passed = 0.0, 0
    for _ in range(400):
        simulation.step({'hip': 14.0 * math.cos(simulation.position[0])}, 1e-3)
        passed += simulation.health.near_singular
        left = max(left, simulation.health.closure)
    # The other machine has come through its flat position.
    assert passed > 5 and simulation.position[4] < -0.1
    # What is left out repeats the others but for the difference of lengths.
    assert 1e-10 < simulation.closure < 1e-6
    assert left < 1e-13
    assert simulation.energy_balance.residual == pytest.approx(0.0, abs=1e-10)


@PLANE_AND_SPACE
def test_loops_that_come_to_contradict_one_another_are_named_at_once(space):
    simulation = simulate(*neck(space, 3e-3, math.pi, 0.3))
    with pytest.raises(ClosureError, match='front_pin .*and back_pin .*contradict') as caught:
        simulation.step({'hip': 0.0}, 1.0)
    message = str(caught.value)
    # No smaller step helps; it is where the joints are.
    assert 'smaller' not in message and 'hip = 0.0' in message and 'end stops' in message
    assert simulation.health.evaluations < 5000
    assert 0.0 < simulation.position[0] < 0.1
    assert simulation.closure < 1e-5 and simulation.health.rank == 3
    assert simulation.energy_balance.residual == pytest.approx(0.0, abs=1e-8)


@PLANE_AND_SPACE
def test_lengths_that_are_plainly_different_lock_the_machine(space):
    simulation = simulate(*neck(space, 1e-3, math.pi / 2.0, 0.3))
    start = simulation.position.copy()
    simulation.step({'hip': 10.0}, 0.1)
    assert simulation.health.rank == 4
    np.testing.assert_allclose(simulation.position, start, rtol=0, atol=1e-12)
    assert simulation.closure < 1e-12


@PLANE_AND_SPACE
def test_a_rod_that_reaches_nowhere_is_refused(space):
    mechanism, q = neck(space, 0.0, math.pi / 2.0, 0.3)
    front, back = mechanism.cut_joints
    longer = (LENGTH + 3.0 * ARM, *back.point_a[1:])
    with pytest.raises(AssemblyError, match='back_pin open'):
        simulate(replace(mechanism, cut_joints=(front, replace(back, point_a=longer))), q)
