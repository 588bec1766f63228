# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Errors of estimators."""


class EstimationError(RuntimeError):
    """Nothing can be estimated, or not any longer; the message says why and what to do."""
