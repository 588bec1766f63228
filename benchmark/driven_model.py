# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
A robot of a file in MJCF under sines on its drives, beside MuJoCo.

All drives get the same torque, of 1 N m and 1 Hz, held for each millisecond of a second; contacts
are left out. Prints how far each run comes, its CPU time, how far it opens the loops, and its
energy error. MuJoCo's is what energies change less the work of drives, springs, dampers, dry
friction and limits: what its soft loops and its steps add or take.
"""

import math
import os
from pathlib import Path
import sys
import time
import warnings

# Before anything loads a library that has threads of its own.
for _name in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS'):
    os.environ[_name] = '1'

from closedloop_dynamics.mechanism.errors import SimulationError  # noqa: E402
from closedloop_dynamics.scene.loading import load_scene  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from closedloop_dynamics.visual.tables import markdown_table, seconds  # noqa: E402
from machine import description, parser_of  # noqa: E402
import mujoco  # noqa: E402
import numpy as np  # noqa: E402
from peer_mujoco import compiled  # noqa: E402

HOLD = 1e-3  # [s]
# Torque of every drive in each interval of a second [N m], and stiffness of limits [N m/rad].
TORQUES, STOPS = np.sin(2.0 * math.pi * HOLD * np.arange(1000)), 100.0


def run_ours(file, end_stops, **method):
    """Run a scene of the file; return a row of the table, and why it ended early."""
    scene = load_scene(file, end_stops=end_stops)
    simulation = Simulation(scene, method={'step_size': HOLD, **method})
    driven = np.isin(simulation.torque_names, simulation.mechanism.actuated_joints)
    used, opened, why = 0.0, 0.0, ''
    for torque in TORQUES:
        begin = time.process_time()
        try:
            simulation.advance(torque * driven, 1)
        except SimulationError as error:
            why = str(error)
        used += time.process_time() - begin
        opened = max(opened, simulation.closure)
        if why:
            break
    balance = simulation.energy_balance
    return (simulation.time, used, opened, balance.residual, balance.work), why


def run_mujoco(file, limits):
    """Run the file in MuJoCo; return a row of the table."""
    model = compiled(file)
    model.opt.timestep = HOLD
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    if not limits:
        model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_LIMIT
    data = mujoco.MjData(model)
    begin = time.process_time()
    for torque in TORQUES:
        data.ctrl[:] = torque
        mujoco.mj_step(model, data)
    used = time.process_time() - begin
    # Once more, with all that the balance needs.
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_DENSE
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    mujoco.mj_resetData(model, data)
    mujoco.mj_forward(model, data)
    start, opened, work, driven = data.energy.sum(), 0.0, 0.0, 0.0
    for torque in TORQUES:
        data.ctrl[:] = torque
        rates = data.qvel.copy()
        mujoco.mj_step(model, data)
        # The forces are those at the start of the step.
        rates = 0.5 * (rates + data.qvel)
        others = data.efc_type != mujoco.mjtConstraint.mjCNSTR_EQUALITY
        rows = data.efc_J.reshape(-1, model.nv)[others]
        forces = data.qfrc_actuator + data.qfrc_passive + rows.T @ data.efc_force[others]
        work += forces @ rates * HOLD
        driven += data.qfrc_actuator @ rates * HOLD
        opened = max(opened, np.abs(data.efc_pos[:data.ne]).max(initial=0.0))
    mujoco.mj_forward(model, data)
    return data.time, used, opened, data.energy.sum() - start - work, driven


def main(arguments=None):
    """Run the comparison."""
    parser = parser_of(__doc__)
    parser.add_argument('file', type=Path, metavar='FILE', help='in MJCF, with motors')
    file = parser.parse_args(arguments).file
    warnings.simplefilter('ignore')
    stops, rows, reasons = f'end stops of {STOPS:g} N m/rad', [], []
    for name, stiffness, method in (
            ('auto, without limits', None, {}), (f'auto, {stops}', STOPS, {}),
            (f'rk4, {stops}', STOPS, {'integrator': 'rk4'})):
        row, why = run_ours(file, stiffness, **method)
        rows.append((name, row))
        if why:
            reasons.append(f'{name}: {why}')
    for name, limits in (('MuJoCo, without limits', False), ('MuJoCo, its soft limits', True)):
        rows.append((name, run_mujoco(file, limits)))
    print(f'{description()}\n\n' + markdown_table(
        ('run', 'comes to [s]', 'CPU per simulated second', 'loops open by [m, rad]',
         'energy error [J]', 'work of the drives [J]'),
        [(name, f'{reached:.3g}', seconds(used / max(reached, HOLD)), f'{opened:.0e}',
          f'{error:.0e}', f'{work:.3g}') for name, (reached, used, opened, error, work) in rows]))
    for reason in reasons:
        print(f'\n{reason}')
    return 0


if __name__ == '__main__':
    sys.exit(main())
