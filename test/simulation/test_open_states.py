# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""States that leave loops open are refused wherever they come in, with the loop and the gap."""

from functools import partial

from closedloop_dynamics import (
    AssemblyError, Differentiator, Linearisation, Model, rollout, Sensitivity, Simulation, State)
from closedloop_dynamics.simulation.model import begins
import numpy as np
import pytest

# Without left-out equations and with such, in the plane and in space.
SCENES = ('three_rrr', 'rssr_four_bar', 'bennett', 'excavator_arm')


def opened(model, seed=0):
    """Return a state beside the scene's start that leaves the loops open, and by how much."""
    rng, start = np.random.default_rng(seed), model.assemble()
    names = model.coordinates
    q = names.moved(start.q, 0.2 * rng.normal(size=names.nv))
    state = State(0.0, q, start.qd, start.own, names)
    simulation = Simulation(model)
    simulation.data.integrated[:names.nq] = q
    simulation.data.touch()
    return state, simulation.closure


def separating(model):
    """Return the scene's start with rates that open the loops."""
    start = model.assemble()
    return State(0.0, start.q, np.cos(np.arange(len(start.qd))), start.own, model.coordinates)


def ways_in(model, state):
    """Return all that takes states, by name."""
    simulation = Simulation(model)
    evaluate = model.evaluator()

    def evaluated():
        evaluate.q[:], evaluate.qd[:] = state.q, state.qd
        evaluate()

    found = {
        'state': lambda: model.state(state.q, state.qd),
        'evaluate': lambda: model.evaluate(state),
        'readings': lambda: model.readings(state),
        'inverse': lambda: model.inverse(state, np.zeros_like(state.qd)),
        'inertia': lambda: model.inertia(state),
        'constraint_jacobian': lambda: model.constraint_jacobian(state),
        'begins': lambda: begins(model, state),
        'solve': lambda: model.solve({model.joint_names[0]: 0.1}, branch=state),
        'evaluator': evaluated,
        'simulation': lambda: Simulation(model, state),
        'rollout': lambda: rollout(model, state, steps=2),
        'step': lambda: model.step(state, None, 1e-3),
        'forward_dynamics': lambda: simulation.forward_dynamics(state.q, state.qd),
        'of lists': lambda: simulation.forward_dynamics(state.q.tolist(), state.qd.tolist()),
        'inverse_dynamics': lambda: simulation.inverse_dynamics(
            state.q, state.qd, np.zeros_like(state.qd))}
    if not simulation.data.has_redundant_constraints:
        found.update({
            'linearise': lambda: model.linearise(state),
            'linear_model': lambda: Linearisation(simulation).linear_model(state.q, state.qd),
            'derivatives': lambda: Differentiator(simulation)(state.q, state.qd)})
    if model.scene.name == 'three_rrr':
        found['trajectory'] = lambda: Sensitivity(
            model, {'integrator': 'heun'}).trajectory(state, steps=2)
    return found


@pytest.mark.parametrize('scene', SCENES)
def test_open_states_are_refused_with_the_loop_and_the_gap(scene):
    model = Model.from_scene(scene)
    state, gap = opened(model)
    loops = [cut.name for cut in model.mechanism.cut_joints]
    assert gap > 1e-2
    for name, use in ways_in(model, state).items():
        with pytest.raises(AssemblyError, match=f'open by {gap:.3g} m or rad') as refused:
            use()
            pytest.fail(name)
        assert any(f'cut_joints.{loop} ' in str(refused.value) for loop in loops), name
    batch = State.stack([model.assemble(), state])
    for use in (model.evaluate, model.inertia, partial(begins, model),
                lambda states: rollout(model, states, steps=2),
                lambda states: model.state(states.q, states.qd)):
        with pytest.raises(AssemblyError, match='state 1: state: expected one that closes'):
            use(batch)


@pytest.mark.parametrize('scene', SCENES)
def test_rates_that_open_the_loops_are_refused(scene):
    model = Model.from_scene(scene)
    state = separating(model)
    for name, use in ways_in(model, state).items():
        # Positions alone decide on which branch the way begins.
        with pytest.raises(AssemblyError, match='separating at'):
            use()
            pytest.fail(name)


@pytest.mark.parametrize('scene', SCENES)
def test_the_nearest_closed_state_is_taken_where_that_is_asked_for(scene):
    model = Model.from_scene(scene)
    start = model.assemble()
    rng = np.random.default_rng(1)
    q = model.coordinates.moved(start.q, 1e-3 * rng.normal(size=len(start.qd)))
    qd = 0.1 * rng.normal(size=len(start.qd))
    for given in (q, np.array([q, start.q])):
        closed = model.state(given, np.broadcast_to(qd, (*given.shape[:-1], len(qd))), close=True)
        one = closed[0] if closed.is_batch else closed
        # Coupler and rocker move as far as the gap is wide, and levers are of the size one.
        assert 0.0 < np.abs(model.coordinates.apart(one.q, q)).max() < 0.1
        assert np.abs(model.constraint_jacobian(one) @ one.qd).max() < 1e-12
        assert model.evaluate(one).closure < 1e-12
    # A few corrections come to the same, and keep what is closed.
    simulation = Simulation(model)
    near = simulation.closed(q, qd)
    assert simulation.forward_dynamics(*near)[0].shape == qd.shape
    np.testing.assert_allclose(simulation.closed(*near)[0], near[0], rtol=0, atol=1e-12)


def test_corrections_do_not_lead_anywhere():
    simulation = Simulation.from_scene('three_rrr')
    with pytest.raises(AssemblyError, match='from which corrections leave cut_joints.cut_1 open'):
        simulation.closed(simulation.position + np.cos(np.arange(7)), np.zeros(7))


def test_states_of_a_machine_with_other_lengths_are_open():
    model = Model.from_scene('four_bar')
    longer = model.with_parameters({'mechanism.cut_joints.cut_1.point_a.0': 0.36})
    with pytest.raises(AssemblyError, match='cut_joints.cut_1 open by 0.0'):
        longer.evaluate(model.assemble())


def test_prescribed_motions_count_as_loops():
    scene = Simulation.from_scene(
        'four_bar', motion={'crank_joint': '1.0472 + 0.3*sin(3*t)'}).scene
    model = Model(scene)
    start = model.assemble()
    assert model.evaluate(start).closure < 1e-12
    late = State(0.2, start.q, start.qd, model.assemble(time=0.2).own, model.coordinates)
    with pytest.raises(AssemblyError, match='effects.motion_crank_joint open by 0.169 m or rad'):
        model.evaluate(late)


def test_functions_of_jax_refuse_open_states():
    jax = pytest.importorskip('jax', reason='needs jax, from the Python package index')
    jax.config.update('jax_enable_x64', True)
    from closedloop_dynamics.export.jax_dynamics import jax_dynamics
    model = Model.from_scene('four_bar')
    state, _ = opened(model)
    with pytest.raises(Exception, match='cut_joints.cut_1 open by'):
        jax_dynamics(model)(state.q, state.qd, np.zeros(1))[0].block_until_ready()
