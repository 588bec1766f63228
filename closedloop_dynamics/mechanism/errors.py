# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Errors of a simulation; every message gives event, cause and remedy."""


class SimulationError(RuntimeError):
    """A simulation cannot go on, or a request to it cannot be met."""


class NumericalError(SimulationError):
    """The state left the finite numbers; the last finite one is kept."""


class StiffnessError(SimulationError):
    """The scene is too stiff for the step of an explicit method."""


class ClosureError(SimulationError):
    """The loops cannot be held closed at this step."""


class MotionError(ClosureError):
    """A prescribed motion that the mechanism cannot follow any further."""


class SingularityError(SimulationError):
    """The method cannot pass the singular configuration at hand."""


class AssemblyError(SimulationError):
    """No state that closes the loops was found, or the held coordinates do not fix one."""


class InaccuracyWarning(RuntimeWarning):
    """A motion is off by more than it should be, but not meaningless."""
