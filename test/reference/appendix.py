# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The block Jacobians of the paper's appendix, element by element.

Koul, Shah, Saha and Manivannan (2014), "Reduced-order forward dynamics of
multiclosed-loop systems", Multibody System Dynamics 31, 451-476, A.1 and A.2.

Every function returns {(cut joint, subsystem): block}, both counted from 1.
With ``printed`` it returns what the page says; without, the misprints are
corrected and every row has the sign of psi = p_a - p_b, body A being the one on
the left of the closure equation.
"""

import numpy as np

PI = np.pi


def scraper_angles(theta):
    """Return {i: alpha_i} of the carpet scraping mechanism."""
    one, two, three, four, five, six, seven = theta
    return {1: one, 2: two, 3: PI + two + three, 4: four, 5: five + four - 2 * PI,
            6: six + four - 2 * PI, 7: seven + six + four - 4 * PI}


def scraper_blocks(theta, lengths, printed=False):
    """
    Return the blocks of appendix A.1, carpet scraping mechanism.

    Parameters
    ----------
    theta : sequence of 7 floats
        Joint angles [rad].
    lengths : dict
        a1, a2, a3, a39, a46, a56, a59, a67, a97 [m].
    printed : bool
        Whether to return the misprints too.

    """
    alpha = scraper_angles(theta)
    s = {index: np.sin(angle) for index, angle in alpha.items()}
    c = {index: np.cos(angle) for index, angle in alpha.items()}
    a1, a2, a3, a39, a46, a56, a59, a67, a97 = (
        lengths[name] for name in ('a1', 'a2', 'a3', 'a39', 'a46', 'a56', 'a59', 'a67', 'a97'))
    j11 = np.array([[a1 * s[1]],
                    [a1 * c[1]]])
    j12 = np.array([[-a2 * s[2] - a3 * s[3], -a3 * s[3]],
                    [-a2 * c[2] - a3 * c[3], -a3 * c[3]]])
    j22 = np.array([[-a2 * s[2] + a39 * s[3], a39 * s[3]],
                    [-a2 * c[2] - a39 * c[3], -a39 * c[3]]])
    j23 = np.array([[a59 * s[5] + (a46 - a56) * s[4], a59 * s[5], 0.0, 0.0],
                    [-a59 * c[5] - (a46 - a56) * c[4], -a59 * c[5], 0.0, 0.0]])
    j33 = np.array([[-a46 * s[4] - a67 * s[6] - a97 * s[7] + a59 * s[5] + (a46 - a56) * s[4],
                     a59 * s[5], -a67 * s[6] - a97 * s[7], -a97 * s[7]],
                    [a46 * c[4] + a67 * c[6] + a97 * c[7] - a59 * c[5] - (a46 - a56) * c[4],
                     -a59 * c[5], a67 * c[6] + a97 * c[7], a97 * c[7]]])
    if not printed:
        # Row 1 of cut 1 is d(P3 - P1) in print, row 2 d(P1 - P3).
        j11[0] *= -1.0
        j12[0] *= -1.0
        j22[1, 0] = a2 * c[2] - a39 * c[3]
    return {(1, 1): j11, (1, 2): j12, (2, 2): j22, (2, 3): j23, (3, 3): j33}


def three_rrr_angles(theta):
    """Return {i: alpha_i} of the 3-RRR manipulator, 7' being alpha_7'."""
    one, two, three, four, five, six, seven = theta
    platform = one + two + three
    return {1: one, 2: six, 3: seven, 4: one + two, 5: platform + four - PI,
            6: platform + five - (PI - PI / 3), 7: platform, "7'": platform + PI / 3}


def three_rrr_blocks(theta, lengths, printed=False):
    """
    Return the blocks of appendix A.2, 3-RRR planar parallel manipulator.

    Parameters
    ----------
    theta : sequence of 7 floats
        Joint angles [rad].
    lengths : dict
        a1, a2, a3, b1, b2, b3, d1 [m].
    printed : bool
        Whether to return the misprints too.

    """
    alpha = three_rrr_angles(theta)
    s = {index: np.sin(angle) for index, angle in alpha.items()}
    c = {index: np.cos(angle) for index, angle in alpha.items()}
    a1, a2, a3, b1, b2, b3, d1 = (
        lengths[name] for name in ('a1', 'a2', 'a3', 'b1', 'b2', 'b3', 'd1'))
    sign = -1.0 if printed else 1.0
    j11 = np.array([[-a1 * s[1] - b1 * s[4] - d1 * s[7] + b2 * s[5],
                     -b1 * s[4] - d1 * s[7] + b2 * s[5], -d1 * s[7] + b2 * s[5], b2 * s[5], 0.0],
                    [a1 * c[1] + b1 * c[4] + sign * d1 * c[7] - b2 * c[5],
                     b1 * c[4] + sign * d1 * c[7] - b2 * c[5],
                     d1 * c[7] - b2 * c[5], -b2 * c[5], 0.0]])
    j21 = np.array([[-a1 * s[1] - b1 * s[4] - d1 * s["7'"] + b3 * s[6],
                     -b1 * s[4] - d1 * s["7'"] + b3 * s[6], -d1 * s["7'"] + b3 * s[6],
                     0.0, b3 * s[6]],
                    [a1 * c[1] + b1 * c[4] + d1 * c["7'"] - b3 * c[6],
                     b1 * c[4] + d1 * c["7'"] - b3 * c[6], d1 * c["7'"] - b3 * c[6],
                     0.0, -b3 * c[6]]])
    return {(1, 1): j11, (2, 1): j21,
            (1, 2): np.array([[a2 * s[2]], [-a2 * c[2]]]), (1, 3): np.zeros((2, 1)),
            (2, 2): np.zeros((2, 1)), (2, 3): np.array([[a3 * s[3]], [-a3 * c[3]]])}


# Joints of each subsystem, in the order of the blocks' columns.
SCRAPER_SUBSYSTEMS = {1: (0,), 2: (1, 2), 3: (3, 4, 5, 6)}
THREE_RRR_SUBSYSTEMS = {1: (0, 1, 2, 3, 4), 2: (5,), 3: (6,)}


def assembled(blocks, subsystems, cuts, nv=7):
    """Return the (2 cuts, nv) Jacobian made of the blocks, zero where there is none."""
    jac = np.zeros((2 * cuts, nv))
    for (cut, subsystem), block in blocks.items():
        jac[2 * cut - 2:2 * cut, subsystems[subsystem]] = block
    return jac
