# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Time in a real browser: the past of a run, two runs, estimates, plots over an angle, files."""

from dataclasses import replace
from test.view.browser import browser, program
from test.view.test_browser import on_screen, pause, READY, stage
from test.view.test_page import contents
from xml.etree import ElementTree

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.mechanism.kinematics import body_poses, poses_in_space
from closedloop_dynamics.recording.recording import read_recording
from closedloop_dynamics.view.columns import motion_columns, motion_rows
from closedloop_dynamics.view.description import describe
from closedloop_dynamics.view.page import live_page, recorded_page
from closedloop_dynamics.visual.trajectory import Trajectory
import numpy as np
from PIL import Image
import pytest

pytestmark = pytest.mark.skipif(
    program() is None, reason='no Chromium is installed (Debian: apt install chromium)')
# The key of the keyboard, as the browser has it.
SHIFT = 8
SVG = '{http://www.w3.org/2000/svg}'


@pytest.fixture(scope='module')
def open_page():
    with browser() as open_page:
        yield open_page


def run_to(tab, live, end, torque=0.0):
    """Run from the start to a time, and stand still."""
    live.ask('reset')
    tab.wait('page.frame.time === 0 && !page.playing')
    live.ask('command', joint='theta_1', value=torque)
    live.end = end
    live.ask('play')
    tab.wait(f'page.frame.time >= {end} - 0.02 && page.frame.time < {end} + 0.2')
    pause(tab, live, lambda: live.ask('pause'))


def changed(one, other):
    """Return the share of pixels that differ."""
    return (np.abs(one - other).max(axis=2) > 25).mean()


def drag(tab, selector, begin, end, modifiers=0):
    """Drag the mouse over an element, from one share of its width to another."""
    x, y, width, height = tab.ask(f"""(() => {{
        const e = document.querySelector({selector!r});
        e.scrollIntoView({{block: "center"}});
        const box = e.getBoundingClientRect();
        return [box.x, box.y, box.width, box.height]; }})()""")
    y += height / 2
    tab.mouse('mouseMoved', x + begin * width, y)
    tab.mouse('mousePressed', x + begin * width, y, 1, modifiers)
    for share in np.linspace(begin, end, 5):
        tab.mouse('mouseMoved', x + share * width, y, 1, modifiers)
    tab.mouse('mouseReleased', x + end * width, y, 0, modifiers)


def test_the_slider_shows_the_past_while_the_run_goes_on(open_page, live):
    tab = open_page(live.url)
    tab.wait(READY)
    run_to(tab, live, 0.8)
    present = stage(tab)
    assert 'kept' in tab.ask('document.getElementById("kept").textContent')
    live.end = 1.2
    live.ask('play')
    drag(tab, '#time', 0.97, 0.3)
    # Once the page has heard of the whole drag.
    tab.wait('page.timeline.past !== null && page.timeline.past < 0.6 '
             '&& page.now === page.timeline.past')
    past = tab.ask('page.now')
    assert past > 0.1
    # The run has gone on to its end; what is seen has not.
    tab.wait(f'page.history.end >= {live.end} && page.frame.time >= {live.end}')
    assert tab.ask('page.now') == past
    # A connection that is lost for a while changes nothing.
    count = tab.ask('page.history.count')
    tab.ask('page.socket.close()')
    tab.wait('page.lost')
    tab.wait('!page.lost && page.resumed === false && page.socket.readyState === WebSocket.OPEN')
    assert tab.ask('page.timeline.past') == past == tab.ask('page.now')
    assert tab.ask('page.history.count') <= count + 2
    alone = Simulation(load_scene('three_rrr_vertical'))
    alone.advance(alone.joint_torques(None), round(past / alone.step_size))
    first = tab.ask('page.scene.columns.plots')
    shown = tab.ask('[...page.shownRow]')[first:first + 3]
    expected = alone.coordinates.by_freedom(alone.position)[:3]
    np.testing.assert_allclose(shown, expected, atol=2e-2)
    np.testing.assert_allclose(
        tab.ask('page.picture.trails[0].now.slice(0, 2)'), alone.points[0], atol=2e-3)
    assert changed(stage(tab), present) > 0.005
    # What is taken hold of would be of another time.
    tab.mouse('mouseMoved', *on_screen(tab, 0, 0))
    assert tab.ask('page.picture.hover') is None
    tab.click('#live')
    tab.wait('page.timeline.past === null && page.now === page.frame.time')
    live.ask('pause')
    assert not tab.errors
    tab.close()


