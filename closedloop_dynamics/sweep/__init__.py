# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Many simulations of one mechanism: what is varied, run anywhere, written as it comes."""

from .runner import sweep

__all__ = ['sweep']
