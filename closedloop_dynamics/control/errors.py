# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Errors of controllers and nodes."""


class StartError(RuntimeError):
    """A controller or node that cannot start or go on; the message is for the user, one line."""
