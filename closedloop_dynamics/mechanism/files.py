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

"""Files of limited size, read without waiting for anyone."""

import errno
import os
import stat


def read_file(path, most):
    """
    Return what is in a file, one byte more than it may have at the most.

    Parameters
    ----------
    path : str or pathlib.Path
        Of the file.
    most : int
        How many bytes it may have.

    Returns
    -------
    bytes

    Raises
    ------
    OSError
        Where it cannot be read, or is a pipe or a device.
    ValueError
        Where no path can be so: a NUL, or what no file name can be coded as.

    """
    # Opening a pipe would wait for its other end.
    with open(path, 'rb', opener=lambda name, flags: os.open(
            name, flags | os.O_NONBLOCK)) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, 'a pipe or a device')
        return file.read(most + 1)
