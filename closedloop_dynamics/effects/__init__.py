# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Forces that a scene may name: one law a file, the set of them, and their energy."""
