# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""How an advance ended, and constants of the engine's steppers; a test compares them."""

# Status of an advance. NO_PROGRESS: whichever closure equations are left out. SINGULAR: of a
# batch, which has no rank-revealing path. DOUBTFUL: a guard may have ended the run, or not.
(DONE, NOT_FINITE, OPEN_LOOP, STEP_TOO_SMALL, TOO_MUCH_WORK, INTERRUPTED, POOR_EQUATIONS,
 CONTACT_PASSED, NO_PROGRESS, SINGULAR, DOUBTFUL) = range(11)

# Evaluation limit between two times of output, of the error-controlled methods; next to a singular
# position one counts as so many.
MOST_EVALUATIONS, RANK_REVEALING_WORK = 200_000, 20

# The least tolerance of the default method; its tolerance against the accuracy; and the run's own
# error against the distance to its reference run.
FLOOR, SHARE, CLOSER = 1e-13, 1e-3, 0.1
# In which it estimates its error, and the longest pause between two estimates [s].
WINDOW, LONGEST_PAUSE = 1.0, 8.0
