# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Output for people: drawings, pictures, animations, tables, progress bars, and a URDF."""
