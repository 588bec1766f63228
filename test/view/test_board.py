# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Machines that are drawn from nothing with the mouse, and their closed forms."""

import cmath
import math
from test.view.browser import program
from test.view.test_edit_page import opened

from closedloop_dynamics.mechanism.kinematics import body_poses, named_paths, pose_of, world_points
from closedloop_dynamics.scene.loading import scene_of_yaml
from closedloop_dynamics.simulation.simulation import Simulation
import pytest

pytestmark = pytest.mark.skipif(
    program() is None, reason='no Chromium is installed (Debian: apt install chromium)')
CHECKED = ('page.edit.board.reported.text === page.edit.board.text && '
           'page.edit.board.status.textContent')
DEGREE = math.pi / 180.0


class Hand:
    """A mouse on the board; places are in metres on the paper."""

    def __init__(self, tab):
        self.tab = tab

    def seen(self, place):
        return self.tab.ask(f"""(() => {{
            const {{canvas}} = page.edit.board, box = canvas.getBoundingClientRect();
            const [u, v] = page.edit.board.seen([{place[0]}, {place[1]}]);
            return [u + box.x, v + box.y]; }})()""")

    def take(self, tool):
        self.tab.click(f'[data-tool="{tool}"]')

    def press(self, place):
        x, y = self.seen(place)
        self.tab.mouse('mouseMoved', x, y)
        self.tab.mouse('mousePressed', x, y, 1)

    def release(self, place):
        self.tab.mouse('mouseReleased', *self.seen(place))

    def click(self, tool, *places):
        self.take(tool)
        for place in places:
            self.press(place)
            self.release(place)

    def drag(self, tool, *pairs):
        self.take(tool)
        for start, end in pairs:
            self.press(start)
            for share in (0.5, 1.0):
                at = [(1.0 - share) * a + share * b for a, b in zip(start, end)]
                self.tab.mouse('mouseMoved', *self.seen(at), 1)
            self.release(end)

    def reported(self):
        self.tab.wait(CHECKED)
        return self.tab.ask('page.edit.board.status.textContent')

    def ask(self, what):
        return self.tab.ask(f'page.edit.board.{what}')

    def nodes(self):
        """Return the places of the pins on the paper as complex numbers, by name."""
        return {name: complex(node['x'], node['y'])
                for name, node in self.ask('drawing.nodes').items()}

    def run(self, times):
        """Yield the time, and the places of joints and points as complex numbers, by name."""
        scene = scene_of_yaml(self.ask('text'), 'drawing.yaml')
        simulation = Simulation(scene)
        for time in times:
            if time > simulation.time:
                simulation.step(duration=time - simulation.time)
            yield scene.effects['motor_1'].speed * time, _places(simulation), simulation


def _places(simulation):
    mechanism, q = simulation.mechanism, simulation.position
    frames = body_poses(mechanism, q)
    found = {joint.name: pose_of(mechanism, frames, joint.child)[:2]
             for joint in mechanism.joints}
    found.update({cut.name: world_points(pose_of(mechanism, frames, cut.body_a), cut.point_a)
                  for cut in mechanism.cut_joints})
    return {name: complex(*place)
            for name, place in {**named_paths(mechanism, q), **found}.items()}


def meeting(a, b, from_a, from_b, like):
    """Return where circles about two places meet, on the side of three places as drawn."""
    apart = abs(b - a)
    along = (apart ** 2 + from_a ** 2 - from_b ** 2) / (2.0 * apart)
    across = math.sqrt(from_a ** 2 - along ** 2)
    one, other, third = like
    side = math.copysign(1.0, ((third - one) * (other - one).conjugate()).imag)
    return a + (b - a) / apart * complex(along, side * across)


@pytest.fixture(scope='module')
def board(tmp_path_factory):
    with opened('four_bar', tmp_path_factory.mktemp('drawings')) as (tab, _):
        tab.click('#new')
        tab.wait('page.edit.board.element.open')
        yield Hand(tab)


