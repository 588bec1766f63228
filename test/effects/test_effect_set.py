# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Effects together: energy balance of any set, switching, inverse dynamics, none at all."""

from collections import Counter
from dataclasses import astuple, fields, replace

from closedloop_dynamics import (
    AssemblyError, load_scene, Point, SceneError, Simulation, SimulationError)
from closedloop_dynamics.codegen import cache, routines
from closedloop_dynamics.effects.registry import (
    Actuator, BodyContact, Bushing, Cable, Contact, effect_type, EFFECTS, EndStop, ExternalForce,
    FluidDrag, ForceTable, Gravity, JointDamping, JointFriction, JointSpring, Law, MagneticSpring,
    Payload, PointSpring, PrescribedForce, PrescribedMotion, Rotor, Sensor, Tendon, TendonFriction,
    TendonInertia)
from closedloop_dynamics.kinematics.modeling import build_model
import numpy as np
import pytest

from .machines import assert_balanced, block, simulated
from ..reference import cases

EARTH = Gravity((0.0, -9.81))


def drawn(case, seed=0):
    """Draw a case with a named place of the ground beside its points."""
    rng, mechanism, q, qd = cases.drawn(case, seed)
    return rng, replace(mechanism, points=(
        *mechanism.points, Point('base', 'ground', (0.1, 0.05)))), q, qd


def every_effect(rng, mechanism, q):
    """Return one effect of every type, at random places of a mechanism with points."""
    def joint():
        return str(rng.choice(mechanism.joint_names))

    def point():
        return str(rng.choice([
            point.name for point in mechanism.points if point.body != 'ground']))

    motor = str(rng.choice(mechanism.actuated_joints))
    stopped = int(rng.integers(len(q)))
    place = tuple(rng.normal(size=2))
    return {
        'gravity': EARTH,
        'damping': JointDamping(joint(), 0.3),
        'spring': JointSpring(joint(), 5.0, float(rng.normal())),
        'stop': EndStop(mechanism.joint_names[stopped], 200.0, lower=q[stopped] - 0.05,
                        upper=q[stopped] + 0.05, damping=0.5),
        'friction': JointFriction(joint(), 0.5, static_ratio=1.2, stribeck_velocity=0.5,
                                  friction_coefficient=0.1, radius=0.02, load_time=0.02),
        'cord': PointSpring(point(), anchor=place, stiffness=30.0, damping=2.0),
        'push': ExternalForce(point(), tuple(rng.normal(size=2))),
        'floor': Contact(point(), (0.0, float(rng.normal())), 500.0, exponent=1.5, damping=0.4,
                         friction=0.3, slip_velocity=0.2, scraping=10.0),
        'motor': Actuator(motor, max_torque=1.5, max_speed=20.0, lag=0.02, delay=0.003),
        'rotor': Rotor(joint(), 0.001, 5.0),
        'part': Payload(str(rng.choice([body.name for body in mechanism.bodies])), 0.5),
        'encoder': Sensor(position_noise=0.1, seed=1)}


