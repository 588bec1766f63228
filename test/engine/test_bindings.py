# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What the bindings promise: arguments that do not fit are refused, bound arrays live on."""

import gc
import inspect
from itertools import product
import re
import sys
import weakref

from closedloop_dynamics import Method, Simulation
from closedloop_dynamics.codegen import function_table as calls
from closedloop_dynamics.engine import native
from closedloop_dynamics.engine.types import BODY_A, CUT_NUMBER, CUT_TYPE, PATH_B
from closedloop_dynamics.kinematics.modeling import build_model
from closedloop_dynamics.scene.integrators import PROJECTION
from closedloop_dynamics.scene.tableau import RK4
from closedloop_dynamics.simulation.guards import guard_limits
from closedloop_dynamics.simulation.run import DONE
from closedloop_dynamics.simulation.system import build_system, number_of_states
import numpy as np
import pytest

from ..reference import cases
from ..simulation import test_stepper

TYPES = [each for _, each in inspect.getmembers(native, inspect.isclass)]


def parameters_of(function):
    """Return the names of the arguments that the text of a function declares."""
    depth, text = 1, ''
    for letter in function.__doc__[len(function.__name__) + 1:]:
        depth += {'(': 1, ')': -1}.get(letter, 0)
        if depth == 0:
            return [re.search(r'[a-z_]+', item)[0] for item in text.split(', ') if item]
        text += letter


PARAMETERS = {
    (place.__name__.rsplit('.', 1)[-1], name): parameters_of(function)
    for place in (native, *TYPES) for name, function in inspect.getmembers(place, callable)
    if name != 'bind' and not name.startswith('_') and function not in TYPES}
# Any object is true or false; numbers of any size are energies, positive ones accuracies.
TAKE_ANYTHING = {'sample', 'restart', 'with_independent', 'use_independent', 'jump_balance',
                 'aim', 'resume_run'}


def function(name):
    """Return a function of the engine; of a method, one that takes the object first."""
    return getattr(next(place for place in (native, *TYPES) if hasattr(place, name)), name)


@pytest.fixture(scope='module')
def objects():
    """Return an object of each type, and the module, by name."""
    simulation = Simulation.from_scene('slider_crank_end_stop')
    system, case = simulation.data.system, test_stepper.Case('rssr_four_bar')
    made = [system.model, system.work, system.model.manifold(), system.effects, system,
            simulation.stepping.run, system.snapshot(), native.stop_flag(0),
            case.stepper.called_by_address()[0][0], native]
    found = {type(each).__name__: each
             for each in (getattr(each, 'native', each) for each in made)}
    return {**found, 'native': native, 'case': case, 'simulation': simulation}


def built():
    """Return a system of seven joints in a state that is no special one."""
    _, mechanism, q, qd = cases.drawn('three_rrr')
    made = build_system(build_model(mechanism))
    made.tau[:] = 0.1
    return made, np.concatenate([q, qd])


@pytest.fixture
def system():
    """Return a system and a state."""
    return built()


def parts(system):
    """Return a system's good arguments for some functions, by their names."""
    one, state = system
    nv = len(one.qdd)
    q, qd = state[:nv].copy(), state[nv:].copy()
    return {
        'outward': (one.model.native, q, qd, one.work),
        'inward': (one.model.native, one.tau, one.work, False),
        'largest': (q,),
        'forward_dynamics': (one.model.native, one.work, q, qd, one.tau, one.qdd, one.lam),
        'evaluate': (one.native, q, qd),
        'derivative': (one.native, state.copy(), np.zeros(2 * nv)),
        'stabilise': (one.native, PROJECTION, state.copy()),
        'evaluate_state': (one.native, state.copy())}


FUNCTIONS = ('outward', 'inward', 'largest', 'forward_dynamics', 'evaluate', 'derivative',
             'stabilise', 'evaluate_state')


def unwritable(array):
    """Return a copy that must not be written."""
    copied = array.copy()
    copied.flags.writeable = False
    return copied


