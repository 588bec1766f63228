# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Arrays that do not fit together are refused, so that none is read beyond its end.

The arguments are those that simulations hand over, each damaged in turn. ``scripts/sanitize`` runs
this with each access to memory checked: there an array that is accepted and read too far ends the
run.
"""

from copy import deepcopy
import ctypes
import random

from closedloop_dynamics import load_scene, Model, Sensitivity, Simulation
from closedloop_dynamics.codegen.equations import Far, Loops, with_all_equations
from closedloop_dynamics.codegen.workspace import allocate
from closedloop_dynamics.effects import effect_table
from closedloop_dynamics.effects.expression import program
from closedloop_dynamics.effects.registry import FluidDrag, JointSpring, Law
from closedloop_dynamics.engine import native
from closedloop_dynamics.kinematics.pose_grid import Axis, Platform, PoseGrid
from closedloop_dynamics.scene.integrators import PROJECTION
from closedloop_dynamics.simulation.derivative_code import DerivativeCode
from closedloop_dynamics.simulation.rollout_run import QUANTITIES
from closedloop_dynamics.simulation.traced_scene import TracedScene
import numpy as np
import pytest

from ..effects import test_cut_freedoms, test_effect_set, test_joint_spring, test_space
from ..effects.machines import simulated
from ..estimation import test_correction
from ..kinematics import test_driven
from ..simulation import test_stepper

RUNS = [('three_rrr', 'rk4'), ('three_rrr', 'rodas4'), ('three_rrr', 'rodas4_fixed'),
        ('three_rrr', 'dopri5'), ('carpet_scraper_on_carpet', 'auto'), ('geneva_drive', 'auto'),
        ('bennett', 'rk4'), ('scissor_lift', 'rk4'), ('stewart_platform', 'rk4'),
        ('differential', 'auto')]
# Addresses of code, which nothing can check.
ADDRESSES = ('table',)
NAMELESS_ADDRESSES = {
    ('run_batch', (0, 0)), ('system', (10,)), ('with_equations', (3,)), ('use_equations', (3,)),
    ('callable_dynamics', (3,))}
# Functions to whose arguments generated code has the addresses: these very arrays are handed over.
LINKED = ('run_batch',)
# Functions that return a system.
SYSTEMS = ('system', 'with_equations', 'with_independent', 'copy')
# Any length will do: of values, of places, of bodies behind the last one that is asked for; or the
# function returns that it has done nothing.
ANY_LENGTH = {
    ('model', 4), ('system', 3), ('system', 10), ('with_equations', 3), ('use_equations', 3),
    ('largest', 0), ('points_in_state', 2), ('points_in_state', 3), ('points_in_state', 4),
    ('reach_poses', 9), ('spread_torques', 0), ('spread_torques', 1),
    ('spread_torques', 2), ('evaluate_given', 2), ('evaluate_given', 3), ('evaluate_given', 4),
    ('find_torques', 6), ('find_torques', 7), ('find_torques', 8), ('find_joint_forces', 4),
    ('advance_run', 1), ('cut_wrenches', 2), ('place_points', 1), ('cut_axis', 1),
    ('bias_forces', 1), ('correct_errors', 11), ('rates', 1), ('rates', 2), ('run_samples', 1),
    ('run_samples', 2), ('callable_steps', 5), ('callable_dynamics', 2), ('callable_dynamics', 3)}
REFUSALS = (TypeError, ValueError, BufferError, OverflowError)


# Types of the engine whose objects have methods.
TYPES = (native.Model, native.Workspace, native.Manifold, native.EffectTable, native.System,
         native.Run, native.Snapshot, native.StopFlag, native.Callable)


def place_of(name):
    """Return the module, or the type, that has a function of the engine."""
    return next(place for place in (native, *TYPES) if hasattr(place, name))


def function(name):
    """Return a function of the engine; of a method, one that takes the object first."""
    return getattr(place_of(name), name)


class Recorder:
    """The engine's module as simulations see it: each function keeps what it was called with."""

    def __init__(self):
        self.calls = {}

    def note(self, name, *arguments):
        # Methods are called with objects of their type, not with what has one.
        arguments = tuple(getattr(each, 'native', each) for each in arguments)
        shapes = repr([shape(each) for each in arguments])
        self.calls.setdefault(name, {}).setdefault(shapes, arguments)

    def function(self, name, real):
        def call(*arguments):
            self.note(name, *arguments)
            return real(*arguments)
        return call

    def bind(self, real):
        def bind(name, *first):
            bound = real(name, *first)

            def call(*rest):
                self.note(name, *first, *rest)
                return bound(*rest)
            return call
        return bind