def every_element(rng, mechanism, q):
    """Return one machine element of every type, likewise."""
    def joint():
        return str(rng.choice(mechanism.joint_names))

    def point():
        return str(rng.choice([
            point.name for point in mechanism.points if point.body != 'ground']))

    stretched, place = int(rng.integers(len(q))), tuple(rng.normal(size=2))
    return {
        'cutter': PrescribedForce(
            'cycloid', joint(), amplitude=2.0, start=0.0301, rise=0.02, hold=0.04, fall=0.01),
        'shaker': PrescribedForce('sine', point=point(), direction=place, axes='body',
                                  amplitude=3.0, frequency=10.0),
        'gas': ForceTable(tuple(q[stretched] + [-0.1, 0.0, 0.1]), (2.0, 1.0, -1.0),
                          mechanism.joint_names[stretched], damping=0.1),
        'strut': ForceTable((0.0, 0.5, 2.0), (-1.0, 3.0, 4.0), point_a=point(), anchor=place,
                            interpolation='cubic'),
        'mount': Bushing(point(), anchor=place, stiffness=(20.0, 5.0), damping=(1.0, 0.0),
                         turning_stiffness=2.0, turning_damping=0.1),
        'belt': Tendon(dict.fromkeys(mechanism.joint_names[:2], 0.5), (20.0, 3.0), (0.1, 0.05),
                       (-0.1, 0.1)),
        'sheath': TendonFriction(dict.fromkeys(mechanism.joint_names[:2], 0.4), 0.3),
        'weight': TendonInertia(dict.fromkeys(mechanism.joint_names[-2:], -0.5), 0.2),
        'water': FluidDrag(point(), (0.5, 0.1), (0.3, 0.2), 0.05, 0.02, (0.2, -0.1), 0.3),
        'magnet': Law({'d': '-k*d*exp(-d)*(1 + z)', 'a': '-c*da*abs(da) + 0.1*sin(5*t)'},
                      joints={'a': joint()}, distances={'d': (point(), place)},
                      rates={'da': 'a', 'dd': 'd'}, parameters={'k': 8.0, 'c': 0.05},
                      states={'z': '4*dd - 20*z'}),
        'catch': MagneticSpring(point(), 0.5, 0.2, anchor=place),
        'rope': Cable((point(), point(), point()), 50.0, 0.1, damping=0.1),
        'roller': BodyContact(point(), 'base', 'line', 300.0, radius=0.02, exponent=1.5,
                              damping=0.4, friction=0.3, slip_velocity=0.2)}


def all_effects(rng, mechanism, q):
    """Return one effect of every type, machine elements among them."""
    return {**every_effect(rng, mechanism, q), **every_element(rng, mechanism, q)}


def test_every_type_of_effect_takes_part():
    rng, mechanism, q, _ = drawn('three_rrr')
    # A prescribed motion would leave drives and forces of its joint nothing to do.
    assert {type(effect) for effect in all_effects(rng, mechanism, q).values()} == set(
        EFFECTS.values()) - {PrescribedMotion}


@pytest.mark.parametrize('kind, seed', [
    (kind, seed) if seed == 0 else pytest.param(kind, seed, marks=pytest.mark.slow)
    for kind, seeds in ((every_effect, 6), (every_element, 3)) for seed in range(seeds)])
@pytest.mark.parametrize('case', ['three_rrr', 'slider_crank', 'carpet_scraper'])
def test_the_energy_balance_of_random_sets_closes_with_the_step(case, kind, seed):
    rng, mechanism, q, qd = drawn(case, seed)
    effects = kind(rng, mechanism, q)
    chosen = {name: effect for name, effect in effects.items() if rng.random() < 0.6}
    torque = {name: float(rng.normal()) for name in mechanism.actuated_joints}
    residuals = []
    for step_size in (4e-4, 1e-4):
        simulation = simulated(mechanism, chosen, q, 0.3 * qd, step_size=step_size)
        simulation.step(torque, 0.1)
        simulation.step({name: -value for name, value in torque.items()}, 0.1)
        balance = simulation.energy_balance
        residuals.append(abs(balance.residual))
    size = balance.kinetic + abs(balance.work) + balance.dissipated + 1.0
    # Kinks of stops, contacts and friction leave order 2.
    assert residuals[1] <= 1e-5 * size, (residuals, list(chosen))
    assert residuals[1] <= max(0.5 * residuals[0], 1e-9 * size), (residuals, list(chosen))


def test_the_energy_balance_survives_switching_and_new_states():
    rng, mechanism, q, qd = drawn('three_rrr')
    simulation = simulated(mechanism, all_effects(rng, mechanism, q), q, qd, step_size=2e-4)
    for name in simulation.effects:
        simulation.step([1.0, -1.0, 0.5], 0.01)
        simulation.set_effect(name, enabled=False)
        simulation.step([0.5, 0.5, 0.5], 0.01)
        simulation.set_effect(name, enabled=True)
    simulation.set_effect('part', mass=2.0)
    simulation.set_effect('spring', stiffness=20.0)
    simulation.set_state(q)
    simulation.step(duration=0.05)
    assert_balanced(simulation, 1e-3)