WRONG_ARRAYS = {
    'float32': lambda array: array.astype(np.float32),
    'bytes in another order': lambda array: array.astype(array.dtype.newbyteorder()),
    'whole numbers for real ones, or the reverse': lambda array: array.astype(
        np.float64 if array.dtype == np.int64 else np.int64),
    'int32': lambda array: array.astype(np.int32),
    'complex': lambda array: array.astype(complex),
    'object': lambda array: array.astype(object),
    'one dimension more': lambda array: array[np.newaxis].copy(),
    'no dimension': lambda array: array.ravel()[0].reshape(()).copy(),
    'not contiguous': lambda array: np.repeat(array, 2, axis=-1)[..., ::2],
    'backwards': lambda array: array[::-1],
    'read-only': unwritable,
    'not aligned': lambda array: np.frombuffer(
        bytearray(array.nbytes + 1), offset=1, dtype=array.dtype).reshape(array.shape),
    'a list': lambda array: array.tolist(),
    'None': lambda array: None,
    'a number': lambda array: 1.0,
    'a record': lambda array: (array,),
    'text': lambda array: 'array'}


def kept(array, wrong):
    """Return whether what was done to an array leaves it as good as it was."""
    return isinstance(wrong, np.ndarray) and wrong.dtype == array.dtype and (
        wrong.ndim == array.ndim and wrong.flags.c_contiguous and wrong.flags.aligned
        and wrong.flags.writeable)


@pytest.mark.parametrize('place, name', PARAMETERS)
def test_wrong_number_of_arguments_is_refused(objects, place, name):
    one, count = getattr(objects[place], name), len(PARAMETERS[place, name])
    for number in {0, max(0, count - 1), count + 1, 40} - {count}:
        with pytest.raises(TypeError, match=rf'{name}: expected {count} arguments?, got {number}'):
            one(*[np.zeros(3)] * number)
    with pytest.raises(TypeError):
        one(**dict.fromkeys(PARAMETERS[place, name] or ['more'], 0))


@pytest.mark.parametrize('place, name', [
    key for key, parameters in PARAMETERS.items() if parameters and key[1] not in TAKE_ANYTHING])
def test_nonsense_is_refused_by_every_function(objects, place, name):
    for thing in (object(), 'text', 2 ** 80, float('nan'), [1.0], (), (1, 2), {},
                  np.zeros((2, 2, 2, 2)), native, print):
        with pytest.raises((TypeError, ValueError, OverflowError)):
            getattr(objects[place], name)(*[thing] * len(PARAMETERS[place, name]))


@pytest.mark.parametrize('name', FUNCTIONS)
def test_good_arguments_are_taken(system, name):
    arguments = parts(system)[name]
    function(name)(*arguments)
    native.bind(name, *arguments)()


@pytest.mark.parametrize('name', FUNCTIONS)
def test_wrong_arrays_are_refused(system, name):
    arguments = parts(system)[name]
    refused = 0
    for wrong, (place, value) in product(WRONG_ARRAYS.values(), enumerate(arguments)):
        if not isinstance(value, np.ndarray) or kept(value, wrong(value)):
            continue
        broken = (*arguments[:place], wrong(value), *arguments[place + 1:])
        for call in (function(name), lambda *given: native.bind(name, *given)):
            with pytest.raises((TypeError, ValueError, BufferError)):
                call(*broken)
            refused += 1
    assert refused > 10


def description(system):
    """Return what a system's model is made of, by name."""
    return {name: getattr(system.model, name).copy() for name in (
        'tree', 'body', 'gravity', 'cut', 'cut_point', 'path_body')}


@pytest.mark.parametrize('wrong', WRONG_ARRAYS)
def test_wrong_arrays_of_a_description_are_refused(system, wrong):
    one, none = system[0], np.zeros(0, dtype=np.int64)
    limits = guard_limits(Method(integrator='rk4'), False, False, False, 1.0, 1.0)
    for field, array in RK4._asdict().items():
        # What is only read may be read-only.
        if not isinstance(array, np.ndarray) or not array.size or wrong == 'read-only':
            continue
        changed = WRONG_ARRAYS[wrong](array)
        if kept(array, changed):
            continue
        options = RK4._replace(**{field: changed}), None, PROJECTION, 1e-6
        with pytest.raises((TypeError, ValueError, BufferError)):
            one.run(system[1], 'fixed', options, limits, none, none)
    for field, array in description(system[0]).items():
        changed = WRONG_ARRAYS[wrong](array)
        if not kept(array, changed) and wrong != 'read-only':
            with pytest.raises((TypeError, ValueError, BufferError)):
                native.model(*{**description(system[0]), field: changed}.values())