def made(folder):
    """Yield simulations that have each kind of effect, in the plane, in space, in cut joints."""
    for scene, integrator in RUNS:
        yield Simulation.from_scene(scene, integrator=integrator)
    rng, mechanism, q, qd = test_effect_set.drawn('three_rrr')
    yield simulated(mechanism, test_effect_set.all_effects(rng, mechanism, q), q, qd)
    mechanism, _, effects = test_space.linkage_with_all_of_it()
    effects['air'] = FluidDrag('end', (0.1, 0.2, 0.3), flow=(1.0, 0.0, 0.0))
    effects['law'] = Law({'d': '-k*d - z', 'x': 't - x'}, distances={'d': ('tip', 'end')},
                         components={'x': ('end', 'z')}, parameters={'k': 2.0}, states={'z': 'd'})
    yield simulated(mechanism, effects, np.zeros(len(mechanism.joints)))
    yield simulated(test_joint_spring.ball(), {'spring': JointSpring('socket', 8.0)},
                    (0.3, 0.6, 0.0, 0.0, 0.8), 4 * [0.0])
    yield test_cut_freedoms.simulation(
        test_cut_freedoms.machine(folder, test_cut_freedoms.CUTS[1]), test_cut_freedoms.EFFECTS)


def shape(given):
    """Return a key that differs where arguments do."""
    if isinstance(given, tuple):
        return tuple(map(shape, given))
    return getattr(given, 'shape', type(given).__name__)


def use(simulation):
    """Ask a simulation for all kinds of things."""
    count = len(simulation.actuated_joints)
    for _ in range(2):
        simulation.step(duration=0.003)
    if count:
        simulation.inverse_dynamics(
            simulation.position, simulation.velocity, simulation.acceleration)
    simulation.forward_dynamics(simulation.position, simulation.velocity, np.zeros(count))
    simulation.evaluator()
    for name in ('joint_forces', 'constraint_forces', 'energy', 'points'):
        getattr(simulation, name)
    for samples in (1, 9):
        simulation.rollout(np.zeros((samples, 3, count)), steps=6, every=2)
    simulation.rollout(np.zeros((2, 3, count)), steps=6, quantities=QUANTITIES)


