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
YAML to Mechanism.

Every error names file and line, key path, what was expected and what was got:
``arm.yaml:12: joints.elbow.parent: expected the name of a body or 'ground',
got the text 'uper_arm' (did you mean 'upper_arm'?)``.

"""

from dataclasses import replace

from .document import Document
from .fields import at, keys_of, mapping
from .mechanism import Mechanism, MechanismError
from .validation import checked, is_spatial, SECTIONS, validate_mechanism

# What a massless body need not say, beside its centre of mass.
_NOTHING = {'mass': 0.0, 'inertia': 0.0}

__all__ = ['read_mechanism', 'validate_mechanism']


def read_mechanism(path):
    """
    Read a mechanism from a YAML file.

    Parameters
    ----------
    path : str or pathlib.Path
        Of the file.

    Returns
    -------
    Mechanism

    Raises
    ------
    MechanismError
        Where the file cannot be read or describes no mechanism.

    """
    document = Document(path, MechanismError)
    with document.errors():
        return checked(_mechanism(document.data))


def _mechanism(data):
    """Return a Mechanism of the right keys, its values unchecked."""
    mapping(data, *keys_of(Mechanism))
    mechanism = Mechanism(**{
        key: _records(value, key) if key in SECTIONS else value for key, value in data.items()})
    origin = (0.0, 0.0, 0.0) if is_spatial(mechanism) else (0.0, 0.0)
    bodies = tuple(
        replace(body, center_of_mass=origin)
        if body.massless is True and body.center_of_mass is None else body
        for body in mechanism.bodies or ())
    return replace(mechanism, bodies=bodies)


def _records(section, key):
    """Return the records of one section of the file."""
    record_type, _ = SECTIONS[key]
    required, optional = keys_of(record_type, leave_out=('name',))
    records = []
    with at(key):
        for entry, values in mapping({} if section is None else section).items():
            with at(entry):
                if key == 'bodies' and isinstance(values, dict) and values.get('massless') is True:
                    values = {**_NOTHING, 'center_of_mass': None, **values}
                records.append(record_type(entry, **mapping(values, required, optional)))
    return tuple(records)