def test_effects_that_are_absent_or_off_leave_the_motion_as_it_is():
    rng, mechanism, q, qd = drawn('three_rrr')
    bare = simulated(mechanism, {'gravity': EARTH}, q, qd)
    assert bare.data.system.applied is bare.data.system.tau
    assert bare.data.system.effects is None
    off = simulated(mechanism, all_effects(rng, mechanism, q), q, qd)
    for name in off.effects:
        off.set_effect(name, enabled=name == 'gravity')
    assert off.data.enabled_effects == ('gravity',)
    for simulation in (bare, off):
        simulation.step([1.0, 2.0, 3.0], 0.1)
    for name in ('position', 'velocity', 'multipliers'):
        # While any is off evaluations are in parts: other products are rounded before they are
        # added, and those of armatures of zero are.
        expected = getattr(bare, name)
        np.testing.assert_allclose(
            getattr(off, name), expected, rtol=0, atol=1e-12 * np.abs(expected).max())


def of_type(kind):
    """Return a case with a start, the effects of a type among all, and the others."""
    rng, mechanism, q, qd = drawn('three_rrr')
    effects = all_effects(rng, mechanism, q)
    those = {name: record for name, record in effects.items() if effect_type(record) == kind}
    if kind == 'prescribed_motion':
        those = {'turn': PrescribedMotion(
            'expression', mechanism.joint_names[0], expression=f'{q[0]} + 0.1*sin(t)')}
    return (mechanism, q, 0.3 * qd), those, {
        name: record for name, record in effects.items() if name not in those}


def counted(model):
    """Return how many operations of each kind each routine of a model takes."""
    found = {}
    for which in (routines.MOTION, routines.OUTWARD, routines.ACCELERATION,
                  routines.CORRECTION):
        routine = routines.MechanismTrace(model).routine(which)
        found[which] = Counter(routine.graph.operations[n][0] for n in routine.needed())
    return found


def rows_and_states(simulation):
    """Return how many laws an evaluation calls, and how many states they have."""
    table = simulation.data.system.effects
    return np.array([len(table.laws), len(table.states)]) if table is not None else np.zeros(2)


@pytest.mark.parametrize('kind', EFFECTS)
def test_an_effect_that_is_not_listed_costs_nothing(kind):
    case, those, others = of_type(kind)
    expected = counted(build_model(case[0]))
    listed, bare = (simulated(case[0], some, *case[1:]) for some in (those, {}))
    listed.step(duration=0.002)
    assert bare.data.system.effects is None
    assert counted(bare.data.system.model) == expected
    # What is listed adds rows of the table; inertia and equations are the mechanism's. A payload
    # may give a body a first moment that is zero without it.
    more = kind in ('payload', 'rotor', 'prescribed_motion')
    assert (counted(listed.data.system.model) != expected) == more
    if kind != 'prescribed_motion':
        whole, without = (rows_and_states(simulated(case[0], some, *case[1:]))
                          for some in ({**others, **those}, others))
        np.testing.assert_array_equal(whole - rows_and_states(listed), without)


