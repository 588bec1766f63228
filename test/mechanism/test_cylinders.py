# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Rods of variable length as one element: driven by length and by force, against closed forms."""

import math

from closedloop_dynamics import load_scene, MechanismError, read_mechanism, Simulation
from closedloop_dynamics.mechanism.reader import with_parameters
from closedloop_dynamics.view.editing import Editor
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
import yaml

# A boom on a pivot, lifted by a cylinder between the ground and its middle.
MECHANISM = """\
name: crane
parameters: {l: 0.4}
bodies:
  boom: {mass: 3.0, center_of_mass: [l, 0], inertia: 0.2}
joints:
  pivot: {type: revolute, parent: ground, child: boom, position: [0, 0]}
cylinders:
  lift: {between: [ground, boom], points: [[300 mm, 0], [l, 0]], mass: 1.5, length: 20 cm%s}
points:
  tip: {body: boom, position: [0.8, 0]}
"""
IN_SPACE = """\
name: crane
parameters: {l: 0.4}
bodies:
  boom: {mass: 3.0, center_of_mass: [l, 0, 0], inertia: [0.2, 0.2, 0.2]}
joints:
  pivot: {type: revolute, parent: ground, child: boom, position: [0, 0, 0], axis: [0, 0, 1]}
cylinders:
  lift: {between: [ground, boom], points: [[300 mm, 0, 0], [l, 0, 0]], mass: 1.5, length: 20 cm,
         axis: [1, 2, 0]%s}
points:
  tip: {body: boom, position: [0.8, 0, 0]}
"""
# A mast on a ball, held and moved by two cylinders and a third one on it.
MAST = """\
name: mast
bodies:
  mast: {mass: 4.0, center_of_mass: [0, 0, 0.5], inertia: [0.3, 0.3, 0.02]}
joints:
  ball: {type: universal, parent: ground, child: mast, position: [0, 0, 0], axis: [1, 0, 0],
         second_axis: [0, 1, 0]}
cylinders:
  left: {between: [ground, mast], points: [[0.5, 0.2, 0], [0, 0.05, 0.6]], mass: 1, length: 0.3,
         axis: [-1, 0, 1], actuated: true}
  right: {between: [mast, ground], points: [[0, 0, 0.7], [-0.1, 0.6, 0.1]], mass: 1.2,
          length: 0.3, axis: [0, 1, -1], actuated: true}
"""
MAST_SCENE = """\
mechanism: ./mast.yaml
initial:
  position: {ball.1: 0.1, ball.2: -0.2, left_foot.1: 0, left_foot.2: 0, left: 0.6,
             right_foot.1: 0, right_foot.2: 0, right: 0.8}
  hold: [ball.1, ball.2]
  velocity: {ball.1: 0.7, ball.2: -0.4}
effects: {gravity: {type: gravity, acceleration: [0, 0, -9.81]}}
"""
SCENE = """\
mechanism: ./crane.yaml
initial: {at: {lift_head: [0, 0.4]}}
effects:
  gravity: {type: gravity, acceleration: [0, -9.81]}
%s
"""


def crane(tmp_path, more='', effects=''):
    (tmp_path / 'crane.yaml').write_text(MECHANISM % more)
    path = tmp_path / 'scene.yaml'
    path.write_text(SCENE % effects)
    return load_scene(path)


def of_length(length):
    """Return the angle of the boom, by the law of cosines."""
    return math.acos((0.3 ** 2 + 0.4 ** 2 - length ** 2) / (2.0 * 0.3 * 0.4))


def test_a_cylinder_has_the_length_that_is_commanded(tmp_path):
    simulation = Simulation(crane(tmp_path, effects=(
        '  drive: {type: prescribed_motion, joint: lift, shape: sine, amplitude: 50 mm, '
        'frequency: 0.5}')))
    names = simulation.coordinates.names
    begun = dict(zip(names, simulation.position))
    assert begun['lift'] == pytest.approx(0.5, abs=1e-12)
    for _ in range(4):
        simulation.step(duration=0.2)
        length = 0.5 + 0.05 * math.sin(math.pi * simulation.time)
        now = dict(zip(names, simulation.position))
        assert now['lift'] == pytest.approx(length, abs=1e-10)
        assert now['pivot'] == pytest.approx(of_length(length), abs=1e-9)


def test_the_force_of_a_cylinder_holds_the_boom(tmp_path):
    scene = crane(tmp_path, ', actuated: true')
    simulation = Simulation(scene)
    pose = dict(zip(simulation.coordinates.names, simulation.position))
    # Virtual work: lengthening by dl turns the boom by dl times the slope of the angle.
    step = 1e-6
    slope = (of_length(0.5 + step) - of_length(0.5 - step)) / (2.0 * step)

    def energy(length):
        angle = of_length(length)
        head = [0.4 * math.cos(angle), 0.4 * math.sin(angle)]
        unit = [(head[0] - 0.3) / length, head[1] / length]
        # Boom, barrel and rod, whose centres are 0.1 m from their pins.
        return 9.81 * (3.0 * 0.4 * math.sin(angle) + 0.75 * 0.1 * unit[1]
                       + 0.75 * (head[1] - 0.1 * unit[1]))

    assert pose['pivot'] == pytest.approx(of_length(0.5)) and slope > 0.0
    force = (energy(0.5 + step) - energy(0.5 - step)) / (2.0 * step)
    simulation.step([force], duration=0.2)
    after = dict(zip(simulation.coordinates.names, simulation.position))
    assert after['lift'] == pytest.approx(0.5, abs=1e-6)


