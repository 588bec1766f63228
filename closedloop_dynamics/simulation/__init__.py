# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Simulation of a scene: its data, runs with their guards, readings, derivatives, batches."""
