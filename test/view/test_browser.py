# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The page in a real browser: a slider moves the mechanism, what is drawn changes."""

from test.view.browser import browser, PATIENCE, program
import time

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.mechanism.kinematics import body_poses, poses_in_space
from closedloop_dynamics.view.columns import motion_columns
from closedloop_dynamics.view.description import describe, grabs
from closedloop_dynamics.view.page import recorded_page
import numpy as np
import pytest

pytestmark = pytest.mark.skipif(
    program() is None, reason='no Chromium is installed (Debian: apt install chromium)')
READY = 'typeof page !== "undefined" && Boolean(page.shownRow) && Boolean(page.controls)'
POSITION = 'page.position("theta_1")'


@pytest.fixture(scope='module')
def open_page():
    with browser() as open_page:
        yield open_page


def stage(tab):
    """Return the part of the picture with the mechanism."""
    x, y, width, height = map(round, tab.ask("""(() => {
        const box = document.getElementById("solid").getBoundingClientRect();
        return [box.x, box.y, box.width, box.height]; })()"""))
    return tab.picture()[y:y + height, x:x + width].astype(int)


def on_screen(tab, body, place):
    """Return where a place of a body is in the window, by their numbers [CSS pixels]."""
    return tab.ask(f"""(() => {{
        const [x, y] = page.picture.project(page.picture.grabbed([{body}, {place}]));
        const box = document.getElementById("solid").getBoundingClientRect();
        return [x + box.x, y + box.y]; }})()""")


def pause(tab, live, how):
    """Pause in the way given; wait until the page shows the state that time stands still at."""
    how()
    tab.wait('!page.playing')
    # The page hears of the pause before it gets the last state.
    tab.wait(f'!page.fresh && page.now === {float(live.simulation.time)!r}')


def test_a_slider_moves_the_mechanism(open_page, live):
    tab = open_page(live.url)
    tab.wait(READY)
    live.ask('effect', name='gravity', enabled=False)
    before, start = stage(tab), tab.ask(POSITION)
    live.end = 0.0
    # Something is drawn, in the colours of the subsystems.
    assert (np.abs(before - np.array([0, 114, 178])).max(axis=2) < 60).mean() > 0.005
    tab.click('#play')
    tab.wait('page.playing')
    x, y = tab.middle('#drives input[type=range]')
    tab.mouse('mousePressed', x, y, 1)
    tab.mouse('mouseMoved', x + 20, y, 1)
    tab.mouse('mouseReleased', x + 20, y)
    tab.wait('page.controls.drives.theta_1.value > 0')
    live.end = 1.0
    tab.wait(f'Math.abs({POSITION} - {start}) > 0.2')
    pause(tab, live, lambda: tab.click('#play'))
    assert live.runner.drives['theta_1'].value > 0.0
    place = live.simulation.joint_names.index('theta_1')
    assert tab.ask(POSITION) == np.float32(live.simulation.position[place])
    changed = (np.abs(stage(tab) - before).max(axis=2) > 30).mean()
    assert changed > 0.005
    assert not tab.errors
    tab.close()


def test_a_drive_follows_an_expression_that_is_typed(open_page, live):
    tab = open_page(live.url)
    tab.wait(READY)
    live.ask('effect', name='gravity', enabled=False)
    start = tab.ask(POSITION)
    for joint in live.simulation.actuated_joints[1:]:
        live.ask('drive', joint=joint, mode='torque')
    tab.ask("""(() => {
        const {select} = page.drives.rows.theta_1;
        select.value = "expression";
        select.onchange(); })()""")
    row = 'page.drives.rows.theta_1'
    tab.wait(f'!{row}.law.hidden && {row}.slider.element.hidden')
    tab.ask(f"""(() => {{
        const {{input}} = page.drives.rows.theta_1;
        input.value = "{start} + 0.3*sin(2*t)";
        input.onchange(); }})()""")
    tab.wait('page.controls.drives.theta_1.value.includes("sin")')
    live.end = 0.6
    tab.click('#play')
    tab.wait('page.now > 0.5')
    pause(tab, live, lambda: tab.click('#play'))
    assert abs(tab.ask(POSITION) - start - 0.3 * np.sin(2.0 * tab.ask('page.now'))) < 1e-3
    assert not tab.errors
    tab.close()


