# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The page that draws and simulates machines by itself: in a real browser, from disk."""

from dataclasses import replace
import json
from test.view.browser import browser, program

from closedloop_dynamics.scene.loading import scene_of_yaml
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.view.page import editor_page
from closedloop_dynamics.view.standalone import METHOD
from matplotlib.path import Path
import numpy as np
import pytest

pytestmark = pytest.mark.skipif(
    program() is None, reason='no Chromium is installed (Debian: apt install chromium)')
READY = 'typeof page !== "undefined" && Boolean(page.shownRow) && Boolean(page.controls)'
MACHINE = 'page.socket.machine'


def drawing(nodes, **elements):
    """Return a drawing: nodes by name (x, y, and ``ground`` or ``trace``) [m], and elements."""
    return {'name': 'drawn', 'nodes': {
        name: {'x': x, 'y': y, **dict.fromkeys(marks, True)}
        for name, (x, y, *marks) in nodes.items()}, 'elements': elements}


def link(*nodes):
    return {'kind': 'link', 'nodes': list(nodes)}


FOUR_BAR = drawing(
    {'A': (0.0, 0.0, 'ground'), 'B': (0.02, 0.03), 'C': (0.1, 0.07), 'D': (0.1, 0.0, 'ground'),
     'E': (0.05, 0.09, 'trace')},
    link_1=link('A', 'B'), link_2=link('B', 'C', 'E'), link_3=link('C', 'D'))
DRAWINGS = {
    'four_bar': FOUR_BAR,
    # A block on the ground, a spring, a damper, a force and a torque.
    'slider_crank': drawing(
        {'A': (0.0, 0.0, 'ground'), 'B': (0.03, 0.02, 'trace'), 'C': (0.12, 0.01, 'trace'),
         'D': (0.1, 0.08, 'ground')},
        link_1=link('A', 'B'), link_2=link('B', 'C'),
        slider_1={'kind': 'slider', 'node': 'C', 'on': None, 'angle': 0.1, 'block': True},
        spring_1={'kind': 'spring', 'a': 'D', 'b': 'B', 'stiffness': 20.0, 'damping': 0.1},
        force_1={'kind': 'force', 'node': 'C', 'x': -0.2, 'y': 0.1},
        motor_1={'kind': 'motor', 'node': 'A', 'law': 'torque', 'value': 0.01}),
    # A pin in a slot of a lever.
    'whitworth': drawing(
        {'A': (0.0, 0.0, 'ground'), 'B': (0.0, -0.05, 'ground'), 'C': (0.03, 0.01, 'trace'),
         'D': (0.05, 0.1, 'trace')},
        link_1=link('A', 'C'), link_2=link('B', 'D'),
        slider_1={'kind': 'slider', 'node': 'C', 'on': 'link_2', 'angle': 1.1071487177940904,
                  'block': False}),
    # A rod of variable length beneath a lever; both fall.
    'cylinder': drawing(
        {'A': (0.0, 0.0, 'ground'), 'B': (0.08, -0.02, 'ground'), 'C': (0.06, 0.05, 'trace'),
         'D': (0.1, 0.08, 'trace')},
        link_1=link('A', 'C', 'D'), cylinder_1={'kind': 'cylinder', 'a': 'B', 'b': 'C'}),
    # Two gears, with a bar on one that falls.
    'gears': drawing(
        {'A': (0.0, 0.0, 'ground'), 'B': (0.045, 0.0, 'ground'), 'C': (0.045, 0.1, 'trace'),
         'D': (0.03, 0.12, 'trace')},
        link_1=link('B', 'C', 'D'),
        gear_1={'kind': 'gear', 'node': 'A', 'teeth': 20, 'module': 0.003, 'ring': False,
                'fixed': None},
        gear_2={'kind': 'gear', 'node': 'B', 'teeth': 10, 'module': 0.003, 'ring': False,
                'fixed': 'link_1'},
        mesh_1={'kind': 'mesh', 'a': 'gear_1', 'b': 'gear_2'}),
    # A parallelogram with a third crank, whose equations repeat others.
    'redundant': drawing(
        {'A': (0.0, 0.0, 'ground'), 'B': (0.1, 0.0, 'ground'), 'C': (0.2, 0.0, 'ground'),
         'D': (0.03, 0.05, 'trace'), 'E': (0.13, 0.05), 'F': (0.23, 0.05, 'trace')},
        link_1=link('A', 'D'), link_2=link('B', 'E'), link_3=link('C', 'F'),
        link_4=link('D', 'E', 'F'))}


@pytest.fixture(scope='module')
def page_of_editor(tmp_path_factory):
    path = tmp_path_factory.mktemp('editor') / 'editor.html'
    path.write_text(editor_page('Draw and simulate', METHOD), encoding='utf-8')
    return path


