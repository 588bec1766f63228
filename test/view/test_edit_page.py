# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Editing in a real browser: dragged, added, undone, saved, opened, while it moves."""

from contextlib import contextmanager
from test.view.browser import browser, program
import threading

from closedloop_dynamics import load_scene, Simulation
from closedloop_dynamics.view.library import Library
from closedloop_dynamics.view.own_motion import own_motion
from closedloop_dynamics.view.page import live_page
from closedloop_dynamics.view.runner import Runner
from closedloop_dynamics.view.server import Server
import numpy as np
import pytest

pytestmark = pytest.mark.skipif(
    program() is None, reason='no Chromium is installed (Debian: apt install chromium)')
READY = 'typeof page !== "undefined" && Boolean(page.shownRow) && Boolean(page.controls)'


@contextmanager
def opened(scene, folder):
    """Serve a scene; yield a page of it and its runner."""
    runner = Runner(load_scene(scene), own=own_motion, library=Library(folder))
    server = Server([live_page(scene)], [runner.feed], resource=runner.resource)
    over = threading.Event()
    thread = threading.Thread(target=runner.run, args=(lambda: not over.is_set(),))
    thread.start()
    try:
        with browser() as open_page:
            tab = open_page(server.url)
            tab.wait(READY)
            yield tab, runner
            assert not tab.errors
    finally:
        over.set()
        thread.join()
        server.close()


def on_screen(tab, place):
    """Return where a place, an expression in the page, is in the window [CSS pixels]."""
    return tab.ask(f"""(() => {{
        const [x, y] = page.picture.project({place});
        const box = document.getElementById("solid").getBoundingClientRect();
        return [x + box.x, y + box.y]; }})()""")


def handle(name):
    return f'page.edit.place(page.edit.handles.find((one) => one.name === "{name}"))'


def click(tab, place):
    x, y = on_screen(tab, place)
    tab.mouse('mouseMoved', x, y)
    tab.mouse('mousePressed', x, y, 1)
    tab.mouse('mouseReleased', x, y)


def add(tab, what, *places):
    tab.ask(f'page.edit.begin({what!r})')
    for place in places:
        click(tab, place)


def remove(tab, what):
    # What can be removed arrives behind the machine.
    tab.wait(f'[...page.edit.less.options].some((one) => one.value === "{what}")')
    tab.ask(f"""page.edit.less.value = "{what}"; page.edit.less.onchange()""")


def test_a_machine_is_edited_saved_and_opened(tmp_path):
    with opened('four_bar', tmp_path) as (tab, runner):
        tab.click('#editing')
        tab.wait('page.edit.on && page.edit.curves.length === 1')
        curve, before = tab.ask('page.edit.curves[0]'), tab.picture().astype(int)
        x, y = on_screen(tab, handle('coupler_joint'))
        tab.mouse('mouseMoved', x, y)
        tab.mouse('mousePressed', x, y, 1)
        for k in range(1, 6):
            tab.mouse('mouseMoved', x - 4 * k, y - 6 * k, 1)
        tab.mouse('mouseReleased', x - 20, y - 30)
        tab.wait(f'Math.abs({on_x("coupler_joint")} - {x - 20}) < 2')
        after = tab.ask('page.edit.curves[0]')
        assert np.abs(np.array(after) - curve).max() > 0.01
        assert (np.abs(tab.picture().astype(int) - before).max(axis=2) > 30).mean() > 0.005
        assert runner.simulation.closure < 1e-9
        # A link from the ground to the coupler, by two clicks; the page goes on, and the camera
        # stays where it is.
        tab.ask('window.same = true; page.zoom(0.9); page.plots.groups[1].card.hidden')
        seen = tab.ask('[page.picture.distance, ...page.picture.target]')
        add(tab, 'link', '[0.25, -0.02, 0]', handle('coupler_point'))
        tab.wait(f'{READY} && page.scene.bodies.length === 4 && page.edit.on')
        tab.ask('document.querySelector("[data-do=undo]").click()')
        tab.wait(f'{READY} && page.scene.bodies.length === 3 && page.edit.on')
        tab.ask('document.querySelector("[data-do=redo]").click()')
        tab.wait(f'{READY} && page.scene.bodies.length === 4 && page.edit.on')
        # A point goes and comes back; what others hang on is not offered.
        remove(tab, 'point coupler_point')
        tab.wait(f'{READY} && page.scene.points.length === 0')
        tab.ask('document.querySelector("[data-do=undo]").click()')
        tab.wait(f'{READY} && page.scene.points.length === 1')
        assert 'body crank' not in tab.ask(
            '[...document.querySelectorAll("#remove option")].map((one) => one.value)')
        assert tab.ask('window.same')
        assert tab.ask('[page.picture.distance, ...page.picture.target]') == seen
        tab.ask('page.edit.name.value = "mine"')
        tab.click('[data-do=save]')
        tab.wait('document.getElementById("notes").textContent.includes("saved")')
        saved = load_scene(tmp_path / 'mine.yaml')
        assert len(saved.mechanism.bodies) == 4 and Simulation(saved).closure < 1e-9
        assert '# m/s^2' in (tmp_path / 'mine.yaml').read_text()
        # What cannot be is said, and nothing changes.
        tab.ask('page.ask("set", {key: "length.coupler.cut_1", value: 3})')
        tab.wait('document.getElementById("notes").textContent.includes("closed")')
        tab.click('#open')
        tab.wait('document.querySelectorAll("#machines img").length > 20')
        tab.wait('document.querySelector("#machines img").naturalWidth > 0')
        tab.press_escape()
        tab.wait('!document.getElementById("library").open')
        tab.click('#open')
        tab.ask('[...document.querySelectorAll("#machines button")].find('
                '(one) => one.textContent.startsWith("slider_crank")).click()')
        tab.wait(f'{READY} && page.scene.title === "slider_crank" && !page.edit.on')
        tab.wait('page.picture.row && page.history.count > 0')
        assert tab.ask('window.same && page.edit.name.value') == 'slider_crank_edited'
        tab.click('#play')
        tab.wait('page.now > 0.1')
        tab.close()


