# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop forces``: the torques and forces that a recorded motion takes."""

from contextlib import contextmanager
import csv
from pathlib import Path

import numpy as np

from .command import (
    Argument, Command, complain, measured_options, OVERWRITE, require_free, SET, UsageError,
    with_numbers)
from ..mechanism.errors import SimulationError
from ..recording.errors import BagReadError, RecordingError
from ..recording.forces import ForceBag, forces_along, measured_positions
from ..recording.run import headings, row
from ..scene.loading import load_scene
from ..simulation.simulation import Simulation
from ..visual.progress import announced, progress_to
from ..visual.trajectory import magnitudes


def _run(arguments):
    if arguments.output.suffix != '.csv' and arguments.output.exists():
        raise UsageError(f'--output: {arguments.output} exists; name another bag')
    require_free(arguments, arguments.output)
    scene = with_numbers(load_scene(arguments.scene), arguments)
    mechanism = scene.mechanism
    joints = arguments.joints or [
        name for name in mechanism.actuated_joints if name in mechanism.coordinates.names]
    with announced('Reading and compiling ...'):
        try:
            stamps, positions = measured_positions(arguments.bag, arguments.topic, joints)
        except (RecordingError, BagReadError) as error:
            raise UsageError(str(error)) from None
        simulation = Simulation.from_scene(scene)
    times = 1e-9 * np.array([stamp - stamps[0] for stamp in stamps])
    largest = _Largest(simulation)
    with _opened(arguments, simulation) as write, progress_to(
            times[-1], 's', simulation.scene.name) as show:
        try:
            for k in forces_along(simulation, joints, times, positions, arguments.deviation):
                write(stamps[k], float(times[k]))
                largest.sample()
                show(times[k])
        except SimulationError as error:
            return complain(
                arguments, f'at {times[largest.count]:.6g} s of the recording: {error}')
        except ValueError as error:
            raise UsageError(f'--joints: {error}') from None
    print(f'{arguments.bag}: {len(times)} states of {simulation.scene.name}, {times[-1]:.6g} s, '
          f'from {", ".join(joints)}\n{largest}\nforces in {arguments.output}')
    return 0


@contextmanager
def _opened(arguments, simulation):
    """Yield a function that writes the present state, with a stamp [ns] and a time [s]."""
    if arguments.output.suffix != '.csv':
        with ForceBag(arguments.output, simulation) as bag:
            yield lambda stamp, time: bag.write(stamp)
        return
    with open(arguments.output, 'w', newline='', encoding='utf-8') as file:
        writer = csv.writer(file)
        writer.writerow(headings(simulation, True))
        yield lambda stamp, time: writer.writerow(map(repr, row(simulation, time, True)))


class _Largest:
    """The largest torques and forces of a motion, as text."""

    def __init__(self, simulation):
        self._simulation, self.count = simulation, 0
        self._torque = np.zeros(len(simulation.actuated_joints))
        self._force = np.zeros(len(simulation.mechanism.cut_joints))

    def sample(self):
        """Add the present state."""
        simulation = self._simulation
        self.count += 1
        np.maximum(self._torque, np.abs(simulation.data.system.tau[simulation.data.actuated]),
                   out=self._torque)
        np.maximum(self._force, magnitudes(simulation.constraint_forces), out=self._force)

    def __str__(self):
        """Return a line for each joint."""
        simulation = self._simulation
        return '\n'.join([
            *(f'  {name}: at most {value:.4g} N m or N' for name, value in zip(
                simulation.actuated_joints, self._torque)),
            *(f'  {cut.name}: force of at most {value:.4g} N' for cut, value in zip(
                simulation.mechanism.cut_joints, self._force))])


COMMAND = Command(
    name='forces',
    summary='compute the torques and joint forces of a recorded motion',
    description="""\
Read the positions of some joints from a bag (those that a robot measures), find the whole
motion that closes the loops, and the torques and forces that it takes by the model of a
scene: inverse dynamics, state by state, with all the effects of the scene. Rates and
accelerations are those of splines through the positions; measured ones are noisy, and
accelerations more so: give their --deviation. A motion that touches a singular position is
refused, as the other joints do not follow from the measured ones there.
""",
    examples=(
        'forces my_bag --scene three_rrr --output forces.csv',
        'forces robot_bag --scene delta_robot --deviation 1e-4 --output forces_bag'),
    arguments=(
        Argument('bag', metavar='BAG', help='directory of the bag, or one of its files'),
        Argument('--scene', metavar='SCENE', required=True,
                 help='the mechanism with its masses: a shipped scene by its name, or a YAML '
                      'file'),
        SET,
        Argument('--topic', metavar='NAME', default='/joint_states',
                 help='whose positions are taken (default: /joint_states)'),
        *measured_options('the actuated ones',
                          'accelerations are those of splines as smooth as it allows (default: 0, '
                          'through all of them)'),
        Argument('--output', metavar='BAG_OR_CSV', type=Path, required=True,
                 help='a new bag with joint_states, constraint_forces/CUT and '
                      'joint_forces/JOINT, or a file *.csv with the same'),
        OVERWRITE),
    run=_run)
