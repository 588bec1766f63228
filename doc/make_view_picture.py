# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Take the picture of the page of ``closedloop view``: ``doc/pictures/view.png``.

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


def main():
    """Run the scene for a while and write the picture."""
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
            picture = Image.fromarray(tab.picture()).quantize(128)
            picture.save(ROOT / 'doc' / 'pictures' / 'view.png', optimize=True)
    finally:
        over.set()
        thread.join()
        server.close()


if __name__ == '__main__':
    main()