@pytest.fixture(scope='module')
def open_page():
    with browser() as open_page:
        yield open_page


@pytest.fixture(scope='module')
def tab(open_page, page_of_editor):
    tab = open_page(page_of_editor.as_uri())
    tab.wait(READY)
    yield tab
    assert not tab.errors
    tab.close()


def show(tab, drawn):
    """Simulate a drawing from its start, paused."""
    tab.ask(f'page.editor.board.drawing = new Drawing({json.dumps(drawn)});'
            'page.editor.show(); page.ask("reset")')


def simulation_of(tab):
    """Return the simulation of the YAML that the page writes for its drawing."""
    scene = scene_of_yaml(tab.ask('page.editor.board.drawing.text()'), 'drawn.yaml')
    return Simulation.from_scene(replace(scene, method=replace(
        scene.method, integrator='dop853', tolerance=1e-13)))


@pytest.mark.parametrize('name', DRAWINGS)
def test_a_drawing_moves_as_its_scene(name, tab):
    show(tab, DRAWINGS[name])
    simulation = simulation_of(tab)
    if any(one['kind'] == 'motor' for one in DRAWINGS[name]['elements'].values()):
        # Both have its torque.
        assert tab.ask('page.controls.motion') == 'own'
    tab.ask(f'page.socket.until(0.25); {MACHINE}.evaluate()')
    assert tab.ask('page.socket.failure') is None
    assert tab.ask(f'{MACHINE}.time') == pytest.approx(0.25, abs=1e-12)
    before = simulation.points
    simulation.step({}, 0.25)
    for point in (one.name for one in simulation.mechanism.points):
        found = tab.ask(f"""(() => {{
            const at = page.scene.points.findIndex((one) => one.name === "{point}");
            const [row, x, y] = {MACHINE}.described.points[at];
            return {MACHINE}.pointOf(row, [x, y, 0])[0].slice(0, 2); }})()""")
        np.testing.assert_allclose(found, simulation.point(point), rtol=0, atol=1e-9)
    assert np.abs(simulation.points - before).max() > 1e-3
    assert abs(tab.ask(f'{MACHINE}.residual')) < 1e-9


@pytest.mark.parametrize('name, freedoms', (('four_bar', 1), ('redundant', 1), ('gears', 1)))
def test_degrees_of_freedom_are_shown(name, freedoms, tab):
    tab.ask(f'page.editor.board.drawing = new Drawing({json.dumps(DRAWINGS[name])})')
    reported = tab.ask('page.editor.made().reported()')
    assert reported['error'] is None and reported['freedoms'] == freedoms
    # Of the parallelogram's third crank.
    assert reported['repeated'] == (['F'] if name == 'redundant' else [])
    assert ('F repeats others' in reported['words']) == (name == 'redundant')


def gear(node, teeth, ring=False, fixed=None):
    return {'kind': 'gear', 'node': node, 'teeth': teeth, 'module': 0.003, 'ring': ring,
            'fixed': fixed}


# A planet on an arm, in a ring at rest and about a sun, which pushes a rack.
PLANETARY = drawing(
    {'A': (0.0, 0.0, 'ground'), 'B': (0.0495, 0.0)},
    link_1=link('A', 'B'), gear_1=gear('A', 20), gear_2=gear('B', 13),
    gear_3=gear('A', 46, True, 'ground'), mesh_1={'kind': 'mesh', 'a': 'gear_1', 'b': 'gear_2'},
    mesh_2={'kind': 'mesh', 'a': 'gear_3', 'b': 'gear_2'},
    rack_1={'kind': 'rack', 'gear': 'gear_1', 'angle': 2.0},
    motor_1={'kind': 'motor', 'node': 'A', 'body': 'link_1', 'law': 'speed', 'value': 1.0})


def outlines(tab):
    """Return the teeth of all bodies in the world, shape (n, 2), of the ground as '-1'."""
    found = tab.ask(f"""(() => {{
        const found = {{}}, put = (row, shapes) => {{
          for (const {{kind, outline, hole, origin, x}} of shapes) {{
            if (kind !== 'profile') continue;
            const teeth = row ? outline : hole, turned = Math.atan2(x[1], x[0]);
            found[row - 1] = teeth.map((place) => {{
              const [u, v] = rotate(place, turned);
              return {MACHINE}.pointOf(row, [origin[0] + u, origin[1] + v, 0])[0].slice(0, 2);
            }});
          }}
        }};
        {MACHINE}.evaluate();
        put(0, page.scene.ground);
        page.scene.bodies.forEach(({{name, shapes}}) => put(page.editor.made().row[name], shapes));
        return found; }})()""")
    return {name: np.array(places) for name, places in found.items()}


