# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
How many frames per second a page of ``closedloop view`` shows, and what that costs.

For each scene it starts the command, opens its page in Chromium without a window, which draws
WebGL by the processor, and lets it run in real time, its drives held. Printed are the frames that
a client without a browser gets when it asks for the next one at once, those that the page has
drawn, the distances between them, and the shares of a core that the command and the browser took.
It ends with 1 if the page has shown fewer frames than ``--least``.
"""

import argparse
import os
from pathlib import Path
import subprocess
import sys
import time

from machine import description, ROOT
import numpy as np

sys.path.insert(0, str(ROOT))

from test.view.browser import browser  # noqa: E402,I100
from test.view.client import Client  # noqa: E402,I100

COMMAND = [sys.executable, '-m', 'closedloop_dynamics.cli', 'view', '--no-open', '--port', '0']
READY = 'typeof page !== "undefined" && Boolean(page.shownRow) && Boolean(page.told)'
# Counts the frames that the page takes, with their times [ms].
COUNTING = """(() => {
    window.shownAt = [];
    const draw = page.picture.draw.bind(page.picture);
    let last = null;
    page.picture.draw = (theme) => {
        draw(theme);
        if (page.frame.number !== last) window.shownAt.push(performance.now());
        last = page.frame.number;
    };
})()"""


def processes():
    """Return parent and CPU time [s] of every process, by its number."""
    found, tick = {}, os.sysconf('SC_CLK_TCK')
    for path in Path('/proc').glob('[0-9]*/stat'):
        try:
            fields = path.read_text().rpartition(')')[2].split()
        except OSError:
            # It has ended meanwhile.
            continue
        found[int(path.parent.name)] = int(fields[1]), (int(fields[11]) + int(fields[12])) / tick
    return found


def cpu_time(root, without=()):
    """Return the CPU time of a process and of all that it has started [s]."""
    known = processes()
    wanted, total = [root], 0.0
    while wanted:
        one = wanted.pop()
        total += known.get(one, (0, 0.0))[1]
        wanted += [number for number, (parent, _) in known.items()
                   if parent == one and number not in without]
    return total


def client_rate(url, duration):
    """Return the frames per second of a client that is always ready."""
    with Client(url) as client:
        client.until(lambda client: client.row is not None)
        start, count = time.monotonic(), 0
        while time.monotonic() < start + duration:
            count += client.take() is not None
        return count / (time.monotonic() - start)


def measured(scene, duration, open_page, size):
    """Return what one scene gives, as a row of the table."""
    server = subprocess.Popen([*COMMAND, scene], stdout=subprocess.PIPE, text=True)
    try:
        url = next(line for line in server.stdout if line.startswith('http')).strip()
        with Client(url) as client:
            client.until(lambda client: client.controls.get('drives'))
            # Held, it stays in the middle of the picture.
            for joint in client.controls['drives']:
                client.ask('drive', joint=joint, mode='position')
            client.ask('play')
            client.until(lambda client: client.controls.get('playing'))
        begin = cpu_time(server.pid), time.monotonic()
        alone = client_rate(url, duration)
        alone_share = (cpu_time(server.pid) - begin[0]) / (time.monotonic() - begin[1])
        tab = open_page(url, *size)
        tab.wait(READY)
        # Compiled shaders, filled caches.
        time.sleep(2.0)
        tab.ask(COUNTING)
        # The browser is a child of this process, as the server is.
        start = [cpu_time(server.pid), cpu_time(os.getpid(), (server.pid,)), time.monotonic()]
        time.sleep(duration)
        taken = [cpu_time(server.pid), cpu_time(os.getpid(), (server.pid,)), time.monotonic()]
        shown = np.array(tab.ask('window.shownAt'))
        own, around, passed = (after - before for after, before in zip(taken, start))
        tab.close()
    finally:
        server.terminate()
        server.wait()
    periods = np.diff(shown)
    return (alone, 100.0 * alone_share, len(shown) / passed, *np.percentile(periods, (50, 99)),
            100.0 * own / passed, 100.0 * around / passed)


def main():
    """Print a line for each scene."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('scenes', nargs='*', default=['stewart_platform'])
    parser.add_argument('--duration', type=float, default=10.0, help='of each measurement [s]')
    parser.add_argument('--size', type=int, nargs=2, default=(1280, 800),
                        help='of the page [pixels]')
    parser.add_argument('--least', type=float, default=0.0,
                        help='frames per second that the page is to show')
    arguments = parser.parse_args()
    print(description())
    print('scene, client [Hz], command [% of a core] | page [Hz], period median and 99 % [ms], '
          'command and browser [% of a core]; load of the machine')
    slowest = np.inf
    with browser() as open_page:
        for scene in arguments.scenes:
            row = measured(scene, arguments.duration, open_page, arguments.size)
            slowest = min(slowest, row[2])
            print('{}: {:.1f} Hz, {:.0f} % | {:.1f} Hz, {:.1f} and {:.1f} ms, {:.0f} and {:.0f} %'
                  '; load {:.1f}'.format(scene, *row, os.getloadavg()[0]), flush=True)
    return int(slowest < arguments.least)


if __name__ == '__main__':
    sys.exit(main())