@pytest.mark.parametrize('kind', sorted(set(EFFECTS) - {'prescribed_motion'}))
def test_switching_acts_within_one_step(kind):
    case, those, others = of_type(kind)
    few = {name: others[name] for name in ('gravity', 'spring') if name in others}
    torque, step = [1.0, -2.0, 0.5], 2e-4
    on, switched, off = (simulated(case[0], some, *case[1:], step_size=step)
                         for some in ({**few, **those}, {**few, **those}, few))
    switched.step(torque, 50 * step)
    # Laws that follow the time see the same one.
    on.step(torque, 51 * step)
    for enabled, twin in ((False, off), (True, on)):
        for name in those:
            switched.set_effect(name, enabled=enabled)
        q, qd, time = switched.position, switched.velocity, switched.time
        for simulation in (switched, twin):
            simulation.set_state(q, qd)
            simulation.step(torque, step)
        # A step, and no more, is what the others have made since.
        np.testing.assert_allclose(switched.velocity, twin.velocity, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(switched.position, twin.position, rtol=1e-12, atol=1e-14)
        assert switched.time == pytest.approx(time + step, rel=1e-9)


def test_readings_of_all_effects_add_up_to_the_balance():
    rng, mechanism, q, qd = drawn('three_rrr')
    simulation = simulated(mechanism, all_effects(rng, mechanism, q), q, qd, step_size=2e-4)
    simulation.step([1.0, -1.0, 0.5], 0.1)
    readings = {name: simulation.effect_readings(name) for name in simulation.effects}
    dissipated = [each['dissipated_energy'] for each in readings.values()
                  if 'dissipated_energy' in each]
    assert len(dissipated) >= 5
    balance = simulation.energy_balance
    assert sum(dissipated) == pytest.approx(balance.dissipated, rel=1e-12)
    before = readings['damping']
    simulation.step([1.0, -1.0, 0.5], 2e-4)
    after = simulation.effect_readings('damping')
    assert after['dissipated_energy'] - before['dissipated_energy'] == pytest.approx(
        1e-4 * (before['dissipated_power'] + after['dissipated_power']), rel=1e-3)
    # The damping's own law.
    rate = simulation.velocity[simulation.joint_names.index(simulation.effects['damping'].joint)]
    assert after['dissipated_power'] == pytest.approx(0.3 * rate ** 2, rel=1e-12)


def test_parameters_take_effect_at_the_next_step():
    simulation = simulated(block(), {'push': ExternalForce('center')}, [0.0])
    simulation.step(duration=0.1)
    assert simulation.velocity[0] == 0.0
    simulation.set_effect('push', force=(2.0, 0.0))
    simulation.step(duration=0.1)
    assert simulation.velocity[0] == pytest.approx(0.2, rel=1e-12)
    simulation.set_effect('push', enabled=False)
    simulation.step(duration=0.1)
    assert simulation.velocity[0] == pytest.approx(0.2, rel=1e-12)
    assert simulation.energy_balance.work == pytest.approx(0.02, rel=1e-12)


@pytest.mark.parametrize('name, values, match', [
    ('pusch', {'enabled': True}, "did you mean 'push'"),
    ('push', {'enabled': 1}, 'effects.push.enabled'),
    ('push', {'force': [1.0]}, 'effects.push.force'),
    ('push', {'forse': [1.0, 0.0]}, "did you mean 'force'"),
    ('push', {'point': 'rear'}, 'effects.push.point')])
def test_impossible_changes_are_refused_and_change_nothing(name, values, match):
    simulation = simulated(block(), {'push': ExternalForce('center', (1.0, 0.0))}, [0.0])
    with pytest.raises(ValueError, match=match):
        simulation.set_effect(name, **values)
    assert simulation.effects == {'push': ExternalForce('center', (1.0, 0.0))}
    simulation.step(duration=0.1)
    assert simulation.velocity[0] == pytest.approx(0.1, rel=1e-12)


def ask(simulation):
    """Ask whether changes could be made, and have changes refused; return how many were."""
    refused = 0
    for name, record in simulation.effects.items():
        values = {field.name: getattr(record, field.name) for field in fields(record)}
        changes = [{'enabled': False}, {'enabled': True}, {}, *(
            {key: factor * value} for key, value in values.items()
            if type(value) is float and value for factor in (1.5, 1e12))]
        for change in changes:
            try:
                simulation.stepping.check_effect(name, **change)
            except (ValueError, SimulationError) as error:
                refused += 1
                with pytest.raises(type(error)):
                    simulation.set_effect(name, **change)
        with pytest.raises(ValueError, match='unheard_of'):
            simulation.set_effect(name, unheard_of=1.0)
    with pytest.raises(AssemblyError):
        simulation.set_state(simulation.position, np.full_like(simulation.velocity, 1e12))
    simulation.stepping.prepare_method(step_size=0.5 * simulation.step_size)
    simulation.forward_dynamics(simulation.position, simulation.velocity)
    return refused


def traces(simulation):
    """Return all that a run shows, the noise of its sensors among it."""
    # Twice: the second time nothing is drawn.
    measured = [*simulation.measured(), *simulation.measured()]
    readings = [list(simulation.effect_readings(name).values()) for name in simulation.effects]
    return [simulation.state, *measured, *readings, [*astuple(simulation.energy_balance)],
            simulation.acceleration, simulation.multipliers]


@pytest.mark.parametrize('kind, method', [
    *((kind, {'integrator': 'rk4'}) for kind in EFFECTS),
    ('all', {'integrator': 'rk4'}), ('all', {'integrator': 'auto'})])
def test_questions_leave_no_trace(kind, method):
    noisy = Sensor(position_noise=1e-3, velocity_noise=1e-2, delay=0.0023, seed=4)
    if kind == 'all':
        rng, mechanism, q, qd = drawn('three_rrr')
        case, effects = (mechanism, q, 0.3 * qd), all_effects(rng, mechanism, q)
    else:
        case, effects, _ = of_type(kind)
    effects = {**effects, 'noise': noisy}
    if kind not in ('all', 'actuator'):
        effects['late'] = Actuator(case[0].actuated_joints[-1], delay=0.004)
    asked, other = (simulated(case[0], effects, *case[1:], step_size=1e-3, **method)
                    for _ in range(2))
    refused = 0
    for number in range(6):
        torque = np.sin(number + np.arange(len(asked.actuated_joints)))
        for simulation in (asked, other):
            simulation.step(torque, 0.003)
        refused += ask(asked)
        for one, expected in zip(traces(asked), traces(other)):
            np.testing.assert_array_equal(one, expected)
        assert asked.effects == other.effects
        assert asked.data.enabled_effects == other.data.enabled_effects
    # All together are too stiff for explicit steps where one of them is.
    assert refused or kind != 'all' or method['integrator'] == 'auto'


@pytest.mark.parametrize('case', ['three_rrr', 'slider_crank', 'carpet_scraper'])
def test_inverse_dynamics_sees_the_effects(case):
    rng, mechanism, q, qd = drawn(case)
    effects = all_effects(rng, mechanism, q)
    simulation = simulated(mechanism, effects, q, qd)
    # What the drive does to a command is not the mechanism's.
    simulation.set_effect('motor', enabled=False)
    moving = simulation.data.integrated
    table = simulation.data.system.effects
    row, = np.flatnonzero(table.feels)
    state = table.first_state[row]
    torque = {name: float(rng.normal()) for name in mechanism.actuated_joints}
    for _ in range(60):
        qdd, lam = simulation.forward_dynamics(q, qd, torque)
        # The load of a steady motion: what the joint feels.
        moving[2 * len(q) + state + 1] = table.output[row, 2]
    found, multipliers = simulation.inverse_dynamics(q, qd, qdd)
    scale = np.abs(lam).max()
    assert np.allclose(found, list(torque.values()), atol=1e-9 * scale)
    assert np.allclose(multipliers, lam, atol=1e-9 * scale)


@pytest.mark.parametrize('kind', [every_effect, every_element])
@pytest.mark.parametrize('method', [
    {'integrator': 'semi_implicit_euler'}, {'integrator': 'heun'}, {'integrator': 'auto'},
    # A kernel of its own each, for this test alone.
    *(pytest.param({key: value}, marks=pytest.mark.slow) for key, value in (
        ('integrator', 'dop853'), ('integrator', 'rodas4'), ('stabilisation', 'independent')))])
def test_every_method_moves_the_effects_own_states(method, kind):
    rng, mechanism, q, qd = drawn('slider_crank')
    effects = kind(rng, mechanism, q)
    ends = []
    for chosen in ({'step_size': 2e-4}, {'step_size': 2e-4, 'tolerance': 1e-8, **method}):
        simulation = simulated(mechanism, effects, q, 0.3 * qd, **chosen)
        simulation.step([1.0], 0.1)
        ends.append(np.append(simulation.position, simulation.energy_balance.dissipated))
    assert np.allclose(*ends, atol=2e-3 if 'euler' in str(method) else 2e-5)


def test_readings_of_an_effect_that_is_not_listed_are_refused():
    simulation = simulated(block(), {'push': ExternalForce('center')}, [0.0])
    with pytest.raises(ValueError, match='one of the effects'):
        simulation.effect_readings('pull')


@pytest.mark.parametrize('scene', [
    'three_rrr', pytest.param('double_wishbone', marks=pytest.mark.slow)])
def test_effects_switched_off_in_the_scene_act_once_they_are_switched_on(scene):
    scene = load_scene(scene)
    names = tuple(name for name, record in scene.effects.items() if record.motion(name) is None)
    off = Simulation(replace(scene, switched_off=names))
    bare = Simulation(replace(scene, effects={
        name: record for name, record in scene.effects.items() if name not in names}))
    for simulation in (off, bare):
        simulation.step(duration=0.05)
    assert set(off.data.enabled_effects).isdisjoint(names)
    np.testing.assert_array_equal(off.position, bare.position)
    np.testing.assert_array_equal(off.velocity, bare.velocity)
    # A rollout begins as the simulation is.
    off.reset()
    runs = off.rollout(steps=10)
    off.advance(off.joint_torques(None), 10)
    np.testing.assert_array_equal(runs.position[0, -1], off.position)
    off.reset()
    for name in names:
        off.set_effect(name, enabled=True)
    whole = Simulation(scene)
    q, qd = whole.position, whole.velocity
    np.testing.assert_array_equal(
        off.forward_dynamics(q, qd)[0], whole.forward_dynamics(q, qd)[0])


def test_a_switch_in_a_scene_is_a_boolean_and_of_no_prescribed_motion(tmp_path):
    path = tmp_path / 'scene.yaml'

    def load(switch, effect='{type: gravity, acceleration: [0.0, -9.81], %s}'):
        path.write_text('mechanism: four_bar\n'
                        'initial: {position: {crank_joint: 1.0, coupler_joint: -0.5, '
                        'rocker_joint: 2.0}, hold: [crank_joint]}\n'
                        f'effects:\n  one: {effect % switch}\n')
        return load_scene(path)

    assert load('enabled: false').switched_off == ('one',)
    assert load('enabled: true') == load('')
    with pytest.raises(SceneError, match=r"effects.one.enabled: expected .*true or false.*'off'"):
        load('enabled: "off"')
    with pytest.raises(SceneError, match=r'effects.one.enabled: .*leave it out of the scene'):
        load('enabled: false', '{type: prescribed_motion, joint: crank_joint, '
             'shape: expression, expression: t, %s}')


@pytest.mark.parametrize('scene', ['three_rrr', 'bennett'])
def test_switching_and_tuning_what_changes_bodies_compiles_nothing(scene, monkeypatch):
    read = load_scene(scene)
    place = (0.1, 0.2) if read.mechanism.planar else (0.1, 0.2, 0.3)
    effects = {
        **{f'rotor_{name}': Rotor(name, 0.01) for name in read.mechanism.joint_names[:3]},
        # A mass in the origin leaves moments of inertia as they are.
        **{f'part_{body.name}': Payload(body.name, 1.0) for body in read.mechanism.bodies[:2]}}
    tuned = {name: replace(record, **(
        {'inertia': 0.03} if isinstance(record, Rotor) else {'position': place}))
        for name, record in effects.items()}
    q = Simulation.from_scene(scene).position
    found = {name: Simulation(replace(read, effects={**read.effects, **those})).acceleration
             for name, those in (('off', {}), ('tuned', tuned))}
    one = Simulation(replace(read, effects={**read.effects, **effects}))
    wanted = []
    monkeypatch.setattr(cache, 'read', wanted.append)
    for name in effects:
        one.set_effect(name, enabled=False)
        one.step(duration=0.001)
    one.set_state(q)
    np.testing.assert_allclose(one.acceleration, found['off'], rtol=1e-10)
    for name, record in tuned.items():
        one.set_effect(name, enabled=True, **(
            {'inertia': 0.03} if isinstance(record, Rotor) else {'position': place}))
        one.step(duration=0.001)
    one.set_state(q)
    np.testing.assert_allclose(one.acceleration, found['tuned'], rtol=1e-10)
    assert not wanted
