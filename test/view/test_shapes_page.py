# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Gears, pulleys, cams and guides in a real browser: what a user sees of them."""

from test.view.browser import browser, program

from closedloop_dynamics.mechanism.kinematics import body_poses, poses_in_space
from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.view.columns import motion_columns
from closedloop_dynamics.view.description import describe
from closedloop_dynamics.view.page import recorded_page
import numpy as np
import pytest

pytestmark = pytest.mark.skipif(
    program() is None, reason='no Chromium is installed (Debian: apt install chromium)')
READY = 'typeof page !== "undefined" && Boolean(page.shownRow)'


@pytest.fixture(scope='module')
def open_page():
    with browser() as open_page:
        yield open_page


@pytest.fixture
def played(open_page, tmp_path):
    """Return a function that opens a page with a scene in some positions."""
    tabs = []

    def opened(name, positions, **size):
        scene = load_scene(name)
        columns = motion_columns(scene.mechanism)
        positions = np.array(positions, dtype=float)
        rows = np.zeros((len(positions), columns.width), dtype=np.float32)
        rows[:, :7 * len(scene.mechanism.bodies)] = poses_in_space(body_poses(
            scene.mechanism, positions)).reshape(len(positions), -1)
        path = tmp_path / f'{name}.html'
        path.write_text(recorded_page(name, describe(
            scene.mechanism, columns, scene.effects, mode='recording', title=name),
            np.arange(len(positions), dtype=float), rows))
        tab = open_page(path.as_uri(), **size)
        tabs.append(tab)
        tab.wait(READY)
        show(tab, 0)
        # It may have moved on before, and guides are as long as what has slid in them was seen to.
        tab.ask('page.picture.guides.begin()')
        show(tab, 0)
        # Nothing but the machine.
        tab.ask("""page.picture.shown = {forces: false, names: false, path: false, paths: false};
            page.picture.touched = true""")
        return tab

    yield opened
    for tab in tabs:
        assert not tab.errors
        tab.close()


def show(tab, row):
    """Let a page show one of its rows."""
    tab.ask(f"""page.playing = false; page.now = {row};
        new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))""")


def colors(tab, places):
    """Return what is seen at places in the world, shape (n, 3)."""
    seen = tab.picture().astype(int)
    pixels = tab.ask(f"""(() => {{
        const box = document.getElementById("solid").getBoundingClientRect();
        return {np.asarray(places).tolist()}.map((place) => {{
          const [x, y] = page.picture.project(place);
          return [Math.floor(x + box.x), Math.floor(y + box.y)]; }}); }})()""")
    return np.array([seen[y, x] for x, y in pixels])


def on_circle(radius, count, height):
    angles = 2.0 * np.pi * np.arange(count) / count
    return np.column_stack([radius * np.cos(angles), radius * np.sin(angles),
                            np.full(count, height)])


def painted(seen):
    """Return which colours are not grey: those of bodies."""
    return np.ptp(seen, axis=-1) > 40


def test_a_ring_has_teeth_as_its_ratio_says_and_they_turn(played):
    half = np.pi / 54.0
    turned = [half, half, half, 0.0, 0.0, 0.0]
    tab = played('planetary_gear', [np.zeros(6), turned], width=1900, height=1700)
    # Between the roots of its teeth and the tips of the planets, at the upper side of the wheels.
    height = tab.ask('page.scene.bodies[1].shapes[0].origin[2]')
    places = on_circle(0.0937, 54 * 8, height)
    before = painted(colors(tab, places))
    assert np.sum(before != np.roll(before, 1)) == 2 * 54
    show(tab, 1)
    after = painted(colors(tab, places))
    assert np.sum(after != np.roll(after, 1)) == 2 * 54
    # By half a pitch: gaps are where teeth were.
    assert np.mean(before == after) < 0.4
    # Eighteen of each planet and the sun, thrice as many of the ring.
    assert tab.ask("""page.scene.bodies.map(({shapes}) => (
        shapes.filter(({kind}) => kind === 'profile').map(({outline}) => outline.length / 6)))
        .flat()""") == [18, 54, 18, 18, 18]


def test_cams_and_geneva_wheels_are_filled(played):
    scene = load_scene('geneva_drive')
    tab = played('geneva_drive', [scene.initial.position])
    height = tab.ask('page.scene.bodies[1].shapes[0].origin[2]')
    angles = np.pi + np.pi / 4.0 + np.pi / 2.0 * np.arange(4)

    def about(radius, angles):
        return np.column_stack([0.1 + radius * np.cos(angles), radius * np.sin(angles),
                                np.full(4, height)])

    # Solid between the slots, and nothing in these.
    assert painted(colors(tab, about(0.03, angles + np.pi / 4.0))).all()
    assert not painted(colors(tab, about(0.05, angles))).any()
    tab = played('cam_follower', [load_scene('cam_follower').initial.position])
    assert painted(colors(tab, [[0.0, -0.03, 0.0], [0.03, 0.0, 0.0]])).all()


def test_a_rope_turns_its_pulleys_without_slip(played):
    scene = load_scene('rope_hoist')
    start = np.array(scene.initial.position)
    # The load sinks by 0.05, the weight rises by twice that.
    tab = played('rope_hoist', [start, start + [-0.05, 0.1]])
    turns = """(() => {
        const line = page.scene.lines[0];
        return cableWay(line.ends.map(([body, place]) => (
          moved(page.picture.frameOf(body), place))), line.radii).turns.map(([, turn]) => turn);
        })()"""
    before = np.array(tab.ask(turns))
    show(tab, 1)
    lower, upper = np.array(tab.ask(turns)) - before
    # The rope on the upper one goes with the weight, that on the lower one half as fast.
    assert lower == pytest.approx(-0.05 / 0.1, rel=1e-5)
    assert upper == pytest.approx(0.1 / 0.1, rel=1e-5)


@pytest.mark.parametrize('name', ['cam_follower', 'planetary_gear', 'rope_hoist', 'differential'])
def test_all_of_a_machine_is_in_the_picture(played, name):
    tab = played(name, [load_scene(name).initial.position])
    tab.ask('page.picture.view("first")')
    inside = """page.picture.parts.reach.every(([body, place]) => {
        const at = page.picture.project(moved(page.picture.frameOf(body), place));
        const {clientWidth, clientHeight} = page.picture.canvas;
        return at[0] >= 0 && at[0] <= clientWidth && at[1] >= 0 && at[1] <= clientHeight; })"""
    tab.wait(inside)
    # And it is not small in it.
    edges = tab.ask("""(() => {
        const all = Object.values(page.picture.extent).map((place) => page.picture.project(place));
        return [0, 1].map((k) => Math.max(...all.map((at) => at[k]))
          - Math.min(...all.map((at) => at[k]))); })()""")
    width, height = tab.ask('[page.picture.canvas.clientWidth, page.picture.canvas.clientHeight]')
    assert max(edges[0] / width, edges[1] / height) > 0.6


def test_a_slider_stays_in_its_guide_which_grows(played):
    scene = load_scene('slider_crank')
    start = np.array(scene.initial.position)
    names = scene.mechanism.coordinates.names
    moved = start.copy()
    moved[names.index('slider_joint')] += 0.4
    tab = played('slider_crank', [start, moved])
    guide = 'page.picture.guides.all[0]'
    low, high = tab.ask(f'[{guide}.low, {guide}.high]')
    assert low < start[names.index('slider_joint')] < high < moved[names.index('slider_joint')]
    show(tab, 1)
    assert tab.ask(f'{guide}.high') > moved[names.index('slider_joint')]
    assert tab.ask(f'{guide}.low') == low
