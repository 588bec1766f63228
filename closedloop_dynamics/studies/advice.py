# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The cheapest method for a wanted accuracy, the most accurate one for a given budget."""

from dataclasses import dataclass
from typing import Optional

from .accuracy import Line, Row
from ..visual.tables import seconds, share


@dataclass(frozen=True)
class Advice:
    """A recommended setting."""

    row: Optional[Row]  # None where nothing will do
    text: str  # The reason, and lines to paste into a scene


def for_target(study, target):
    """
    Find the cheapest setting whose largest position error is within a target.

    Only settings count whose finer neighbours all hold it, too: one that meets the target by luck
    will miss it on the next scene.

    ``target``: float [rad or m].
    """
    wanted = f'An error of positions of at most {target:g} rad or m over {study.duration:g} s'
    known = study.reference.error.position
    if target < known:
        return Advice(None, f'{wanted} cannot be decided: the reference itself is only known to '
                            f'{known:.1e}. Ask for more than that, or for a shorter duration.')
    holding = []
    for rows in study.lines().values():
        for row in reversed([row for row in rows if not row.failure]):
            if not row.position_error <= target:
                break
            holding.append(row)
    if holding:
        return _advice(wanted, min(holding, key=lambda row: row.cost))
    if not _succeeding(study):
        return Advice(None, f'{wanted} is reached by no method: none gets through.')
    best = min(_succeeding(study), key=lambda row: row.position_error)
    return Advice(None, f'{wanted} is reached by none of the settings tried; the smallest error '
                        f'is {best.position_error:.1e}, by {_named(best)}. {_why(best, study)}')


def for_budget(study, budget):
    """Find the most accurate setting that costs no more than a share of real time."""
    wanted = f'For at most {share(budget)} on this machine'
    affordable = [row for row in _succeeding(study) if row.cost <= budget]
    if affordable:
        return _advice(wanted, min(affordable, key=lambda row: row.position_error))
    if not _succeeding(study):
        return Advice(None, f'{wanted} nothing gets through, nor for more.')
    least = min(_succeeding(study), key=lambda row: row.cost)
    return Advice(None, f'{wanted} nothing gets through: the cheapest setting, {_named(least)}, '
                        f'takes {share(least.cost)}. Take a larger budget.')


def yaml_lines(method):
    """Return the lines of a scene that choose a method."""
    lines = ['method:', f'  integrator: {method.integrator}']
    key = Line(method.integrator).key
    lines += [f'  {key}: {_yaml_number(getattr(method, key))}',
              f'  stabilisation: {method.stabilisation}']
    return '\n'.join(lines)


def _succeeding(study):
    return [row for row in study.rows if not row.failure]


def _advice(wanted, row):
    return Advice(row, (
        f'{wanted}: error {row.position_error:.1e} rad or m, {seconds(row.cost)} of CPU time per '
        f'simulated second, {share(row.cost)}.\n{yaml_lines(row.method)}'))


def _named(row):
    return f'{row.line} at {row.line.key.replace("_", " ")} {row.setting.value:g}'


def _why(best, study):
    if best.position_error <= 2.0 * study.reference.error.position:
        return 'Smaller errors cannot be measured with this reference.'
    return 'Finer ones were not tried, or cost too much; without --quick more are.'


def _yaml_number(value):
    """Write a number that YAML 1.1 reads as one: with a point before the exponent."""
    text = f'{value:.10g}'
    mantissa, e, exponent = text.partition('e')
    return text if not e or '.' in mantissa else f'{mantissa}.0e{exponent}'
