# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Controllers: torques from the state of a mechanism, along paths, by its model."""
