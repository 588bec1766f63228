# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Files of limited size, read without waiting for anyone."""

import errno
import os
import stat


def read_file(path, most):
    """
    Return the contents of a file, bytes, up to one beyond its limit.

    OSError where it cannot be read, or is a pipe or a device; ValueError where no path can be so:
    a NUL, or what no file name can be coded as.
    """
    # Opening a pipe would wait for its other end.
    with open(path, 'rb', opener=lambda name, flags: os.open(
            name, flags | os.O_NONBLOCK)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, 'a pipe or a device')
        return file.read(most + 1)