def test_what_is_kept_of_a_run_is_bounded(open_page, tmp_path):
    path = tmp_path / 'empty.html'
    path.write_text(live_page('empty'))
    tab = open_page(path.as_uri())
    tab.wait('typeof History.prototype.makeRoom === "function"')
    # More rows than there is room for, and then another run.
    kept = tab.ask("""(() => {
        const history = new History({columns: {width: 2, plots: 0}, bodies: []});
        history.most = 1500;
        for (let k = 0; k < 4000; k++) history.add(0.5 * k, [k, -k]);
        const {count, begin, end} = history, at = history.before(1600.2);
        const kept = [count, begin, end, history.time(at), ...history.row(at),
                      history.valueAt(1600.25, 0)];
        // The last state again, by a time that was rounded, is no other run.
        const same = [history.add(1999.5 - 1e-9, [5, 5]), history.count, history.end];
        return [...kept, ...same,
                history.add(0, [7, 7]), history.count, history.value(0, 1)]; })()""")
    assert kept == [1500, 1250.0, 1999.5, 1600.0, 3200, -3200, 3200.5, False, 1500, 1999.5,
                    True, 1, 7]
    tab.close()


def test_a_run_is_kept_beside_the_next_one(open_page, live):
    tab = open_page(live.url)
    tab.wait(READY)
    run_to(tab, live, 0.5)
    tab.click('#runs-panel summary')
    tab.click('#keep')
    tab.ask('page.plots.groups[0].canvas.scrollIntoView()')
    run_to(tab, live, 0.5, torque=20.0)
    tab.wait('document.querySelector("#plots .chip .value").textContent.includes("|")')
    two, lines = stage(tab), tab.ask('document.querySelector("#plots canvas").toDataURL()')
    assert 'kept' in tab.ask('document.getElementById("keys").textContent')
    assert tab.ask('!document.getElementById("other").hidden')
    # Pale, at the place of the first run at this time.
    alone = Simulation(load_scene('three_rrr_vertical'))
    now = tab.ask('Math.min(page.now, page.comparison.ghost.history.end)')
    alone.advance(alone.joint_torques(None), round(now / alone.step_size))
    np.testing.assert_allclose(
        np.array(tab.ask('[...page.comparison.ghost.pale.trails[0].now]'))[:2],
        alone.points[0], atol=2e-3)
    tab.click('#drop')
    tab.wait('page.picture.ghost === null')
    tab.ask('page.plots.groups[0].canvas.scrollIntoView()')
    assert changed(stage(tab), two) > 0.01
    tab.wait('!document.querySelector("#plots .chip .value").textContent.includes("|")')
    assert tab.ask('document.querySelector("#plots canvas").toDataURL()') != lines
    assert not tab.errors
    tab.close()


