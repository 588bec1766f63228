# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
How an advance ended, and the columns of the records that the engine's steppers keep.

The meanings are in ``engine/error_control.hpp`` and ``engine/switching.hpp``; a test compares
the places.
"""

# Status of an advance. SINGULAR: of a batch, which has no rank-revealing path.
(DONE, NOT_FINITE, OPEN_LOOP, STEP_TOO_SMALL, TOO_MUCH_WORK, INTERRUPTED,
 POOR_EQUATIONS, CONTACT_PASSED) = range(8)
SINGULAR = 9
# A guard may have ended the run, or not.
DOUBTFUL = 10

# Evaluation limit between two times of output, of the error-controlled methods; next to a singular
# position one counts as so many.
MOST_EVALUATIONS, RANK_REVEALING_WORK = 200_000, 20

# In the place of a step size: there is no step to interpolate, but there is a past.
NOTHING_BETWEEN = -1.0

# Columns of the control record of every error-controlled method.
(REACHED, NEXT_STEP, STEP_START, STEP_SIZE, EXTENDED, ACCEPTED, REJECTED, ERROR,
 LARGEST_ERROR, WORK, RESTARTED, HOLD, STIFFNESS) = range(13)
CONTROL_COLUMNS = 13
# Columns that the default method adds.
(STIFF, STIFF_COUNT, NONSTIFF_COUNT, STIFF_THRESHOLD, SINCE_WORK, SINCE_TIME, EXPLICIT_RATE,
 TRIAL_STEPS, SHORT, SHORT_STEP, SHORT_WAIT) = range(CONTROL_COLUMNS, CONTROL_COLUMNS + 11)
SWITCHING_COLUMNS = CONTROL_COLUMNS + 11
# Columns of its monitor.
(ACCURACY, TOLERANCE, OPEN, UNTIL, PAUSE, SMALLEST, BOUND, CARRIED, LARGEST_BOUND, NEXT_BOUND,
 TIGHTENED) = range(11)
MONITOR_COLUMNS = 11
# The least tolerance of the default method; its tolerance against the accuracy, and that of the
# reference run against it; the run's own error against the distance of the two.
FLOOR, SHARE, LOOSER, CLOSER = 1e-13, 1e-3, 30.0, 0.1
# In which it estimates its error, and the longest pause between two estimates [s].
WINDOW, LONGEST_PAUSE = 1.0, 8.0

# Rows of the scratch of explicit methods before the slopes, and the one with the latest state.
FIRST_SLOPE, AFTER = 5, 3
# Rows of the scratch of the stiff method.
STIFF_ROWS = 12
