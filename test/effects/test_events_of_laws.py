# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Laws with an event: a step ends where their gap changes its sign."""

from dataclasses import dataclass

from closedloop_dynamics import Differentiator
from closedloop_dynamics.codegen.expression_graph import chosen
from closedloop_dynamics.effects.registry import EndStop, Law
from closedloop_dynamics.effects.traced_effect import TracedEffect
from closedloop_dynamics.effects.traced_laws import refused
from closedloop_dynamics.mechanism.fields import FieldError
import pytest

from .machines import assert_balanced, block, flyer, simulated, spatial_block

METHODS = ('auto', 'dopri5', 'dop853', 'rodas4')
X = {'joints': {'x': 'slide'}, 'rates': {'v': 'x'}}
# Pushes a block back on one side of zero, with a force that jumps there.
FIELD = Law({'x': '-f*beyond'}, event={'beyond': '-x'}, parameters={'f': 3.0},
            energy='f*x*beyond', **X)


@dataclass(frozen=True)
class Field(TracedEffect):
    """The same field, and one of another strength on the other side."""

    joint: str
    force: float = 3.0
    other: float = 1.0

    def trace(self, law):
        x = law.joint(self.joint)
        force = chosen(law.event(-x.value), law.parameter('force'), -law.parameter('other'))
        x.push(-force)
        law.store(force * x.value)


@pytest.mark.parametrize('integrator', METHODS)
@pytest.mark.parametrize('machine', [block, spatial_block])
def test_a_force_that_jumps_is_exact(machine, integrator):
    one = simulated(machine(), {'it': FIELD}, [-0.1], [1.0], integrator=integrator,
                    step_size=0.07)
    # It comes to the edge at 0.1 s, and back to it 2 v / f later.
    there = 0.1 + 2.0 / 3.0
    one.step(duration=0.5)
    assert one.position[0] == pytest.approx(0.4 - 1.5 * 0.4**2, abs=1e-10)
    one.step(duration=0.5)
    assert one.velocity[0] == pytest.approx(-1.0, abs=1e-10)
    assert one.position[0] == pytest.approx(-(1.0 - there), abs=1e-10)
    assert_balanced(one, 1e-10)


@pytest.mark.parametrize('integrator', METHODS)
def test_a_block_between_two_fields_swings_for_ever(integrator):
    one = simulated(block(), {'it': Field('slide')}, [-0.5], integrator=integrator)
    # Down from 0.5 in 1 s to 1 m/s, there and back in 2/3 s, up again in 1 s.
    period = 2.0 + 2.0 / 3.0
    for _ in range(5):
        one.step(duration=0.6 * period)
    assert one.position[0] == pytest.approx(-0.5, abs=1e-9)
    assert one.velocity[0] == pytest.approx(0.0, abs=1e-9)
    assert_balanced(one, 1e-9)


@pytest.mark.parametrize('integrator', METHODS)
def test_a_stop_that_a_law_states_is_that_of_the_package(integrator):
    law = Law({'x': '-k*(x - u)*max(1 + c*v, 0)*pressed'}, event={'pressed': 'u - x'},
              parameters={'k': 2000.0, 'u': 0.2, 'c': 0.3}, energy='k*(x - u)**2/2*pressed',
              dissipation='k*(x - u)*(max(1 + c*v, 0) - 1)*v*pressed', **X)
    one, two = (simulated(block(), {'it': effect}, [0.0], [1.0], integrator=integrator,
                          accuracy=1e-9)
                for effect in (law, EndStop('slide', upper=0.2, stiffness=2000.0, damping=0.3)))
    for each in (one, two):
        each.step(duration=0.5)
    assert one.velocity[0] < -0.5
    # The same steps: all but rounding is the same.
    assert one.position[0] == pytest.approx(two.position[0], abs=1e-9)
    assert one.energy_balance.dissipated == pytest.approx(
        two.energy_balance.dissipated, rel=1e-7)


def test_the_gap_may_follow_the_time_and_states():
    # The force begins at 0.123 s, and where the state z = t^2 is 0.04.
    for event, begin in (({'on': '0.123 - t'}, 0.123), ({'on': '0.04 - z'}, 0.2)):
        law = Law({'x': '6*on'}, joints={'x': 'slide'}, states={'z': '2*t'}, event=event)
        one = simulated(block(), {'it': law}, [0.0], integrator='auto')
        one.step(duration=0.5)
        assert one.velocity[0] == pytest.approx(6.0 * (0.5 - begin), abs=1e-10)
        assert one.position[0] == pytest.approx(3.0 * (0.5 - begin)**2, abs=1e-10)


def test_the_gap_may_be_one_of_places():
    # A ball that floats down into a field that turns it back: down, there, up again.
    law = Law({'y': '5*below'}, components={'y': ('ball', 'y')}, event={'below': 'y'},
              energy='-5*y*below')
    one = simulated(flyer(), {'it': law}, [0.0, 0.5, 0.0], [0.0, -2.0, 0.0], integrator='auto')
    mass = 1.0 + 0.25
    inside = 2.0 * 2.0 * mass / 5.0
    one.step(duration=0.25 + 0.5 * inside)
    assert one.position[1] == pytest.approx(-0.5 * 4.0 * mass / 5.0, abs=1e-9)
    one.step(duration=0.5 * inside + 0.25)
    assert one.position[1] == pytest.approx(0.5, abs=1e-9)
    assert_balanced(one, 1e-9)


def test_a_fixed_step_takes_the_side_of_the_sign():
    one = simulated(block(), {'it': FIELD}, [-0.1], [1.0], step_size=1e-3)
    one.step(duration=1.0)
    assert one.position[0] == pytest.approx(-0.7 / 3.0, abs=2e-3)


@pytest.mark.parametrize('changes, expected', [
    ({'event': {'on': 'x - v'}}, 'event: expected a gap of coordinates'),
    ({'event': {'on': '3'}}, 'event: expected a gap'),
    ({'event': {'on': 'x', 'off': 'x - 1'}}, 'event: expected at most 1 event'),
    ({'event': {'x': 'x'}}, 'event.x: expected a name that is not in use'),
    ({'event': {'on': 'x*on'}}, "event.on: .* unknown name 'on'"),
    ({'event': {}}, 'event: expected a mapping'),
    ({'event': 'x'}, 'event: expected a mapping')])
def test_what_is_no_event_is_refused(changes, expected):
    with pytest.raises(FieldError, match=expected):
        Law({'x': '1'}, **X, **changes)


@pytest.mark.parametrize('x', [0.15, 0.25])
def test_the_derivatives_are_those_of_the_side(x):
    law = Law({'x': '-k*(x - u)*(1 + c*v)*pressed'}, event={'pressed': 'u - x'},
              parameters={'k': 2000.0, 'u': 0.2, 'c': 0.3}, **X)
    for effect in (law, EndStop('slide', upper=0.2, stiffness=2000.0, damping=0.3)):
        found = Differentiator(simulated(block(), {'it': effect}, [x]))([x], [0.5])
        pressed = x > 0.2
        assert found.by_position[0, 0] == pytest.approx(-2000.0 * 1.15 * pressed, rel=1e-12)
        assert found.by_velocity[0, 0] == pytest.approx(-2000.0 * 0.3 * 0.05 * pressed, rel=1e-9)


def test_a_motion_through_an_event_has_no_derivatives():
    one = simulated(block(), {'it': FIELD}, [-0.1])
    assert refused(one.data.effect_set) == {}
    assert refused(one.data.effect_set, along=True) == {
        'it': 'law: its force may jump at its event, within a step'}
