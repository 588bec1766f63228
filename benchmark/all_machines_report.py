# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Tables, sentences and the picture of what all_machines.py has measured."""

from statistics import median

from all_machines import OURS, RATES, read, TARGETS
from matplotlib.figure import Figure
from peer_report import cheapest, styled
from sentences import paragraph, spread

from closedloop_dynamics.visual.appearance import COLORS, DOTS_PER_INCH  # noqa: I100
from closedloop_dynamics.visual.tables import markdown_table, seconds

MOTIONS = {0: 'free', 100: 'torques held at 100 Hz', 1000: 'torques held at 1 kHz'}
NAMES = {0: 'free', 100: 'held 100', 1000: 'held 1000'}
NOTHING = '-'
# Of a motion in which nothing moves, and of one that no setting of others keeps an error in.
STILL, NOT_REACHED = 'stands still', 'not reached'
# The same machine under two names counts once.
SAME = {'three_rrr_vertical': 'three_rrr'}
# Errors that are reported must be so much larger than what the reference is known to.
ABOVE = 3.0
COST, ERROR = 'cpu_time_per_second', 'error'
# Marker and colour by target: of the default filled, of others hollow and grey.
MARKERS = dict(zip(TARGETS, zip('os^', COLORS)))
# Whose method it is, in two letters; doc/accuracy_machines.md says which.
METHODS = {'RK4': 'M4', 'implicitfast': 'Mi', **{
    f'{method} in C++{ending}': letters + digit
    for method, digit in (('RK4', '4'), ('Fehlberg 7(8)', '7'))
    for ending, letters in (('', 'C'), (', lcaba', 'L'), (', lcaba, 2 iterations', 'LL'))}}


class Results:
    """
    What was measured, by machine.

    Attributes
    ----------
    machines : dict of str to str
        Kind by name, ``'scene'`` or ``'robot'``.
    reasons : list of (str, str, str)
        Machine, simulator, and why it was not measured there.

    """

    def __init__(self, path):
        """Read a CSV file."""
        self._rows, self.machines, self.reasons = {}, {}, []
        for row in read(path):
            self.machines[row['machine']] = row['kind']
            if row['engine'] != OURS and row['note']:
                self.reasons.append((row['machine'], row['engine'], row['note']))
            self._rows.setdefault((row['machine'], row['rate']), []).append(row)

    def _kept(self, machine, rate, target):
        """Return the rows as far as the reference can tell an error."""
        return [row for row in self._rows.get((machine, rate), ())
                if ABOVE * row['known_to'] <= target]

    def ours(self, machine, rate, target):
        """Return the row of the default method that was asked for an accuracy, or None."""
        return cheapest([row for row in self._kept(machine, rate, target)
                         if row['target'] == target], target, COST)

    def other(self, machine, rate, target):
        """Return the cheapest row of another simulator that keeps an error, or None."""
        return cheapest([row for row in self._kept(machine, rate, target)
                         if row['engine'] != OURS and row[COST] == row[COST]], target, COST)

    def still(self, machine, rate):
        """Return whether nothing moves."""
        return any(row['note'] == STILL for row in self._rows.get((machine, rate), ()))

    def why(self, machine, rate):
        """Return in a few words why no row of another simulator keeps an error."""
        if self.still(machine, rate):
            return STILL
        if any(row['engine'] != OURS and row[COST] == row[COST]
               for row in self._rows.get((machine, rate), ())):
            return NOT_REACHED
        known = {text.partition(':')[0] for name, _, text in self.reasons if name == machine}
        return ', '.join(sorted(known)) or NOTHING

    def moving(self, rate):
        """Return the machines that count in a motion: that move, each once."""
        return [machine for machine in self.machines
                if SAME.get(machine) not in self.machines and not self.still(machine, rate)]

    def digit(self, machine, rate):
        """Return what one more digit costs, as a share; None where it was not measured."""
        ends = [self.ours(machine, rate, target) for target in (TARGETS[0], TARGETS[-1])]
        if None in ends:
            return None
        return (ends[1][COST] / ends[0][COST]) ** (1.0 / 6.0) - 1.0


