# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Loops that are drawn wide open are closed, the right way round; what cannot be is reported."""

from closedloop_dynamics import Body, Coupling, CutJoint, Joint, Mechanism
from closedloop_dynamics.codegen import space
from closedloop_dynamics.engine.types import CUT_NUMBER, POSSIBLE
from closedloop_dynamics.kinematics.global_assembly import (
    CLOSED, ClosureProblem, find_closed, never_closed)
from closedloop_dynamics.mechanism.validation import validate_mechanism
import numpy as np
import pytest

BAR = (1.0, (0.0, 0.0, 0.0), (0.01, 0.01, 0.01))
Z = (0.0, 0.0, 1.0)
TURNED = (0.18257418583505536, 0.3651483716701107, 0.5477225575051661, 0.7302967433402214)


def mechanism(joints, cuts, couplings=()):
    """Return a mechanism whose bodies are the joints' children, all the same."""
    return validate_mechanism(Mechanism(
        'm', tuple(Body(joint.child, *BAR) for joint in joints), tuple(joints), tuple(cuts),
        couplings=tuple(couplings)))


def every_joint():
    """Return a tree with every type of joint, cut at its end in every way."""
    kinds = [('revolute', {'axis': Z}), ('prismatic', {'axis': (1.0, 0.0, 0.0)}),
             ('helical', {'axis': Z, 'lead': 0.3}), ('cylindrical', {'axis': Z}),
             ('universal', {'axis': Z, 'second_axis': (0.0, 1.0, 0.0)}), ('spherical', {}),
             ('planar', {}), ('free', {})]
    joints, parent = [], 'ground'
    for number, (kind, keys) in enumerate(kinds):
        joints.append(Joint(f'j{number}', kind, parent, f'b{number}', (0.3, 0.1 * number, -0.2),
                            orientation=TURNED, **keys))
        parent = f'b{number}'
    points = {'point_a': (0.1, 0.2, 0.3), 'point_b': (0.0, -0.2, 0.1)}
    axes = {'axis_a': (0.0, 0.6, 0.8), 'axis_b': (0.8, 0.0, 0.6)}
    cuts = [CutJoint(kind, kind, parent, f'b{number}', **points, **(axes if kind in (
        'revolute', 'cylindrical', 'universal', 'planar') else {}))
        for number, kind in enumerate(('revolute', 'cylindrical', 'universal', 'planar',
                                       'spherical', 'fixed'))]
    cuts.append(CutJoint('thread', 'helical', parent, 'ground', **points, axis_b=(0.0, 0.6, 0.8),
                         lead=0.2, orientation=TURNED))
    cuts.append(CutJoint('prismatic', 'prismatic', parent, 'ground', **points,
                         axis_b=(0.0, 0.6, 0.8), orientation=TURNED))
    cuts += [CutJoint('distance', 'distance', parent, 'b1', **points, length=0.7),
             CutJoint('point_on_line', 'point_on_line', parent, 'b2', **points, axis_b=Z),
             CutJoint('point_on_plane', 'point_on_plane', parent, 'b3', **points, axis_b=Z)]
    return mechanism(joints, cuts, [Coupling('gear', {'j0': 1.0, 'j1': -3.0, 'j2': 0.5}, 0.1)])


def test_jacobian_is_the_derivative_of_the_closure_errors():
    loops, rng = ClosureProblem(every_joint(), 0.7, {'j0': (-0.1, 0.1)}), np.random.default_rng(0)
    for _ in range(5):
        q = loops.moved(loops.start(), rng.normal(size=loops.nv))
        _, jac = loops.residual(q)
        change = 1e-6 * rng.normal(size=loops.nv)
        ahead, behind = (loops.residual(loops.moved(q, step))[0]
                         for step in (change, -change))
        found, expected = (ahead - behind) / 2e-6, jac @ change / 1e-6
        # Axes that turn with a body change these three places, but not their sum of squares.
        apart, start = np.ones(len(found), dtype=bool), 0
        for cut in loops.equations.model.cut[np.argsort(loops.equations.model.cut[:, CUT_NUMBER])]:
            if space.is_carried(loops.equations.model, cut):
                apart[start:start + 3] = False
            start += int(cut[POSSIBLE]).bit_count()
        np.testing.assert_allclose(found[apart], expected[apart], atol=1e-8)
        for one in np.flatnonzero(~apart).reshape(-1, 3):
            psi = 0.5 * (ahead + behind)[one]
            # Of places up to ten metres away, by four roundings in a difference of 2e-6.
            rounding = 4.0 * np.spacing(10.0) * np.abs(psi).sum() / 2e-6
            assert psi @ found[one] == pytest.approx(psi @ expected[one], abs=1e-8 + rounding)


