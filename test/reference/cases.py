# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The cases that every test of the dynamics goes through, each with a random closed state.

The shipped mechanisms by their names, linkages of a regular shape by theirs, random linkages by
number; in space machines and random mechanisms with joints of all types.
"""

import copy
import functools

from closedloop_dynamics.scene.loading import load_scene
import numpy as np
import pytest

from . import linkages, spatial_linkages, spatial_machines, special, states

SHIPPED = ('carpet_scraper', 'four_bar', 'hoeken_pantograph_leg', 'slider_crank', 'three_rrr')
SPECIAL = {'ladder': lambda rng: special.ladder(4, rng.uniform(-1.0, 1.0), rng.normal()),
           'parallelogram': lambda rng: special.parallelogram(rng.uniform(0.2, 1.0)),
           'chain': lambda rng: special.chain(rng, 6),
           'star': lambda rng: special.star(rng, 4)}
# One to four subsystems each, every other one shuffled.
RANDOM = range(20)
# Rods, pins in slots, couplings.
ELEMENTS = tuple(f'elements_{n}' for n in range(8))
ALL = (*SHIPPED, *SPECIAL, *RANDOM, *ELEMENTS)
MACHINES_IN_SPACE = ('rssr_four_bar', 'stewart_platform', 'delta_robot')
RANDOM_IN_SPACE = tuple(f'space_{n}' for n in range(6))


def first(number, values):
    """Return the parameters of a test that draws at random: all after the first are slow."""
    return [value if k < number else pytest.param(value, marks=pytest.mark.slow)
            for k, value in enumerate(values)]


def only(kept, values):
    """Return the parameters of a test: those not among ``kept`` are slow."""
    assert set(kept) <= set(values)
    return [value if value in kept else pytest.param(value, marks=pytest.mark.slow)
            for value in values]


# One shipped scene of each class of topology: one loop, several, gears, cables, and in space
# trees with loops, platforms, loops that are mobile only because of their lengths.
CLASSES = ('four_bar', 'three_rrr', 'carpet_scraper_on_carpet', 'slider_crank_end_stop',
           'planetary_gear', 'rope_hoist', 'stewart_platform', 'differential', 'bennett')
# Shipped linkages with a slider, with subsystems that share a body, with three loops at one body.
SOME = ('carpet_scraper', 'slider_crank', 'three_rrr')
# One random linkage of each number of subsystems, and some with elements; --all takes the others.
PARAMETERS = (*only(SOME, SHIPPED), *SPECIAL, *first(4, RANDOM), *first(2, ELEMENTS))
IN_SPACE = (*MACHINES_IN_SPACE, *first(3, RANDOM_IN_SPACE))


def drawn(case, seed=0):
    """
    Draw a state of one case.

    Parameters
    ----------
    case : str or int
        Of ``ALL`` or ``IN_SPACE``.
    seed : int
        Another seed draws another state, and another random linkage.

    Returns
    -------
    rng : numpy.random.Generator
        To draw more from.
    mechanism : Mechanism
    q, qd : ndarray, shape (nq,), (nv,)
        A state that closes the loops.

    """
    rng, mechanism, q, qd = _drawn(case, seed)
    return copy.deepcopy(rng), mechanism, q.copy(), qd.copy()


@functools.cache
def _drawn(case, seed):
    """Return the same once and for all: many tests draw the same, some by many attempts."""
    rng = np.random.default_rng([(*ALL, *MACHINES_IN_SPACE, *RANDOM_IN_SPACE).index(case), seed])
    if case in RANDOM_IN_SPACE:
        return (rng, *spatial_linkages.random_mechanism(rng))
    if case in MACHINES_IN_SPACE:
        return (rng, *spatial_machines.in_motion(getattr(spatial_machines, case)()[0], rng))
    if case in SHIPPED:
        scene = load_scene(case)
        return (rng, scene.mechanism,
                *states.random_state(rng, scene.mechanism, scene.initial.position))
    if case in SPECIAL:
        return (rng, *SPECIAL[case](rng))
    if case in ELEMENTS:
        return (rng, *linkages.with_elements(rng))
    return (rng, *linkages.random_linkage(rng, n_subsystems=1 + case % 4, shuffle=case % 2 == 1))