def test_a_point_is_dragged_by_the_mouse(open_page, live):
    tab = open_page(live.url)
    tab.wait(READY)
    live.ask('effect', name='gravity', enabled=False)
    body = [one.name for one in live.simulation.mechanism.bodies].index('platform')
    x, y = on_screen(tab, body, 0)
    place = f'page.picture.grabbed([{body}, 0])'
    before = tab.ask(place)
    tab.click('#play')
    tab.mouse('mouseMoved', x, y)
    tab.mouse('mousePressed', x, y, 1)
    tab.mouse('mouseMoved', x + 60, y, 1)
    tab.wait('page.controls.grabbed !== null')
    tab.wait(f'{place}[0] > {before[0] + 0.01}')
    tab.mouse('mouseReleased', x + 60, y)
    tab.wait('page.controls.grabbed === null')
    assert not tab.errors
    tab.close()


def test_the_picture_is_dark_and_light_and_fits_a_phone(open_page, live):
    brightness = {}
    for dark in (False, True):
        tab = open_page(live.url, width=390, height=844, dark=dark, phone=True)
        tab.wait(READY)
        # Nothing sticks out at the side.
        assert tab.ask('document.documentElement.scrollWidth <= innerWidth')
        assert tab.ask("""[...document.querySelectorAll("button, select, input")].filter(
            (e) => e.offsetParent).every((e) => {
              const box = e.getBoundingClientRect();
              return box.left >= 0 && box.right <= innerWidth + 1; })""")
        brightness[dark] = tab.picture().mean()
        assert not tab.errors
        tab.close()
    assert brightness[False] > 2.0 * brightness[True]


def test_keys_belong_to_the_page_and_change_no_list(open_page, live):
    tab = open_page(live.url)
    tab.wait(READY)
    integrator = '[data-key=integrator]'
    tab.ask(f'document.querySelector("{integrator}").focus()')
    before = tab.ask(f'document.querySelector("{integrator}").value')
    live.ask('step', count=10)
    tab.wait('page.now > 0')
    tab.press('r')
    tab.wait('page.now === 0')
    tab.press('e')
    assert tab.ask(f'document.querySelector("{integrator}").value') == before
    # What the mouse has clicked on gives the keys back.
    tab.click('#effects-panel .gravity .switch')
    tab.wait('!page.controls.effects.gravity.enabled')
    tab.press(' ')
    tab.wait('page.playing && page.now > 0')
    pause(tab, live, lambda: tab.press(' '))
    assert not tab.ask('page.controls.effects.gravity.enabled')
    # In a field they are text.
    tab.ask('document.querySelector("#drives input[type=text]").select()')
    now = tab.ask('page.now')
    tab.press('r')
    # A reset would have come before these steps.
    tab.ask('page.step()')
    tab.wait(f'page.now !== {now!r}')
    assert tab.ask('page.now') == pytest.approx(now + 10 * live.simulation.step_size, rel=1e-9)
    assert not tab.errors
    tab.close()


def test_refusals_from_before_a_page_was_opened_are_not_shown(open_page, live):
    for name in ('first', 'second'):
        live.feed.log(name)
    tab = open_page(live.url)
    tab.wait(READY)
    # Notes stay.
    tab.ask('window.setTimeout = () => 0')
    live.feed.log('third')
    tab.wait('document.querySelectorAll(".note").length > 0')
    assert tab.ask('[...document.querySelectorAll(".note")].map((e) => e.textContent)') == [
        'third']
    tab.close()


