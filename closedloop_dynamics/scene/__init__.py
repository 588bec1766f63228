# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Scenes: a mechanism, the effects on it, method and start, as files and records."""
