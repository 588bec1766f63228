# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Interactive view of mechanisms in a browser: page, server and their messages."""