def use_kernels(simulation, note):
    """Call what simulations ask for seldom, with the arrays of one."""
    system, run = simulation.data.system, simulation.stepping.run.native
    model, work, handle, effects = system.model, system.work, system, system.effects
    nq, nv, state = len(simulation.position), len(system.qdd), simulation.data.integrated.copy()
    q, qd = state[:nq].copy(), state[nq:nq + nv].copy()

    def call(name, *arguments):
        arguments = tuple(getattr(each, 'native', each) for each in arguments)
        note(name, *arguments)
        return function(name)(*copied(arguments))

    call('outward', model, q, qd, work)
    call('update', model, work, 2)
    call('inward', model, system.tau[:nv].copy(), work, False)
    call('assemble', model, work)
    call('factorize', model, work)
    call('forward_dynamics', model, work, q, qd, system.tau[:nv].copy(), system.qdd, system.lam)
    call('with_equations', system, model, with_all_equations(model), np.zeros(0, dtype=np.int64))
    call('with_independent', system, True)
    other = deepcopy(system)
    call('use_equations', other, other.model, with_all_equations(other.model),
         np.zeros(0, dtype=np.int64))
    call('bias_forces', work, work.force.copy())
    call('tree_torque', model, work, system.qdd, np.zeros(nv))
    call('to_user_order', model, system.lam, np.zeros_like(system.lam))
    call('largest', q)
    call('evaluate', handle, q, qd)
    call('evaluate_with_poses', handle, state)
    call('evaluate_again', handle, state, 2)
    call('derivative', handle, state, np.zeros_like(state))
    call('stabilise', handle, PROJECTION, state)
    call('advance_run', run, system.tau.copy(), 2)
    call('make_steps', run, 1e-3, 2, 2)
    call('command', run, system.tau.copy())
    call('jump_balance', run, 0.1)
    call('set_time', run, 0.5, 3)
    call('resume_run', run, True)
    call('sample', run, True)
    call('restart', run, True)
    call('take_run', run, run)
    call('take_numbers', deepcopy(system), handle)
    call('try_step', run, state, 1e-4)
    call('recall', run, simulation.state)
    call('write_whole', run, simulation.state)
    call('accuracy_in', run, simulation.state)
    call('take_method', run, run)
    for name in ('begin', 'add_work', 'balance', 'check_energy', 'record_energy',
                 'find_start', 'rewind', 'whole_length', 'time', 'base', 'steps', 'run_report',
                 'clear_cost', 'jump', 'restart_guards'):
        call(name, run)
    call('write_kept', run, False, simulation.state)
    call('set_guard_limits', run, simulation.stepping.run.guard_limits,
         np.zeros(0, dtype=np.int64))
    every = with_all_equations(model)
    nc, numbers = len(simulation.constraint_jacobian), np.arange(max(nv, 6))
    loops = Loops(np.ones(nc, dtype=np.int64), numbers[:min(nc, 2)].copy(), numbers[:nv].copy(),
                  3e-6, 1e-12, 0.1)
    solver = every, allocate(every), system.manifold
    call('close_loops', *solver, q, loops, 1e-9, 1e-9)
    call('close_rates', *solver, q, qd, loops, np.zeros(min(nc, 2)))
    states = q[np.newaxis].copy(), qd[np.newaxis].copy()
    call('close_states', *solver, *states, loops, 1e-9, np.zeros(1, dtype=np.int64))
    call('first_open', *solver, *states, 1e-9)
    far = Far(np.ones(nc), np.ones(nv), np.zeros(len(every.cut), dtype=np.int64),
              np.array([[0.0, 0.0, -1.0, 1.0]]), np.zeros(nc + len(every.cut) + 1))
    call('search_loops', *solver, q, loops, far, 1e-9, 3)
    call('loop_residuals', *solver, q, loops, far, far.target.copy(),
         np.zeros((len(far.target), nv)))
    if system.manifold is not None:
        call('move', system.manifold, q, qd, 0.1)
        call('rates', system.manifold, state, np.zeros(nq))
    call('fill_quaternions', np.tile(np.eye(3), (2, 1, 1)), np.zeros((2, 4)))
    if system.whole is not None:
        call('find_all_multipliers', handle, q, qd, np.zeros_like(system.whole.lam))
    elif effects is None or not len(effects.cuts.index):
        call('check_starts', run, 1e-9, state[np.newaxis].copy(),
             np.zeros(1, dtype=np.int64))
    if effects is None:
        return
    call('apply_effects', effects, work.body, np.resize(q, nv), qd, system.tau)
    call('expression_value', np.array(program('2*sin(3*t)')), 0, 0.1)
    call('load_joints', handle, model, work, qd, system.qdd, system.lam)
    reported, = effect_table.for_engine([effects.elements[0]], effects.is_spatial, True)
    call('put_effect', effects, 0, reported)
    cuts = effects.cuts
    for k in range(len(cuts.index)):
        call('cut_axis', effects, work.body, k)
        call('cut_accelerations', effects, model, work, system.qdd, True, cuts.qdd)
        call('measure_cut_coordinates', effects, work.body, cuts.q, cuts.qd)


def use_driver(simulation, integrator):
    """Make steps by the methods themselves."""
    simulation.stepping.prepare_method(integrator=integrator)()
    simulation.step(duration=2e-3)
    if integrator == 'auto':
        simulation.stepping.run.aim(1e-5)


def dynamics(scene):
    """Have accelerations of a scene called by address; return what that works with."""
    data = Simulation.from_scene(scene).data
    qdd, lam = np.zeros(len(data.system.qdd)), np.zeros(len(data.system.lam))
    code = DerivativeCode(data, qdd, lam, scene=TracedScene(data, instant=True))
    return data, code, data.system.native.callable_dynamics(
        data.integrated.copy(), np.array(data.actuated, dtype=np.int64), code.table, qdd, lam,
        code.columns, code.found)