def test_records_of_another_length_are_refused(system):
    one, _ = system
    model, q, qd, work = parts(system)['outward']
    for wrong in ((), (work,), [work], vars(one.work), one.model, one.native):
        with pytest.raises(TypeError, match=r'outward: work: expected an object of .*Workspace'):
            model.outward(q, qd, wrong)
    with pytest.raises(TypeError, match='tableau: expected a tuple of 6 fields'):
        one.run(system[1], 'fixed', ((), None, 0, 1e-6), None, q, q)
    with pytest.raises(TypeError, match='limits: expected a tuple of 14 fields'):
        one.run(system[1], 'fixed', (None, None, 0, 1e-6), None, q, q)


@pytest.mark.parametrize('wrong', [None, 1, 'system', (), np.zeros(3), object()],
                         ids=lambda wrong: type(wrong).__name__)
def test_what_is_no_system_is_refused(system, wrong):
    for name, arguments in parts(system).items():
        if name != 'largest':
            with pytest.raises(TypeError):
                function(name)(wrong, *arguments[1:])
            with pytest.raises(TypeError):
                native.bind(name, wrong)


def test_an_object_of_another_type_is_no_system(system):
    one, _ = system
    bound = native.bind('largest', np.zeros(3)).__self__
    for other in (bound, one.model.native, one.snapshot()):
        with pytest.raises(TypeError, match='doesn.t apply|requires'):
            native.System.evaluate(other, np.zeros(7), np.zeros(7))
        with pytest.raises(TypeError, match='expected an object of .*System'):
            native.bind('evaluate', other, np.zeros(7), np.zeros(7))
        with pytest.raises(TypeError):
            type(other)()


def test_what_is_refused_is_reported_by_its_declaration(system):
    one, _ = system
    with pytest.raises(ValueError, match=re.escape(
            r'forward_dynamics: expected tau[V], where V = 7, got [3]')):
        one.model.forward_dynamics(one.work, *np.zeros((2, 7)), np.zeros(3), one.qdd, one.lam)
    with pytest.raises(ValueError, match=re.escape(
            'points_in_state: expected row<B[n], where B = 8, got 8')):
        one.points_in_state(np.zeros(14), np.array([1, 8]), np.zeros((2, 2)), np.zeros((2, 2)))
    with pytest.raises(ValueError, match=re.escape(
            'correct_errors: expected slope[m,n], where m = 2, n = 3, got [2,4]')):
        native.correct_errors(np.zeros((3, 3)), np.zeros((2, 4)), *[np.zeros(1)] * 12)
    with pytest.raises(TypeError, match='outward: qd: expected float64 of 1 dimensions, got'):
        one.model.outward(np.zeros(7), np.zeros(7, dtype=np.int64), one.work)


@pytest.mark.parametrize('field, change', [
    ('tree', lambda tree: tree[:-1].copy()), ('tree', lambda tree: tree + 1),
    ('body', lambda body: body[:-1].copy()), ('body', lambda body: body[:, 1:].copy()),
    ('gravity', lambda gravity: np.zeros(5)), ('cut', lambda cut: cut + 1),
    ('cut', lambda cut: cut[:, 1:].copy()), ('cut', lambda cut: cut[::-1].copy()),
    ('cut_point', lambda point: point[1:].copy()), ('path_body', lambda body: body + 7)])
def test_descriptions_of_no_model_are_refused(system, field, change):
    arrays = description(system[0])
    native.model(*arrays.values())
    with pytest.raises(ValueError, match='model: expected'):
        native.model(*{**arrays, field: change(arrays[field])}.values())


def test_only_equations_of_the_same_cut_joints_are_taken(system):
    model = system[0].model
    assert model.with_cut(model.cut).tree is not model.tree
    assert np.shares_memory(model.with_cut(model.cut).tree, model.tree)
    for column in (CUT_TYPE, BODY_A, PATH_B, CUT_NUMBER):
        cut = model.cut.copy()
        cut[0, column] += 1
        with pytest.raises(ValueError, match='same cut joints'):
            model.with_cut(cut)


def test_what_is_constant_cannot_be_written(system):
    model = system[0].model
    for array in (model.cut, model.path_body, model.pair, model.column, model.row, model.entry):
        with pytest.raises(ValueError):
            array[...] = 0