def test_plots_over_an_angle_are_looked_at_closely(open_page, tmp_path, capsys):
    path = tmp_path / 'run.html'
    assert main(['view', 'four_bar', '--motion', 'crank_joint=1+6*t', '--duration', '3',
                 '--save', str(path)]) == 0
    tab = open_page(path.as_uri(), height=1600)
    tab.wait('typeof page !== "undefined" && Boolean(page.shownRow)')
    tab.ask('page.playing = false; page.timeline.seek(2)')
    force = 'page.plots.groups.find((one) => one.group === "force where loops close")'
    tab.wait(f'{force}.seen?.to === 3')
    column = tab.ask('page.scene.plots.findIndex((one) => one.name === "crank_joint")')
    tab.ask(f"""(() => {{
        const over = document.getElementById("over");
        over.value = "{column}";
        over.onchange(); }})()""")
    # Turns lie above one another: the force is the same in each.
    tab.wait(f'{force}.seen.to > 6')
    seen = np.array(tab.ask(f'{force}.seen.runs[0].places'))
    assert 0.0 <= seen[:, 0].min() < 0.1 and 6.2 < seen[:, 0].max() < 2.0 * np.pi
    turn = 2.0 * np.pi / 6.0
    times = np.array(tab.ask('[...page.history.times]'))
    middle = (times > 0.3) & (times < 3.0 - turn - 0.3)
    series = np.array(tab.ask(f"""[...Array(page.history.count).keys()].map(
        (k) => page.history.value(k, {force}.series[0].column))"""))
    np.testing.assert_allclose(np.interp(times[middle] + turn, times, series), series[middle],
                               atol=0.02 * series.max())
    # A drag looks closer, the pointer tells, a double click shows all again.
    tab.ask(f'{force}.canvas.id = "force"')
    before = tab.ask(f'{force}.canvas.toDataURL()')
    drag(tab, '#force', 0.4, 0.6)
    tab.wait(f'page.plots.zoom && {force}.seen.to - {force}.seen.from < 2')
    tab.wait(f'{force}.at.textContent.startsWith("t = ")')
    assert 'rad' in tab.ask(f'{force}.at.textContent')
    assert tab.ask(f'{force}.canvas.toDataURL()') != before
    begin, end = tab.ask('page.plots.zoom')
    drag(tab, '#force', 0.7, 0.5, SHIFT)
    tab.wait(f'page.plots.zoom[0] > {begin} + 0.1')
    assert tab.ask('page.plots.zoom[1] - page.plots.zoom[0]') == pytest.approx(end - begin)
    tab.ask("""document.getElementById("force").dispatchEvent(new WheelEvent("wheel", {
        ctrlKey: true, deltaY: -200, cancelable: true}))""")
    tab.wait(f'page.plots.zoom[1] - page.plots.zoom[0] < {0.8 * (end - begin)}')
    tab.ask('document.getElementById("force").dispatchEvent(new MouseEvent("dblclick"))')
    tab.wait(f'page.plots.zoom === null && {force}.seen.to > 6')
    assert not tab.errors
    tab.close()


