# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The description that ``closedloop check`` prints says what was understood."""

from copy import deepcopy
from dataclasses import replace

from closedloop_dynamics import (
    AssemblyError, Body, Joint, load_scene, Mechanism, scene_names, Simulation)
from closedloop_dynamics.kinematics.motions import moving
from closedloop_dynamics.studies.check import describe
import pytest

from ..reference import cases
from ..reference.machines import parallelogram


def paragraphs(*described):
    """Return the lines of each paragraph by its heading."""
    parts = [part.splitlines() for part in describe(*described).split('\n\n')]
    return {lines[0]: [line.strip() for line in lines[1:]] for lines in parts}


def cells(lines):
    """Return the cells of a table, which stand two or more spaces apart."""
    return [[cell.strip() for cell in line.split('  ') if cell.strip()] for line in lines]


# A jack whose nut is 0.413 mm beside the axis of its screw.
JACK = {
    'mechanism': {
        'name': 'jack',
        'bodies': {
            'screw': {'mass': 1.0, 'center_of_mass': [0, 0, 0.1], 'inertia': [0.01, 0.01, 0.001]},
            'head': {'mass': 2.0, 'center_of_mass': [0, 0, 0], 'inertia': [0.01, 0.01, 0.01]}},
        'joints': {
            'bearing': {'type': 'revolute', 'parent': 'ground', 'child': 'screw',
                        'position': [0, 0, 0], 'axis': [0, 0, 1]},
            'guide': {'type': 'prismatic', 'parent': 'ground', 'child': 'head',
                      'position': [0.1, 0, 0.2], 'axis': [0, 0, 1]}},
        'cut_joints': {
            'nut': {'type': 'helical', 'body_a': 'head', 'point_a': [-0.099587, 0, 0],
                    'body_b': 'screw', 'point_b': [0, 0, 0.2], 'axis_b': [0, 0, 1],
                    'lead': 0.00048}}},
    'initial': {'position': {'bearing': 0, 'guide': 0}, 'hold': ['bearing']}}


def test_a_machine_that_cannot_be_assembled_has_no_degrees_of_freedom():
    scene = load_scene(JACK)
    with pytest.raises(AssemblyError, match=r'nut open by 0\.000413 m beside its axis\.'):
        Simulation(scene)
    count = next(line for line in paragraphs(scene)['Summary'] if 'degrees' in line)
    assert 'not known: the loops do not close next to the start' in count
    # With the nut on the axis it is the machine of one freedom that it was drawn as.
    straight = deepcopy(JACK)
    straight['mechanism']['cut_joints']['nut']['point_a'] = [-0.1, 0, 0]
    assert 'degrees of freedom  ' in describe(load_scene(straight))
    assert Simulation(load_scene(straight)).data.degrees_of_freedom() == 1


def test_idle_freedoms_are_reported():
    found = paragraphs(load_scene('rssr_four_bar'), Simulation(load_scene('rssr_four_bar')))
    assert any('1 of these: rod turns about' in line for line in found['Summary'])
    # A shaft between two bearings is driven, a platform moves with its legs.
    for name in ('bennett', 'stewart_platform', 'excavator_arm'):
        assert 'idle' not in describe(load_scene(name), Simulation(load_scene(name)))


def test_three_rrr_is_described_whole():
    scene = load_scene('three_rrr')
    parts = paragraphs(scene, Simulation(scene))
    assert list(parts) == [
        'Scene three_rrr', 'Mechanism three_rrr', 'Bodies: 7', 'Joints: 7', 'Subsystems: 3',
        'Cut joints: 2', 'Points: 4', 'Summary',
        'Joints at the start, as given and with the loops closed: 7', 'Effects: 1', 'Method']
    assert parts['Scene three_rrr'] == [scene.description]
    assert parts['Mechanism three_rrr'] == [scene.mechanism.description]
    assert cells(parts['Bodies: 7'])[:2] == [
        ['name', 'mass [kg]', 'centre of mass [m]', 'inertia [kg m^2]'],
        ['proximal_1', '3', '[0.2, 0]', '0.04']]
    assert cells(parts['Joints: 7'])[4] == [
        'theta_4', 'revolute', 'platform', 'distal_2', '[0.4, 0]', '-3.14159', 'no']
    assert cells(parts['Subsystems: 3'])[1:] == [
        ['1', 'theta_1, theta_2, theta_3, theta_4, theta_5'], ['2', 'theta_6'], ['3', 'theta_7']]
    assert cells(parts['Cut joints: 2'])[2] == [
        'cut_2', 'revolute', 'distal_3', '[-0.6, 0]', 'proximal_3', '[0.4, 0]', '2', '1, 3']
    assert cells(parts['Summary']) == [
        ['constraint equations', '4'],
        ['degrees of freedom', '3 = 7 joints - 4 equations'],
        ['elimination order', 'cut_1, cut_2; blocks of fill: 0'],
        ['actuated joints', 'theta_1, theta_6, theta_7']]
    assert cells(parts['Joints at the start, as given and with the loops closed: 7'])[1:3] == [
        ['theta_1', '1.0467', '0', 'held', '1.0467', '0'],
        ['theta_2', '5.4206', '0', 'free', '5.42081', '0']]
    given = 'Joints at the start, before the loops are closed: 7'
    assert cells(paragraphs(scene)[given])[2] == ['theta_2', '5.4206', '0', 'free']
    assert cells(parts['Effects: 1'])[1:] == [['gravity', 'gravity', 'acceleration = [0, -9.81]']]
    assert cells(parts['Method']) == [
        ['integrator', 'auto'], ['accuracy', '1e-06 rad or m within a second'],
        ['step size', '0.001 s'], ['stabilisation', 'projection']]


