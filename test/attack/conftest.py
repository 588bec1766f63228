# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""What the attacks on processes share with the tests of the nodes."""

from test.ros.conftest import context, domain, listener, processes

__all__ = ['context', 'domain', 'listener', 'processes']
