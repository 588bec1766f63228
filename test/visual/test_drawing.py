# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures show the mechanism where it is, with units, and legends that cover nothing."""

from closedloop_dynamics import read_mechanism, Simulation
from closedloop_dynamics.mechanism import kinematics
from closedloop_dynamics.recording.run import columns, Report, run
from closedloop_dynamics.scene.loading import config_directory
from closedloop_dynamics.visual import pictures, trajectory as motions
from closedloop_dynamics.visual.appearance import outline, sliders
from closedloop_dynamics.visual.drawing import MechanismArtist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
import numpy as np
import pytest

from ..reference import loop_closure as closures

SCENES = ('carpet_scraper', 'four_bar', 'hoeken_pantograph_leg', 'slider_crank', 'three_rrr')
# Of joints that all turn, as those of another one; more of them take longer to draw.
SIMILAR = ('carpet_scraper', 'hoeken_pantograph_leg', 'three_rrr')
# Every kind of joint and cut, on the ground and between bodies; no named point.
EVERYTHING = """
name: everything
bodies:
  arm: {mass: 1.0, center_of_mass: [0.1, 0.0], inertia: 0.01}
  sleeve: {mass: 1.0, center_of_mass: [0.0, 0.0], inertia: 0.01}
  rod: {mass: 1.0, center_of_mass: [0.1, 0.0], inertia: 0.01}
  cart: {mass: 1.0, center_of_mass: [0.0, 0.0], inertia: 0.01}
  plate: {mass: 1.0, center_of_mass: [0.1, 0.1], inertia: 0.01}
joints:
  turn: {type: revolute, parent: ground, child: arm, position: [0.0, 0.0], actuated: true}
  slide: {type: prismatic, parent: arm, child: sleeve, position: [0.1, 0.0]}
  swing: {type: revolute, parent: sleeve, child: rod, position: [0.0, 0.0]}
  drive: {type: prismatic, parent: ground, child: cart, position: [0.5, 0.0], angle: 1.0}
  tilt: {type: revolute, parent: cart, child: plate, position: [0.0, 0.0]}
cut_joints:
  pin: {type: revolute, body_a: rod, point_a: [0.3, 0.0], body_b: plate, point_b: [0.2, 0.0]}
  weld: {type: fixed, body_a: plate, point_a: [0.0, 0.2], body_b: rod, point_b: [0.2, 0.1],
         angle: 0.3}
  slot: {type: prismatic, body_a: ground, point_a: [0.3, 0.3], body_b: rod, point_b: [0.1, 0.0]}
  rail: {type: prismatic, body_a: plate, point_a: [0.1, 0.0], body_b: ground,
         point_b: [0.2, 0.2], angle: 0.5}
"""


def simulated(scene, duration=0.4):
    """Return the motion of a scene under small torques, and its simulation."""
    simulation, rows = Simulation.from_scene(scene), []
    torque = np.full(len(simulation.actuated_joints), 0.05)
    run(simulation, duration, 100, torque, report=Report(), on_row=rows.append)
    return motions.from_rows(simulation.mechanism, columns(simulation), rows), simulation


@pytest.fixture
def everything(tmp_path):
    """Return a made-up motion of the mechanism with every kind of joint."""
    path = tmp_path / 'everything.yaml'
    path.write_text(EVERYTHING)
    mechanism = read_mechanism(path)
    random = np.random.default_rng(5)
    count, joints = 50, len(mechanism.joints)
    return motions.Trajectory(
        mechanism, np.linspace(0.0, 1.0, count), *random.normal(size=(3, count, joints)),
        forces=random.normal(size=(count, len(mechanism.cut_joints), 3)))


@pytest.mark.parametrize('scene', SCENES)
def test_bodies_are_placed_as_the_simulation_places_them(scene):
    motion, simulation = simulated(scene)
    poses = kinematics.body_poses(motion.mechanism, motion.position)
    np.testing.assert_allclose(poses[-1], simulation.body_poses, rtol=0, atol=1e-14)
    for point in motion.mechanism.points:
        place = kinematics.named_point(motion.mechanism, poses, point.name)
        np.testing.assert_allclose(
            place[-1], simulation.point(point.name), rtol=0, atol=1e-14)
    closure = closures.closure(motion.mechanism, motion.position)
    assert closure[-1] == pytest.approx(simulation.closure, abs=1e-15)
    assert closure.max() < 1e-10