def test_teeth_of_gears_and_racks_lie_in_gaps_as_they_turn(tab):
    show(tab, PLANETARY)
    rows = tab.ask('page.editor.made().row')
    for time in (0.0, 0.11, 0.29, 0.4):
        tab.ask(f'page.socket.until({time})')
        teeth = outlines(tab)
        sun, planet, rack = (teeth[str(rows[name] - 1)] for name in ('gear_1', 'gear_2', 'rack_1'))

        def tips(outline, count):
            return outline.reshape(-1, count, 2)[:, count // 2 - 1:count // 2 + 1].mean(axis=1)

        assert (len(sun), len(planet), len(teeth['-1'])) == (12 * 20, 12 * 13, 12 * 46)
        mine = tips(planet, 12)
        assert not Path(sun).contains_points(mine).any()
        assert Path(teeth['-1']).contains_points(mine).all()
        assert not Path(rack).contains_points(tips(sun, 12)).any()
        for outline, others in ((planet, tips(sun, 12)), (planet, tips(teeth['-1'], 12)),
                                (sun, mine), (sun, tips(rack[:-2], 4))):
            assert not Path(outline).contains_points(others).any()
        # They reach into one another.
        away = np.linalg.norm(mine, axis=1)
        assert away.min() < 0.03 + 0.0015 and away.max() > 0.069 + 0.0015
        assert np.linalg.norm(tips(rack[:-2], 4), axis=1).min() < 0.03


CAM = drawing(
    {'A': (0.0, 0.0, 'ground'), 'B': (0.0, 0.05), 'C': (0.0, 0.08)}, link_1=link('B', 'C'),
    cam_1={'kind': 'cam', 'node': 'A', 'roller': 'B', 'radius': 0.01,
           'radii': [0.04, 0.045, 0.05, 0.045]},
    slider_1={'kind': 'slider', 'node': 'C', 'on': 'ground', 'angle': 1.5707963267948966,
              'block': True},
    motor_1={'kind': 'motor', 'node': 'A', 'body': 'cam_1', 'law': 'speed', 'value': 3.0})
GENEVA = drawing(
    {'A': (0.0, 0.0, 'ground'), 'B': (0.1, 0.0, 'ground')},
    geneva_1={'kind': 'geneva', 'wheel': 'A', 'driver': 'B', 'slots': 5},
    motor_1={'kind': 'motor', 'node': 'B', 'body': 'geneva_1_driver', 'law': 'speed',
             'value': 3.0})
BELT = drawing(
    {'A': (0.0, 0.0, 'ground'), 'B': (0.1, 0.0, 'ground')},
    gear_1=gear('A', 20), gear_2=gear('B', 30),
    belt_1={'kind': 'belt', 'a': 'gear_1', 'b': 'gear_2'})


@pytest.mark.parametrize('name, drawn', [
    *DRAWINGS.items(), ('planetary', PLANETARY), ('cam', CAM), ('geneva', GENEVA),
    ('belt', BELT)])
def test_a_scene_is_drawn_again_from_its_text(name, drawn, tab):
    text, again, elements = tab.ask(f"""(() => {{
        const drawn = new Drawing({json.dumps(drawn)}), text = drawn.text();
        const again = new SceneReader(text).drawing;
        return [text, again.text(), again.elements]; }})()""")
    # Points, and places of the start, may be in another order.
    one, other = (sorted(map(sorted, written.split('\n'))) for written in (text, again))
    assert one == other
    kinds = [one['kind'] for one in elements.values()]
    assert sorted(kinds) == sorted(one['kind'] for one in drawn['elements'].values())


def typed(tab, text):
    """Type a text into the board; return what is shown of it."""
    tab.ask(f"""(() => {{
        const {{area}} = page.editor.board;
        area.value = {json.dumps(text)};
        area.dispatchEvent(new Event("input")); }})()""")
    tab.wait(f'page.editor.board.reported.text === {json.dumps(text)}')
    return tab.ask('page.editor.board.status.textContent')


def test_a_scene_is_typed_and_what_is_wrong_reported_with_its_line(tab):
    show(tab, FOUR_BAR)
    tab.ask('page.editor.board.open()')
    text = tab.ask('page.editor.board.text')
    node = 'page.editor.board.drawing.nodes.E'
    other = '# Mine.\n' + text.replace('E: [50 mm, 90 mm]', 'E: [5 cm, 0.09]')
    assert typed(tab, other).startswith('1 degree of freedom')
    assert tab.ask('page.editor.board.text') == other
    assert tab.ask(f'[{node}.x, {node}.y]') == [0.05, 0.09]
    line = text[:text.index('    A:')].count('\n') + 1
    for before, after, words in (
            ('between: [ground, link_1]', 'between: [ground, link_7]',
             f'line {line}: expected the name of a body, got link_7'),
            ('  joints:', '  springs: {}\n  joints:', 'the board has no mechanism.springs'),
            ('points: [[0, 0]', 'points: [[1 deg, 0]',
             f'line {line}: expected units of length, got 1 deg'),
            ('B: [20 mm, 30 mm]', 'B: [20 mm, 30 mm', 'expected'),
            ('inertia: 0.0000285833', 'inertia: 0.00003',
             'line 6: mechanism.bodies.link_3.inertia: expected 0.0000285833')):
        assert words in typed(tab, text.replace(before, after, 1)), after
    assert tab.ask('page.editor.board.element.open')
    tab.click('#board [data-do="simulate"]')
    assert tab.ask('page.editor.board.element.open')
    # A click on what is shown leads to the line.
    tab.ask('page.editor.board.status.click()')
    area = 'page.editor.board.area'
    start, end = tab.ask(f'[{area}.selectionStart, {area}.selectionEnd]')
    assert tab.ask('page.editor.board.text')[start:end].startswith('    link_3: {mass')
    # The mouse draws on from the last drawing, and undoing brings the typed text back.
    tab.click('#board [data-do="undo"]')
    assert tab.ask('page.editor.board.text') != text
    for _ in range(4):
        tab.click('#board [data-do="undo"]')
    assert tab.ask('page.editor.board.text') == other
    tab.click('#board [data-do="undo"]')
    assert tab.ask('page.editor.board.text') == text
    tab.click('#board [data-do="close"]')


def chain(count):
    places = {f'P{k}': (0.02 * k, 0.0) for k in range(count + 1)}
    places['P0'] = (0.0, 0.0, 'ground')
    return drawing(places, **{f'link_{k}': link(f'P{k - 1}', f'P{k}')
                              for k in range(1, count + 1)})


@pytest.mark.parametrize('drawn, expected', (
    (chain(13), 'expected 12 links at most on this page, got 13'),
    (drawing({'A': (0.0, 0.0), 'B': (0.1, 0.0)}, link_1=link('A', 'B')),
     'expected joints that lead to the ground'),
    (drawing({'A': (0.0, 0.0, 'ground'), 'B': (0.1, 0.0)}, cam_1={
        'kind': 'cam', 'node': 'A', 'roller': 'B', 'radius': 0.01, 'radii': [0.02]}),
     'outlines that touch are not simulated on this page')))
def test_what_cannot_be_simulated_here_is_said(drawn, expected, tab):
    tab.ask(f'page.editor.board.drawing = new Drawing({json.dumps(drawn)}); page.editor.show()')
    assert expected in tab.ask('document.getElementById("message").textContent')


def test_a_drawing_is_simulated_and_shared_by_its_address(open_page, page_of_editor):
    tab = open_page(page_of_editor.as_uri())
    tab.wait(READY)
    tab.wait('page.playing && page.now > 0.1')
    assert tab.ask('page.scene.title') == 'four_bar'
    assert tab.ask('page.controls.drives.A.mode') == 'speed'
    tab.click('#new')
    tab.ask(f'page.editor.board.drawing = new Drawing({json.dumps(DRAWINGS["slider_crank"])});'
            'page.editor.board.changed()')
    tab.wait('page.editor.board.status.textContent.startsWith("1 degree")')
    tab.click('#board [data-do="simulate"]')
    tab.wait('page.scene.title === "drawn" && page.playing && page.now > 0.1')
    address = tab.ask('location.href')
    assert '#' in address and len(address) < 2000
    # The scene as YAML, for closedloop.
    assert Simulation.from_scene(scene_of_yaml(
        tab.ask('fetch(page.editor.board.link.href).then((answer) => answer.text())'),
        'drawn.yaml')).actuated_joints
    other = open_page(address)
    other.wait(READY)
    assert other.ask('page.scene.title') == 'drawn'
    assert other.ask('page.editor.board.drawing.text()') == tab.ask(
        'page.editor.board.drawing.text()')
    for one in (tab, other):
        assert not one.errors
        one.close()


def test_an_address_that_is_damaged_is_said(open_page, page_of_editor):
    tab = open_page(page_of_editor.as_uri() + '#%7Bnonsense')
    tab.wait('typeof page !== "undefined" && !document.getElementById("message").hidden')
    assert 'no drawing' in tab.ask('document.getElementById("message").textContent')
    tab.close()


def test_without_scripts_it_says_what_is_missing(open_page, page_of_editor):
    tab = open_page(page_of_editor.as_uri(), scripts=False)
    tab.wait('document.readyState === "complete" && Boolean(document.querySelector("noscript p"))')
    assert 'Allow scripts' in tab.ask('document.querySelector("noscript p").innerText')
    tab.close()
