# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Slow, obvious NumPy twins of the compiled kernels; the package never imports them.

* ``dense``: reduced coordinates, Lagrange's equations, complex-step derivatives.
* ``maximal``: three coordinates per body, every joint a constraint.
* ``appendix``: the paper's block Jacobians, as printed and corrected.
* ``machines``: the mechanisms of the paper, built by hand.
* ``linkages``: random and special linkages with states that close.
* ``exact``: solutions known to (nearly) all digits.
"""