def test_scraper_eliminates_without_fill():
    parts = paragraphs(load_scene('carpet_scraper').mechanism)
    summary = dict(cells(parts['Summary']))
    assert summary['constraint equations'] == '6'
    assert summary['degrees of freedom'].startswith('1 = 7 joints - 6 equations')
    order, fill = summary['elimination order'].split('; ')
    assert sorted(order.split(', ')) == ['cut_1', 'cut_2', 'cut_3']
    assert fill == 'blocks of fill: 0'
    assert [row[-1] for row in cells(parts['Cut joints: 3'])[1:]] == ['1, 2', '2, 3', '3']


def test_mechanism_alone_has_no_scene():
    parts = paragraphs(load_scene('slider_crank').mechanism)
    assert list(parts)[0] == 'Mechanism slider_crank'
    assert list(parts)[-1] == 'Summary'
    assert cells(parts['Joints: 3'])[3][:2] == ['slider_joint', 'prismatic']


def test_tree_without_cuts_or_drives():
    pendulum = Mechanism('pendulum', (Body('rod', 1.0, (0.5, 0.0), 0.1),),
                         (Joint('pivot', 'revolute', 'ground', 'rod', (0.0, 0.0)),))
    parts = paragraphs(pendulum)
    assert parts['Cut joints: none'] == []
    assert not any(title.startswith('Points') for title in parts)
    assert dict(cells(parts['Summary'])) == {
        'constraint equations': '0',
        'degrees of freedom': '1 = 1 joints - 0 equations',
        'elimination order': 'none; blocks of fill: 0', 'actuated joints': 'none'}


def test_time_constant_is_shown_where_it_matters():
    scene = load_scene('four_bar')
    method = replace(scene.method, stabilisation='baumgarte', baumgarte_time_constant=0.02)
    shown = dict(cells(paragraphs(replace(scene, method=method, effects={}))['Method']))
    assert shown['time constant'] == '0.02 s'
    assert 'Effects: none' in describe(replace(scene, effects={}))


@pytest.mark.parametrize('name', cases.only(cases.CLASSES, scene_names()))
def test_every_shipped_scene_is_described_in_plain_columns(name):
    text = describe(load_scene(name))
    assert all(line == line.rstrip() for line in text.splitlines())
    assert text.isascii() and not text.endswith('\n')
    for joint in load_scene(name).mechanism.joints:
        assert joint.name in text


def test_of_an_over_constrained_mechanism_what_can_move_is_named():
    assert dict(cells(paragraphs(parallelogram(rockers=4))['Summary']))['degrees of freedom'] == (
        '1 = 6 joints - 5 independent equations (3 of 8 repeat others)')


@pytest.mark.parametrize('name, motion, reported', [
    ('slider_crank', {'crank_joint': '1.0472'},
     '0 = 3 joints - 2 equations - 1 prescribed motion'),
    ('bennett', {'joint_1': '1+2*t'},
     '0 = 3 joints - 2 independent equations (3 of 5 repeat others) - 1 prescribed motion'),
    ('rssr_four_bar', {'crank': 't'},
     '1 = 5 of the joints - 3 equations - 1 prescribed motion')])
def test_prescribed_motions_are_counted_apart_from_equations(name, motion, reported):
    scene = moving(load_scene(name), motion)
    assert dict(cells(paragraphs(scene, Simulation(scene))['Summary']))[
        'degrees of freedom'] == reported
