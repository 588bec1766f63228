# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Studies: accuracy, effects and stability, measured; the best machine, found."""
