# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Take the pictures of the page of ``closedloop view`` in ``doc/pictures``.

``view.png`` has the plots that are shown at first, ``view_accuracy.png`` those of forces, closure
and error, ``view_edit.png`` a machine that is edited, ``view_board.png`` one that is drawn,
``view_time.png`` two runs over an angle;
``machines_plane.png`` and ``machines_space.png`` have all shipped machines.

    python doc/make_view_picture.py          (from the checkout, which is on the PYTHONPATH)

Needs Chromium.
"""

from contextlib import contextmanager
from pathlib import Path
from test.view.browser import browser
from test.view.test_board import Hand, jansens_leg
import threading

from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.view.library import Library
from closedloop_dynamics.view.own_motion import own_motion
from closedloop_dynamics.view.page import live_page
from closedloop_dynamics.view.runner import Runner
from closedloop_dynamics.view.server import Server
from PIL import Image, ImageDraw, ImageFont

ROOT = Path(__file__).resolve().parents[1]
MOVING, EDITED = 'three_rrr', 'four_bar'
# Plots.
ACCURACY = ['force at cut joints', 'closure error', 'angle from a singularity', 'estimated error']
# Of each shipped mechanism a scene, and how long it has run [s].
IN_PLANE = {
    'four_bar': 0.8, 'slider_crank': 0.4, 'three_rrr': 1.0, 'carpet_scraper': 0.9,
    'hoeken_pantograph_leg': 0.6, 'cam_follower': 0.1, 'geneva_drive': 0.3, 'rope_hoist': 0.4,
    'bistable_toggle': 0.5, 'planetary_gear': 0.25, 'rack_press': 0.3, 'scissor_lift': 0.3,
    'elliptic_gear_press': 0.7, 'geared_five_bar': 0.5, 'humanoid_knee': 0.4}
IN_SPACE = {
    'stewart_platform': 1.0, 'delta_robot': 1.0, 'rssr_four_bar': 0.8, 'bricard': 0.5,
    'bennett': 0.5, 'double_wishbone': 0.6, 'differential': 0.4, 'humanoid_ankle': 0.5,
    'excavator_arm': 1.0}
# Of a machine in a sheet of them [pixels], and how many are beside one another.
WIDE, TALL, ACROSS = 330, 240, 3
BARE = """(() => {
    const style = document.createElement('style');
    style.textContent = `header, aside, #views, #tools, #legend, #unit, #grid, #transport, #notes,
      #message { display: none !important; }
      #stage { position: fixed !important; inset: 0 !important; height: 100% !important; }
      #solid, #lines { inset: 0 !important; height: 100% !important; }`;
    document.head.append(style); })()"""


def save(tab, name):
    """Save what a tab shows now."""
    picture = Image.fromarray(tab.picture()).quantize(256)
    picture.save(ROOT / 'doc' / 'pictures' / f'{name}.png', optimize=True)


@contextmanager
def page(open_page, scene, **size):
    """Serve a scene; yield a page of it."""
    runner, over = Runner(load_scene(scene), own=own_motion, library=Library()), threading.Event()
    server = Server([live_page(scene)], [runner.feed], resource=runner.resource)
    thread = threading.Thread(target=runner.run, args=(lambda: not over.is_set(),))
    thread.start()
    try:
        tab = open_page(f'{server.url}?smooth', **size)
        tab.wait('typeof page !== "undefined" && Boolean(page.shownRow) && Boolean(page.controls)')
        yield tab
    finally:
        over.set()
        thread.join()
        server.close()


def sheet(open_page, scenes, name):
    """Save a picture of several machines as the page draws them, with their names."""
    font = ImageFont.load_default(15)
    tall = TALL + 26
    whole = Image.new('RGB', (ACROSS * WIDE, -(-len(scenes) // ACROSS) * tall), 'white')
    for number, (scene, duration) in enumerate(scenes.items()):
        with page(open_page, scene, width=2 * WIDE, height=2 * TALL) as tab:
            tab.ask(BARE)
            tab.ask('page.ask("play")')
            tab.wait(f'page.now > {duration}')
            tab.ask('page.ask("pause")')
            tab.wait('!page.playing')
            tab.ask('page.picture.view("first")')
            picture = Image.fromarray(tab.picture()).resize((WIDE, TALL), Image.Resampling.LANCZOS)
            tab.close()
        x, y = number % ACROSS * WIDE, number // ACROSS * tall
        whole.paste(picture, (x, y))
        ImageDraw.Draw(whole).text((x + WIDE // 2, y + TALL + 13), scene, 'black', font, 'mm')
    whole.quantize(256, kmeans=2).save(ROOT / 'doc' / 'pictures' / f'{name}.png', optimize=True)


def compare(tab):
    """Keep a run, change the machine, go back in time; show forces of both over the crank."""
    run_to(tab, 2.2)
    tab.ask('document.getElementById("keep").click()')
    tab.ask('page.ask("reset")')
    tab.wait('page.now === 0')
    tab.ask('page.ask("set", {key: "length.coupler.cut_1", value: 0.33})')
    run_to(tab, 2.2)
    tab.ask("""(() => {
        for (const name of ["handle", "edit-panel", "drives-panel", "numbers-panel"]) {
          document.getElementById(name).hidden = true;
        }
        document.getElementById("runs-panel").open = true;
        page.plots.groups.forEach((plot) => {
          plot.open = ["drive torque or force", "force at cut joints"].includes(plot.group);
          plot.card.hidden = !plot.open; });
        const over = document.getElementById("over");
        over.value = page.scene.plots.findIndex(({name}) => name === "crank_joint");
        over.onchange();
        page.timeline.seek(1.53); })()""")
    tab.wait('page.plots.visible.size >= 2 && page.now === 1.53')


def draw(tab):
    """Draw a leg of Jansen with the mouse."""
    tab.click('#new')
    tab.wait('page.edit.board.element.open')
    hand = Hand(tab)
    tab.ask('Object.assign(page.edit.board, {middle: [0.05, 0.03], scale: 3900})')
    jansens_leg(hand)
    hand.click('select', (0.09, 0.08))
    hand.reported()
    tab.click('#board [data-do=fit]')


def run_to(tab, end):
    """Run to a time, and stand still."""
    tab.ask('page.ask("play")')
    tab.wait(f'page.now > {end} && page.now < {2.0 * end}')
    tab.ask('page.ask("pause")')
    tab.wait('!page.playing')


def main():
    """Run the scene for a while, edit and compare another one, and write the pictures."""
    with browser() as open_page:
        sheet(open_page, IN_PLANE, 'machines_plane')
        sheet(open_page, IN_SPACE, 'machines_space')
        with page(open_page, MOVING, width=1520, height=860) as tab:
            tab.ask('page.ask("play")')
            tab.wait('page.now > 6.0')
            tab.ask('page.ask("pause")')
            tab.wait('!page.playing')
            save(tab, 'view')
            tab.ask(f"""page.plots.groups.forEach((plot) => {{
                plot.open = {ACCURACY}.includes(plot.group); plot.card.hidden = !plot.open; }})""")
            tab.wait('page.plots.visible.size === 4')
            save(tab, 'view_accuracy')
        with page(open_page, EDITED, width=1100, height=700) as tab:
            tab.ask('page.ask("edit", {on: true})')
            tab.wait('page.edit.on && page.edit.curves.length')
            tab.ask("""page.ask("move", {
                    kind: "joint", name: "coupler_joint", at: [0.02, 0.12, 0]});
                document.getElementById("numbers-panel").open = true;
                document.getElementById("drives-panel").open = false;""")
            tab.wait('!page.edit.undo.disabled')
            save(tab, 'view_edit')
        with page(open_page, EDITED, width=1100, height=700) as tab:
            draw(tab)
            save(tab, 'view_board')
        with page(open_page, EDITED, width=1100, height=700) as tab:
            compare(tab)
            save(tab, 'view_time')


if __name__ == '__main__':
    main()
