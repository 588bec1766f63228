# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""The server of pages, with clients that are quick, slow, many, or up to no good."""

from contextlib import ExitStack
import json
import struct
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from closedloop_dynamics.view.feed import Feed
from closedloop_dynamics.view.server import Server, WINDOW
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect

PATIENCE = 30.0


class Client:
    """A page without a browser."""

    def __init__(self, url):
        self._stack = ExitStack()
        self.socket = self._stack.enter_context(connect(
            url.replace('http', 'ws').replace('/?', '/live?')
            if '?' in url else url.replace('http', 'ws') + 'live'))
        self.scene = json.loads(self.socket.recv(timeout=PATIENCE))
        assert self.scene['type'] == 'scene'
        self.controls, self.row, self.number, self.time = {}, None, 0, 0.0

    def ask(self, what, **more):
        self.socket.send(json.dumps({'do': what, **more}))

    def take(self, seen=True):
        """Take the next message; return the number of the frame, or None."""
        data = self.socket.recv(timeout=PATIENCE)
        if isinstance(data, str):
            self.controls = json.loads(data)
            return None
        self.number, self.time = struct.unpack('<Ixxxxd', data[:16])
        self.row = np.frombuffer(data[16:], dtype=np.float32)
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


@pytest.mark.parametrize('text', [
    'nonsense', '[' * 5000, '{}', '[]', '3', 'null', '{"do": "fly"}', '{"do": ["play"]}',
    '{"do": "play", "now": true}', '{"do": "speed"}', '{"do": "speed", "factor": 1e9}',
    '{"do": "speed", "factor": NaN}', '{"do": "speed", "factor": "1"}',
    '{"do": "step", "count": 0}', '{"do": "step", "count": 1.5}',
    '{"do": "step", "count": true}', '{"do": "command", "joint": "theta_1", "value": Infinity}',
    '{"do": "command", "joint": {}, "value": 0}', '{"do": "pull", "at": [0, 0]}',
    '{"do": "seen", "frame": -1}', '{"do": "effect", "name": "gravity", "values": [1]}',
    b'\x00\x01\x02', b''])
def test_nonsense_is_refused_counted_and_changes_nothing(live, text):
    state, refused = live.simulation.state, live.feed.refused
    with Client(live.url) as client:
        client.socket.send(text)
        client.until(lambda client: client.controls.get('refused') == refused + 1)
        assert client.controls['notes'][-1]['text']
        # It goes on with the same page.
        client.ask('step', count=1)
        client.until(lambda client: client.row is not None and client.time > 0.0)
    assert live.feed.refused == refused + 1
    assert len(state) == len(live.simulation.state)


def test_a_message_that_is_too_long_ends_that_page_alone(live):
    with Client(live.url) as other, Client(live.url) as client:
        client.socket.send('x' * 100_000)
        with pytest.raises(ConnectionClosed):
            while True:
                client.socket.recv(timeout=PATIENCE)
        other.ask('play')
        other.until(lambda client: client.row is not None and client.time > 0.1)


def test_who_is_slow_gets_the_newest_and_no_queue():
    feed = Feed({'name': 'test'})
    server = Server(['page'], [feed])
    row = np.zeros(500, dtype=np.float32)
    try:
        with Client(server.url) as client:
            feed.show(0.0, row)
            client.take(seen=False)
            for number in range(2, 400):
                feed.show(float(number), row)
            # What the controls say comes in any case, after the frames before it.
            feed.tell(playing=False)
            frames = [client.number]
            while not client.controls:
                number = client.take(seen=False)
                if number is not None:
                    frames.append(number)
            assert len(frames) <= WINDOW
            feed.show(1000.0, row)
            newest = feed.number
            # One that was not sent says nothing of those that were.
            client.ask('seen', frame=12345678)
            client.ask('seen', frame=frames[-1])
            while client.number != newest:
                client.take(seen=False)
                frames.append(client.number)
            assert client.time == 1000.0 and len(frames) <= 2 * WINDOW + 1
    finally:
        server.close()


def test_ten_pages_come_and_go(live):
    with Client(live.url) as first:
        first.ask('play')
        with ExitStack() as stack:
            clients = [stack.enter_context(Client(live.url)) for _ in range(10)]
            for client in clients:
                begin = client.number
                client.until(lambda client: client.number > begin + 5)
            assert live.feed.pages == 11
        # Without goodbye.
        rude = Client(live.url)
        rude.socket.socket.close()
        time = first.time
        first.until(lambda client: client.time > time + 0.2)
        assert first.controls['playing']
    while live.feed.pages:
        live.server._thread.join(0.01)
    assert live.feed.refused == json.loads(live.feed.controls)['refused']


def test_the_run_goes_on_without_its_server(live):
    with Client(live.url) as client:
        client.ask('play')
        client.until(lambda client: client.row is not None and client.time > 0.1)
    live.server.close()
    time = live.simulation.time
    while live.simulation.time < time + 0.3:
        live.server._thread.join(0.01)
    assert live.runner.playing


def opened(url, **headers):
    try:
        with urlopen(Request(url, headers=headers), timeout=PATIENCE) as answer:
            return answer.status, answer.headers, answer.read()
    except HTTPError as error:
        return error.code, error.headers, b''


def test_pages_are_served_to_this_host_only():
    server = Server(['<p>first</p>', '<p>second</p>'], [Feed({}), Feed({})])
    try:
        status, headers, body = opened(server.url)
        assert (status, body) == (200, b'<p>first</p>') and server.token is None
        assert "default-src 'none'" in headers['Content-Security-Policy']
        assert opened(server.url + '1')[2] == b'<p>second</p>'
        assert opened(server.url + '2')[0] == opened(server.url + '../etc/passwd')[0] == 404
        # Another name that leads here, and a page of another site.
        assert opened(server.url, Host=f'evil.example:{server.port}')[0] == 403
        assert opened(server.url, Host=f'localhost:{server.port}')[0] == 200
        url = server.url.replace('http', 'ws') + 'live'
        with pytest.raises(InvalidStatus, match='403'), connect(
                url, origin='https://evil.example'):
            pass
        with connect(url, origin=server.url.rstrip('/')):
            pass
    finally:
        server.close()


def test_a_token_is_needed_where_others_may_listen():
    server = Server(['<p>page</p>'], [Feed({'name': 'test'})], host='0.0.0.0')
    try:
        assert server.token and server.token in server.url and len(server.token) > 16
        here = f'http://127.0.0.1:{server.port}/'
        assert opened(here)[0] == opened(here + '?token=guess')[0] == 403
        assert opened(f'{here}?token={server.token}')[2] == b'<p>page</p>'
        with pytest.raises(InvalidStatus, match='403'), connect(
                here.replace('http', 'ws') + 'live'):
            pass
        with Client(f'{here}?token={server.token}') as client:
            assert client.scene['name'] == 'test'
    finally:
        server.close()


def test_a_port_that_is_taken_is_refused():
    server = Server(['page'], [])
    try:
        with pytest.raises(OSError):
            Server(['page'], [], port=server.port)
    finally:
        server.close()
