# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Serves pages over HTTP and their data over websockets, in a thread of its own.

A page gets frames as fast as it says that it has shown them, always the newest. It may be slow,
go away, or send nonsense: what computes does not wait for it.
"""

import asyncio
from contextlib import suppress
import hmac
from http import HTTPStatus
import ipaddress
import secrets
import threading
from urllib.parse import parse_qs, urlsplit

from ..mechanism.extras import of_an_extra

with of_an_extra():
    from websockets.asyncio.server import serve
    from websockets.datastructures import Headers
    from websockets.exceptions import ConnectionClosed
    from websockets.http11 import Response

# Frames on the way to a page that it has not shown yet.
WINDOW = 3
# Bytes of a message that a page may send.
LARGEST_MESSAGE = 2 ** 20
# How long to wait for pages at the end [s].
PATIENCE = 1.0
# For the answer to a ping [s]: a computer that is very busy is not gone.
SILENCE = 120.0
LOCAL = '127.0.0.1'
LOCAL_NAMES = ('localhost', '127.0.0.1', '[::1]')
# A page may load nothing from elsewhere, and talk to this server only.
POLICY = ("default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
          "img-src 'self' data: blob:; connect-src 'self'; frame-ancestors 'none'; "
          "base-uri 'none'")


class Server:
    """
    Serves one page for each feed: ``/``, ``/1``, ...

    ``pages`` are HTML; there are no ``feeds`` where they have all that they show. With any
    ``host`` but those of this host a token is needed; ``port`` 0: any that is free; ``resource``
    returns the kind and the bytes of what else can be asked for, by its path; None where there is
    nothing. ``url``: of the first page, with the token if there is one. OSError, OverflowError
    where the port cannot be had.
    """

    def __init__(self, pages, feeds, host=LOCAL, port=0, resource=lambda path: None):
        self._pages, self._feeds = [page.encode() for page in pages], feeds
        self._host, self._resource = host, resource
        self.token = None if is_local(host) else secrets.token_urlsafe(16)
        self._started, self._error = threading.Event(), None
        self._loop, self._over, self._attending = None, None, set()
        self._wanted_port, self.port = port, None
        self.thread = threading.Thread(target=self._run, name='view_server', daemon=True)
        self.thread.start()
        self._started.wait()
        if self._error is not None:
            raise self._error
        name = f'[{host}]' if ':' in host else host
        self.url = f'http://{name}:{self.port}/' + (f'?token={self.token}' if self.token else '')

    def close(self):
        """End all connections and stop listening."""
        with suppress(RuntimeError):
            # The loop may be over already.
            self._loop.call_soon_threadsafe(self._over.set)
        self.thread.join(2.0 * PATIENCE)

    def _run(self):
        asyncio.run(self._serve())

    async def _serve(self):
        self._loop, self._over = asyncio.get_running_loop(), asyncio.Event()
        try:
            server = await serve(
                self._attend, self._host, self._wanted_port, process_request=self._answer,
                max_size=LARGEST_MESSAGE, compression=None, close_timeout=PATIENCE,
                ping_timeout=SILENCE,
                server_header=None)
        except (OSError, OverflowError) as error:
            self._error = error
            self._started.set()
            return
        self.port = server.sockets[0].getsockname()[1]
        self._started.set()
        await self._over.wait()
        server.close()
        # For pages only: a browser also opens connections that it asks nothing of for seconds.
        if self._attending:
            await asyncio.wait(self._attending, timeout=PATIENCE)

    # Pages.

    async def _answer(self, connection, request):
        """Answer a request that is not to become a websocket, 400 if it is malformed."""
        try:
            return await self._response_to(connection, request)
        except (LookupError, ValueError):
            # Headers given twice; addresses and numbers that cannot be read.
            return _response(HTTPStatus.BAD_REQUEST, 'text/plain', b'Malformed request.\n')

    async def _response_to(self, connection, request):
        """Return the response to a request, None if it may become a websocket."""
        address = urlsplit(request.path)
        if not self._may(request, address):
            return _response(HTTPStatus.FORBIDDEN, 'text/plain', (
                b'Open the address that `closedloop view` has printed, as a whole.\n'))
        # Files are read and pictures drawn while pages get their frames.
        found = await asyncio.to_thread(self._resource, address.path)
        if found is not None:
            return _response(HTTPStatus.OK, *found)
        name = address.path.strip('/').removesuffix('live').strip('/')
        if name and not (name.isdecimal() and int(name) < len(self._pages)):
            return _response(HTTPStatus.NOT_FOUND, 'text/plain', b'There is no such page.\n')
        if not address.path.endswith('live'):
            return _response(HTTPStatus.OK, 'text/html; charset=utf-8',
                             self._pages[int(name or 0)])
        if not self._feeds:
            return _response(HTTPStatus.NOT_FOUND, 'text/plain', b'Nothing runs here.\n')
        connection.feed = self._feeds[int(name or 0)]
        return None

    def _may(self, request, address):
        """Return whether a request comes from a permitted page of this server."""
        host = request.headers.get('Host', '')
        if self.token is None:
            # A name that leads here by the DNS of somebody else is not ours.
            if host.removesuffix(f':{self.port}').lower() not in LOCAL_NAMES:
                return False
        else:
            given = parse_qs(address.query).get('token', [''])[0]
            if not hmac.compare_digest(given.encode(), self.token.encode()):
                return False
        # Browsers say which page opens a websocket: another site's must not.
        origin = request.headers.get('Origin')
        return origin is None or urlsplit(origin).netloc == host

    # Websockets.

    async def _attend(self, connection):
        """Send a page its scene and rows, and take its requests, until it goes."""
        feed, changed = connection.feed, asyncio.Event()
        page = _Page(connection, feed, changed)

        def wake():
            with suppress(RuntimeError):
                # The loop may be over already.
                self._loop.call_soon_threadsafe(changed.set)

        attending = asyncio.current_task()
        self._attending.add(attending)
        attending.add_done_callback(self._attending.discard)
        feed.on_change.append(wake)
        feed.pages += 1
        sending = asyncio.create_task(page.send())
        try:
            async for text in connection:
                page.hear(text)
        except ConnectionClosed:
            # A tab was closed, or a network was lost.
            pass
        finally:
            feed.on_change.remove(wake)
            feed.pages -= 1
            sending.cancel()
            feed.leave(page)


class _Page:
    """One page that is open."""

    def __init__(self, connection, feed, changed):
        self._connection, self._feed, self._changed = connection, feed, changed
        self._sent, self._seen = [], 0
        changed.set()

    def hear(self, text):
        """Receive the messages of the page."""
        seen = self._feed.accept(self, text)
        if seen in self._sent:
            del self._sent[:self._sent.index(seen) + 1]
            self._changed.set()

    async def send(self):
        """Send what is new, as long as the page keeps up."""
        with suppress(ConnectionClosed):
            described, version, number, sampled = 0, 0, 0, 0
            while True:
                await self._changed.wait()
                self._changed.clear()
                if self._feed.described != described:
                    described = self._feed.described
                    # A page does not show frames that came before, nor say that it has.
                    self._sent.clear()
                    await self._connection.send(self._feed.description)
                # What belongs to a description that the page does not have yet comes after that.
                newest, controls = self._feed.version, self._feed.controls
                if newest != version and self._feed.described == described:
                    version = newest
                    await self._connection.send(controls)
                if self._feed.number != number and len(self._sent) < WINDOW:
                    frame = self._feed.frame(sampled)
                    if self._feed.described == described:
                        frame, number, sampled = frame
                        self._sent.append(number)
                        await self._connection.send(frame)
                if self._feed.described != described:
                    self._changed.set()


def is_local(host):
    """Return whether an address can be reached from this host only."""
    if host == 'localhost':
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _response(status, kind, body):
    return Response(status.value, status.phrase, Headers({
        'Content-Type': kind, 'Content-Length': str(len(body)), 'Connection': 'close',
        'Content-Security-Policy': POLICY, 'X-Content-Type-Options': 'nosniff',
        'Referrer-Policy': 'no-referrer', 'Cache-Control': 'no-store'}), body)
