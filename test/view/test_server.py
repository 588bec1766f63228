# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The server of pages, with clients that are quick, slow, many, or up to no good."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
import json
import socket
from test.view.client import Client, PATIENCE
from threading import Event
from urllib.error import HTTPError
from urllib.request import Request, urlopen

from closedloop_dynamics.view.feed import Feed
from closedloop_dynamics.view.server import LARGEST_MESSAGE, Server, WINDOW
import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import connect


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
        client.socket.send('x' * (LARGEST_MESSAGE + 1))
        with pytest.raises(ConnectionClosed):
            while True:
                client.socket.recv(timeout=PATIENCE)
        other.ask('play')
        other.until(lambda client: client.row is not None and client.time > 0.1)


def test_who_is_slow_gets_the_newest_and_no_queue():
    feed = Feed({'name': 'test', 'columns': {'width': 500}})
    server = Server(['page'], [feed])
    row = np.zeros(500, dtype=np.float32)
    try:
        with Client(server.url) as client:
            feed.show(0.0, row)
            client.take(seen=False)
            for number in range(2, 400):
                feed.show(float(number), row)
            # What the controls say comes in any case, after the frames before it.
            feed.send_controls(playing=False)
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
        live.server.thread.join(0.01)
    assert live.feed.refused == json.loads(live.feed.controls)['refused']


def test_the_run_goes_on_without_its_server(live):
    with Client(live.url) as client:
        client.ask('play')
        client.until(lambda client: client.row is not None and client.time > 0.1)
    live.server.close()
    time = live.simulation.time
    while live.simulation.time < time + 0.3:
        live.server.thread.join(0.01)
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
                url, origin='https://evil.example', open_timeout=PATIENCE):
            pass
        with connect(url, origin=server.url.rstrip('/'), open_timeout=PATIENCE):
            pass
    finally:
        server.close()


MALFORMED = {
    'digits': ('/' + 5000 * '9', ''), 'digits of a websocket': (f'/{5000 * "9"}/live', ''),
    'two origins': ('/', 'Origin: http://localhost:{port}\r\nOrigin: http://evil.example\r\n'),
    'two hosts': ('/', 'Host: localhost:{port}\r\n'),
    'origin': ('/', 'Origin: http://[\r\n'), 'address': ('//[x]:7/', ''),
    'letters': ('/\xe9', ''), 'letters of a header': ('/', 'Origin: \xe9\r\n'),
    'token': ('/?token=\xff', ''), 'no header': ('/', 'nothing\r\n'),
    'length': ('/', 'Content-Length: x\r\n'), 'body': ('/', 'Content-Length: 9\r\n'),
}


@pytest.mark.parametrize('host', ['127.0.0.1', '0.0.0.0'])
@pytest.mark.parametrize('path, headers', MALFORMED.values(), ids=MALFORMED)
def test_malformed_requests_are_refused_quietly(caplog, capfd, host, path, headers):
    server = Server(['<p>page</p>'], [Feed({})], host)
    path += f'?token={server.token}' if server.token and '?' not in path else ''
    text = f'GET {path} HTTP/1.1\r\nHost: localhost:{{port}}\r\n{headers}\r\n'
    try:
        with socket.create_connection(('127.0.0.1', server.port), PATIENCE) as connection:
            connection.sendall(text.format(port=server.port).encode('latin-1'))
            answer = b''.join(iter(lambda: connection.recv(4096), b''))
        # What is not HTTP at all ends the connection without an answer.
        assert answer.split()[1:2] in ([], [b'400'], [b'403'])
        assert opened(server.url)[0] == 200
    finally:
        server.close()
    assert not [record for record in caplog.records if record.levelname == 'ERROR']
    assert capfd.readouterr().err == ''


def test_a_token_is_needed_where_others_may_listen():
    server = Server(['<p>page</p>'], [Feed({'name': 'test'})], host='0.0.0.0')
    try:
        assert server.token and server.token in server.url and len(server.token) > 16
        here = f'http://127.0.0.1:{server.port}/'
        assert opened(here)[0] == opened(here + '?token=guess')[0] == 403
        assert opened(f'{here}?token={server.token}')[2] == b'<p>page</p>'
        with pytest.raises(InvalidStatus, match='403'), connect(
                here.replace('http', 'ws') + 'live', open_timeout=PATIENCE):
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
        with pytest.raises(OverflowError):
            Server(['page'], [], port=70_000)
    finally:
        server.close()


def test_a_connection_that_asks_for_nothing_holds_up_no_end():
    server = Server(['page'], [Feed({'name': 'test'})])
    # As a browser opens them ahead of need.
    with socket.create_connection(('127.0.0.1', server.port)), Client(server.url):
        server.close()
        assert not server.thread.is_alive()


def test_a_page_that_is_opened_late_gets_the_states_before(live):
    with Client(live.url) as first:
        first.ask('play')
        first.until(lambda client: client.row is not None and client.time > 1.0)
        with Client(live.url) as late:
            late.until(lambda client: client.row is not None)
            assert late.samples[0][0] < 0.1 and late.time > 1.0


def test_files_are_read_while_pages_get_their_frames():
    feed, asked, over = Feed({'name': 'test', 'columns': {'width': 1}}), Event(), Event()

    def resource(path):
        if path != '/slow':
            return None
        asked.set()
        over.wait(PATIENCE)
        return 'text/plain', b'read'

    server = Server(['page'], [feed], resource=resource)
    try:
        with ThreadPoolExecutor(1) as pool, Client(server.url) as client:
            answer = pool.submit(lambda: urlopen(f'{server.url}slow').read())
            assert asked.wait(PATIENCE)
            feed.show(3.0, np.zeros(1, dtype=np.float32))
            while client.number != feed.number:
                client.take()
            assert client.time == 3.0 and not answer.done()
            over.set()
            assert answer.result() == b'read'
    finally:
        over.set()
        server.close()


def test_frames_of_an_earlier_machine_are_not_waited_for():
    # A page that gets another machine drops the frames that it has not drawn, without a word.
    description = {'name': 'test', 'columns': {'width': 5}}
    feed = Feed(description)
    server = Server(['page'], [feed])
    row = np.zeros(5, dtype=np.float32)
    try:
        with Client(server.url) as client:
            for number in range(WINDOW + 2):
                feed.describe({**description, 'number': number}, float(number), row)
                while client.time != number or client.row is None:
                    client.take(seen=False)
                client.row = None
    finally:
        server.close()
