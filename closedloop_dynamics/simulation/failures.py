# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Why a step could not be made, in words: what happened, and what to do."""

import numpy as np

from .guards import MOST_EXCHANGES
from ..engine import types as t
from ..engine.status import (
    CONTACT_PASSED, MOST_EVALUATIONS, NO_PROGRESS, NOT_FINITE, OPEN_LOOP, POOR_EQUATIONS,
    RANK_REVEALING_WORK, TOO_MUCH_WORK)
from ..mechanism.errors import ClosureError, NumericalError

# Fraction of the closure limit above which loops may be contradictory.
CONTRADICTION = 0.1
# Contacts that a message names.
MOST_NAMED = 3


def failure(data, status, size):
    """Return the error to raise where a step [s] could not be made."""
    if status == NOT_FINITE:
        return NumericalError(
            f'The state left the finite numbers at t = {data.time:.9g} s; the last finite '
            f'state is kept. Take a smaller step than {size:g} s, or smaller torques '
            f'(largest now {np.abs(data.system.tau).max(initial=0.0):g}).')
    if status == NO_PROGRESS:
        return NumericalError(
            f'The motion does not go on at t = {data.time:.9g} s, whichever closure equations '
            f'are left out as repeating others ({MOST_EXCHANGES} choices were tried); the '
            'last good state is kept. Make lengths and axes of the loops agree to more '
            'digits, or start elsewhere.')
    # Loops that are well closed here opened because of the step, or at a change point.
    if status == POOR_EQUATIONS or status == OPEN_LOOP and data.has_redundant_constraints and (
            data.closure > CONTRADICTION * data.system.settings.closure_limit):
        contradiction = data.loop_model.contradiction(data.q)
        if contradiction:
            return ClosureError(
                f'The loops cannot stay closed after t = {data.time:.9g} s; the state before '
                f'is kept. {contradiction}')
    if status == OPEN_LOOP:
        error = data.system.work.health[t.CLOSURE]
        advice = data.assembler.advice_on_opening(data.q) or (
            f'Take a smaller step than {size:g} s: the motion in one step is too large.')
        return ClosureError(
            f'The loops could not be closed after the step at t = {data.time:.9g} s (error '
            f'{error:.3g}); the state before it is kept. {advice}')
    if status == TOO_MUCH_WORK:
        return NumericalError(
            f'The motion at t = {data.time:.9g} s takes more than {MOST_EVALUATIONS} '
            f'evaluations for {size:g} s; the last good state is kept. '
            + _advice_on_work(data))
    if status == CONTACT_PASSED:
        return NumericalError(
            f'A contact ({data.effect_set.passed}) was passed within a step of {size:g} s at '
            f't = {data.time:.9g} s, undetected between evaluations; the state before is '
            'kept. Take a smaller step, or a method with error control, such as '
            'integrator: auto.')
    return NumericalError(
        f'No step at t = {data.time:.9g} s is small enough to keep the error that is '
        'allowed; the last good state is kept. The motion is not smooth there: allow '
        'more, or take a fixed step.')


def _advice_on_work(data):
    """Return a remedy where a step takes too many evaluations."""
    count = data.system.work.health[t.RANK_REVEALING_COUNT]
    data.touch()
    data.evaluate()
    if data.system.work.health[t.RANK_REVEALING_COUNT] == count:
        return ('Take smaller torques (largest now '
                f'{np.abs(data.system.tau).max(initial=0.0):g}), allow a larger error, '
                'or leave out the effect that is so fast.' + _pressing(data))
    return ('Closure equations depend on others next to this position, where an evaluation '
            f'counts as {RANK_REVEALING_WORK}. ' + (
                'No independent coordinates describe the motion through it: take '
                'stabilisation: projection.'
                if data.scene.method.stabilisation == 'independent' else
                'Allow a larger error, or keep away from it by stops or another start.'))


def _pressing(data):
    """Return the contacts that press, the hardest first, with depths and forces."""
    readings = {name: data.effect_readings(name)
                for name, acts in data.effect_set.enabled.items() if acts}
    pressing = sorted(((one['normal_force'], name, one['depth'])
                       for name, one in readings.items()
                       if one.get('normal_force', 0.0) > 0.0), reverse=True)
    found = ', '.join(f'{name} ({depth:.3g} m deep, normal force {force:.3g} N)'
                      for force, name, depth in pressing[:MOST_NAMED])
    return f' In contact: {found}.' if found else ''