@pytest.fixture
def hand(board):
    board.tab.click('#board [data-do=clear]')
    board.tab.wait('page.edit.board.text === ""')
    board.tab.ask('Object.assign(page.edit.board, {middle: [0.05, 0.03], scale: 4000})')
    return board


def four_bar(hand):
    hand.drag('bar', ((0, 0), (0, 0.04)), ((0.1, 0), (0.12, 0.08)))
    hand.click('link', (0, 0.04), (0.12, 0.08), (0.06, 0.1), (0, 0.04))
    hand.click('ground', (0, 0), (0.1, 0))
    hand.click('trace', (0.06, 0.1))
    hand.click('motor', (0, 0))


def coupler(at, crank):
    """Return both other pins of the four-bar's coupler when its crank has turned so far."""
    b = at['A'] + (at['B'] - at['A']) * cmath.exp(1j * crank)
    d = meeting(b, at['C'], abs(at['D'] - at['B']), abs(at['D'] - at['C']),
                (at['B'], at['C'], at['D']))
    return b, d, b + (at['E'] - at['B']) * (d - b) / (at['D'] - at['B'])


TURN = [0.1, 0.3, 0.55, 0.8]


def test_a_four_bar_is_drawn(hand):
    four_bar(hand)
    assert hand.reported().startswith('0 degrees of freedom left, 1 driven')
    at = hand.nodes()
    assert at['E'] == 0.06 + 0.1j
    for crank, places, _ in hand.run(TURN):
        b, d, e = coupler(at, crank)
        assert abs(places['D'] - d) < 1e-8 and abs(places['E'] - e) < 1e-8
        assert abs(places['B'] - b) < 1e-8


def test_a_slider_crank_is_drawn(hand):
    hand.drag('bar', ((0, 0), (0.02, 0.02)), ((0.02, 0.02), (0.1, 0)))
    hand.click('ground', (0, 0))
    hand.click('slider', (0.1, 0), (0.14, 0))
    hand.click('motor', (0, 0))
    assert hand.reported().startswith('0 degrees of freedom left, 1 driven')
    at = hand.nodes()
    crank, rod = abs(at['B']), abs(at['C'] - at['B'])
    for turned, places, _ in hand.run(TURN):
        angle = turned + cmath.phase(at['B'])
        x = crank * math.cos(angle) + math.sqrt(rod ** 2 - (crank * math.sin(angle)) ** 2)
        assert abs(places['C'] - x) < 1e-8


def test_a_whitworth_quick_return_is_drawn(hand):
    hand.drag('bar', ((0, 0), (0, 0.1)), ((0, 0.04), (0, 0.06)), ((0, 0.1), (0.1, 0.08)))
    hand.click('ground', (0, 0), (0, 0.04))
    hand.click('slot', (0, 0.06), (0, 0.08))
    hand.click('slider', (0.1, 0.08), (0.13, 0.08))
    hand.click('motor', (0, 0.04))
    assert hand.reported().startswith('0 degrees of freedom left, 1 driven')
    at = hand.nodes()
    rod = abs(at['E'] - at['B'])
    for turned, places, _ in hand.run(TURN):
        pin = 0.04j + 0.02j * cmath.exp(1j * turned)
        tip = 0.1 * pin / abs(pin)
        ram = tip.real + math.sqrt(rod ** 2 - (tip.imag - 0.08) ** 2)
        assert abs(places['slider_1'] - pin) < 1e-8 and abs(places['B'] - tip) < 1e-8
        assert abs(places['E'] - complex(ram, 0.08)) < 1e-8


def test_a_six_bar_linkage_is_drawn(hand):
    hand.tab.ask('page.edit.board.scale = 2800')
    four_bar(hand)
    hand.drag('bar', ((0.06, 0.1), (0.18, 0.1)), ((0.18, 0.1), (0.18, 0)))
    hand.click('ground', (0.18, 0))
    assert hand.reported().startswith('0 degrees of freedom left, 1 driven')
    at = hand.nodes()
    for crank, places, _ in hand.run(TURN):
        e = coupler(at, crank)[2]
        f = meeting(e, at['G'], abs(at['F'] - at['E']), abs(at['F'] - at['G']),
                    (at['E'], at['G'], at['F']))
        assert abs(places['E'] - e) < 1e-8 and abs(places['F'] - f) < 1e-8


