# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Studies of methods: accuracy, formulations, effects and stability, measured."""