@pytest.mark.parametrize('width', [390, 761, 860, 980, 1024, 1440, 1500])
def test_nothing_sticks_out_or_is_cut_off(open_page, live, width):
    tab = open_page(live.url, width=width, height=800)
    tab.wait(READY)
    assert tab.ask("""[...document.querySelectorAll(
        "#transport *, #bar, #views, #tools, #runs-panel button, .drive > *, " +
        ".entry, .plot canvas, .effect input")]
        .filter((e) => e.getBoundingClientRect().width).filter((e) => {
          const box = e.getBoundingClientRect();
          const frame = e.closest("section, .panel").getBoundingClientRect();
          return box.left < frame.left || box.right > frame.right + 1; })
        .map((e) => e.outerHTML.slice(0, 80))""") == []
    assert tab.ask("""[...document.querySelectorAll(".drive b, button")].filter(
        (e) => e.scrollWidth > e.clientWidth + 1).map((e) => e.outerHTML)""") == []
    assert tab.ask('document.getElementById("solid").clientWidth') > 300
    # Nor do the buttons lie on the machine.
    assert tab.ask("""page.picture.parts.reach.every(([body, place]) => {
        const bar = document.getElementById("bar").getBoundingClientRect();
        const picture = document.getElementById("solid").getBoundingClientRect();
        return page.picture.project(moved(page.picture.frameOf(body), place))[1]
          > bar.bottom - picture.top; })""")
    tab.close()


def test_distances_and_angles_are_measured_and_a_body_is_followed(open_page, live):
    tab = open_page(live.url)
    tab.wait(READY)
    mechanism = live.simulation.mechanism
    body = [one.name for one in mechanism.bodies].index('platform')
    before = stage(tab)
    tab.click('#measure')
    places = [(body, 0), (body, 1), (body, 2)]
    for one in places:
        x, y = on_screen(tab, *one)
        tab.mouse('mousePressed', x, y, 1)
        tab.mouse('mouseReleased', x, y)
    tab.wait('page.picture.measured.length === 3')
    first, middle, last = grabs(mechanism, mechanism.bodies[body])[:3]
    sides = np.array([first - middle, last - middle])
    lengths = np.linalg.norm(sides, axis=1)
    np.testing.assert_allclose(
        tab.ask('page.picture.measurements().map((one) => one.value)'),
        [*lengths, np.degrees(np.arccos(sides[0] @ sides[1] / lengths.prod()))], rtol=1e-5)
    assert tab.ask('page.controls.grabbed') is None
    tab.wait('!page.picture.lines.hidden')
    assert (np.abs(stage(tab) - before).max(axis=2) > 30).sum() > 300
    tab.click('#measure')
    tab.wait('page.picture.lines.hidden')
    # A point is marked for as long as the pointer is on it.
    tab.mouse('mouseMoved', *on_screen(tab, body, 0))
    tab.wait('page.picture.hover && !page.picture.lines.hidden')
    tab.mouse('mouseMoved', *tab.middle('#measure'))
    tab.wait('page.picture.lines.hidden')
    # The followed body stays where it is on the screen.
    tab.ask(f"""document.getElementById("follow").value = "{body}";
                document.getElementById("follow").onchange()""")
    seen = f'page.picture.project(page.picture.grabbed([{body}, 0])).slice(0, 2)'
    live.ask('step', count=1)
    tab.wait('page.now > 0 && page.picture.followedAt !== null')
    place, at = tab.ask(seen), tab.ask(f'page.picture.grabbed([{body}, 0])')
    live.ask('step', count=300)
    tab.wait('page.now > 0.1')
    assert np.abs(np.subtract(tab.ask(f'page.picture.grabbed([{body}, 0])'), at)).max() > 0.01
    np.testing.assert_allclose(tab.ask(seen), place, atol=0.5)
    assert not tab.errors
    tab.close()


def distance(place, line):
    """Return how far a place is from a line of straight pieces."""
    along, to = np.diff(line, axis=0), place - line[:-1]
    share = (to * along).sum(axis=1) / np.maximum((along * along).sum(axis=1), 1e-30)
    return np.linalg.norm(to - np.clip(share, 0.0, 1.0)[:, np.newaxis] * along, axis=1).min()