def test_files_of_the_page_open_again(open_page, live, tmp_path):
    tab = open_page(live.url)
    tab.wait(READY)
    run_to(tab, live, 0.5, torque=5.0)
    tab.click('#runs-panel summary')
    # Each has a button.
    assert set(tab.ask('[...document.querySelectorAll("#files button")].map('
                       '(one) => one.dataset.file)')) == {
        'picture.png', 'picture.svg', 'plots.png', 'plots.svg', 'csv', 'html'}

    def saved_file(what):
        folder = tmp_path / what
        folder.mkdir()
        return tab.download(f'[data-file="{what}"]', folder)

    seen, file = stage(tab), saved_file('picture.png')
    assert file.name == 'three_rrr_vertical.png'
    with Image.open(file) as picture:
        pixels = np.asarray(picture.convert('RGB')).astype(int)
    # Without what lies above it in the page.
    assert changed(pixels, seen[:pixels.shape[0], :pixels.shape[1]]) < 0.08
    with Image.open(saved_file('plots.png')) as picture:
        assert np.asarray(picture.convert('L')).std() > 5.0
    drawing = ElementTree.parse(saved_file('picture.svg')).getroot()
    blue = [path for path in drawing.iter(f'{SVG}path') if (color := path.get('fill', '#'))[1:]
            and color.startswith('#') and int(color[5:], 16) > int(color[1:3], 16) + 40]
    assert len(blue) > 50
    words = {text.text for text in ElementTree.parse(saved_file('plots.svg')).iter(f'{SVG}text')}
    assert {'energy [J] over time', 'kinetic'} <= words
    # The table is read by this package, and is the motion.
    table = saved_file('csv')
    assert 'position.theta_1 [rad]' in table.read_text().split('\n')[0].split(',')
    motion = read_recording(table, load_scene('three_rrr_vertical')).motion
    alone = Simulation(load_scene('three_rrr_vertical'))
    alone.advance(alone.joint_torques({'theta_1': 5.0}), round(motion.time[-1] / alone.step_size))
    np.testing.assert_allclose(motion.position[-1], alone.position, atol=1e-5)
    np.testing.assert_allclose(motion.forces[-1], alone.constraint_forces, rtol=1e-3, atol=1e-3)
    # The page plays what was seen, and can be opened beside a run.
    saved = saved_file('html')
    _, times, rows = contents(saved)
    np.testing.assert_allclose(times, motion.time)
    again = open_page(saved.as_uri())
    again.wait('typeof page !== "undefined" && Boolean(page.shownRow)')
    assert again.ask('page.history.count') == len(times) and not again.errors
    again.close()
    run_to(tab, live, 0.3)
    before = stage(tab)
    tab.ask(f"""(() => {{
        const files = new DataTransfer();
        files.items.add(new File([{saved.read_text()!r}], "run.html"));
        document.getElementById("beside").files = files.files;
        document.getElementById("beside").dispatchEvent(new Event("change")); }})()""")
    tab.wait('page.picture.ghost?.name === "run.html"')
    assert changed(stage(tab), before) > 0.001
    assert not tab.errors
    tab.close()


def test_estimates_are_pale_with_bands(open_page, tmp_path):
    """A band spans two standard deviations on both sides; the pale machine is where it is said."""
    mechanism = load_scene('four_bar').mechanism
    start, time = np.array(load_scene('four_bar').initial.position), np.linspace(0.0, 1.0, 50)
    zero, forces = np.zeros((50, 3)), np.zeros((50, 1, 3))
    motion = Trajectory(mechanism, time, np.tile(start, (50, 1)), zero, zero, forces)
    estimate = replace(motion, position=motion.position + 0.3)
    columns = motion_columns(mechanism, estimated=True)
    path = tmp_path / 'estimated.html'
    path.write_text(recorded_page('estimated', describe(mechanism, columns, mode='recording',
                                                        title='estimated'), time, motion_rows(
        motion, (estimate, np.full((50, 3), 0.1), np.full((50, 3), np.nan)))))
    tab = open_page(path.as_uri())
    tab.wait('typeof page === "object" && page.plots.groups[0].seen'
             ' && page.picture.ghost.pale.row')
    assert 'as estimated' in tab.ask('document.getElementById("keys").textContent')
    crank = body_poses(mechanism, estimate.position[0], ('crank',))
    np.testing.assert_allclose(
        np.array(tab.ask('[...page.picture.ghost.pale.frames[0]]')).reshape(4, 4)[3, :3],
        poses_in_space(crank)[0, :3], atol=1e-6)
    # Heights of the band's corners, as the plot fills it.
    heights = tab.ask("""(() => {
        const plot = page.plots.groups.find(({group}) => group === "joint position");
        const pen = new SvgPen(400, 100), frame = plot.seen, fill = pen.fill.bind(pen);
        let found = [];
        pen.fill = () => { found = pen.path.match(/ [-0-9.]+/g).map(Number); fill(); };
        const run = frame.runs.find(({one}) => one.name === "crank_joint, estimated");
        plot.band(pen, run.one, run.places, frame);
        return [Math.min(...found), Math.max(...found), frame.y(%r), frame.y(%r)]; })()""" % (
        float(start[0]) + 0.5, float(start[0]) + 0.1))
    np.testing.assert_allclose(heights[:2], heights[2:], atol=0.1)
    assert not tab.errors
    tab.close()
