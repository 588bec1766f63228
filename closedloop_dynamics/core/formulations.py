# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Which formulation an evaluation uses.

The augmented and the system-level one are to compare the method against: they work on dense
matrices of the whole mechanism and cost O((n + m)^3) and O(n^3 + m^3); they see neither subsystems
nor the cut-joint graph.
"""

SUBSYSTEM, SYSTEM, AUGMENTED = range(3)
