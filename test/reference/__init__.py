# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
Slow, obvious NumPy twins of the compiled kernels; the package never imports them.

* ``dense``: reduced coordinates, Lagrange's equations, complex-step derivatives.
* ``maximal``: three coordinates per body, every joint a constraint.
* ``appendix``: the paper's block Jacobians, as printed and corrected.
* ``machines``: the mechanisms of the paper, built by hand.
* ``linkages``: random and special linkages with states that close.
* ``exact``: solutions known to (nearly) all digits.

"""
