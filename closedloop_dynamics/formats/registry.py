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

"""Which files are models in other formats, and what reads and writes them."""

from pathlib import Path

from .building import mechanism_of
from .loops import add_loops
from .mjcf import read_mjcf
from .mjcf_writing import mjcf
from .model import Asked
from .sdf import read_sdf
from .sdf_writing import sdf
from .urdf import read_urdf
from .urdf_writing import urdf_with_loops
from .xml_file import read_xml
from ..mechanism.mechanism import MechanismError

# By the outermost element of a file whose name ends with .xml.
ROOTS = {'mujoco': read_mjcf, 'robot': read_urdf, 'sdf': read_sdf}


def _read_xml(path, asked):
    return ROOTS[read_xml(path, tuple(ROOTS)).tag](path, asked)


READERS = {'.urdf': read_urdf, '.xacro': read_urdf, '.mjcf': read_mjcf, '.xml': _read_xml,
           '.sdf': read_sdf, '.world': read_sdf}
WRITERS = {'.mjcf': mjcf, '.xml': mjcf, '.urdf': urdf_with_loops, '.sdf': sdf, '.world': sdf}


def is_model(path):
    """Tell from its name whether a file is a model in another format."""
    return Path(path).suffix.lower() in READERS


def read_model(path, end_stops=None, loops=None, mend_inertias=False, **asked):
    """
    Read a model in another format as a mechanism.

    Parameters
    ----------
    path : str or pathlib.Path
        Of the file; how its name ends tells the format.
    end_stops : float, optional
        Stiffness that limits of joints become end stops with [N m/rad or N/m].
    loops : mapping, optional
        Loops that the file does not tell (``loops``).
    mend_inertias : bool
        Whether moments of inertia that no body has are changed a little, not refused.
    **asked
        As ``model.Asked`` has it.

    Returns
    -------
    building.Imported

    Raises
    ------
    MechanismError
        With file, line and element.
    FieldError
        Where one of the loops given is none.

    """
    path = Path(path)
    if not is_model(path):
        raise MechanismError(f'{path}: expected a name that ends with one of '
                             f'{", ".join(READERS)}, got another')
    model = READERS[path.suffix.lower()](path, Asked(**asked))
    if loops is not None:
        add_loops(model, loops)
    return mechanism_of(model, end_stops, mend_inertias)
