# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
The mechanisms of the paper, built by hand, independent of the YAML files.

Each builder returns a Mechanism; its ``*_START`` are coordinates near which it
assembles.
"""

from closedloop_dynamics.mechanism.mechanism import Body, CutJoint, Joint, Mechanism
import numpy as np

LEG_LENGTHS = {
    'a1': 0.025, 'a2': 0.0625, 'a3': 0.0625, 'a39': 0.0625,
    'a46': 0.2, 'a56': 0.15, 'a97': 0.15, 'a59': 0.075, 'a67': 0.075, 'a6': 0.3}
LEG_MASSES = (0.0047, 0.0117, 0.0234, 0.0374, 0.014, 0.0562, 0.0281)
LEG_PIVOTS = ((0.0, 0.0), (0.05, 0.0), (0.07, -0.03))
LEG_START = (0.0, 4.5110, 0.4027, -0.8764, -1.4604, -1.4604, -1.6812)

SCRAPER_LENGTHS = {
    'a1': 0.038, 'a2': 0.1152, 'a3': 0.1152, 'a39': 0.1152,
    'a46': 0.39, 'a56': 0.26, 'a97': 0.26, 'a59': 0.13, 'a67': 0.13, 'a6': 0.39}
SCRAPER_MASSES = (1.5, 3.0, 5.0, 3.0, 1.0, 3.0, 2.0)
SCRAPER_PIVOTS = ((0.0, 0.0), (-0.0895, 0.0), (-0.0895, 0.40))
SCRAPER_START = (0.0, 0.9844, 1.1728, -0.9285, -1.2846, -1.2846, -1.8570)

THREE_RRR_LENGTHS = {
    'a1': 0.4, 'a2': 0.4, 'a3': 0.4, 'b1': 0.6, 'b2': 0.6, 'b3': 0.6, 'd1': 0.4}
THREE_RRR_START = (1.0467, 5.4206, -2.5357,
                   4.1883 - 2.0939 - (1.0467 + 5.4206 - 2.5357) + np.pi,
                   5.7637 - 0.9869 - (1.0467 + 5.4206 - 2.5357) + 2.0 * np.pi / 3.0,
                   4.1883, 5.7637)


def bar(name, mass, length, center):
    """Return a uniform bar along its x axis, its centre of mass at (``center``, 0)."""
    return Body(name, mass, (center, 0.0), mass * length ** 2 / 12.0)


def revolute(name, parent, child, position, angle=0.0, actuated=False):
    """Return a revolute tree joint."""
    return Joint(name, 'revolute', parent, child, position, angle, actuated)


def revolute_cut(name, body_a, point_a, body_b, point_b):
    """Return a revolute cut joint."""
    return CutJoint(name, 'revolute', body_a, body_b, point_a, point_b)


def hoeken_pantograph(name, lengths, masses, pivots):
    """Return Hoeken's linkage driving a pantograph (appendix A.1)."""
    size = lengths
    near = size['a46'] - size['a56']
    bars = ((size['a1'], size['a1'] / 2), (size['a2'], size['a2'] / 2),
            (size['a3'] + size['a39'], 0.0), (size['a46'], size['a46'] / 2),
            (size['a59'], size['a59'] / 2), (size['a6'], size['a6'] / 2),
            (size['a97'], size['a97'] / 2))
    bodies = tuple(bar(f'link_{index}', mass, *shape)
                   for index, (mass, shape) in enumerate(zip(masses, bars), start=1))
    joints = (
        revolute('theta_1', 'ground', 'link_1', pivots[0], actuated=True),
        revolute('theta_2', 'ground', 'link_2', pivots[1]),
        revolute('theta_3', 'link_2', 'link_3', (size['a2'], 0.0)),
        revolute('theta_4', 'ground', 'link_4', pivots[2]),
        revolute('theta_5', 'link_4', 'link_5', (near, 0.0)),
        revolute('theta_6', 'link_4', 'link_6', (size['a46'], 0.0)),
        revolute('theta_7', 'link_6', 'link_7', (size['a67'], 0.0)))
    cuts = (
        revolute_cut('cut_1', 'link_1', (size['a1'], 0.0), 'link_3', (-size['a3'], 0.0)),
        revolute_cut('cut_2', 'link_3', (size['a39'], 0.0), 'link_5', (size['a59'], 0.0)),
        revolute_cut('cut_3', 'link_7', (size['a97'], 0.0), 'link_5', (size['a59'], 0.0)))
    return Mechanism(name, bodies, joints, cuts)