def test_live_paths_and_plots_are_of_all_states(open_page, live):
    tab = open_page(live.url)
    tab.wait(READY)
    live.ask('effect', name='gravity', enabled=True)
    # A page that shows nothing while time runs: of the frames it gets a few, and then the last.
    tab.ask('page.takeFrame = () => {}')
    live.end = 1.0
    tab.click('#play')
    give_up = time.monotonic() + PATIENCE
    while live.simulation.time < live.end:
        assert time.monotonic() < give_up
        time.sleep(0.01)
    tab.ask('delete page.takeFrame')
    pause(tab, live, lambda: tab.click('#play'))
    times = np.array(tab.ask(
        '[...Array(page.history.count).keys()].map((k) => page.history.time(k))'))
    # Every frame that was not shown is there, too, and states between.
    assert times[-1] == live.simulation.time and len(times) > 60
    # The path has no chords: it passes by the point of the platform at each state.
    trail = np.array(tab.ask(
        '[...page.picture.trails[0].places.subarray(0, 3 * page.picture.trails[0].count)]'))
    trail = trail.reshape(-1, 3)
    alone, away = Simulation(load_scene('three_rrr_vertical')), 0.0
    for _ in range(round(times[-1] / alone.step_size)):
        alone.advance(alone.joint_torques(None), 1)
        away = max(away, distance(alone.points[0], trail[:, :2]))
    assert away < 0.002
    assert not tab.errors
    tab.close()


def test_the_page_comes_back_with_its_server(open_page, live):
    tab = open_page(live.url)
    tab.wait(READY)
    port = live.server.port
    live.server.close()
    tab.wait('page.lost && !document.getElementById("message").hidden')
    again = type(live.server)([''], [live.feed], port=port)
    tab.wait('!page.lost && document.getElementById("message").hidden')
    tab.click('#play')
    tab.wait('page.playing')
    again.close()
    assert live.runner.playing and not tab.errors
    tab.close()


def colored(tab, color):
    """Return how much of the stage has about a colour, lit or in the shade."""
    direction = np.array(color) / np.linalg.norm(color)
    seen = stage(tab)
    along = seen @ direction
    away = np.linalg.norm(seen - along[..., None] * direction, axis=2)
    return ((away < 0.12 * along) & (along > 60.0)).mean()


@pytest.mark.parametrize('name, least', [
    # A rope over pulleys; the outline of a cam; springs, and a road that is a box.
    ('rope_hoist', 0.005), ('cam_follower', 0.002), ('double_wishbone', 0.001)])
def test_ropes_outlines_and_springs_are_drawn(open_page, tmp_path, name, least):
    scene = load_scene(name)
    columns, count = motion_columns(scene.mechanism), 2
    bodies = len(scene.mechanism.bodies)
    rows = np.zeros((count, columns.width), dtype=np.float32)
    rows[:, :7 * bodies] = poses_in_space(body_poses(
        scene.mechanism, np.array([scene.initial.position] * count))).reshape(count, -1)
    described = describe(scene.mechanism, columns, scene.effects, mode='recording', title=name)
    shares = []
    for lines in (described, {**described, 'lines': [], 'wires': [], 'surfaces': []}):
        path = tmp_path / f'{len(shares)}.html'
        path.write_text(recorded_page(name, lines, np.array([0.0, 1.0]), rows))
        tab = open_page(path.as_uri())
        tab.wait('typeof page !== "undefined" && Boolean(page.shownRow)')
        tab.ask('page.picture.view("slanted"); page.playing = false')
        shares.append(colored(tab, (140, 109, 49)))
        assert not tab.errors
        tab.close()
    assert shares[0] > shares[1] + least