def test_a_system_is_of_one_mechanism_and_linked(system):
    one, _ = system
    other = build_system(build_model(cases.drawn('three_rrr')[1]))
    table, none = one.table.copy(), (
        np.zeros(0, dtype=np.int64), np.zeros((0, 2), dtype=np.int64), np.zeros((0, 2)))
    values = 0.0, 1.0, 1e-9, False
    # There is the address of the factors; code says how many there are.
    with pytest.raises(ValueError, match='expected how many factors are kept'):
        one.model.system(one.model, None, *none, *values, table)
    table[calls.FACTORS] = 0
    one.model.system(one.model, None, *none, *values, table)
    for code in (table[1:].copy(), np.zeros_like(table)):
        with pytest.raises(ValueError, match='addresses of'):
            one.model.system(one.model, None, *none, *values, code)
    with pytest.raises(ValueError, match='places of joints'):
        one.model.system(one.model, None, np.array([9]), *none[1:], *values, table)
    with pytest.raises(ValueError, match='of the mechanism'):
        one.with_equations(other.model, other.model, table)
    unconnected = native.model(*description(one).values())
    with pytest.raises(ValueError, match='addresses of code'):
        unconnected.system(unconnected, None, *none, *values, table)
    with pytest.raises(ValueError, match='joints have code'):
        unconnected.outward(np.zeros(7), np.zeros(7), one.work)


def test_bind_refuses_what_it_does_not_know():
    for arguments, error in (((), TypeError), ((3,), TypeError), (('',), ValueError),
                             (('evaluatte',), ValueError), (('bind',), ValueError),
                             ((None, 1), TypeError)):
        with pytest.raises(error):
            native.bind(*arguments)
    bound = native.bind('largest', np.array([1.0, -3.0]))
    assert bound() == 3.0
    with pytest.raises(TypeError):
        bound(1)


def test_bound_arrays_are_read_at_each_call():
    values = np.zeros(3)
    largest = native.bind('largest', values)
    for number in (0.0, 2.5, -7.0):
        values[1] = number
        assert largest() == abs(number)


def test_bound_arrays_live_as_long_as_what_they_are_bound_to():
    class Watched(np.ndarray):
        """An array that can be watched."""

    values = np.full(100_000, -2.0).view(Watched)
    watched, before = weakref.ref(values), sys.getrefcount(values)
    largest = native.bind('largest', values)
    assert sys.getrefcount(values) == before + 1
    with pytest.raises(TypeError):
        native.bind('largest', values, values)
    with pytest.raises(TypeError):
        native.bind('move', None, values, 'text', 1.0)
    assert sys.getrefcount(values) == before + 1
    del values
    gc.collect()
    # What was given back would be used by another.
    others = [np.full(100_000, 9.0) for _ in range(20)]
    assert watched() is not None and largest() == 2.0
    del largest, others
    gc.collect()
    assert watched() is None


def test_functions_and_views_keep_the_memory_of_a_system():
    one, state = built()
    nv = len(one.qdd)
    out = np.zeros(number_of_states(one))
    one.derivative(state, out)
    expected, views = one.qdd.copy(), [one.qdd, one.work.body, one.model.tree, one.work.health]
    found = [view.copy() for view in views]
    derivative = native.bind('derivative', one, state, out)
    watched = weakref.ref(one)
    del one
    gc.collect()
    others = [np.full(100, 9.0) for _ in range(2000)]
    for view, before in zip(views, found):
        np.testing.assert_array_equal(view, before)
    views.clear()
    derivative()
    np.testing.assert_array_equal(out[nv:], expected)
    del others, derivative
    gc.collect()
    assert watched() is None


def test_no_reference_is_lost_or_kept_by_calls(system):
    arguments = parts(system)['forward_dynamics']
    watched = [*arguments, arguments[1].native]

    def calls():
        native.Model.forward_dynamics(*arguments)
        with pytest.raises(TypeError):
            native.Model.forward_dynamics(*arguments[:-1], 'text')
        with pytest.raises(TypeError):
            native.Model.forward_dynamics(*arguments[:-1])

    calls()
    gc.collect()
    before = [sys.getrefcount(each) for each in watched]
    for _ in range(50):
        calls()
    gc.collect()
    assert [sys.getrefcount(each) for each in watched] == before


