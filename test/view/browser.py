# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A real browser without a window, driven over its DevTools port."""

import base64
from contextlib import contextmanager
import io
import itertools
import json
import os
from pathlib import Path
import shutil
import signal
import subprocess
import tempfile
import time

from closedloop_dynamics.ros.background import die_with
import numpy as np
from PIL import Image
from websockets.sync.client import connect

NAMES = ('chromium', 'chromium-browser', 'google-chrome', 'chrome')
# Longest wait for a browser on a busy machine [s].
PATIENCE = 240.0
# After which a picture is asked for again [s]: the browser may lose the frame that it waits for.
FRAME_PATIENCE = 15.0
# A page works the same whether it is in front or behind others, and where /dev/shm is small.
STEADY = ('--disable-background-timer-throttling', '--disable-backgrounding-occluded-windows',
          '--disable-renderer-backgrounding', '--disable-hang-monitor', '--disable-dev-shm-usage',
          '--disable-component-update', '--disable-default-apps', '--disable-sync',
          '--no-default-browser-check', '--password-store=basic', '--allow-pre-commit-input')
# What a page shows and knows, for messages.
SEEN = """JSON.stringify([document.visibilityState, document.body?.innerText.slice(0, 300),
    typeof page === "undefined" ? null : [page.lost, page.playing, page.now, page.frame?.time,
    page.frame?.number, page.fresh, page.timeline?.past, page.history?.begin, page.history?.end,
    page.socket?.readyState, page.controls?.playing]])"""


def program():
    """Return the path of a browser, or None."""
    return next(filter(None, map(shutil.which, NAMES)), None)


@contextmanager
def browser():
    """Run a browser; yield a function that opens a page in it."""
    parent = os.getpid()
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as home:
        process = subprocess.Popen(
            [program(), '--headless=new', '--no-sandbox', '--disable-gpu-sandbox',
             '--use-angle=swiftshader', '--enable-unsafe-swiftshader', '--no-first-run',
             '--disable-gpu-rasterization', '--disable-accelerated-2d-canvas',
             '--disable-extensions', '--disable-background-networking', '--hide-scrollbars',
             *STEADY, '--remote-debugging-port=0', f'--user-data-dir={home}', 'about:blank'],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            preexec_fn=lambda: die_with(parent, signal.SIGKILL))
        try:
            reported = Path(home, 'DevToolsActivePort')
            end = time.monotonic() + PATIENCE
            while not (reported.is_file() and len(reported.read_text().splitlines()) == 2):
                assert process.poll() is None and time.monotonic() < end, 'no browser'
                time.sleep(0.05)
            port, path = reported.read_text().splitlines()
            with connect(f'ws://127.0.0.1:{port}{path}', max_size=None, open_timeout=PATIENCE,
                         ping_interval=None) as socket:
                tabs = []
                yield lambda *arguments, **options: Tab(socket, tabs, *arguments, **options)
        finally:
            process.kill()
            process.wait()