def test_closure_sees_every_kind_of_loop(everything):
    poses = kinematics.body_poses(everything.mechanism, everything.position)
    closure = closures.closure(everything.mechanism, everything.position)
    assert closure.shape == (50,)
    rod, plate = (kinematics.pose_of(everything.mechanism, poses, name)
                  for name in ('rod', 'plate'))
    gap = kinematics.world_points(rod, (0.3, 0.0)) - kinematics.world_points(
        plate, (0.2, 0.0))
    angle = plate[:, 2] - rod[:, 2] - 0.3
    rail = kinematics.world_points(plate, (0.1, 0.0)) - (0.2, 0.2)
    across = rail[:, 1] * np.cos(0.5) - rail[:, 0] * np.sin(0.5)
    for error in (gap[:, 0], gap[:, 1], angle, across, plate[:, 2] - 0.5):
        assert np.all(closure >= np.abs(error))


def test_outlines_go_through_what_the_description_places():
    mechanism = read_mechanism(config_directory() / 'mechanisms' / 'three_rrr.yaml')
    corners = {tuple(point) for point in outline(mechanism, 'platform').round(6)}
    assert corners == {(0.0, 0.0), (0.4, 0.0), (0.2, 0.34641)}
    assert outline(mechanism, 'distal_2').tolist() == [[-0.6, 0.0], [0.0, 0.0]]
    mechanism = read_mechanism(config_directory() / 'mechanisms' / 'carpet_scraper.yaml')
    assert outline(mechanism, 'coupler').tolist() == [[-0.1152, 0.0], [0.1152, 0.0]]
    mechanism = read_mechanism(config_directory() / 'mechanisms' / 'slider_crank.yaml')
    assert outline(mechanism, 'slider').tolist() == [[0.0, 0.0]]


def test_bodies_on_slides_are_blocks_whichever_way_the_slide_is_described(everything):
    assert sliders(everything.mechanism) == {'sleeve', 'cart', 'plate'}