def test_a_saved_page_plays_without_a_server(open_page, tmp_path, capsys):
    path = tmp_path / 'run.html'
    assert main(['view', 'four_bar', '--duration', '1', '--save', str(path)]) == 0
    tab = open_page(path.as_uri())
    tab.wait('typeof page !== "undefined" && Boolean(page.shownRow) && page.now > 0.1')
    tab.ask('page.playing && page.toggle()')
    tab.ask('document.getElementById("time").value = 0; document.getElementById("time").oninput()')
    assert tab.ask('page.now') == 0
    first = stage(tab)
    tab.ask('document.getElementById("time").value = 700;'
            'document.getElementById("time").oninput()')
    assert tab.ask('page.now') > 0.6
    assert (np.abs(stage(tab) - first).max(axis=2) > 30).mean() > 0.003
    assert not tab.errors
    tab.close()


def test_paths_and_plots_of_a_recording_are_of_all_its_rows(open_page, tmp_path):
    scene, count = load_scene('four_bar'), 30_000
    columns = motion_columns(scene.mechanism)
    described = describe(scene.mechanism, columns, scene.effects, mode='recording', title='rows')
    described['points'] = [{'name': 'tip', 'body': 0, 'place': [0.1, 0.0, 0.0]}]
    rows = np.zeros((count, columns.width), dtype=np.float32)
    rows[:, 6:7 * len(scene.mechanism.bodies):7] = 1.0
    # A point that jumps aside for one row, and a force that does.
    place = count // 3 + 1
    rows[place, 1] = 0.5
    rows[place, columns.layout['columns']['plots']] = 777.0
    path = tmp_path / 'run.html'
    path.write_text(recorded_page('rows', described, np.arange(count) / 1000.0, rows))
    tab = open_page(path.as_uri())
    tab.wait('typeof page !== "undefined" && Boolean(page.shownRow)')
    trail = 'page.picture.trails[0]'
    tab.ask('page.playing = false; page.now = page.end')
    tab.wait(f'{trail}.shown === {count}')
    np.testing.assert_allclose(
        tab.ask(f'[...{trail}.places.subarray({3 * place - 3}, {3 * place + 6})]'),
        [0.1, 0.0, 0.0, 0.1, 0.5, 0.0, 0.1, 0.0, 0.0], atol=1e-6)
    run = 'page.plots.groups[0].run(page.history, 0, 0, page.history.count - 1, 500)'
    assert tab.ask(f'Math.max(...{run}.map((k) => page.history.value(k, 0)))') == 777.0
    assert 250 <= tab.ask(f'{run}.length') <= 520
    # The same after a jump in time: nothing between is left out.
    tab.ask('page.now = page.begin; page.picture.forget()')
    tab.wait(f'{trail}.shown === 1')
    assert not tab.errors
    tab.close()


@pytest.mark.parametrize('heavy', [True, False])
@pytest.mark.parametrize('force, drawn', [(3e-8, False), (1.0, True)])
def test_arrows_are_of_forces_that_matter(open_page, tmp_path, force, drawn, heavy):
    scene = load_scene('four_bar')
    columns, mechanism = motion_columns(scene.mechanism), scene.mechanism
    rows = np.zeros((2, columns.width), dtype=np.float32)
    rows[:, :7 * len(mechanism.bodies)] = poses_in_space(body_poses(
        mechanism, np.array([scene.initial.position] * 2))).reshape(2, -1)
    rows[:, columns.layout['columns']['forces']] = force * 9.81 * sum(
        body.mass for body in mechanism.bodies)
    path = tmp_path / 'run.html'
    described = describe(mechanism, columns, scene.effects, mode='recording', title='arrows')
    if not heavy:
        # What a drive can exert tells what matters, too.
        torque = described['weight'] * described['size']
        described.update(weight=0.0, drives=[
            {'joint': 'crank_joint', 'slides': False, 'torque': torque}])
    path.write_text(recorded_page('arrows', described, np.array([0.0, 1.0]), rows))
    tab = open_page(path.as_uri())
    tab.wait('typeof page !== "undefined" && page.picture?.forces.forceScale > 0')
    longest = tab.ask('Math.max(...page.picture.forces.found().map(({along}) => norm(along)))')
    size = tab.ask('page.picture.size')
    assert (longest > 0.05 * size) if drawn else (longest < 1e-6 * size)
    assert not tab.errors
    tab.close()
