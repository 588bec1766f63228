# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The effects that a scene may list, by their ``type``.

A new effect is one file beside this one, holding a frozen dataclass of its parameters that checks
itself when built, and its law on symbols (``force_law``), if it has one; and one line here.
"""

from .actuator import Actuator
from .body_contact import BodyContact
from .bushing import Bushing
from .cable import Cable
from .contact import Contact
from .end_stop import EndStop
from .external_force import ExternalForce
from .fluid_drag import FluidDrag
from .force_table import ForceTable
from .gravity import Gravity
from .joint_damping import JointDamping
from .joint_friction import JointFriction
from .joint_spring import JointSpring
from .law import Law
from .magnetic_spring import MagneticSpring
from .payload import Payload
from .point_spring import PointSpring
from .prescribed_force import PrescribedForce
from .prescribed_motion import PrescribedMotion
from .rotor import Rotor
from .sensor import Sensor
from .tendon import Tendon
from .tendon_friction import TendonFriction
from .tendon_inertia import TendonInertia

EFFECTS = {
    'actuator': Actuator,
    'body_contact': BodyContact,
    'bushing': Bushing,
    'cable': Cable,
    'contact': Contact,
    'end_stop': EndStop,
    'external_force': ExternalForce,
    'fluid_drag': FluidDrag,
    'force_table': ForceTable,
    'gravity': Gravity,
    'joint_damping': JointDamping,
    'joint_friction': JointFriction,
    'joint_spring': JointSpring,
    'law': Law,
    'magnetic_spring': MagneticSpring,
    'payload': Payload,
    'point_spring': PointSpring,
    'prescribed_force': PrescribedForce,
    'prescribed_motion': PrescribedMotion,
    'rotor': Rotor,
    'sensor': Sensor,
    'tendon': Tendon,
    'tendon_friction': TendonFriction,
    'tendon_inertia': TendonInertia,
}


def effect_type(record):
    """Return the name that a scene gives the type of a record; of a user's class its own."""
    return next((name for name, kind in EFFECTS.items() if kind is type(record)),
                type(record).__name__)
