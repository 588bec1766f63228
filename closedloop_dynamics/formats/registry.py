# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Formats of models, with their readers and writers."""

from importlib import import_module
from pathlib import Path

from ..mechanism.mechanism import MechanismError, TOLERANCE

# Modules and functions, imported when a file needs them: most simulations read no other format.
_MJCF, _URDF, _SDF = ('mjcf', 'read_mjcf'), ('urdf', 'read_urdf'), ('sdf', 'read_sdf')
# Readers by the outermost element of a file whose name ends with .xml.
ROOTS = {'mujoco': _MJCF, 'robot': _URDF, 'sdf': _SDF}
# Readers and writers by how a file's name ends.
READERS = {'.urdf': _URDF, '.xacro': _URDF, '.mjcf': _MJCF, '.xml': ROOTS, '.sdf': _SDF,
           '.world': _SDF}
_TO_MJCF, _TO_SDF = ('mjcf_writing', 'mjcf'), ('sdf_writing', 'sdf')
WRITERS = {'.mjcf': _TO_MJCF, '.xml': _TO_MJCF, '.urdf': ('urdf_writing', 'urdf_with_loops'),
           '.sdf': _TO_SDF, '.world': _TO_SDF}


def _function(place):
    module, name = place
    return getattr(import_module(f'.{module}', __package__), name)


def writer(suffix):
    """Return the function that writes a format, by the ending of the file's name, in WRITERS."""
    return _function(WRITERS[suffix])


def is_model(path):
    """Return whether a file is, by its name, a model in another format."""
    return Path(path).suffix.lower() in READERS


def read_model(path, end_stops=None, loops=None, mend_inertias=False, tolerance=TOLERANCE,
               **options):
    """
    Read a model in another format as a mechanism.

    Parameters
    ----------
    path : str or pathlib.Path
        Of the file; how its name ends gives the format.
    end_stops : float, optional
        Stiffness that limits of joints become end stops with [N m/rad or N/m].
    loops : mapping, optional
        Loops that the file does not describe (``loops``).
    mend_inertias : bool
        Whether moments of inertia that no body has are changed a little, not refused.
    tolerance : float
        As of a Mechanism.
    **options
        As ``model.ReadOptions`` has it.

    Returns
    -------
    building.Imported

    Raises
    ------
    MechanismError
        With file, line and element.
    FieldError
        Where one of the loops given is invalid.

    """
    path = Path(path)
    if not is_model(path):
        raise MechanismError(f'{path}: expected a name that ends with one of '
                             f'{", ".join(READERS)}, got another')
    # Here, as they are imported with the reader.
    from .building import mechanism_of
    from .loops import add_loops
    from .model import ReadOptions
    from .xml_file import read_xml
    place = READERS[path.suffix.lower()]
    if place is ROOTS:
        place = ROOTS[read_xml(path, tuple(ROOTS)).tag]
    model = _function(place)(path, ReadOptions(**options))
    if loops is not None:
        add_loops(model, loops)
    return mechanism_of(model, end_stops, mend_inertias, tolerance)