def triangle(length):
    """Return two bars on the ground, 1 apart, that meet in a pin: one of length 1, one other."""
    joints = [Joint('left', 'revolute', 'ground', 'a', (0.0, 0.0, 0.0), axis=Z, actuated=True),
              Joint('right', 'revolute', 'ground', 'b', (1.0, 0.0, 0.0), axis=Z)]
    cut = CutJoint('pin', 'revolute', 'a', 'b', (1.0, 0.0, 0.0), (length, 0.0, 0.0), axis_a=Z,
                   axis_b=Z)
    return mechanism(joints, [cut])


@pytest.mark.parametrize('start', [(0.0, 0.0), (3.0, -3.0), (-2.0, 0.5)])
def test_loops_that_are_drawn_wide_open_close(start):
    found = find_closed(triangle(1.2), 1.0, np.array(start))
    # The law of cosines.
    assert found.closed
    assert np.cos(found.q[0]) == pytest.approx((1.0 + 1.0 - 1.44) / 2.0, abs=1e-8)
    assert np.abs(found.q - start).max() <= np.pi


def test_a_thread_turns_as_it_slides():
    joint = Joint('free', 'free', 'ground', 'a', (0.1, 0.0, 0.0))
    cuts = [CutJoint('thread', 'helical', 'a', 'ground', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0),
                     axis_b=Z, lead=0.2),
            CutJoint('stop', 'point_on_plane', 'a', 'ground', (0.0, 0.0, 0.0), (0.0, 0.0, 0.3),
                     axis_b=Z)]
    found = find_closed(mechanism([joint], cuts), 1.0,
                        np.array([0.2, 0.1, 0.0, 0.3, -0.2, 0.1, 0.9273618495495703]))
    assert found.closed
    np.testing.assert_allclose(found.q[:3], [-0.1, 0.0, 0.3], atol=1e-8)
    # A slide of 0.3 m at 0.2 m/rad.
    np.testing.assert_allclose(np.abs(found.q[3:]), [0.0, 0.0, np.sin(0.75), np.cos(0.75)],
                               atol=1e-7)


def test_limits_choose_the_branch():
    machine = triangle(1.2)
    for limits, sign in (((0.0, 3.0), 1.0), ((-3.0, 0.0), -1.0)):
        found = find_closed(machine, 1.0, np.array([-sign, -sign]), limits={'left': limits})
        assert found.closed
        assert np.sign(np.sin(found.q[0])) == sign


def test_held_joints_stay():
    found = find_closed(triangle(1.2), 1.0, np.array([1.2870022175866, 0.0]), hold=['left'])
    assert found.closed
    assert found.q[0] == 1.2870022175866


def test_a_loop_that_cannot_close_is_reported_with_its_gap():
    # A bar of 2.5 and one of 1 on pins 1 apart: half a metre too long.
    found = find_closed(triangle(2.5), 1.0, np.array([0.3, -0.2]), starts=1)
    assert not found.closed
    assert found.closure_errors == {'pin': pytest.approx(0.5, abs=1e-4)}


def test_gaps_are_in_metres_whatever_the_size():
    found = find_closed(triangle(2.5), 4.0, np.array([0.3, -0.2]), starts=1)
    assert found.closure_errors == {'pin': pytest.approx(0.5, abs=1e-4)}


