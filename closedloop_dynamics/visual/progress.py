# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Show the progress of a long computation on a terminal, and of its preparation."""

from contextlib import contextmanager
import sys
from threading import Timer

from tqdm import tqdm

# What is done sooner shows no bar and no message [s].
SHOW_AFTER = 1.0
BAR = '{desc}: {percentage:3.0f}%|{bar}| {n:.4g} of {total:.4g} {unit} [{elapsed} < {remaining}]'


def progress_bar(total, unit, description):
    """
    Return a bar on stderr, a context manager whose method ``update`` takes the progress.

    It appears after a second, only on a terminal, and is gone at the end.
    """
    return tqdm(total=total, unit=unit, desc=description, file=sys.stderr, disable=None,
                delay=SHOW_AFTER, leave=False, bar_format=BAR)


@contextmanager
def progress_to(total, unit, description):
    """Yield a function that takes how far it is, and shows that as a bar."""
    with progress_bar(total, unit, description) as bar:
        yield lambda done: bar.update(done - bar.n)


@contextmanager
def parts_bar(unit, description):
    """Yield a function that takes the parts done and all parts, and shows them as a bar."""
    with progress_bar(1, unit, description) as bar:

        def progress(done, total):
            bar.total = total
            bar.update(done - bar.n)

        yield progress


@contextmanager
def announced(message):
    """Print a message on stderr if the block takes longer than a second."""
    timer = Timer(SHOW_AFTER, print, (message,), {'file': sys.stderr, 'flush': True})
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()
