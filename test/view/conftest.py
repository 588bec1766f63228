# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A simulation that is shown, with a clock that moves when set; compiled once."""

import json
import math
import threading

from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.view.page import live_page
from closedloop_dynamics.view.runner import RATE, Runner
from closedloop_dynamics.view.server import Server
import pytest


class Shown:
    """A runner and its clock."""

    def __init__(self, scene):
        self.now, self.served = 100.0, False
        # Simulated time from which on the clock stands still [s].
        self.end = math.inf
        self.runner = Runner(load_scene(scene), lambda: self.now)
        self.simulation, self.feed = self.runner.simulation, self.runner.feed

    def ask(self, what, page='page', **more):
        """Ask for something as a page does, and let it be followed."""
        self.feed.accept(page, json.dumps({'do': what, **more}))
        if not self.served:
            self.runner.tick()

    def run(self, frames):
        """Let so many frames pass."""
        for _ in range(frames):
            if self.simulation.time < self.end:
                self.now += 1.0 / RATE
            self.runner.tick()


@pytest.fixture(scope='session')
def shown_once():
    return Shown('three_rrr_vertical')


@pytest.fixture
def shown(shown_once):
    """At its start, with the method, the effects and the drives of its scene."""
    shown = shown_once
    shown.end = math.inf
    shown.ask('kinematic', on=False)
    shown.runner.start_pose = None
    shown.ask('release', page=shown.runner.holder)
    shown.ask('reset')
    shown.ask('effect', name='gravity', enabled=True, values={'acceleration': [0.0, -9.81]})
    shown.ask('speed', factor=1.0)
    assert shown.simulation.time == 0.0 and not shown.runner.playing
    return shown


@pytest.fixture
def live(shown):
    """Serve it, with a thread that lets time pass as fast as frames are made."""
    server = Server([live_page('test')], [shown.feed])
    over = threading.Event()

    def run():
        while not over.wait(0.005):
            shown.run(1)

    thread = threading.Thread(target=run)
    shown.served = True
    thread.start()
    shown.url, shown.server = server.url, server
    yield shown
    over.set()
    thread.join()
    shown.served = False
    server.close()
