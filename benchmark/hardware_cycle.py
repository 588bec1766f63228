# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
What a cycle of the hardware interface of ros2_control costs, without ROS.

    python benchmark/hardware_cycle.py                    (from the checkout)

Wall clock time of cycles of 1 ms, one step each, of the small loop that the tests drive, too: all
driven joints under efforts of 0, or held by servos. States and commands of ros2_control's handles
are not in it.
"""

import argparse
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory

from machine import ROOT

sys.path.insert(0, str(ROOT))

from closedloop_dynamics.engine import build  # noqa: E402,I100
from closedloop_dynamics.simulation.c_source import c_source  # noqa: E402
from closedloop_dynamics.simulation.simulation import Simulation  # noqa: E402
from closedloop_dynamics.visual.tables import markdown_table  # noqa: E402

PACKAGE = ROOT / 'closedloop_hardware'
SCENES = ('four_bar', 'three_rrr', 'stewart_platform')
OPTIONS = ('-std=c99', '-O3', '-ffp-contract=fast', '-march=native')
PERIOD, CYCLES = 1e-3, 20_000


def measured(program, scene, folder, cycles):
    """
    Return times of a cycle: median, 99 % and most under efforts, then with servos [s].

    Raises
    ------
    RuntimeError
        Where a cycle fails.

    """
    simulation = Simulation.from_scene(scene, integrator='rk4', step_size=PERIOD)
    for name, text in zip(('machine.c', 'machine.h'), c_source(simulation, 'machine')):
        (folder / name).write_text(text)
    model = folder / 'machine.so'
    subprocess.run(['cc', *OPTIONS, '-fPIC', '-shared', '-o', model, folder / 'machine.c', '-lm'],
                   check=True)
    times = []
    for kind in ('effort', 'position'):
        commands = ' '.join(f'{joint} {kind}' for joint in simulation.actuated_joints)
        orders = f'commands {commands}\ntimed {PERIOD} {cycles}\n'
        done = subprocess.run([program, model, str(PERIOD), '100'], input=orders, text=True,
                              capture_output=True, check=True)
        good, _, *found = done.stdout.splitlines()[-1].split(maxsplit=5)
        if good != '1':
            raise RuntimeError(f'{scene}, {kind}: {done.stdout}')
        times += map(float, found)
    return times


def main(arguments=None):
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('scenes', nargs='*', default=SCENES, help='which are measured')
    parser.add_argument('--quick', action='store_true', help='few cycles')
    options = parser.parse_args(arguments)
    with TemporaryDirectory() as folder:
        folder = Path(folder)
        program = folder / 'loop'
        subprocess.run([*build.compiler(), '-std=c++17', '-O2', '-DNDEBUG',
                        '-I', PACKAGE / 'include', '-isystem', build.eigen(),
                        PACKAGE / 'src' / 'mechanism.cpp', PACKAGE / 'test' / 'loop.cpp', '-ldl',
                        '-o', program], check=True)
        rows = [[f'`{scene}`', *(f'{1e6 * time:.1f}' for time in measured(
            program, scene, folder, 100 if options.quick else CYCLES))]
            for scene in options.scenes]
    print(markdown_table(
        ['a cycle [us]', 'efforts: median', '99 %', 'most', 'servos: median', '99 %', 'most'],
        rows))
    return 0


if __name__ == '__main__':
    sys.exit(main())
