# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Take the pictures of the page of ``closedloop view`` in ``doc/pictures``.

``view.png`` has the plots that are shown at first, ``view_accuracy.png`` those of forces, closure
and error.

    python doc/make_view_picture.py          (from the checkout, which is on the PYTHONPATH)

Needs Chromium.

"""

from pathlib import Path
from test.view.browser import browser
import threading

from closedloop_dynamics.simulation.scene import load_scene
from closedloop_dynamics.view.page import live_page
from closedloop_dynamics.view.runner import Runner
from closedloop_dynamics.view.server import Server
from PIL import Image

ROOT = Path(__file__).resolve().parents[1]
SCENE = 'three_rrr'
# Plots.
ACCURACY = ['force at cut joints', 'closure error', 'angle from a singularity', 'estimated error']


def save(tab, name):
    """Save what a tab shows now."""
    picture = Image.fromarray(tab.picture()).quantize(128)
    picture.save(ROOT / 'doc' / 'pictures' / f'{name}.png', optimize=True)


def main():
    """Run the scene for a while and write the pictures."""
    runner, over = Runner(load_scene(SCENE)), threading.Event()
    server = Server([live_page(SCENE)], [runner.feed])
    thread = threading.Thread(target=runner.run, args=(lambda: not over.is_set(),))
    thread.start()
    try:
        with browser() as open_page:
            tab = open_page(f'{server.url}?smooth', width=1520, height=860)
            tab.wait('typeof page !== "undefined" && Boolean(page.shownRow)')
            for joint, torque in (('theta_1', 4.0), ('theta_6', -2.0), ('theta_7', 3.0)):
                tab.ask(f'page.ask("command", {{joint: "{joint}", value: {torque}}})')
            tab.ask('page.ask("speed", {factor: 0.2}); page.ask("play")')
            tab.wait('page.now > 2.0')
            tab.ask('page.ask("pause")')
            tab.wait('!page.playing')
            save(tab, 'view')
            tab.ask(f"""page.plots.groups.forEach((plot) => {{
                plot.open = {ACCURACY}.includes(plot.group); plot.card.hidden = !plot.open; }})""")
            tab.wait('page.plots.visible.size === 4')
            save(tab, 'view_accuracy')
    finally:
        over.set()
        thread.join()
        server.close()


if __name__ == '__main__':
    main()