def test_peaucellier_draws_a_straight_line(hand):
    o, q, c, d, a, b = (0, 0), (0.02, 0), (0.04, 0), (0.08, 0), (0.06, 0.03), (0.06, -0.03)
    hand.drag('bar', (q, c), (o, a), (o, b), (c, a), (c, b), (d, a), (d, b))
    hand.click('ground', o, q)
    hand.click('trace', d)
    hand.click('motor', q)
    assert hand.reported().startswith('0 degrees of freedom left, 1 driven')
    name, = (name for name, place in hand.nodes().items() if place == 0.08)
    for turned, places, _ in hand.run([0.05, 0.1, 0.15]):
        assert abs(places[name] - complex(0.08, 0.08 * math.tan(0.5 * turned))) < 1e-8


def jansens_leg(hand):
    """Draw it, return the places of its pins."""
    # By the lengths of Jansen, to what the pointer can tell; the closed form has those drawn.
    o, b, crank = 0j, -38 - 7.8j, 15j
    like = {'c': (crank, b, 0j), 'e': (crank, b, -20 - 50j)}
    c = meeting(crank, b, 50, 41.5, (crank, b, -20 + 40j))
    e = meeting(crank, b, 61.9, 39.3, like['e'])
    d = meeting(b, c, 40.1, 55.8, (b, c, -80 + 0j))
    f = meeting(d, e, 39.4, 36.7, (d, e, -90 - 60j))
    foot = meeting(e, f, 49, 65.7, (e, f, -30 - 100j))
    wanted = dict(zip('obpcedft', (o, b, crank, c, e, d, f, foot)))
    put = {key: ((place.real + 90) / 1e3, (place.imag + 75) / 1e3)
           for key, place in wanted.items()}
    hand.tab.click('[data-set=snaps]')
    hand.drag('bar', *((put[one], put[other]) for one, other in (
        'op', 'pc', 'pe', 'be', 'df')))
    hand.click('link', *(put[key] for key in 'bcdb'))
    hand.click('link', *(put[key] for key in 'efte'))
    hand.click('ground', put['o'], put['b'])
    hand.click('trace', put['t'])
    hand.click('motor', put['o'])
    hand.tab.click('[data-set=snaps]')
    return put


def test_jansens_leg_is_drawn(hand):
    put = jansens_leg(hand)
    assert hand.reported().startswith('0 degrees of freedom left, 1 driven')
    nodes = hand.nodes()
    names = {key: min(nodes, key=lambda name: abs(nodes[name] - complex(*place)))
             for key, place in put.items()}
    at = {key: nodes[name] for key, name in names.items()}
    assert len(set(names.values())) == len(nodes) == 8
    assert all(abs(at[key] - complex(*put[key])) < 5e-4 for key in at)

    def joined(one, other, third, here):
        return meeting(here[one], here[other], abs(at[third] - at[one]),
                       abs(at[third] - at[other]), (at[one], at[other], at[third]))

    for turned, places, _ in hand.run(TURN):
        here = {'b': at['b'], 'p': at['o'] + (at['p'] - at['o']) * cmath.exp(1j * turned)}
        for one, other, third in ('pbc', 'pbe', 'bcd', 'def', 'eft'):
            here[third] = joined(one, other, third, here)
        for key, place in here.items():
            assert abs(places[names[key]] - place) < 1e-7, key


