# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""One mechanism in motion: scene, state, what advances it, what watches it, and many at once."""
