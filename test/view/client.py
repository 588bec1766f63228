# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A page without a browser."""

from contextlib import ExitStack
import json
import struct

import numpy as np
from websockets.sync.client import connect

PATIENCE = 120.0


class Client:
    """The messages to a page, and its requests."""

    def __init__(self, url):
        self._stack = ExitStack()
        self.socket = self._stack.enter_context(connect(
            url.replace('http', 'ws').replace('/?', '/live?')
            if '?' in url else url.replace('http', 'ws') + 'live',
            open_timeout=PATIENCE, ping_interval=None))
        self.scene = json.loads(self.socket.recv(timeout=PATIENCE))
        assert self.scene['type'] == 'scene'
        self.samples = []
        self.controls, self.row, self.number, self.time = {}, None, 0, 0.0

    def ask(self, what, **more):
        self.socket.send(json.dumps({'do': what, **more}))

    def take(self, seen=True):
        """Take the next message; return the number of the frame, or None."""
        data = self.socket.recv(timeout=PATIENCE)
        if isinstance(data, str):
            self.controls = json.loads(data)
            return None
        self.number, count, self.time = struct.unpack('<IId', data[:16])
        values = np.frombuffer(data[16:], dtype=np.float32)
        self.row = values[:self.scene['columns']['width']] if count else values
        self.samples += [(self.time + sample[0], sample[1:])
                         for sample in values[len(self.row):].reshape(count, -1)] if count else []
        if seen:
            self.ask('seen', frame=self.number)
        return self.number

    def until(self, condition):
        while not condition(self):
            self.take()

    def __enter__(self):
        return self

    def __exit__(self, *error):
        self._stack.close()


def plotted(client, group, name):
    column = [(plot['group'], plot['name']) for plot in client.scene['plots']].index((group, name))
    return client.row[client.scene['columns']['plots'] + column]


def test_the_state_follows_a_slider(live):
    with Client(live.url) as client:
        client.until(lambda client: client.row is not None)
        start = plotted(client, 'joint position', 'theta_1')
        client.ask('effect', name='gravity', enabled=False)
        client.ask('command', joint='theta_1', value=10.0)
        client.ask('play')
        client.until(lambda client: client.time > 0.3)
        assert client.controls['drives']['theta_1'] == {'mode': 'torque', 'value': 10.0}
        assert plotted(client, 'drive torque or force', 'theta_1') == 10.0
        assert plotted(client, 'joint position', 'theta_1') > start + 0.05
        client.ask('pause')
        client.until(lambda client: not client.controls['playing'])
