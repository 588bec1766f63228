# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Take the pictures of the page of ``closedloop view`` in ``doc/pictures``.

``view.png`` has the plots that are shown at first, ``view_accuracy.png`` those of forces, closure
and error, ``view_edit.png`` a machine that is edited.

    python doc/make_view_picture.py          (from the checkout, which is on the PYTHONPATH)

Needs Chromium.

"""

from contextlib import contextmanager
from pathlib import Path
from test.view.browser import browser
import threading

from closedloop_dynamics.simulation.scene import load_scene
from closedloop_dynamics.view.library import Library
from closedloop_dynamics.view.own_motion import own_motion
from closedloop_dynamics.view.page import live_page
from closedloop_dynamics.view.runner import Runner
from closedloop_dynamics.view.server import Server
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
MOVING, EDITED = 'three_rrr', 'four_bar'
# Plots.
ACCURACY = ['force at cut joints', 'closure error', 'angle from a singularity', 'estimated error']


def save(tab, name):
    """Save what a tab shows now."""
    picture = Image.fromarray(tab.picture()).quantize(128)
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
        tab.wait('typeof page !== "undefined" && Boolean(page.shownRow) && Boolean(page.told)')
        yield tab
    finally:
        over.set()
        thread.join()
        server.close()


def main():
    """Run the scene for a while, edit another one, and write the pictures."""
    with browser() as open_page:
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


if __name__ == '__main__':
    main()
