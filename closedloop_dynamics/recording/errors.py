# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Errors of recordings."""


class RecordingError(ValueError):
    """A recording without the data needed; the message gives a remedy."""


class BagReadError(OSError):
    """A bag that cannot be read; the message says why."""
