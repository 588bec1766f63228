# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What a step of the C that ``closedloop export`` writes costs, beside one of the engine.

Both make the same steps of RK4 with projection from the start of a scene, in turn, in one thread
of one process; the C with the options that doc/export.md gives, for any machine and for this one.

With ``--cycles``: what a cycle of the hardware interface of ros2_control costs, without ROS. Wall
clock time of cycles of 1 ms, one step each, of the small loop that the tests drive, too: all
driven joints under efforts of 0, or held by servos. States and commands of ros2_control's handles
are not in it.
"""

import ctypes
from functools import partial
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory

from closedloop_dynamics.engine import build
from closedloop_dynamics.export.c_source import c_source
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.visual.tables import markdown_table
from machine import least, parser_of, ROOT
import numpy as np

PACKAGE = ROOT / 'closedloop_hardware'
SCENES = ('four_bar', 'slider_crank', 'carpet_scraper', 'three_rrr', 'rssr_four_bar',
          'stewart_platform')
MACHINES = {'any machine': (), 'this machine': ('-march=native',)}
STEP, STEPS, ROUNDS, CYCLES = 1e-3, 2000, 15, 20_000
MANY = """\
#include "machine.h"
int many(machine_state *state, const double *tau, int steps)
{
  for (int step = 0; step < steps; ++step) {
    const int status = machine_step(&machine_default, state, tau, 1e-3);
    if (status != 0) {return status;}
  }
  return 0;
}
"""


def compiled(simulation, folder, options, more=()):
    """Return the path of a library of the C of a simulation, and of ``more`` files."""
    folder.mkdir(parents=True)
    for name, text in zip(('machine.c', 'machine.h', 'many.c'),
                          (*c_source(simulation, 'machine'), MANY)):
        (folder / name).write_text(text)
    out = folder / 'machine.so'
    subprocess.run(['cc', '-std=c99', '-O3', '-ffp-contract=fast', '-fPIC', '-shared', *options,
                    '-o', out, folder / 'machine.c', *more, '-lm'], check=True)
    return out


def measured(simulation, folder, quick):
    """
    Return the CPU time of a step of the engine, and of the C by machine [s].

    Raises
    ------
    RuntimeError
        Where a step of the C fails, or where it leads elsewhere.

    """
    simulation.stepping.monitor.sampling = False
    tau, steps = np.zeros(len(simulation.torque_names)), 200 if quick else STEPS
    libraries = {
        name: ctypes.CDLL(str(compiled(
            simulation, folder / name, options, [folder / name / 'many.c'])))
        for name, options in MACHINES.items()}
    size, ends = 8 * (len(simulation.position) + len(simulation.velocity)), {}

    def of_c(name):
        state = (ctypes.c_char * size).from_buffer_copy(
            (ctypes.c_char * size).in_dll(libraries[name], 'machine_start'))
        if status := libraries[name].many(state, ctypes.c_void_p(tau.ctypes.data), steps):
            raise RuntimeError(f'the C stopped with status {status}')
        ends[name] = np.frombuffer(state)[:len(simulation.position)]

    def of_engine():
        simulation.reset()
        simulation.advance(tau, steps)

    times = least({'engine': of_engine, **{name: partial(of_c, name) for name in libraries}},
                  2 if quick else ROUNDS)
    for name, end in ends.items():
        apart = np.abs(end - simulation.position).max()
        if not apart < 1e-6:
            raise RuntimeError(f'the C for {name} is {apart:.3g} rad or m apart')
    return {name: each / steps for name, each in times.items()}


def cycles(program, simulation, folder, quick):
    """
    Return times of a cycle: median, 99 % and most under efforts, then with servos [s].

    Raises
    ------
    RuntimeError
        Where a cycle fails.

    """
    model, times = compiled(simulation, folder, MACHINES['this machine']), []
    for kind in ('effort', 'position'):
        commands = ' '.join(f'{joint} {kind}' for joint in simulation.actuated_joints)
        orders = f'commands {commands}\ntimed {STEP} {100 if quick else CYCLES}\n'
        done = subprocess.run([program, model, str(STEP), '100'], input=orders, text=True,
                              capture_output=True, check=True)
        good, _, *found = done.stdout.splitlines()[-1].split(maxsplit=5)
        if good != '1':
            raise RuntimeError(f'{kind}: {done.stdout}')
        times += map(float, found)
    return times


def main(arguments=None):
    """Measure, and print a table."""
    parser = parser_of(__doc__, 'fewer steps', scenes=SCENES)
    parser.add_argument('--cycles', action='store_true', help='of the hardware interface')
    options = parser.parse_args(arguments)
    rows = []
    with TemporaryDirectory() as folder:
        folder = Path(folder)
        if options.cycles:
            subprocess.run([*build.compiler(), '-std=c++17', '-O2', '-DNDEBUG',
                            '-I', PACKAGE / 'include', '-isystem', build.eigen(),
                            PACKAGE / 'src' / 'mechanism.cpp', PACKAGE / 'test' / 'loop.cpp',
                            '-ldl', '-o', folder / 'loop'], check=True)
        for scene in options.scenes:
            simulation = Simulation.from_scene(scene, integrator='rk4', step_size=STEP)
            if options.cycles:
                cells = [f'{1e6 * time:.1f}' for time in cycles(
                    folder / 'loop', simulation, folder / scene, options.quick)]
            else:
                engine, *others = measured(simulation, folder / scene, options.quick).values()
                cells = [f'{1e6 * engine:.3g}', *(
                    f'{1e6 * each:.3g} ({each / engine:.2f})' for each in others)]
            rows.append([f'`{scene}`', *cells])
    print(markdown_table(
        ['a cycle [us]', 'efforts: median', '99 %', 'most', 'servos: median', '99 %', 'most']
        if options.cycles else
        ['scene', 'engine [us]', *(f'C, for {name} [us]' for name in MACHINES)], rows))
    return 0


if __name__ == '__main__':
    sys.exit(main())
