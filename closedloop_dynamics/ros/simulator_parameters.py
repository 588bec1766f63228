# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Parameters of the simulator node."""

from dataclasses import replace

from closedloop_dynamics.ros.pacing import AS_FAST_AS_POSSIBLE, LOCKSTEP, REALTIME
from closedloop_dynamics.ros.parameters import ALLOW_CODE, Parameter
from closedloop_dynamics.scene.integrators import INTEGRATORS, STABILISATIONS

METHOD = ('integrator', 'step_size', 'stabilisation', 'accuracy', 'budget')

SIMULATOR_PARAMETERS = (
    Parameter(
        'scene', 'three_rrr',
        'What to simulate: the name of a shipped scene, or the path of a scene file.'),
    ALLOW_CODE,
    Parameter(
        'mode', REALTIME,
        'realtime: simulated time follows the steady clock. as_fast_as_possible: it runs as fast '
        'as can be computed and received. lockstep: it advances by one publishing period for '
        'each command.', choices=(REALTIME, AS_FAST_AS_POSSIBLE, LOCKSTEP)),
    Parameter(
        'publish_rate', 100.0,
        'States and constraint forces published per second [Hz], of simulated time in the modes '
        'as_fast_as_possible and lockstep; a command takes effect within one period.',
        (0.1, 10000.0), read_only=False),
    Parameter(
        'step_size', 0.0,
        "Step of the time integration [s]; 0: the scene's own.", (0.0, 0.1), read_only=False),
    Parameter(
        'integrator', '',
        "Method of the time integration; empty: the scene's own.",
        choices=('', *INTEGRATORS), read_only=False),
    Parameter(
        'stabilisation', '',
        "How the loops are kept closed; empty: the scene's own.",
        choices=('', *STABILISATIONS), read_only=False),
    Parameter(
        'accuracy', 0.0,
        'Error of positions within a second that integrator auto keeps [rad or m]; 0: the '
        "scene's own.", (0.0, 1.0), read_only=False),
    Parameter(
        'budget', 0.0,
        'Share of a period that computing may take [1]: integrator auto keeps the best accuracy '
        "that this allows, finer or coarser than accuracy; 0: the scene's own, if it has one.",
        (0.0, 1.0), read_only=False),
    Parameter(
        'real_time_factor', 1.0,
        'Simulated seconds per second of the steady clock [1], in the mode realtime.',
        (0.001, 1000.0), read_only=False),
    Parameter(
        'command_timeout', 0.0,
        'Torques fall to zero when no command arrived, or the last one acted, for so long '
        '[s of the steady clock], also in time that is made up for; '
        '0: the last command holds for ever. Not in the mode lockstep.', (0.0, 3600.0),
        read_only=False),
    Parameter(
        'wait_for_command', False,
        'Keep the initial state, and publish it, until the first command arrives; otherwise a '
        'machine with weight falls while its controller is starting.'),
    Parameter(
        'wait_for_subscribers', 0,
        'Keep the initial state, and publish it, until so many have subscribed to joint_states '
        '[1], so that a recorder misses no motion; 0: begin at once.', (0, 100)),
    Parameter(
        'motion_joints', [''],
        'Joints whose motion follows motion_command, beside those of the scene; they take no '
        'torques.'),
    Parameter(
        'publish_clock', False,
        'Publish simulated time on /clock, from one publishing period on, and stamp all messages '
        'with it.'),
    Parameter(
        'keep_core_awake', False,
        'Stay on one core and use up its spare time, at a priority that gives way to everything, '
        'while time runs: for even periods where cores take long to wake up, as in virtual '
        'machines.', read_only=False),
    Parameter(
        'scheduling_priority', 0,
        'Priority among real-time processes (SCHED_FIFO), before all others; 0: none. The '
        'user must be allowed to (ulimit -r).', (0, 99)),
    Parameter(
        'step_count', 1,
        'Steps of the time integration that the service ~/step advances by [1].', (1, 100000),
        read_only=False),
)
CHANGEABLE = {
    parameter.name: parameter for parameter in SIMULATOR_PARAMETERS if not parameter.read_only}


def method_changes(values, own, used):
    """
    Return the changes of the method in use by values of parameters, by key.

    The scene's ``own`` method holds where a value is left empty. Raises ValueError where there can
    be no such method, or a value means nothing to it.
    """
    wanted = {key: values[key] or getattr(own, key) for key in METHOD}
    # Refuses impossible values.
    method = replace(used, **wanted)
    for key, need in method.unused.items():
        if values.get(key):
            raise ValueError(f'{key}: expected {need} with it, got integrator: '
                             f'{method.integrator}')
    return {key: value for key, value in wanted.items() if value != getattr(used, key)}
