# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Integration of a state in time: steppers, error control, and projection onto the loops."""
