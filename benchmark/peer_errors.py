# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Why a machine is not measured in another simulator; three reasons that are told apart."""


class CannotExpress(ValueError):
    """The simulator has no word for a part of the machine."""

    text = 'cannot express it'


class NotAdapted(ValueError):
    """The simulator might know the machine, but this benchmark does not tell it."""

    text = 'our adapter does not'


class Disagreement(ValueError):
    """The machine that the simulator was told is another one: an error of the benchmark."""