class Tab:
    """One page in the browser."""

    numbers = itertools.count(1)

    def __init__(
            self, socket, tabs, url, width=1280, height=800, dark=False, phone=False,
            scripts=True):
        """
        Open it, with a size in CSS pixels and a theme; its own scripts may be blocked.

        ``tabs``: those of the browser that are open.
        """
        self._socket, self._tabs = socket, tabs
        tabs.append(self)
        target = self._do('Target.createTarget', url='about:blank')['targetId']
        self._session = None
        self._session = self._do('Target.attachToTarget', targetId=target,
                                 flatten=True)['sessionId']
        self._do('Emulation.setDeviceMetricsOverride', width=width, height=height,
                 deviceScaleFactor=2 if phone else 1, mobile=phone)
        self._do('Emulation.setEmulatedMedia', features=[
            {'name': 'prefers-color-scheme', 'value': 'dark' if dark else 'light'}])
        self._do('Emulation.setScriptExecutionDisabled', value=not scripts)
        # Input reaches the page whichever window the browser takes for the active one.
        self._do('Page.bringToFront')
        self._do('Emulation.setFocusEmulationEnabled', enabled=True)
        self.errors = []
        self._do('Runtime.enable')
        self._do('Page.enable')
        self._do('Page.navigate', url=url)
        self._target = target

    def _do(self, method, patience=PATIENCE, **parameters):
        number = next(self.numbers)
        message = {'id': number, 'method': method, 'params': parameters}
        if getattr(self, '_session', None):
            message['sessionId'] = self._session
        self._socket.send(json.dumps(message))
        while True:
            answer = json.loads(self._socket.recv(timeout=patience))
            if answer.get('method') == 'Runtime.exceptionThrown':
                self.errors.append(answer['params']['exceptionDetails'])
            if answer.get('id') == number:
                assert 'error' not in answer, answer
                return answer['result']

    def ask(self, script):
        """Return the value of an expression in the page."""
        result = self._do('Runtime.evaluate', expression=script, returnByValue=True,
                          awaitPromise=True)
        assert 'exceptionDetails' not in result, result
        return result['result'].get('value')

    def wait(self, condition, patience=PATIENCE):
        """Wait until an expression in the page is true."""
        end = time.monotonic() + patience
        while not self.ask(condition):
            assert time.monotonic() < end, (
                f'never true: {condition}; errors: {self.errors}; page: {self.ask(SEEN)}')
            time.sleep(0.05)

    def picture(self):
        """Return what is seen once the page has drawn its state, shape (height, width, 3)."""
        self.ask('new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)))')
        end, data = time.monotonic() + PATIENCE, None
        while data is None:
            try:
                data = self._do('Page.captureScreenshot', FRAME_PATIENCE, format='png')['data']
            except TimeoutError:
                assert time.monotonic() < end, 'the browser takes no picture'
        return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert('RGB'))

    def download(self, selector, folder):
        """Click, and return the path of the file that the browser saves in an empty folder."""
        self._do('Browser.setDownloadBehavior', behavior='allow', downloadPath=str(folder))
        self.click(selector)
        end = time.monotonic() + PATIENCE
        while not (found := [path for path in folder.iterdir()
                             if path.suffix != '.crdownload' and path.stat().st_size]):
            assert time.monotonic() < end, f'{selector} saves nothing'
            time.sleep(0.05)
        return found[0]

    def mouse(self, kind, x, y, buttons=0, modifiers=0):
        """Let the mouse do something: ``mousePressed``, ``mouseMoved``, ``mouseReleased``."""
        self._input(
            {'mousePressed': 'pointerdown', 'mouseReleased': 'pointerup',
             'mouseMoved': 'pointermove' if buttons else None}[kind],
            'Input.dispatchMouseEvent', type=kind, x=x, y=y, buttons=buttons,
            modifiers=modifiers,
            button='left' if kind != 'mouseMoved' or buttons else 'none', clickCount=1)

    def touch(self, *places):
        """Put a finger down at the first place, and lead it over the others."""
        for place, kind in zip(places, ('touchStart', *('touchMove',) * len(places))):
            self._do('Input.dispatchTouchEvent', type=kind,
                     touchPoints=[{'x': place[0], 'y': place[1], 'id': 1}])
        self._do('Input.dispatchTouchEvent', type='touchEnd', touchPoints=[])

    def _input(self, event, method, **parameters):
        """
        Send input, again where it does not reach the page: a busy browser may drop it.

        What is only late arrives twice then; the page gets the first one.
        """
        if event is None:
            self._do(method, **parameters)
            return
        self._expect(event, 'window')
        end = time.monotonic() + PATIENCE
        # The browser answers when the page has handled the event.
        self._do(method, **parameters)
        while not self.ask(f'window.arrived?.{event}'):
            assert time.monotonic() < end, f'{event} never arrives'
            self._do(method, **parameters)

    def _expect(self, event, where):
        """Let the page tell whether an event has arrived, and get no second one."""
        self.ask(f"""(() => {{
            window.arrived ??= {{}};
            window.unguard ??= {{}};
            window.unguard.{event}?.();
            window.arrived.{event} = false;
            const element = {where}, listen = (event) => {{
              if (!event.isTrusted || event.pointerType === "touch") return;
              // A label makes a click of a click, at the same time; a move again changes nothing.
              const first = window.arrived.{event} || event.timeStamp;
              if (event.timeStamp !== first && event.type !== "pointermove") {{
                event.stopImmediatePropagation();
                event.preventDefault();
              }}
              window.arrived.{event} = first;
            }};
            element.addEventListener("{event}", listen, true);
            window.unguard.{event} = () => element.removeEventListener("{event}", listen, true);
        }})()""")

    def click(self, selector):
        """Click on what a CSS selector finds, again where it has moved meanwhile."""
        self._expect('click', f'document.querySelector({json.dumps(selector)})')
        end = time.monotonic() + PATIENCE
        while not self.ask('window.arrived?.click'):
            assert time.monotonic() < end, f'{selector} gets no click'
            x, y = self.middle(selector)
            self.mouse('mouseMoved', x, y)
            self.mouse('mousePressed', x, y, 1)
            self.mouse('mouseReleased', x, y)

    def press(self, key):
        """Press a key that writes a letter."""
        for kind in ('keyDown', 'keyUp'):
            self._input(kind.lower(), 'Input.dispatchKeyEvent', type=kind, key=key,
                        windowsVirtualKeyCode=ord(key.upper()),
                        **({'text': key} if kind == 'keyDown' else {}))

    def press_escape(self):
        """Press Escape."""
        for kind in ('keyDown', 'keyUp'):
            self._input(kind.lower(), 'Input.dispatchKeyEvent', type=kind, key='Escape',
                        code='Escape', windowsVirtualKeyCode=27)

    def middle(self, selector):
        """Return where the middle of what a CSS selector finds is."""
        return self.ask(f"""(() => {{
            const e = document.querySelector({json.dumps(selector)});
            e.scrollIntoView({{block: "nearest"}});
            const box = e.getBoundingClientRect();
            return [box.x + box.width / 2, box.y + box.height / 2]; }})()""")

    def close(self):
        """Close the page."""
        self._session = None
        self._do('Target.closeTarget', targetId=self._target)
        self._tabs.remove(self)
        if self._tabs:
            # Pages behind others are not drawn.
            self._tabs[-1]._do('Page.bringToFront')