@pytest.mark.parametrize('kind', ['prescribed_motion', 'prescribed_force'])
def test_a_cylinder_in_space_is_that_in_the_plane(kind, tmp_path):
    drive = (f'  drive: {{type: {kind}, joint: lift, shape: sine, amplitude: '
             f'{0.05 if kind == "prescribed_motion" else 20.0}, frequency: 0.5}}')
    one = Simulation(crane(tmp_path, effects=drive))
    (tmp_path / 'crane.yaml').write_text(IN_SPACE % '')
    (tmp_path / 'scene.yaml').write_text((SCENE % drive).replace(
        '[0, 0.4]', '[0, 0.4, 0]').replace('[0, -9.81]', '[0, -9.81, 0]'))
    other = Simulation(load_scene(tmp_path / 'scene.yaml'))
    for _ in range(3):
        for simulation in (one, other):
            simulation.step(duration=0.1)
        for name in ('pivot', 'lift'):
            first, second = (simulation.coordinates.names.index(name)
                             for simulation in (one, other))
            assert one.position[first] == pytest.approx(other.position[second], abs=1e-8)
            assert one.acceleration[first] == pytest.approx(other.acceleration[second], abs=1e-6)
        assert other.energy == pytest.approx(one.energy, abs=1e-7)
    assert abs(other.energy_balance.residual) < 1e-7


def test_cylinders_in_space_are_as_long_as_their_pins_are_apart(tmp_path):
    (tmp_path / 'mast.yaml').write_text(MAST)
    (tmp_path / 'scene.yaml').write_text(MAST_SCENE)
    simulation = Simulation.from_scene(load_scene(tmp_path / 'scene.yaml'), accuracy=1e-9)
    names = simulation.coordinates.names
    assert simulation.data.degrees_of_freedom() == 2
    before = simulation.energy
    for force in (0.0, 15.0):
        simulation.step({'left': force, 'right': -force}, 0.3)
        now = dict(zip(names, simulation.position))
        turn = Rotation.from_euler('XY', [now['ball.1'], now['ball.2']]).as_matrix()
        for name, on_mast, on_ground in (
                ('left', [0, 0.05, 0.6], [0.5, 0.2, 0]), ('right', [0, 0, 0.7], [-0.1, 0.6, 0.1])):
            assert now[name] == pytest.approx(
                np.linalg.norm(turn @ on_mast - on_ground), abs=1e-9)
        if not force:
            assert simulation.energy == pytest.approx(before, abs=1e-7)
    assert abs(simulation.energy_balance.residual) < 1e-7


def test_parameters_and_the_editor_reach_a_mechanism_with_cylinders(tmp_path):
    scene = crane(tmp_path)
    other = with_parameters(scene.mechanism, {'l': 0.5})
    assert other.cut_joint('lift_head').point_b == pytest.approx((0.5, 0.0))
    editor = Editor(scene)
    assert {'pivot', 'lift_foot', 'lift_head'} <= {one['name'] for one in editor.handles()}
    editor.set('mechanism.bodies.boom.mass', 4.0)
    # Both ends of the pin that is dragged follow in the file, and where it is drawn at the start.
    editor.move('joint', 'lift_foot', [0.32, 0.01, 0.0], Simulation(scene).position)
    text, kept = editor.text()
    assert yaml.safe_load(text)['mechanism']['cylinders']['lift']['points'][0] == [0.32, 0.01]
    assert kept and 'cylinders' in yaml.safe_load(text)['mechanism']
    assert editor.scene.mechanism.bodies[0].mass == 4.0


@pytest.mark.parametrize('before, after, words', [
    ('[ground, boom]', '[ground, beam]', 'joints.lift_head.between[0]: expected the name of a'),
    ('[ground, boom]', '[boom, boom]', 'cylinders.lift.between: expected a list of the names'),
    ('mass: 1.5', 'mass: 0', 'cylinders.lift.mass: expected a positive number'),
    ('mass: 1.5, ', '', 'cylinders.lift.mass: expected this required key'),
    ('[l, 0]],', '[l]],', 'cylinders.lift.points[1]: expected a list of 2 finite numbers'),
    ('  lift:', '  pivot:', 'cylinders.pivot: expected a name that leaves pivot free in joints'),
    ('20 cm', '20 cm, axis: [1, 0]', 'cylinders.lift.axis: expected one of the keys'),
    (',\n         axis: [1, 2, 0]', '', 'cylinders.lift.axis: expected this required key'),
    ('axis: [1, 2, 0]', 'axis: [0, 0, 0]', 'cylinders.lift.axis: expected a direction'),
    ('mass: 1.5', 'weight: 1.5', 'one of the keys between, points, mass, length, actuated')])
def test_a_cylinder_that_cannot_be_is_refused(tmp_path, before, after, words):
    text = IN_SPACE % '' if 'axis' in before else MECHANISM % ''
    assert before in text
    path = tmp_path / 'crane.yaml'
    path.write_text(text.replace(before, after))
    with pytest.raises(MechanismError) as caught:
        read_mechanism(path)
    assert words in str(caught.value)