def on_x(name):
    """Return an expression of the window's x of a handle."""
    return (f'(page.picture.project({handle(name)})[0] '
            '+ document.getElementById("solid").getBoundingClientRect().x)')


def test_a_length_is_changed_while_it_moves(tmp_path):
    with opened('four_bar', tmp_path) as (tab, runner):
        tab.click('#play')
        tab.wait('page.now > 0.5')
        tab.ask('document.getElementById("numbers-panel").open = true')
        tab.ask('page.edit.numbers.sliders["length.rocker.cut_1"].set(0.27, true)')
        tab.wait('Math.abs(page.scene.cuts[0].point_b[0] - 0.27) < 1e-9')
        now = tab.ask('page.now')
        tab.wait(f'page.now > {now} + 0.5 && page.playing')
        assert tab.ask('page.controls.failure') is None
        # Its thread computes with the simulation while it plays.
        tab.click('#play')
        tab.wait('!page.playing')
        cut, = runner.editor.scene.mechanism.cut_joints
        assert np.hypot(*cut.point_b) == pytest.approx(0.27)
        assert runner.simulation.closure < 1e-9
        tab.close()


def test_another_assembly_is_chosen_by_its_picture(tmp_path):
    with opened('four_bar', tmp_path) as (tab, runner):
        tab.click('#editing')
        tab.wait('page.edit.on')
        before = runner.simulation.position.copy()
        tab.click('[data-do=assemblies]')
        tab.wait('document.querySelectorAll(".machines img").length === 2')
        assert 'proved: 2' in tab.ask('document.querySelector("dialog.choice p").textContent')
        shown = tab.picture()
        assert (shown.max(axis=2) - shown.min(axis=2) > 40).mean() > 0.002
        number = int(np.sign(before[2]) > 0) + 1
        tab.click(f'.machines button:nth-child({number})')
        tab.wait('document.querySelectorAll("dialog.choice").length === 0')
        tab.wait('page.controls.undoable[0]')
        # The crank stays; coupler and rocker are mirrored at the line between their ends.
        base, pin = np.array([0.4, 0.0]), 0.1 * np.exp(1j * before[0])
        axis = complex(*base) - pin
        mirrored = base[0] + (np.conj((0.25 * np.exp(1j * before[2])) / axis)) * axis
        found = base[0] + 0.25 * np.exp(1j * runner.simulation.position[2])
        assert abs(found - mirrored) < 1e-9
        tab.close()
