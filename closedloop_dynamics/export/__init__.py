# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Scenes for other programs: C, FMU, WebAssembly, JAX, PyTorch, environments for learning."""
