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

"""
Compile the rank-revealing path of a scene, for other processes to find it on disk.

    python -m closedloop_dynamics.ros.prepare SCENE PARENT

The least urgent process of all; it ends with the process of number PARENT.

"""

import fcntl
import os
import sys

from closedloop_dynamics.ros.child import die_with

LOWEST_PRIORITY = 19


def prepare(scene):
    """
    Compile the rank-revealing path, unless another process does or has done so.

    Parameters
    ----------
    scene : str
        Name of a shipped scene, or path of a file.

    """
    from closedloop_dynamics.core import cache
    from closedloop_dynamics.integration import ahead
    from closedloop_dynamics.simulation.simulation import Simulation
    system = Simulation.from_scene(scene).system
    if cache.directory() is None:
        sys.exit('there is no place to store compiled code')
    with (cache.directory() / 'prepare.lock').open('w') as lock:
        # Who waited finds all of it on disk.
        fcntl.flock(lock, fcntl.LOCK_EX)
        for get_ready in ahead.preparations(system):
            get_ready()
    if not ahead.is_stored(system):
        sys.exit('compiled code could not be stored')


if __name__ == '__main__':
    die_with(int(sys.argv[2]))
    os.nice(LOWEST_PRIORITY)
    prepare(sys.argv[1])