@pytest.fixture(params=['rk4', 'auto', 'dopri5', 'rodas4', 'rodas4_fixed'])
def guarded(request):
    """Yield a simulation, whose run the engine watches."""
    simulation = Simulation.from_scene('slider_crank_end_stop', integrator=request.param)
    simulation.step(duration=0.01)
    yield simulation


def test_runs_that_do_not_fit_their_system_are_refused(guarded):
    system, run = guarded.data.system, guarded.stepping.run
    tau, other = np.zeros(len(guarded.torque_names)), Simulation.from_scene('three_rrr')
    assert run.advance_run(tau, 1) == DONE
    run.take(other.stepping.run)
    for name, *arguments in (('find_start',), ('rewind',), ('whole_length',), ('balance',),
                             ('resume_run', True)):
        with pytest.raises(ValueError, match='of this system'):
            getattr(run, name)(*arguments)
    run = Simulation.from_scene('slider_crank_end_stop').stepping.run
    for state in (other.data.integrated, guarded.data.integrated[1:].copy()):
        with pytest.raises(ValueError, match=r'run: expected state\[S\]'):
            made(run, system, 'rodas4', state=state)
    with pytest.raises(ValueError, match=r'command: expected tau\[T\]'):
        run.command(np.zeros(len(tau) + 1))
    with pytest.raises(TypeError, match='an object of .*Run'):
        run.native.take_method(system.native)
    with pytest.raises(TypeError, match='1 arguments, got 0'):
        run.command()
    with pytest.raises(TypeError, match='instance'):
        native.Run()
    states, fine = guarded.data.integrated[np.newaxis].copy(), np.zeros(1, dtype=np.int64)
    for wrong, short in ((states[:, 1:].copy(), fine), (states, np.zeros(2, dtype=np.int64))):
        with pytest.raises(ValueError, match='do not fit together'):
            run.check_starts(1e-12, wrong, short)


def test_a_run_keeps_its_system_and_state(guarded):
    run, tau = guarded.stepping.run.native, np.zeros(len(guarded.torque_names))
    state = weakref.ref(guarded.data.integrated)
    guarded.__dict__.clear()
    gc.collect()
    assert state() is not None and run.advance_run(tau, 3) == DONE


def made(run, system, name='fixed', tableau=None, guard_limits=None, roles=None, state=None):
    """Return a run of other arguments, through the bindings alone."""
    none = np.zeros(0, dtype=np.int64)
    state = np.zeros(number_of_states(system)) if state is None else state
    return system.native.run(
        state, name, (tableau, tableau, 0, 1e-6), guard_limits or run.guard_limits,
        none if roles is None else roles, none)


@pytest.mark.parametrize('change', [
    {'step_size': 0.0}, {'step_size': -1e-3}, {'step_size': np.nan}, {'first': 0}, {'most': -1}])
def test_limits_that_no_run_can_have_are_refused(guarded, change):
    run, system, windings = guarded.stepping.run, guarded.data.system, np.zeros(0, dtype=np.int64)
    with pytest.raises(ValueError, match='do not fit the system'):
        run.set_guard_limits(run.guard_limits._replace(**change), windings)
    with pytest.raises(ValueError, match='do not fit the system'):
        run.set_guard_limits(run.guard_limits, np.array([10 ** 6]))
    with pytest.raises(ValueError, match='roles'):
        made(run, system, 'rodas4', roles=np.zeros(99, dtype=np.int64))


def test_methods_that_do_not_fit_are_refused(guarded):
    run, other = guarded.stepping.run, Simulation.from_scene('three_rrr')
    with pytest.raises(ValueError, match='another system'):
        run.native.take_method(other.stepping.run.native)
    with pytest.raises(ValueError, match='no such method'):
        made(run, guarded.data.system, 'euler')
    for name in ('explicit', 'auto', 'fixed'):
        with pytest.raises(ValueError, match='tableau'):
            made(run, guarded.data.system, name)
    for name in ('write_whole', 'recall'):
        with pytest.raises(ValueError, match=r'expected (out|whole)\[L\]'):
            getattr(run, name)(np.zeros(len(guarded.state) + 1))
    with pytest.raises(ValueError, match=r'expected whole\[L\]'):
        run.accuracy_in(np.zeros(3))
    with pytest.raises(ValueError, match='room'):
        run.native.write_kept(False, np.zeros(1))
