# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Estimation: states, joint forces, loads and parameters of a real machine from its sensors."""
