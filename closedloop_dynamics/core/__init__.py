# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Compiled dynamics of one mechanism: kinematics, elimination, loop closure, generated code."""