def test_a_planetary_gear_is_drawn(hand):
    hand.drag('bar', ((0, 0), (0.06, 0)))
    hand.drag('gear', ((0, 0), (0, 0.03)), ((0.06, 0), (0.06, 0.03)), ((0, 0), (0, 0.09)))
    hand.click('ground', (0, 0), (0, 0.09))
    hand.click('motor', (0, 0))
    gears = [one for one in hand.ask('drawing.elements').values() if one['kind'] == 'gear']
    assert [(one['teeth'], one['ring'], one['fixed']) for one in gears] == [
        (20, False, None), (20, False, None), (60, True, 'ground')]
    assert hand.reported().startswith('0 degrees of freedom left, 1 driven')
    hand.tab.click('#board [data-do=fit]')
    top, bottom = hand.seen((0, 0.09))[1], hand.seen((0, -0.09))[1]
    assert 50 < top < bottom < hand.tab.ask('innerHeight')
    for turned, places, simulation in hand.run(TURN):
        # Willis: the carrier turns by a quarter, of teeth 20 / (20 + 60), against a ring at rest.
        assert abs(places['B'] - 0.06 * cmath.exp(0.25j * turned)) < 1e-8
        q = dict(zip(simulation.coordinates.names, simulation.position))
        assert q['B'] == pytest.approx(-0.75 * turned, abs=1e-9)


def test_a_five_slot_geneva_drive_is_drawn(hand):
    hand.drag('geneva', ((0, 0), (0.1, 0)))
    for button in ('first', 'last'):
        hand.tab.click(f'#board .fields button:{button}-of-type')
    hand.click('motor', (0.1, 0))
    assert hand.ask('drawing.elements.geneva_1.slots') == 5
    assert hand.reported().startswith('1 degree of freedom left, 1 driven')
    share = math.sin(math.pi / 5)
    for turned, _, simulation in hand.run([0.42, 0.47, 0.53, 0.58, 1.0]):
        wheel = dict(zip(simulation.coordinates.names, simulation.position))['A']
        # With the pin in a slot; then the wheel has gone on by a fifth of a turn, and rests.
        after = turned - math.pi
        angle = -math.atan2(share * math.sin(after), 1.0 - share * math.cos(after))
        # The slots are wider than the pin by 20 micrometres on either side, at 40 mm and more.
        assert wheel == pytest.approx(angle if abs(after) < 1.0 else -math.pi / 5, abs=2e-3)


def test_other_elements_are_drawn(hand):
    hand.drag('bar', ((0, 0), (0.08, 0.02)), ((0.08, 0.02), (0.1, 0.08)))
    hand.drag('cylinder', ((0.08, 0.02), (0.04, -0.04)))
    hand.drag('gear', ((0, 0.07), (0, 0.1)), ((0.06, 0.07), (0.06, 0.1)))
    hand.drag('gear', ((-0.02, 0.01), (-0.02, 0.04)))
    hand.click('ground', (0, 0), (0.04, -0.04), (0, 0.07), (0.06, 0.07), (-0.02, 0.01))
    hand.click('belt', (0.03, 0.07), (-0.05, 0.01))
    hand.click('rack', (0.06, 0.1))
    hand.drag('spring', ((0.1, 0.08), (0.06, 0.07)))
    hand.drag('damper', ((0.1, 0.08), (0.14, 0.07)))
    hand.click('ground', (0.14, 0.07))
    hand.drag('force', ((0.1, 0.08), (0.12, 0.1)))
    hand.click('motor', (0.06, -0.01), (0, 0.07))
    # The crank with its bar, held by the rod of the cylinder; one gear train.
    assert hand.reported().startswith('1 degree of freedom left, 2 driven')
    elements = hand.ask('drawing.elements')
    assert {one['kind'] for one in elements.values()} == {
        'link', 'cylinder', 'gear', 'mesh', 'belt', 'rack', 'spring', 'force', 'motor'}
    assert elements['force_1']['x'] == pytest.approx(2.0)
    scene = scene_of_yaml(hand.ask('text'), 'drawing.yaml')
    assert scene.effects['spring_2'].damping == 1.0 and scene.effects['spring_2'].stiffness == 0.0
    simulation = Simulation(scene)
    names = simulation.coordinates.names
    begun = dict(zip(names, simulation.position))
    # What nothing of the drawing turns is not turned.
    assert max(abs(begun[name]) for name, at in hand.nodes().items()
               if at in (0.07j, 0.06 + 0.07j, -0.02 + 0.01j)) < 1e-9
    # The rod is as far out as it is drawn, and its motor lengthens it.
    assert begun['cylinder_1'] == pytest.approx(math.hypot(0.04, 0.06), abs=1e-9)
    simulation.step(duration=0.1)
    moved = {name: end - begun[name] for name, end in zip(names, simulation.position)}
    motors = scene.effects['motor_1'], scene.effects['motor_2']
    assert moved['cylinder_1'] == pytest.approx(0.1 * motors[0].speed, abs=1e-9)
    turned = 0.1 * motors[1].speed
    wheels = [name for name, at in hand.nodes().items()
              if at in (0.07j, 0.06 + 0.07j, -0.02 + 0.01j)]
    # A belt turns the same way, a mesh the other; the rack goes as far as the circle rolls.
    assert sorted(moved[name] / turned for name in wheels) == pytest.approx([-1.0, 1.0, 1.0])
    assert abs(moved['rack_1_guide']) == pytest.approx(0.03 * turned, abs=1e-9)


