# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Simulation of one mechanism: scene, state, runs with their guards, and batches of runs."""