def drawn(figure):
    """Draw a figure and return a renderer to measure with."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return canvas.get_renderer()


def legends_of(figure):
    return [*figure.legends, *(axes.get_legend() for axes in figure.axes if axes.get_legend())]


def pictures_of(motion):
    return (pictures.joint_motion(motion, 'motion'),
            pictures.constraint_forces(motion, 'forces'),
            pictures.positions(motion, 'positions'))


def check_picture(figure):
    """Check what makes a picture readable: units, and everything inside and apart."""
    renderer = drawn(figure)
    width, height = figure.canvas.get_width_height()
    for legend in legends_of(figure):
        box = legend.get_window_extent(renderer)
        assert 0 <= box.x0 and box.x1 <= width and 0 <= box.y0 and box.y1 <= height
        for axes in figure.axes:
            assert not box.overlaps(axes.get_window_extent(renderer)), 'a legend covers data'
    shown = [axes for axes in figure.axes if axes.axison]
    assert all('[' in axes.get_ylabel() for axes in shown)
    assert '[' in shown[-1].get_xlabel()


@pytest.mark.parametrize('scene', [
    pytest.param(scene, marks=pytest.mark.slow) if scene in SIMILAR else scene
    for scene in SCENES])
def test_pictures_of_shipped_scenes_are_readable(scene):
    motion, _ = simulated(scene)
    for figure in pictures_of(motion):
        check_picture(figure)


def test_pictures_of_everything_are_readable(everything):
    for figure in pictures_of(everything):
        check_picture(figure)


def test_mechanism_is_drawn_to_scale_and_in_full_view():
    motion, _ = simulated('carpet_scraper')
    figure = pictures.positions(motion, 'scraper')
    axes = figure.axes[0]
    drawn(figure)
    assert axes.get_aspect() == 1.0
    poses = kinematics.body_poses(motion.mechanism, motion.position)
    tool = kinematics.named_point(motion.mechanism, poses, 'tool')
    path = max(axes.get_lines(), key=lambda line: len(line.get_xdata()))
    np.testing.assert_array_equal(path.get_xydata(), tool)
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    assert np.all((tool > (left, low)) & (tool < (right, high)))


def test_force_arrows_start_at_their_cuts_and_share_one_scale():
    motion, _ = simulated('three_rrr')
    poses = kinematics.body_poses(motion.mechanism, motion.position)
    axes = Figure().add_subplot()
    artist = MechanismArtist(axes, motion.mechanism, poses)
    artist.forces(-1, np.array([[0.0, 30.0, 0.0], [0.0, 0.0, -15.0]]), 30.0)
    first, second = axes.texts
    cut_1 = kinematics.world_points(
        kinematics.pose_of(motion.mechanism, poses[-1], 'distal_2'), (-0.6, 0.0))
    assert first.xyann == pytest.approx(cut_1)
    length = first.xy[0] - first.xyann[0]
    assert length > 0.0 and first.xy[1] == pytest.approx(first.xyann[1])
    assert np.subtract(second.xy, second.xyann) == pytest.approx([0.0, -length / 2])


def test_positions_are_spread_and_end_with_the_last():
    motion, _ = simulated('three_rrr', 1.0)
    poses = kinematics.body_poses(motion.mechanism, motion.position)
    chosen = pictures.spread_positions(poses, 5)
    assert chosen == sorted(set(chosen)) and len(chosen) == 5
    assert chosen[-1] == len(poses) - 1


def test_a_mechanism_at_rest_is_drawn_once():
    motion, _ = simulated('four_bar')
    poses = kinematics.body_poses(motion.mechanism, motion.position[:1].repeat(30, axis=0))
    assert pictures.spread_positions(poses, 5) == [29]


def test_turning_joints_are_shown_within_a_turn():
    motion, _ = simulated('four_bar')
    position = motion.position.copy()
    position[:, 0] = np.linspace(0.0, 20.0, len(position))
    turning = motions.Trajectory(motion.mechanism, motion.time, position, motion.velocity,
                                 motion.effort, motion.forces)
    wanted = np.full_like(position, np.nan)
    wanted[:, 0] = 4.7
    figure = pictures.joint_motion(turning, 'turning', (wanted, wanted))
    check_picture(figure)
    line, goal = figure.axes[0].get_lines()
    assert figure.axes[0].get_title(loc='right') == 'within a turn'
    assert np.nanmax(np.abs(line.get_ydata())) <= np.pi
    assert np.nanmax(np.abs(goal.get_ydata())) <= np.pi
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ['wanted']


def test_bands_of_estimates_are_seen_whole_once_they_are_known():
    time = np.linspace(0.0, 1.0, 101)
    deviation = np.where(time < 0.04, 1e3, 0.5)
    figure = pictures.bands({'length [m]': {'low': (time, np.full(101, -3.0), deviation),
                                            'high': (time, np.full(101, 4.0), deviation)}},
                            'time [s]', 'estimates')
    low, high = figure.axes[0].get_ylim()
    # Values and two deviations, with a little room, without what was not known at first.
    assert -5.0 < low < -4.0 and 5.0 < high < 6.0


def test_forces_of_the_whole_run_are_reported_beside_those_of_the_moment():
    motion, _ = simulated('four_bar')
    motion.forces[3, 0] = 0.0, 300.0, 400.0
    legend = pictures.positions(motion, 'forces').legends[0]
    reported = next(text.get_text() for text in legend.get_texts() if 'force' in text.get_text())
    last = np.hypot(*motion.forces[-1, 0, 1:])
    assert f'at {motion.time[-1]:.2f} s: up to {last:.3g} N' in reported
    assert 'whole run up to 500 N' in reported


def test_every_joint_has_a_row_of_its_own():
    motion, _ = simulated('three_rrr')
    figure = pictures.joint_motion(motion, 'joints')
    shown = [axes for axes in figure.axes if axes.axison]
    assert len(shown) == 7 + 7 + 3
    assert all(len(axes.get_lines()) == 1 for axes in shown)


def test_gears_are_drawn_with_their_teeth_and_belts_about_pulleys():
    motion, _ = simulated('planetary_gear', 0.1)
    figure = pictures.positions(motion, 'gears')
    drawn(figure)
    teeth = sorted(len(patch.get_xy()) // 6 for patch in figure.axes[0].patches
                   if len(patch.get_xy()) > 50)
    # In the strong position and in the pale ones: of the ring both edges count.
    assert set(teeth) == {18, 108} and teeth.count(18) == 4 * teeth.count(108)
    axes, ring = figure.axes[0], 0.09
    assert axes.get_xlim()[0] < -ring and axes.get_ylim()[1] > ring
    motion, _ = simulated('geared_five_bar', 0.1)
    figure = pictures.positions(motion, 'belt')
    belt = next(line for line in figure.axes[0].get_lines() if len(line.get_xdata()) == 73)
    x, y = belt.get_xydata().T
    away = np.minimum(np.hypot(x, y) / 0.02, np.hypot(x - 0.4, y) / 0.04)
    np.testing.assert_allclose(away, 1.0, atol=1e-9)
