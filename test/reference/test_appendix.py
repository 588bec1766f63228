# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The appendix's blocks against the closure equations; its misprints are misprints."""

import numpy as np
import pytest

from . import appendix, dense, machines
from .compare import assert_agree, IDENTITY

PAPER = {
    'carpet_scraper': (appendix.scraper_blocks, machines.SCRAPER_LENGTHS,
                       appendix.SCRAPER_SUBSYSTEMS),
    'hoeken_pantograph_leg': (appendix.scraper_blocks, machines.LEG_LENGTHS,
                              appendix.SCRAPER_SUBSYSTEMS),
    'three_rrr': (appendix.three_rrr_blocks, machines.THREE_RRR_LENGTHS,
                  appendix.THREE_RRR_SUBSYSTEMS)}

# Where the print is wrong: (cut, subsystem), row, column.
MISPRINTS = {'scraper': {((2, 2), 1, 0)},
             'three_rrr': {((1, 1), 1, 0), ((1, 1), 1, 1)}}
# Where it differs by the sign of a whole row only.
SIGNS = {((1, 1), 0, 0), ((1, 2), 0, 0), ((1, 2), 0, 1)}


def differing(first, second):
    """Return {(block, row, column)} of unequal elements."""
    return {(key, row, column) for key in first
            for row, column in np.argwhere(first[key] != second[key]).tolist()}


@pytest.mark.parametrize('name', PAPER)
def test_corrected_blocks_are_derivatives_of_the_closure(name):
    blocks, lengths, subsystems = PAPER[name]
    mechanism = machines.MACHINES[name][0]()
    rng = np.random.default_rng(5)
    for _ in range(10):
        theta = rng.uniform(-np.pi, np.pi, 7)
        jac = dense.closure_jacobian(mechanism, theta)
        # 1e-13: element by element, of links below 1 m.
        np.testing.assert_allclose(
            appendix.assembled(blocks(theta, lengths), subsystems, len(jac) // 2), jac,
            rtol=0.0, atol=1e-13)


@pytest.mark.parametrize('name', PAPER)
def test_angles_are_those_of_the_bodies(name):
    mechanism = machines.MACHINES[name][0]()
    theta = np.random.default_rng(6).uniform(-np.pi, np.pi, 7)
    frames = dense.body_frames(mechanism, theta)
    if name == 'three_rrr':
        alpha = appendix.three_rrr_angles(theta)
        bodies = {1: 'proximal_1', 2: 'proximal_2', 3: 'proximal_3', 4: 'distal_1',
                  5: 'distal_2', 6: 'distal_3', 7: 'platform'}
    else:
        alpha = appendix.scraper_angles(theta)
        bodies = {index: f'link_{index}' for index in range(1, 8)}
        # The coupler's own x axis points the other way.
        alpha[3] -= np.pi
    for index, body in bodies.items():
        assert_agree(np.exp(1j * alpha[index]), np.exp(1j * frames[body][1]), IDENTITY)


def test_scraper_prints_one_wrong_element_and_one_row_of_the_other_sign():
    theta = np.random.default_rng(7).uniform(0.1, 1.0, 7)
    arguments = theta, machines.SCRAPER_LENGTHS
    printed = appendix.scraper_blocks(*arguments, printed=True)
    corrected = appendix.scraper_blocks(*arguments)
    assert differing(printed, corrected) == MISPRINTS['scraper'] | SIGNS
    for key, row, column in SIGNS:
        assert printed[key][row, column] == -corrected[key][row, column]


def test_three_rrr_prints_two_wrong_elements():
    theta = np.random.default_rng(8).uniform(0.1, 1.0, 7)
    arguments = theta, machines.THREE_RRR_LENGTHS
    assert differing(appendix.three_rrr_blocks(*arguments, printed=True),
                     appendix.three_rrr_blocks(*arguments)) == MISPRINTS['three_rrr']
