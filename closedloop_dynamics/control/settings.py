# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The settings of controllers; it needs no numerics, so that launch files can list them."""

from typing import Any, NamedTuple, Optional, Tuple

# Modes that answer states.
IMPEDANCE = 'impedance'
LINEAR_REGULATOR, PREDICTIVE = 'linear_regulator', 'predictive'
OPTIMAL_MODES = LINEAR_REGULATOR, PREDICTIVE
# Those with the model of a scene.
MODEL_MODES = ('computed_torque', IMPEDANCE, *OPTIMAL_MODES)
FEEDBACK_MODES = ('pd', *MODEL_MODES)
_PER_JOINT = 'One value for all joints, or one per joint.'


class Setting(NamedTuple):
    """
    A setting of a controller; at a node a parameter.

    ``default`` has the type of the setting; the description has the unit; ``limits`` are the
    smallest and largest value of a number, ``choices`` the words there are (empty: any);
    ``read_only``: it stays as it is while the controller runs.
    """

    name: str
    default: Any
    description: str
    limits: Optional[Tuple[float, float]] = None
    choices: Tuple[str, ...] = ()
    read_only: bool = True


SETTINGS = (
    Setting(
        'mode', 'constant',
        'constant: the torque given. sine: a wave about it. pd: torques that lead the joints '
        'along a reference, from joint_states. computed_torque: the same through the model of '
        'a scene. impedance: a point is held by springs and dampers, through the model. '
        'linear_regulator: a pose or path is kept to at the least cost. predictive: likewise '
        'within the limits of the torques, as predicted over a horizon.',
        choices=('constant', 'sine', *FEEDBACK_MODES)),
    Setting(
        'scene', '',
        'computed_torque, impedance, linear_regulator, predictive: the scene simulated, by name '
        'or path. In computed_torque the gains kp [1/s^2], kd [1/s], ki [1/s^3 or 1/s^2] ask for '
        'accelerations.'),
    Setting(
        'joints', [''],
        'Joints to drive, by name, through joint_command. Not given: all actuated joints, in '
        'the order the simulator (modes with a scene: the scene) gives, through torque_command.'),
    Setting(
        'simulator', 'closedloop_simulator',
        'Name of the simulator node to ask for its actuated_joints, relative to the namespace.'),
    Setting(
        'wait_for_subscribers', 1,
        'Begin when so many have subscribed to the command [1], so that nobody misses the first '
        'one; 0: at once.', (0, 100)),
    Setting(
        'rate', 100.0, 'Commands per second of constant and sine [Hz]; the others send one for '
        'each state received.', (0.1, 2000.0)),
    Setting('torque', [0.0], f'constant, and the mean of sine [N m or N]. {_PER_JOINT}',
            read_only=False),
    Setting('amplitude', [1.0], f'sine: amplitude [N m or N]. {_PER_JOINT}',
            read_only=False),
    Setting('frequency', [1.0], f'sine: frequency [Hz]. {_PER_JOINT}',
            read_only=False),
    Setting('phase', [0.0], f'sine: phase at the first command [rad]. {_PER_JOINT}',
            read_only=False),
    Setting('kp', [0.0], f'pd: gain of the position error [N m/rad or N/m]; 0: the speed '
            f'is controlled, not the position. {_PER_JOINT}',
            read_only=False),
    Setting('kd', [0.0], f'pd: gain of the velocity error [N m s/rad or N s/m]. {_PER_JOINT}',
            read_only=False),
    Setting('ki', [0.0], 'pd: gain of the integral of the position error [N m/(rad s)], of a '
            f'joint with kp = 0 of the velocity error [N m/rad]. {_PER_JOINT}',
            read_only=False),
    Setting('target_position', [float('nan')], 'pd: where the reference begins [rad or m]; '
            'nan: where the joint is when the first state arrives. linear_regulator, predictive: '
            f'the pose; nan: where the joint is when the scene begins. {_PER_JOINT}'),
    Setting('target_velocity', [0.0],
            f'pd: velocity of the reference [rad/s or m/s]. {_PER_JOINT}'),
    Setting('move_amplitude', [0.0], 'pd: amplitude of a sinusoidal motion of the reference '
            f'[rad or m]. {_PER_JOINT}'),
    Setting('move_frequency', [0.25], f'pd: its frequency [Hz]. {_PER_JOINT}'),
    Setting('move_phase', [0.0], 'pd: its phase [rad]; the reference begins at '
            f'target_position whatever the phase. {_PER_JOINT}'),
    Setting('circle_point', '', 'computed_torque: named point that goes round a circle, from '
            'rest where the scene begins, its body keeping its angle; in place of target_* and '
            'move_*. The mechanism needs two or three degrees of freedom, in space three or '
            'six.'),
    Setting('circle_radius', 0.1, 'Radius of the circle [m].', (1e-6, 1e3)),
    Setting('circle_frequency', 0.25, 'Turns per second, after the first one [Hz].',
            (1e-6, 1e3)),
    Setting('circle_phase', 0.0, 'Where on the circle the point begins, seen from its centre '
            '[rad].', (-10.0, 10.0)),
    Setting('circle_tilt', 0.0, 'Angle of the cone that the axes of the body go round with the '
            'point, from where they begin [rad]; in space, with six degrees of freedom.',
            (-1.0, 1.0)),
    Setting('path_point', '', 'computed_torque, linear_regulator, predictive: named point that '
            'goes straight from place to place, from rest to rest, and back to where the scene '
            'begins, again and again; in place of target_*, move_* and circle_*.'),
    Setting('path_places', [0.0], 'The places, one after the other, seen from where it begins '
            '[m]: x, y, in space x, y, z of each.'),
    Setting('path_durations', [1.0], 'Of the way to each place, and back [s].'),
    Setting('impedance_point', '', 'impedance: named point that springs and dampers hold, with '
            'its body, where the scene begins.'),
    Setting('stiffness', [0.0], 'impedance: of the springs along x and y [N/m] and about z '
            '[N m/rad], in space along, then about x, y and z of the world. One value for all, '
            'or one per direction.', read_only=False),
    Setting('damping', [0.0], 'impedance: of the dampers [N s/m, N m s/rad], as stiffness.',
            read_only=False),
    Setting('period', 0.01, 'linear_regulator: between two states; predictive: of the prediction, '
            'at least that between two states [s]. Torques are held for it.', (1e-5, 10.0)),
    Setting('horizon', 5, 'predictive: how many periods are looked ahead [1].', (1, 1000)),
    Setting('state_cost', [1.0, 0.0], 'linear_regulator, predictive: weights of the squared '
            'errors of the independent coordinates, then of their rates: two values, or one for '
            'each.'),
    Setting('torque_cost', [1.0], 'linear_regulator, predictive: weights of the squared '
            f'differences of the torques to those of the reference. {_PER_JOINT}'),
    Setting('feedforward', [0.0],
            f'pd, computed_torque, impedance: torque added always [N m or N]. {_PER_JOINT}',
            read_only=False),
    Setting('torque_limit', [0.0],
            'Modes that answer states: largest magnitude of the torque [N m or N]; 0: '
            "that of the joint's actuator in the scene, else none. "
            f'{_PER_JOINT}', read_only=False),
)
