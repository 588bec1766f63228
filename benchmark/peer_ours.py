# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""This project's simulator beside others."""

from evaluations import evaluate_again
from machine import commit
from peer_cases import Line

from closedloop_dynamics.engine import native  # noqa: I100
from closedloop_dynamics.engine.types import EVALUATIONS
from closedloop_dynamics.simulation.derivative_code import DerivativeCode
from closedloop_dynamics.simulation.simulation import Simulation

NAME, DEFAULT = 'closedloop_dynamics', 'default'
# Of a step that is timed [s]: of many the energy balance is that of the motion from any state.
STEP = 1e-6


class Engine:
    """
    Our simulator of one machine.

    Parameters
    ----------
    machine : peer_cases.Machine

    """

    name, version, agreed = NAME, commit(), 1e-9
    limit, others = None, {}

    def __init__(self, machine):
        self._scene, self._simulation = machine.scene, Simulation(machine.scene)

    def acceleration(self, q, qd, tau):
        """Return joint accelerations, shape (nv,)."""
        system = self._simulation.data.system
        system.tau[:] = tau
        evaluate_again(system, q, qd, 1)
        return system.qdd.copy()

    def timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations}."""
        one, system = self._simulation, self._simulation.data.system
        system.tau[:] = tau
        torque = tau[list(one.coordinates.actuated)]

        def call(count):
            for _ in range(count):
                one.forward_dynamics(q, qd, torque)

        stepping = Simulation.from_scene(self._scene, integrator='rk4', step_size=STEP)

        def steps(count):
            stepping.advance(tau, count)

        def back():
            stepping.set_state(q, qd)
            stepping.stepping.monitor.sampling = False

        steps.prepare = back
        return {'evaluation, compiled loop': lambda count: evaluate_again(system, q, qd, count),
                'evaluation, from Python': call, 'RK4 step with projection': steps}

    def derivative_timings(self, q, qd, tau):
        """Return {what: function of a number of evaluations with all derivatives}."""
        data = self._simulation.data
        data.system.tau[:] = tau
        # Kept: its code writes into arrays of its own.
        self._derivatives = code = DerivativeCode(data, data.system.qdd, data.system.lam)
        again = native.bind('call_for_columns', code.table, q, qd, code.columns, code.found)

        def derivatives(count):
            evaluate_again(data.system, q, qd, count)
            for _ in range(count):
                again()

        return {'evaluation, compiled loop, and all derivatives, from Python': derivatives}

    def lines(self, case, plan):
        """Return the ways to compute a case: the default method, or two at all settings."""
        if plan.accuracies:
            methods = [{'integrator': 'auto', 'accuracy': value} for value in plan.accuracies]
            return [Line(DEFAULT, '', [f'accuracy {value:.0e}' for value in plan.accuracies],
                         lambda number: _motion(case, judged=True, **methods[number]),
                         plan.accuracies)]
        return [
            Line(NAME, 'DOP853', [f'tolerance {value:.0e}' for value in plan.tolerances],
                 lambda number: _motion(case, integrator='dop853', step_size=case.span,
                                        tolerance=plan.tolerances[number])),
            case.stepped(NAME, 'RK4', plan.steps, lambda _, step: _motion(
                case, integrator='rk4', step_size=step))]


def _motion(case, judged=False, **method):
    """Return a function that computes the motion of a case."""
    one = case.simulation(**method)
    steps = round(case.span / one.step_size)

    def back():
        one.reset()
        one.stepping.monitor.sampling = False

    def execute():
        if not judged:
            back()
        for torque in case.torques:
            one.advance(torque, steps)
        return one.position

    def judge():
        error, simulation = case.largest_error(**method)
        return error, simulation.data.system.work.health[EVALUATIONS] / case.duration

    if judged:
        # What the default takes is the motion alone, as a user has it.
        execute.prepare, execute.judged = back, judge
    return execute
