# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Mechanisms in a browser, to be seen and handled: the page, its server, what both show."""