def parallelogram(rockers=1):
    """Return a four-bar of links of 0.2 m and 0.5 m, with so many rockers side by side."""
    places = np.linspace(0.5, 0.1, rockers) if rockers > 1 else [0.5]
    return Mechanism(
        'parallelogram',
        (bar('crank', 1.0, 0.2, 0.1), bar('coupler', 1.0, 0.5, 0.25),
         *(bar(f'rocker_{k}', 1.0, 0.2, 0.1) for k in range(rockers))),
        (revolute('crank_joint', 'ground', 'crank', (0.0, 0.0), actuated=True),
         revolute('coupler_joint', 'crank', 'coupler', (0.2, 0.0)),
         *(revolute(f'joint_{k}', 'ground', f'rocker_{k}', (x, 0.0))
           for k, x in enumerate(places))),
        tuple(revolute_cut(f'cut_{k}', 'coupler', (x, 0.0), f'rocker_{k}', (0.2, 0.0))
              for k, x in enumerate(places)))


def hoeken_pantograph_leg():
    """Return the small leg."""
    return hoeken_pantograph('hoeken_pantograph_leg', LEG_LENGTHS, LEG_MASSES, LEG_PIVOTS)


def carpet_scraper():
    """Return the carpet scraping machine."""
    return hoeken_pantograph('carpet_scraper', SCRAPER_LENGTHS, SCRAPER_MASSES, SCRAPER_PIVOTS)


def three_rrr():
    """Return the 3-RRR manipulator (appendix A.2), both cuts at elbows."""
    corner = (0.4, 0.0)
    other_corner = (0.4 * np.cos(np.pi / 3.0), 0.4 * np.sin(np.pi / 3.0))
    bodies = (
        bar('proximal_1', 3.0, 0.4, 0.2), bar('distal_1', 4.0, 0.6, 0.3),
        Body('platform', 8.0, (0.2, 0.1155), 0.16),
        bar('distal_2', 4.0, 0.6, -0.3), bar('distal_3', 4.0, 0.6, -0.3),
        bar('proximal_2', 3.0, 0.4, 0.2), bar('proximal_3', 3.0, 0.4, 0.2))
    joints = (
        revolute('theta_1', 'ground', 'proximal_1', (0.0, 0.0), actuated=True),
        revolute('theta_2', 'proximal_1', 'distal_1', (0.4, 0.0)),
        revolute('theta_3', 'distal_1', 'platform', (0.6, 0.0)),
        revolute('theta_4', 'platform', 'distal_2', corner, -np.pi),
        revolute('theta_5', 'platform', 'distal_3', other_corner, -2.0 * np.pi / 3.0),
        revolute('theta_6', 'ground', 'proximal_2', (1.0, 0.0), actuated=True),
        revolute('theta_7', 'ground', 'proximal_3', (0.5, np.sqrt(0.75)), actuated=True))
    cuts = (
        revolute_cut('cut_1', 'distal_2', (-0.6, 0.0), 'proximal_2', (0.4, 0.0)),
        revolute_cut('cut_2', 'distal_3', (-0.6, 0.0), 'proximal_3', (0.4, 0.0)))
    return Mechanism('three_rrr', bodies, joints, cuts)


# name: (builder, coordinates near which it assembles)
MACHINES = {
    'carpet_scraper': (carpet_scraper, SCRAPER_START),
    'hoeken_pantograph_leg': (hoeken_pantograph_leg, LEG_START),
    'three_rrr': (three_rrr, THREE_RRR_START)}