def test_a_cam_lifts_its_roller_by_its_table(hand):
    hand.drag('bar', ((0, 0.05), (0, 0.08)))
    hand.click('ground', (0, 0))
    hand.drag('cam', ((0, 0), (0, 0.05)))
    hand.click('slider', (0, 0.08), (0, 0.11))
    hand.click('motor', (0, 0))
    words = hand.reported()
    assert words.startswith('2 degrees of freedom left, 1 driven'), words
    radii = hand.ask('drawing.elements.cam_1.radii')
    assert len(radii) == 36 and min(radii) == pytest.approx(0.04)
    effect = scene_of_yaml(hand.ask('text'), 'drawing.yaml').effects['cam_1_outline']
    assert effect.radii == pytest.approx(radii) and effect.radius == pytest.approx(0.01)


def test_what_repeats_and_what_is_wrong_is_reported_beside_the_element(hand):
    # A parallelogram with a third crank moves, at these lengths only.
    for x in (0.0, 0.05, 0.1):
        hand.drag('bar', ((x, 0), (x, 0.04)))
    hand.click('ground', (0, 0), (0.05, 0), (0.1, 0))
    hand.click('link', (0, 0.04), (0.05, 0.04), (0.1, 0.04))
    hand.tab.ask("""page.edit.board.canvas.dispatchEvent(
        new KeyboardEvent("keydown", {key: "Enter", bubbles: true}))""")
    words = hand.reported()
    assert words.startswith('1 degree of freedom: ')
    assert 'repeats others' in words and '(at these lengths only)' in words
    assert hand.ask('marked.length') > 0
    # A bar that hangs on nothing.
    hand.drag('bar', ((0.12, 0.08), (0.14, 0.08)))
    words = hand.reported()
    assert "mechanism.bodies.link_5: expected joints that lead to 'ground', got none" in words
    assert hand.ask('marked') == ['link_5']
    assert hand.tab.ask('getComputedStyle(page.edit.board.status).color') == hand.tab.ask(
        'getComputedStyle(document.querySelector("#board .reported.bad")).color')
    hand.tab.click('#board [data-do=undo]')
    assert hand.reported().startswith('1 degree of freedom: ')
    assert hand.ask('marked').count('link_5') == 0


