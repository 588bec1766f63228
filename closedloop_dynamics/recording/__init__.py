# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Runs on disk: CSV files and bags, written, read and simulated again."""
