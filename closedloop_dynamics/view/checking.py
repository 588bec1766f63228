# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Findings on a scene while it is drawn: degrees of freedom, repeated equations, faults."""

from dataclasses import replace
import re

from ..kinematics.assembly import Assembler
from ..kinematics.geometry import Geometry
from ..kinematics.motions import with_motions
from ..kinematics.redundancy import find_redundancy, THESE_LENGTHS
from ..kinematics.second_order import count_forbidden
from ..mechanism.errors import AssemblyError
from ..mechanism.mechanism import MechanismError
from ..scene.loading import scene_of_yaml, SceneError


def checked(text, name):
    """
    Return the findings on the text of a scene, as JSON can.

    ``error``: why it cannot be simulated, or None; else ``freedoms``, those left when prescribed
    motions are at their values, ``driven``, how many these are, and ``words`` that say why.
    """
    try:
        scene = scene_of_yaml(text, f'{name}.yaml')
        moved = with_motions(scene)
        mechanism = replace(moved, motions=())
        assembler = Assembler(mechanism, Geometry(mechanism).equations)
        q = assembler.positions(scene.initial.position, scene.initial.hold)
        repeated = find_redundancy(mechanism, q).repeated
        freedoms = assembler.degrees_of_freedom(q) - count_forbidden(mechanism, q)
    except (SceneError, MechanismError, AssemblyError, ValueError) as error:
        place = rf'{re.escape(name)}\.yaml:'
        return {'error': re.sub(f'^{place}', '', re.sub(rf'^{place}(?=\d)', 'line ', str(error)))}
    driven, equations = len(moved.motions), len(mechanism.coordinates.names) - freedoms
    words = [f'{mechanism.coordinates.nv} joints of the tree less {equations} independent '
             'equations of the loops']
    words += [f'{joint} repeats others: its {equation}' + (
        f' ({THESE_LENGTHS})' if kind == THESE_LENGTHS else '')
        for joint, equation, kind in repeated]
    return {'error': None, 'freedoms': freedoms - driven, 'driven': driven, 'words': words,
            'repeated': [joint for joint, *_ in repeated]}