def call_rows(of, state):
    """Call the functions of a callable by their addresses for a state, which may be refused."""
    address, *functions = of.addresses()
    arrays = [np.resize(state, 100), *np.zeros((8, 100))]
    given, found = ((ctypes.c_void_p * len(some))(*(each.ctypes.data for each in some))
                    for some in (arrays[:6], arrays[6:]))
    kind = ctypes.CFUNCTYPE(
        ctypes.c_int64, ctypes.c_void_p, ctypes.c_int64, ctypes.c_void_p, ctypes.c_void_p)
    for each in functions:
        kind(each)(address, 1, given, found)


@pytest.fixture(scope='module')
def calls(tmp_path_factory):
    """Yield the arguments of the engine's functions in some simulations, by name."""
    recorder = Recorder()
    names = [name for place in (native, *TYPES) for name in dir(place)
             if callable(getattr(place, name)) and not name.startswith('_')
             and getattr(place, name) not in TYPES and name != 'views']
    # What they build to differentiate by parameters is kept by nobody.
    sensitivities = [
        Sensitivity(Model.from_scene(scene), {'integrator': integrator, 'step_size': 1e-3},
                    ['effects.gravity.acceleration.1'])
        for scene, integrator in (('three_rrr', 'heun'), ('rssr_four_bar', 'semi_implicit_euler'))]
    with pytest.MonkeyPatch.context() as patch:
        simulations = []
        for name in names:
            real, place = function(name), place_of(name)
            patch.setattr(place, name, recorder.bind(real) if name == 'bind' else
                          recorder.function(name, real))
        for simulation in made(tmp_path_factory.mktemp('machine')):
            use(simulation)
            simulations.append(simulation)
        for integrator in ('dopri5', 'rodas4', 'rodas4_fixed', 'auto'):
            use_driver(simulations[0], integrator)
        for sensitivity in sensitivities:
            trajectory = sensitivity.trajectory(steps=6, every=2)
            trajectory.gradient(trajectory.position)
            trajectory.changes()
        for scene, joint in (('four_bar', 'crank_joint'), ('rssr_four_bar', 'crank')):
            kinematics, start = test_driven.driven(scene, {joint: 0.0})
            kinematics.follow([start, start + 0.1])
        platform = Platform(load_scene('three_rrr'), 'platform_center')
        grid = PoseGrid(platform, [
            Axis(name, place + np.linspace(-0.02, 0.02, 3))
            for name, place in zip('xy', platform.place)], workers=1)
        grid.start_from(platform.start)
        grid.spread()
        stepper = test_stepper.Case('rssr_four_bar')
        stepper.after(stepper.q, stepper.qd, stepper.tau)
        stepper.stepper.change_independent()
        kept = stepper.stepper.called_by_address(), dynamics('rssr_four_bar')
        test_correction.corrected(*test_correction.drawn())
    for simulation in simulations:
        use_kernels(simulation, recorder.note)
    for handle, request, *_ in list(recorder.calls['evaluate_given'].values()):
        recorder.note('evaluate_request', handle, handle, request)
    # The first ones take no arrays, the others addresses of code and what it was generated for.
    without_arrays = {'stop_flag', 'set_stop', 'heed', 'call', 'call_for_columns', 'keep_law',
                      'copy', 'own_model', 'own_effects', 'snapshot', 'restore', 'addresses'}
    assert set(names) - set(recorder.calls) <= {'bind', *without_arrays}
    for name in without_arrays:
        recorder.calls.pop(name, None)
    # Generated code has the addresses of arrays that only the simulations keep.
    yield {name: list(found.values()) for name, found in recorder.calls.items()}
    del simulations, sensitivities, stepper, kept


def leaves(given, path=(), names=()):
    """Yield path, names and value of everything in nested tuples."""
    if isinstance(given, tuple):
        fields = getattr(given, '_fields', range(len(given)))
        for place, (name, each) in enumerate(zip(fields, given)):
            yield from leaves(each, (*path, place), (*names, name))
    else:
        yield path, names, given


def changed(given, path, value, other):
    """Return nested tuples with another value in one place, and in others what ``other`` makes."""
    if not path:
        return value
    parts = [changed(each, path[1:], value, other) if place == path[0] else other(each)
             for place, each in enumerate(given)]
    return type(given)(*parts) if hasattr(given, '_fields') else tuple(parts)


