# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Nonlinear model-predictive control of the 3-RRR manipulator by CasADi and IPOPT.

The model is the C that the package writes, with its derivatives, called by CasADi as an external
function. Every 20 ms an optimal control problem over the next 0.3 s is solved by multiple
shooting, in all seven joint coordinates: they close the loops as the state that it starts from
does. The first torques act on a run of the package. Needs the package casadi and a C compiler, cc.

    python doc/examples/predictive_control.py [CONTROL_STEPS]
"""

from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory

import casadi
from closedloop_dynamics import Model, Simulation
from closedloop_dynamics.export.c_source import c_source
import numpy as np

PERIOD, HORIZON = 0.02, 15      # Of control [s]; how many periods are looked ahead
LIMIT = 3.0                     # Of the torques [N m]
CHANGE = (0.25, -0.2, 0.15)     # Of the drives, from the start to the goal [rad]


def external(simulation, folder):
    """Return accelerations of q, qd and tau as a function of CasADi, with its Jacobian."""
    source, header = c_source(simulation, 'machine', derivatives=True)
    (folder / 'machine.c').write_text(source)
    (folder / 'machine.h').write_text(header)
    subprocess.run(['cc', '-std=c99', '-O1', '-ffp-contract=fast', '-fPIC', '-shared', '-o',
                    folder / 'machine.so', folder / 'machine.c', '-lm'], check=True)
    return casadi.external('machine', str(folder / 'machine.so'))


def controller(dynamics, driven, goal):
    """Return a solver of the optimal control problem, and bounds of its unknowns."""
    nv = len(goal)
    state, torque = casadi.MX.sym('state', 2 * nv), casadi.MX.sym('torque', len(driven))
    tau = casadi.MX(nv, 1)
    for place, joint in enumerate(driven):
        tau[joint] = torque[place]

    def rates(at):
        return casadi.vertcat(at[nv:], dynamics(at[:nv], at[nv:], tau)[0])

    k1 = rates(state)
    k2 = rates(state + 0.5 * PERIOD * k1)
    k3 = rates(state + 0.5 * PERIOD * k2)
    k4 = rates(state + PERIOD * k3)
    step = casadi.Function('step', [state, torque], [
        state + PERIOD / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)])
    states, torques = casadi.MX.sym('x', 2 * nv, HORIZON + 1), casadi.MX.sym(
        'u', len(driven), HORIZON)
    start = casadi.MX.sym('start', 2 * nv)
    gaps = [states[:, 0] - start] + [
        states[:, k + 1] - step(states[:, k], torques[:, k]) for k in range(HORIZON)]
    away = states[:nv, 1:] - casadi.repmat(goal, 1, HORIZON)
    cost = (100.0 * casadi.sumsqr(away) + 0.1 * casadi.sumsqr(states[nv:, 1:])
            + 500.0 * casadi.sumsqr(away[:, -1]) + 0.01 * casadi.sumsqr(torques))
    unknowns = casadi.vertcat(casadi.vec(states), casadi.vec(torques))
    solver = casadi.nlpsol('control', 'ipopt', {
        'x': unknowns, 'p': start, 'f': cost, 'g': casadi.vertcat(*gaps)}, {
            # The external function has first derivatives.
            'ipopt': {'hessian_approximation': 'limited-memory', 'print_level': 0, 'sb': 'yes',
                      'max_iter': 200}, 'print_time': False})
    bounds = np.r_[np.full(2 * nv * (HORIZON + 1), np.inf), np.full(torques.numel(), LIMIT)]
    return solver, bounds


def control(count):
    """Return the distances from the goal [rad] after each period, and the torques [N m]."""
    simulation = Simulation.from_scene('three_rrr_horizontal', integrator='rk4', step_size=1e-3)
    names, nv = simulation.joint_names, len(simulation.velocity)
    driven = [names.index(name) for name in simulation.actuated_joints]
    model, start = Model(simulation.scene), simulation.position
    goal = model.solve({name: start[place] + change for name, place, change in zip(
        simulation.actuated_joints, driven, CHANGE)}).q
    away, torques = [], []
    with TemporaryDirectory() as folder:
        solver, bounds = controller(external(simulation, Path(folder)), driven, goal)
        first = np.r_[start, simulation.velocity]
        guess = np.r_[np.tile(first, HORIZON + 1), np.zeros(len(driven) * HORIZON)]
        for _ in range(count):
            found = solver(x0=guess, p=first, lbx=-bounds, ubx=bounds, lbg=0.0, ubg=0.0)
            if not solver.stats()['success']:
                raise RuntimeError(f'IPOPT: {solver.stats()["return_status"]}')
            guess = np.array(found['x']).ravel()
            torque = guess[2 * nv * (HORIZON + 1):][:len(driven)]
            simulation.step(torque, PERIOD)
            first = np.r_[simulation.position, simulation.velocity]
            away.append(np.abs(simulation.position - goal).max())
            torques.append(torque)
    return np.array(away), np.array(torques)


if __name__ == '__main__':
    away, torques = control(int(sys.argv[1]) if len(sys.argv) > 1 else 40)
    for k in range(4, len(away), 5):
        print(f'{PERIOD * (k + 1):.2f} s: {away[k]:.2e} rad from the goal, torques up to '
              f'{np.abs(torques[k]).max():.3f} N m')
