# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A ROS domain for every test, so that tests and people on one host do not hear each other."""

from contextlib import contextmanager
import fcntl
import os
from pathlib import Path
import random
import tempfile

# Beyond 101 the ports of a domain collide with those Linux gives away.
DOMAINS = range(1, 102)


@contextmanager
def reserve_domain():
    """Hold the lock of a free domain while the body runs; yield its number."""
    candidates = random.Random(os.getpid()).sample(DOMAINS, len(DOMAINS))
    for number in candidates:
        path = Path(tempfile.gettempdir()) / f'closedloop_dynamics_domain_{number}.lock'
        try:
            file = path.open('w')
        except OSError:
            # Another user's lock.
            continue
        with file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except OSError:
                continue
            yield number
            return
    raise RuntimeError('all ROS domains of this host are in use by tests')
