# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The accuracy that a share of a core allows, chosen during a run."""

import math

# The accuracies between which it is chosen [rad or m within a second], a decade apart.
FINEST, COARSEST, DECADE = 1e-9, 1e-2, 10.0
# Time of the clock in one measurement [s]; the smaller one of two in a row counts, as other
# programs disturb single ones.
INTERVAL = 0.05
# Order of DOP853: the cost of a decade of accuracy grows by its root.
ORDER = 8
GROWTH = DECADE ** (1.0 / ORDER)
# Share of real time that computing may take by the clock, the time in which other programs have
# the core included; that of a larger budget is the budget itself.
PERIOD = 0.8
# A finer accuracy is taken where it is expected to need no more than this share of the budget,
# after as many intervals in a row; after twice as many where the last one proved too fine.
ROOM, FIRST_WAIT, LONGEST_WAIT = 0.8, 10, 160
# Decades in one decision.
MOST_DECADES = 3


class Budget:
    """
    Choice of an accuracy that keeps computing within a share of a core, and within real time.

    What other programs take of a core is not what the accuracy costs: CPU time is compared with
    the budget. Only where computing and waiting for the core come near the period, so that it
    would be missed, the accuracy becomes coarser for that.

    It decides by numbers alone: the same measurements give the same accuracies.

    Parameters
    ----------
    share : float
        CPU time per time of the clock that is allowed [1].
    wanted : float
        Accuracy asked for beside it [rad or m within a second]: finer ones are taken where the
        budget allows, coarser ones where it does not, which ``finding`` says.

    Attributes
    ----------
    share, wanted : float
        As given.
    used, elapsed : float
        Shares of CPU time and of time of the clock that are taken at present [1]; NaN before the
        first two intervals.

    """

    def __init__(self, share, wanted):
        self.share, self.wanted = share, wanted
        self.used = self.elapsed = math.nan
        self._period = max(PERIOD, share)
        self._finest, self._coarsest = min(FINEST, wanted), max(COARSEST, wanted)
        self._sums = [0.0, 0.0, 0.0]
        self._before = None
        self._crowded = False
        self._fitting, self._wait, self._refined = 0, FIRST_WAIT, False

    def choose(self, accuracy, simulated, spent, elapsed):
        """
        Record a part of the run, and choose the accuracy of the next one.

        Parameters
        ----------
        accuracy : float
            Of this part [rad or m within a second].
        simulated, spent, elapsed : float
            Time of the clock that it stands for, CPU time of computing, and time of the clock that
            computing took [s].

        Returns
        -------
        float
            The same as long as nothing is to be changed.

        """
        self._sums = [one + more for one, more in zip(self._sums, (simulated, spent, elapsed))]
        time, *costs = self._sums
        if time < INTERVAL * (1.0 - 1e-9):
            return accuracy
        before, self._before = self._before, [cost / time for cost in costs]
        self._sums = [0.0, 0.0, 0.0]
        if before is None:
            # What came before was measured with another accuracy.
            return accuracy
        self.used, self.elapsed = map(min, zip(before, self._before))
        chosen = self._chosen(accuracy)
        if chosen != accuracy:
            self._before = None
        return chosen

    @property
    def _taken(self):
        """Return the used share of the budget [1]."""
        return max(self.used / self.share, self.elapsed / self._period)

    def _chosen(self, accuracy):
        """Return the accuracy that follows from the present shares."""
        if self._taken > 1.0:
            self._crowded = self.used <= self.share
            return self._coarser(accuracy)
        if accuracy > self._finest and GROWTH * self._taken <= ROOM:
            self._fitting += 1
            if self._fitting >= self._wait:
                return self._finer(accuracy)
        else:
            self._fitting = 0
        return accuracy

    def _coarser(self, accuracy):
        """Return an accuracy that the budget is expected to allow, or one nearer to it."""
        if self._refined:
            self._wait = min(2 * self._wait, LONGEST_WAIT)
        self._fitting, self._refined = 0, False
        decades = math.ceil(ORDER * math.log10(self._taken))
        return _rounded(min(
            accuracy * DECADE ** min(max(decades, 1), MOST_DECADES), self._coarsest))

    def _finer(self, accuracy):
        """Return the next finer accuracy."""
        if self._refined:
            # The one before was not too fine.
            self._wait = FIRST_WAIT
        self._fitting, self._refined = 0, True
        return _rounded(max(accuracy / DECADE, self._finest))

    def finding(self, accuracy):
        """Return a finding where the accuracy falls short of the requested one, or ''."""
        if self._taken > 1.0 and accuracy >= self._coarsest:
            if self._crowded:
                return (f'computing takes {self.elapsed:.2g} of real time even with an accuracy '
                        f'of {accuracy:g} rad or m within a second, though no more than '
                        f'{self.used:.2g} of a core: other programs take the rest of it. Give '
                        'this one a core or a priority of its own.')
            return (f'the budget of {self.share:g} of real time is exceeded even with an '
                    f'accuracy of {accuracy:g} rad or m within a second: computing takes '
                    f'{self.used:.2g}. '
                    'Allow a larger budget, or a slower pace.')
        if accuracy > self.wanted:
            if self._crowded:
                return (f'other programs take the core for so long that {accuracy:g} rad or m '
                        f'within a second is kept in the place of {self.wanted:g}. Give this one '
                        'a core or a priority of its own.')
            return (f'the budget of {self.share:g} of real time and the accuracy of '
                    f'{self.wanted:g} rad or m within a second exclude each other: '
                    f'{accuracy:g} is kept. Allow a larger budget or accuracy.')
        return ''


def allowed(share, known):
    """
    Return the finest accuracy that a share of real time is expected to allow.

    ``known``: two accuracies and the shares that they take, positive; shares in between and beyond
    follow a power law. Between ``FINEST`` and ``COARSEST``; None where not even that is allowed.
    """
    (one, at_one), (other, at_other) = known
    power = math.log(at_other / at_one) / math.log(other / one)
    accuracy = COARSEST
    best = None
    while accuracy >= FINEST * (1.0 - 1e-9):
        if at_one * (accuracy / one) ** min(power, 0.0) <= share:
            best = _rounded(accuracy)
        accuracy /= DECADE
    return best


def _rounded(accuracy):
    """Return an accuracy without rounding errors."""
    return float(f'{accuracy:.6g}')
