# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Inertia reflected at a cut joint or along a tendon, whose force follows from accelerations."""

from .force_law import force_law, INERTIA


@force_law(role=INERTIA, engine_only='it acts on accelerations that follow from it')
def reflected_inertia(_):
    """Leave it to ``engine/static_friction.hpp``, which finds it with the accelerations."""
