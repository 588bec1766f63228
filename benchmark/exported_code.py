# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What a step of the C that ``closedloop export`` writes costs, beside one of the engine.

Both make the same steps of RK4 with projection from the start of a scene, in turn, in one thread
of one process; the C with the options that doc/export.md gives, for any machine and for this one.
"""

import argparse
import ctypes
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory
import time

from machine import ROOT
import numpy as np

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.simulation.c_source import c_source  # noqa: E402,I100
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from closedloop_dynamics.visual.tables import markdown_table  # noqa: E402

SCENES = ('four_bar', 'slider_crank', 'carpet_scraper', 'three_rrr', 'rssr_four_bar',
          'stewart_platform')
COMMON = ('-std=c99', '-O3', '-ffp-contract=fast', '-fPIC', '-shared')
MACHINES = {'any machine': (), 'this machine': ('-march=native',)}
STEP, STEPS, ROUNDS = 1e-3, 2000, 15
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


def compiled(simulation, folder, options):
    """Return a function that makes steps, and the bytes of the state that it starts from."""
    for name, text in zip(('machine.c', 'machine.h', 'many.c'),
                          (*c_source(simulation, 'machine'), MANY)):
        (folder / name).write_text(text)
    out = folder / f'{abs(hash(options))}.so'
    subprocess.run(['cc', *COMMON, *options, '-o', out, folder / 'machine.c', folder / 'many.c',
                    '-lm'], check=True)
    library = ctypes.CDLL(str(out))
    size = 8 * (len(simulation.position) + len(simulation.velocity))
    return library.many, bytes((ctypes.c_char * size).in_dll(library, 'machine_start'))


def measured(scene, rounds=ROUNDS, steps=STEPS):
    """
    Return the CPU time of a step of the engine, and of the C by machine [s].

    Raises
    ------
    RuntimeError
        Where a step of the C fails, or where it leads elsewhere.

    """
    simulation = Simulation.from_scene(scene, integrator='rk4', step_size=STEP)
    simulation.stepping.monitor.sampling = False
    tau = np.zeros(len(simulation.torque_names))
    with TemporaryDirectory() as folder:
        codes = {name: compiled(simulation, Path(folder), options)
                 for name, options in MACHINES.items()}
        times = {name: [] for name in ('engine', *codes)}
        for _ in range(rounds):
            for name, (many, start) in codes.items():
                state = ctypes.create_string_buffer(start, len(start))
                begin = time.process_time()
                status = many(state, ctypes.c_void_p(tau.ctypes.data), steps)
                times[name].append((time.process_time() - begin) / steps)
                if status:
                    raise RuntimeError(f'{scene}: the C stopped with status {status}')
            simulation.reset()
            begin = time.process_time()
            simulation.advance(tau, steps)
            times['engine'].append((time.process_time() - begin) / steps)
            apart = np.abs(np.frombuffer(state.raw)[:len(simulation.position)]
                           - simulation.position).max()
            if not apart < 1e-6:
                raise RuntimeError(f'{scene}: the C is {apart:.3g} rad or m apart')
    return {name: min(each) for name, each in times.items()}


def main(arguments=None):
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('scenes', nargs='*', default=SCENES, help='default: %(default)s')
    parser.add_argument('--quick', action='store_true', help='fewer steps')
    options = parser.parse_args(arguments)
    rows = []
    for scene in options.scenes:
        found = measured(scene, *((2, 200) if options.quick else ()))
        engine = found.pop('engine')
        rows.append([f'`{scene}`', f'{1e6 * engine:.3g}', *(
            f'{1e6 * each:.3g} ({each / engine:.2f})' for each in found.values())])
    print(markdown_table(
        ('scene', 'engine [us]', *(f'C, for {name} [us]' for name in MACHINES)), rows))
    return 0


if __name__ == '__main__':
    sys.exit(main())
