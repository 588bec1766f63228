# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A run that is live waits for no compiler: what may be asked of it later is there before."""

from dataclasses import fields, replace
from itertools import product

from closedloop_dynamics import load_scene, Simulation, SimulationError
from closedloop_dynamics.effects.registry import JointFriction, Payload, Rotor
from closedloop_dynamics.kinematics import loop_model
from closedloop_dynamics.mechanism.validation import validate_mechanism
from families import ladder
import numpy as np
import pytest

from ..reference.scenes import scene

# Bennett's linkage turns round several times in so many calls.
CALLS, DURATION = 2000, 0.01


def of_many_joints():
    """Return a scene of more freedoms than are unrolled."""
    mechanism, position = ladder(24)
    mechanism = validate_mechanism(mechanism)
    return scene(mechanism, position, gravity=(0.0, -9.81))


def loaded(name):
    """Return a simulation of a scene with more that may be switched on, as a node loads it."""
    scene = of_many_joints() if name == 'ladder' else load_scene(name)
    joint = next(one.name for one in scene.mechanism.joints if one.actuated)
    more = {'part': Payload(scene.mechanism.bodies[-1].name, 0.5), 'disc': Rotor(joint, 0.01),
            'grease': JointFriction(joint, coulomb=0.1)}
    simulation = Simulation(replace(
        scene, effects={**scene.effects, **more}, switched_off=(*scene.switched_off, *more)))
    simulation.data.prepare_exchanges()
    return simulation


def other_numbers(record):
    """Yield changes of an effect's numbers, to zero as well."""
    for field in fields(record):
        value = getattr(record, field.name)
        if isinstance(value, float):
            yield from ({field.name: other} for other in (0.0, 1.5 * value + 0.01, value))
        elif isinstance(value, tuple) and value and all(isinstance(one, float) for one in value):
            yield from ({field.name: tuple(factor * one for one in value)}
                        for factor in (0.0, 1.5, 1.0))


def requests(simulation):
    """Yield what may be asked of a run that is live."""
    start, names = simulation.position, list(simulation.effects)
    for name in names:
        for enabled in (False, True, False, True):
            yield simulation.set_effect, (name, enabled), {}
        for numbers in other_numbers(simulation.effects[name]):
            yield simulation.set_effect, (name,), numbers
    for stabilisation, integrator in product(
            ('none', 'baumgarte', 'velocity_projection', 'independent', 'projection'),
            ('semi_implicit_euler', 'rk4', 'dopri5', 'rodas4', 'auto')):
        yield simulation.reset, (), {}
        yield lambda **method: simulation.stepping.prepare_method(**method)(), (), {
            'stabilisation': stabilisation, 'integrator': integrator}
    for _ in range(2):
        yield simulation.set_state, (start,), {}
        yield simulation.reset, (), {}
    for read in (simulation.report, simulation.snapshot, simulation.data.load_notes):
        yield read, (), {}


@pytest.mark.parametrize('name', [
    'three_rrr_payload_friction', 'bennett', 'ladder',
    pytest.param('stewart_platform', marks=pytest.mark.slow)])
def test_no_request_compiles(name, wanted):
    simulation = loaded(name)
    followed = 0
    wanted.clear()
    for ask, arguments, named in requests(simulation):
        try:
            ask(*arguments, **named)
            simulation.step({simulation.actuated_joints[0]: 0.1}, duration=0.002)
            followed += 1
        except (ValueError, SimulationError):
            simulation.reset()
        assert np.isfinite((*simulation.acceleration, *simulation.constraint_forces.flat,
                            simulation.energy_balance.residual)).all()
        assert not wanted, (ask, arguments, named)
    assert followed > 40


def test_equations_are_exchanged_without_compiling(wanted):
    """Bennett's linkage turns, and leaves out one choice of equations after the other."""
    scene = load_scene('bennett')
    waiting, ready = Simulation(scene), Simulation(scene)
    chosen = set()
    ready.data.prepare_exchanges()
    wanted.clear()
    for _ in range(CALLS):
        ready.step(duration=DURATION)
        chosen.add(ready.data.loop_model.equations.kept.tobytes())
    assert ready.data.exchanges > 20 and len(chosen) > 3
    assert ready.data.system.is_unrolled
    ready.reset()
    ready.step(duration=DURATION)
    assert not wanted
    # Whoever has not prepared anything comes to the same states.
    ready.reset()
    while waiting.data.exchanges < 5:
        waiting.step(duration=DURATION)
        ready.step(duration=DURATION)
    np.testing.assert_array_equal(waiting.state, ready.state)


def test_too_many_choices_of_equations_are_worked_on_by_loops(wanted, monkeypatch):
    scene = load_scene('bennett')
    coded = Simulation(scene)
    monkeypatch.setattr(loop_model, 'MOST_CHOICES', 1)
    looped = Simulation(scene)
    assert looped.data.system.is_unrolled and not looped.data.exchange_is_cheap
    looped.data.prepare_exchanges()
    wanted.clear()
    while not looped.data.exchanges:
        looped.step(duration=DURATION)
    assert not looped.data.system.is_unrolled
    looped.reset()
    # The equations of the start have theirs.
    assert looped.data.system.is_unrolled
    looped.step(duration=DURATION)
    assert not wanted
    looped.reset()
    for _ in range(100):
        coded.step(duration=DURATION)
        looped.step(duration=DURATION)
    np.testing.assert_allclose(coded.position, looped.position, rtol=0.0, atol=1e-6)


def test_an_exchange_keeps_to_the_code_of_the_scene_as_it_was_loaded(wanted):
    """Friction that comes to be larger at rest is a law apart, whatever is worked on."""
    simulation = loaded('bennett')
    code = simulation.data.system.effects.code
    simulation.set_effect('grease', True, static_ratio=1.5, stribeck_velocity=0.1)
    assert code.fits[0] == 0
    wanted.clear()
    while not simulation.data.exchanges:
        simulation.step(duration=DURATION)
    assert code.fits[0] == 0
    simulation.set_effect('grease', True, static_ratio=1.0)
    assert code.fits[0] == 1
    simulation.step(duration=DURATION)
    assert not wanted