def copied(given):
    """Return a copy of nested tuples of arrays."""
    if isinstance(given, tuple):
        parts = map(copied, given)
        return type(given)(*parts) if hasattr(given, '_fields') else tuple(parts)
    return given.copy() if isinstance(given, np.ndarray) else given


def shorter(array):
    """Yield the array with less in each dimension."""
    for axis, length in enumerate(array.shape):
        if length:
            yield np.ascontiguousarray(np.delete(array, -1, axis))
            yield np.ascontiguousarray(np.delete(array, slice(None), axis))


def with_entry(array, place, value):
    """Return a copy with another value in one place, as counted through all dimensions."""
    array = array.copy()
    array.flat[place] = value
    return array


def damaged(draw, names, value):
    """Return another value of one argument, or of a part of one."""
    if isinstance(value, np.ndarray) and value.size:
        place, whole = draw.randrange(value.size), value.dtype == np.int64
        faults = [*shorter(value), np.concatenate([value, value]), value.astype(np.float32),
                  np.repeat(value, 2, axis=-1)[..., ::2], value[np.newaxis].copy(), None]
        if not whole:
            faults += [with_entry(value, place, each) for each in (np.nan, np.inf, -1.0, 1e18)]
            faults += [np.full_like(value, np.nan)]
        elif names[-1] == 'counts':
            # More would be steps to make.
            faults += [with_entry(value, place, each) for each in (-1, 40, -2 ** 62)]
        elif names[-1] not in ADDRESSES:
            faults += [with_entry(value, place, each) for each in (
                -1, -2, 1, 3, 6, 40, 10 ** 6, 2 ** 62, -2 ** 63)]
            faults += [value + 1, value - 1]
        return draw.choice(faults)
    if isinstance(value, (bool, np.ndarray)) or value is None:
        return draw.choice(['text', object(), np.zeros((2, 2, 2, 2))])
    if isinstance(value, (int, np.integer)):
        return draw.choice([-1, -2 ** 62, 50, 2 ** 80, 0.5])
    if isinstance(value, float):
        return draw.choice([np.nan, np.inf, -1e308, 'text'])
    return draw.choice([None, 'text', 1])


def attack(draw, name, arguments):
    """Call a function with one of its arguments damaged; return whether it refused that."""
    path, names, value = draw.choice([
        leaf for leaf in leaves(arguments) if (name, leaf[0]) not in NAMELESS_ADDRESSES])
    fault, linked = damaged(draw, names, value), name in LINKED
    before = copied(arguments)
    try:
        # Callables work with arrays that the caller keeps.
        given = changed(arguments, path, fault, (lambda same: same) if linked else copied)
        found = function(name)(*given)
        if name in SYSTEMS:
            assert len([length for length in range(100)
                        if takes(found, np.zeros(length))]) == 1
        if name.startswith('callable'):
            call_rows(found, arguments[1] if name == 'callable_dynamics' else arguments[3][0][0])
    except REFUSALS:
        return True
    finally:
        for each, kept in zip(leaves(arguments), leaves(before)) if linked else ():
            if isinstance(each[2], np.ndarray):
                each[2][...] = kept[2]
    return False


def takes(system, state):
    """Return whether a system evaluates a state of this length."""
    try:
        system.evaluate_with_poses(state)
        system.stabilise(PROJECTION, state)
        system.derivative(state, np.zeros_like(state))
    except REFUSALS:
        return False
    return True


def test_every_array_that_is_too_short_is_refused(calls):
    accepted = set()
    for name, many in calls.items():
        for arguments in many:
            for place, value in enumerate(arguments):
                if (not isinstance(value, np.ndarray) or not value.size
                        or (name, place) in ANY_LENGTH):
                    continue
                for fault in shorter(value):
                    try:
                        function(name)(*changed(arguments, (place,), fault, copied))
                        accepted.add((name, place, value.shape, fault.shape))
                    except REFUSALS:
                        pass
    assert not accepted


@pytest.mark.parametrize('count', [2000, pytest.param(40_000, marks=pytest.mark.slow)])
def test_no_damage_to_any_argument_ends_the_process(calls, count):
    draw, refused = random.Random(1), 0
    names = sorted(calls)
    for number in range(count):
        name = names[number % len(names)]
        refused += attack(draw, name, draw.choice(calls[name]))
    assert count / 3 < refused < count
