# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Many simulations of one mechanism: a plan of variations, executors, storage."""

from .runner import sweep

__all__ = ['sweep']