def test_loops_that_no_motion_closes_are_distinguished_from_others():
    # Beside a loop that closes: two bars in parallel planes, 0.04 m apart.
    joints = [Joint(name, 'revolute', 'ground', body, place, axis=Z) for name, body, place in (
        ('left', 'a', (0.0, 0.0, 0.0)), ('right', 'b', (1.0, 0.0, 0.0)),
        ('low', 'c', (3.0, 0.0, 0.0)), ('high', 'd', (4.0, 0.0, 0.04)))]
    cuts = [CutJoint(name, 'spherical', one, other, (1.0, 0.0, 0.0), (1.0, 0.0, 0.0))
            for name, one, other in (('pin', 'a', 'b'), ('aside', 'c', 'd'))]
    machine, start = mechanism(joints, cuts), np.array([1.3, 1.5, 0.2, 0.4])
    found = find_closed(machine, 1.0, start)
    assert not found.closed
    # What can be closed is closed.
    assert found.closure_errors == {
        'pin': pytest.approx(0.0, abs=1e-9), 'aside': pytest.approx(0.04)}
    assert never_closed(machine, 1.0, start) == {'aside': pytest.approx(0.04)}


def test_parts_that_share_no_joints_are_closed_one_by_one():
    # A platform on the ground carries two triangles; a pair of gears stands beside.
    joints = [Joint('base', 'spherical', 'ground', 'base', (0.5, 0.0, 0.0), actuated=True)]
    cuts = []
    for place in (0.0, 2.0):
        joints += [Joint(f'left{place:g}', 'revolute', 'base', f'a{place:g}', (place, 0.0, 0.0),
                         axis=Z),
                   Joint(f'right{place:g}', 'revolute', 'base', f'b{place:g}',
                         (place + 1.0, 0.0, 0.0), axis=Z)]
        cuts.append(CutJoint(f'pin{place:g}', 'revolute', f'a{place:g}', f'b{place:g}',
                             (1.0, 0.0, 0.0), (1.2, 0.0, 0.0), axis_a=Z, axis_b=Z))
    joints += [Joint(name, 'revolute', 'ground', name, (0.0, 5.0, 0.0), axis=Z)
               for name in ('big', 'small')]
    machine = mechanism(joints, cuts, [Coupling('mesh', {'big': 2.0, 'small': 1.0}, 0.6)])
    start = np.concatenate([machine.coordinates.start()[:4],
                            [0.0, 0.0, 3.0, -3.0, 0.5, 0.5]])
    found = find_closed(machine, 1.0, start, hold=['base.rx', 'base.ry', 'base.rz'],
                        limits={'small': (0.0, 0.3)})
    assert found.closed
    np.testing.assert_array_equal(found.q[:4], start[:4])
    np.testing.assert_allclose(np.cos(found.q[[4, 6]]), (1.0 + 1.0 - 1.44) / 2.0, atol=1e-8)
    assert 2.0 * found.q[8] + found.q[9] == pytest.approx(0.6)
    assert -1e-8 < found.q[9] < 0.3 + 1e-8


def test_bodies_do_not_meet_the_wrong_way_round():
    # Turned by half a turn, the directions of both bodies are at right angles as they should be.
    joint = Joint('ball', 'spherical', 'ground', 'a', (0.0, 0.0, 0.0))
    cut = CutJoint('weld', 'fixed', 'a', 'ground', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    found = find_closed(mechanism([joint], [cut]), 1.0, np.array([0.1, 0.99, 0.1, 0.0]))
    assert found.closed
    np.testing.assert_allclose(np.abs(found.q), [0.0, 0.0, 0.0, 1.0], atol=1e-8)


def test_rank_in_a_parallelogram_and_beside_it():
    # Flat, where the rank is less; the third row of the pin and two more always hold.
    joints = [Joint('a', 'revolute', 'ground', 'a', (0.0, 0.0, 0.0), axis=Z),
              Joint('b', 'revolute', 'a', 'b', (0.3, 0.0, 0.0), axis=Z),
              Joint('c', 'revolute', 'ground', 'c', (1.0, 0.0, 0.0), axis=Z)]
    cut = CutJoint('pin', 'revolute', 'b', 'c', (1.0, 0.0, 0.0), (0.3, 0.0, 0.0), axis_a=Z,
                   axis_b=Z)
    loops = ClosureProblem(mechanism(joints, [cut]), 1.0)
    flat = np.zeros(3)
    assert np.abs(loops.residual(flat)[0]).max() < CLOSED
    assert np.linalg.matrix_rank(loops.residual(flat)[1], tol=1e-9) == 1
    assert loops.rank(flat) == 2