def table(results, rate):
    """Return what each machine costs in a motion, and how much more with the best of others."""
    rows = []
    for machine in results.machines:
        ours = [results.ours(machine, rate, target) for target in TARGETS]
        share = results.digit(machine, rate)
        cells = [*(seconds(one[COST]) if one else NOTHING for one in ours),
                 NOTHING if share is None else f'{round(100.0 * share)} %']
        for target, one in zip(TARGETS, ours):
            other = results.other(machine, rate, target)
            if other is None:
                cells.append(results.why(machine, rate))
                continue
            method = other['setting'].partition(', tolerance')[0].partition(', step')[0]
            times = f' ({spread([other[COST] / one[COST]])})' if one else ''
            cells.append(f'{seconds(other[COST])} '
                         f'{METHODS.get(method, other["engine"] + " " + method)}{times}')
        # Machines without drives are not moved by torques.
        if not rate or any(cell != NOTHING for cell in cells):
            rows.append((machine, *cells))
    return markdown_table(
        ('machine', *(f'default, {target:.0e}' for target in TARGETS), 'a digit more',
         *(f'others, {target:.0e}' for target in TARGETS)), rows)


def compared(results, rate):
    """Return costs of the best of others in ours, of the default for 1e-6."""
    pairs = [(results.ours(machine, rate, 1e-6), results.other(machine, rate, 1e-6))
             for machine in results.moving(rate)]
    return [other[COST] / one[COST] for one, other in pairs if one and other]


def by_default(path):
    """Return the sentence of README.md on the default method beside others."""
    ratios = compared(Results(path), 0)
    return (f'The default method with its own error check is {spread(ratios)} times faster '
            f'(median {spread([median(ratios)])}) on the {len(ratios)} machines that others can '
            'express and follow to 1e-6 ([each](doc/accuracy_machines.md)).')


def summary(results):
    """Return the whole in a few sentences."""
    texts = []
    for rate, motion in MOTIONS.items():
        machines = results.moving(rate)
        costs = [one[COST] for one in (
            results.ours(machine, rate, 1e-6) for machine in machines) if one]
        shares = [share for share in (
            results.digit(machine, rate) for machine in machines) if share is not None]
        ratios = compared(results, rate)
        if not costs:
            continue
        texts.append(
            f'**{motion[0].upper()}{motion[1:]}**: the median of {len(costs)} machines is '
            f'{seconds(median(costs))} of CPU time per simulated second for an accuracy of 1e-6, '
            f'the largest {seconds(max(costs))}; one more digit costs '
            f'{100.0 * median(shares):.0f} % (median).' + (
                f' Another simulator keeps an error of 1e-6 on {len(ratios)} of them and takes '
                f'{spread(ratios)} times as long (median {spread([median(ratios)])}).'
                if ratios else ''))
    return '\n'.join(paragraph(text, '* ', '  ') for text in texts)


def reasons(results):
    """Return a table of the machines that other simulators were not measured on, and why."""
    return markdown_table(('machine', 'simulator', 'why not'), results.reasons)


def passages(path):
    """Return {name of a passage: its text} of the pages on accuracy."""
    results = Results(path)
    tables = {f'machines {NAMES[rate]}': table(results, rate) for rate in RATES}
    return {'machines': summary(results), 'machines reasons': reasons(results), **tables}


def picture(path):
    """Draw CPU time per simulated second of all machines."""
    results = Results(path)
    names = sorted(results.machines, key=lambda machine: (
        results.machines[machine] == 'robot',
        (results.ours(machine, 0, 1e-6) or {COST: 0.0})[COST]))
    figure = Figure(figsize=(12.0, 2.0 + 0.22 * len(names)), dpi=DOTS_PER_INCH,
                    layout='constrained')
    panels = figure.subplots(1, len(RATES), sharey=True, sharex=True)
    lines = [('default', results.ours, target) for target in TARGETS] + [
        ('best of the others', results.other, target) for target in TARGETS[:2]]
    for axes, rate in zip(panels, RATES):
        styled(axes, MOTIONS[rate])
        for label, chosen, target in lines:
            places = [(one[COST], number) for number, one in enumerate(
                chosen(machine, rate, target) for machine in names) if one]
            marker, color = MARKERS[target]
            filled = label == 'default'
            axes.plot(*zip(*places) if places else ((), ()), linestyle='', marker=marker,
                      color=color if filled else '#333333', markersize=5,
                      label=f'{label}, {target:.0e}',
                      markerfacecolor=color if filled else 'none')
        axes.set_xlabel('CPU time for one simulated second [s]')
        robots = [number for number, machine in enumerate(names)
                  if results.machines[machine] == 'robot']
        if robots:
            axes.axhline(robots[0] - 0.5, color='#999999', linewidth=0.8)
    panels[0].set_yticks(range(len(names)), names)
    panels[0].set_ylim(-0.7, len(names) - 0.3)
    figure.legend(*panels[0].get_legend_handles_labels(), loc='outside lower center', ncols=5,
                  frameon=False, fontsize=9)
    return figure