def test_numbers_are_typed_with_units_undone_and_nudged_by_keys(hand):
    hand.drag('bar', ((0, 0), (0.04, 0)))
    hand.click('ground', (0, 0))
    hand.click('select', (0.03, 0))
    set_field = """(() => {{
        const label = [...document.querySelectorAll("#board .fields label")].find(
            (one) => one.textContent.startsWith({0!r}));
        const input = label.querySelector("input");
        input.value = {1!r}; input.onchange(); }})()"""
    hand.tab.ask(set_field.format('length', '2 inch'))
    assert hand.nodes()['B'] == pytest.approx(0.0508)
    hand.tab.ask(set_field.format('angle', '90'))
    assert abs(hand.nodes()['B'] - 0.0508j) < 1e-12
    hand.tab.ask('document.querySelector("[data-set=unit]").value = "inch"; '
                 'document.querySelector("[data-set=unit]").onchange()')
    assert 'B: [0, 2 inch]' in hand.ask('text')
    hand.tab.ask(set_field.format('length', 'long'))
    assert abs(hand.nodes()['B'] - 0.0508j) < 1e-12
    named = 'document.querySelector("#board .name")'
    for name in ('my machine', 'my_machine'):
        hand.tab.ask(f'{named}.value = "{name}"; {named}.oninput({{target: {named}}})')
        assert hand.ask('drawing.name') == (name if '_' in name else 'drawing')
        assert hand.tab.ask(f'{named}.classList.contains("bad")') == ('_' not in name)
    hand.click('select', (0, 0.0508))
    key = """page.edit.board.canvas.dispatchEvent(
        new KeyboardEvent("keydown", {{key: "{}", ctrlKey: {}, bubbles: true}}))"""
    hand.tab.ask(key.format('ArrowRight', 'false'))
    assert hand.nodes()['B'].real == pytest.approx(hand.ask('grid'))
    for _ in range(4):
        hand.tab.ask(key.format('z', 'true'))
    assert hand.nodes()['B'] == 0.04 and hand.ask('drawing.unit') == 'mm'
    hand.tab.ask(key.format('y', 'true'))
    assert hand.nodes()['B'] == pytest.approx(0.0508)


def test_text_that_the_board_cannot_draw_is_checked_and_simulated_by_the_server(hand):
    four_bar(hand)
    hand.reported()
    text = hand.ask('text').replace('mechanism:\n', 'mechanism:\n  parameters: {m: 0.2}\n')
    type_text = """(() => {{
        page.edit.board.area.value = {!r};
        page.edit.board.area.dispatchEvent(new Event("input")); }})()"""
    hand.tab.ask(type_text.format(text.replace('speed: 6.28319', 'speed: 5*m')))
    hand.tab.wait('page.edit.board.text.includes("5*m")')
    words = hand.reported()
    assert words.startswith('0 degrees of freedom left, 1 driven')
    line = text[:text.index('motor_1')].count('\n') + 1
    assert words.endswith(f'not drawn, line {line}: expected a number, got 5*m')
    hand.tab.ask(type_text.format(text.replace('speed: 6.28319', 'speed: 5*k')))
    hand.tab.wait('page.edit.board.text.includes("5*k")')
    assert hand.reported().startswith(f'line {line}: effects.motor_1.speed: expected a number')


def test_a_pin_is_moved_by_a_finger(hand):
    hand.drag('bar', ((0, 0), (0.04, 0)))
    hand.take('select')
    (x, y), (u, v) = hand.seen((0.04, 0)), hand.seen((0.06, 0.02))
    # Beside the pin, as fingers are.
    hand.tab.touch((x + 18, y), (u + 8, v), (u + 18, v))
    assert hand.nodes()['B'] == 0.06 + 0.02j


def test_a_drawing_is_simulated(tmp_path):
    with opened('four_bar', tmp_path) as (tab, runner):
        tab.click('#new')
        tab.wait('page.edit.board.element.open')
        hand = Hand(tab)
        four_bar(hand)
        hand.reported()
        tab.click('#board [data-do=simulate]')
        tab.wait('page.scene.title === "drawing" && !page.edit.board.element.open')
        tab.click('#play')
        tab.wait('page.now > 0.2')
        tab.click('#new')
        # It goes on as it was, and is simulated again.
        assert hand.ask('text').startswith('mechanism:\n  name: drawing')
        assert runner.simulation.scene.name == 'drawing'
        hand.drag('bar', ((0.06, 0.1), (0.06, 0.11)))
        hand.reported()
        tab.click('#board [data-do=simulate]')
        tab.wait('page.scene.bodies.length === 4 && !page.edit.board.element.open')
