# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""A page that simulates by itself, in a real browser and from disk: its digits, and its use."""

import csv
from dataclasses import replace
from importlib.resources import files
import json
import math
from test.view.browser import browser, program

from closedloop_dynamics import load_scene, scene_names, Simulation
from closedloop_dynamics.cli import main
from closedloop_dynamics.codegen import function_table as calls
from closedloop_dynamics.codegen.routines import MechanismTrace
from closedloop_dynamics.effects.registry import PrescribedMotion
from closedloop_dynamics.scene.key_paths import changed
from closedloop_dynamics.simulation.traced_scene import refusals
from closedloop_dynamics.view.messages import SPEED
from closedloop_dynamics.view.own_motion import OwnMotion
from closedloop_dynamics.view.standalone import standalone
import numpy as np
import pytest

from ..codegen.spatial_engine import _array, _inputs, interpret
from ..reference.compare import assert_agree, SOLVE

pytestmark = pytest.mark.skipif(
    program() is None, reason='no Chromium is installed (Debian: apt install chromium)')
READY = 'typeof page !== "undefined" && Boolean(page.shownRow) && Boolean(page.controls)'
# Scenes that cannot be written as WebAssembly, as the documentation lists them.
REFUSED = {
    'cam_follower', 'carpet_scraper_dry', 'carpet_scraper_on_carpet', 'geneva_drive',
    'rope_hoist', 'three_rrr_payload_friction'}
QUICK = 'slider_crank', 'slider_crank_end_stop', 'humanoid_ankle', 'three_rrr'

# A crank that is moved, and forces of all shapes on what it moves.
TIMED = """\
mechanism: three_rrr
initial:
  position: {theta_1: 1.0467, theta_2: 5.4206, theta_3: -2.5357, theta_4: 1.3044, theta_5: 2.9396,
             theta_6: 4.1883, theta_7: 5.7637}
  hold: [theta_1, theta_6, theta_7]
effects:
  moved: {type: prescribed_motion, joint: theta_1, shape: table, times: [0, 0.3, 0.8, 1.0],
          values: [1.0467, 1.1, 1.0, 1.0467], period: 1.0}
  written: {type: prescribed_motion, joint: theta_6, shape: expression,
            expression: '4.1883 + 0.05*sin(3*t)*exp(-t)'}
  wave: {type: prescribed_force, joint: theta_3, shape: trapezoid, amplitude: 0.4, rise: 0.02,
         hold: 0.1, period: 0.3}
  spline: {type: prescribed_force, joint: theta_4, shape: table, times: [0, 0.2, 0.5],
           values: [0, 0.2, -0.1], interpolation: cubic}
  corner: {type: prescribed_force, joint: theta_5, shape: expression,
           expression: 'max(0, 0.1*sin(9*t)) - abs(0.1*t - 0.05)'}
  law: {type: law, forces: {q: '-0.1*v*cos(t)'}, joints: {q: theta_7}, rates: {v: q}}
"""


@pytest.fixture(scope='module')
def open_page():
    with browser() as open_page:
        yield open_page


@pytest.fixture(scope='module')
def bare(open_page):
    """Return a page with the code of machines, and nothing to show."""
    tab = open_page('about:blank')
    folder = files('closedloop_dynamics.view') / 'page'
    tab.ask(''.join((folder / part).read_text() for part in (
        'algebra.js', 'history.js', 'expression.js', 'machine.js')) + '; 0')
    return tab


def run(tab, machine, tau, duration, before=''):
    """Run a machine in a page, under torques, in frames; return time, state, energies."""
    return tab.ask(f"""Machine.of({json.dumps(machine)}).then((machine) => {{
        const tau = {json.dumps(tau)};
        machine.torques = () => machine.arrays.tau.set(tau);
        {before}
        machine.reset();
        for (let frame = 1; frame <= 60; frame++) {{
          const end = frame / 60 * {duration};
          while (machine.time < end) machine.advance(end);
        }}
        machine.energy();
        return {{time: machine.time, state: [...machine.state], residual: machine.residual,
                 energies: [...machine.arrays.energies]}}; }})""")


def require_same(found, simulation):
    nq = len(simulation.position)
    assert found['time'] == pytest.approx(simulation.time, abs=1e-12)
    position, velocity = found['state'][:nq], found['state'][nq:-1]
    np.testing.assert_allclose(position, simulation.position, rtol=0, atol=1e-9)
    scale = 1.0 + np.abs(simulation.velocity).max()
    np.testing.assert_allclose(velocity, simulation.velocity, rtol=0, atol=3e-8 * scale)
    assert sum(found['energies']) == pytest.approx(simulation.energy, rel=1e-8, abs=1e-8)


def accurate(scene):
    return Simulation.from_scene(replace(scene, method=replace(
        scene.method, integrator='dop853', tolerance=1e-13)))


def torques(simulation):
    return {joint: 0.02 * (k + 1) for k, joint in enumerate(simulation.actuated_joints)}


def test_what_is_refused_is_listed():
    assert {name for name in scene_names()
            if refusals(Simulation.from_scene(load_scene(name)).data, True, driven=True)} == (
                REFUSED)


@pytest.mark.parametrize('name', [
    name if name in QUICK else pytest.param(name, marks=pytest.mark.slow)
    for name in sorted(set(scene_names()) - REFUSED)])
def test_digits_are_the_same_after_a_second(name, bare):
    scene = load_scene(name)
    _, machine = standalone(scene, OwnMotion())
    simulation = accurate(scene)
    command = torques(simulation)
    found = run(bare, machine, simulation.joint_torques(command).tolist(), 1.0)
    simulation.step(command, 1.0)
    require_same(found, simulation)
    assert abs(found['residual']) < 1e-8


@pytest.mark.parametrize('name, joint, where', (
    ('three_rrr', 1, 0.0), ('stewart_platform', 1, 0.5 * np.pi)))
def test_next_to_singular_arms_results_are_those_with_all_multipliers(name, joint, where, bare):
    scene, rng = load_scene(name), np.random.default_rng(0)
    _, machine = standalone(scene, OwnMotion())
    simulation = accurate(scene)
    model, q = simulation.data.system.model, simulation.position
    nv, nc = len(simulation.velocity), len(simulation.multipliers)
    qd, tau = rng.normal(size=(2, nv))
    for angle in (q[joint], where + 1e-3, where):
        q[joint] = angle
        given = json.dumps({'q': q.tolist(), 'qd': qd.tolist(), 'tau': tau.tolist()})
        results = bare.ask(f"""Machine.of({json.dumps(machine)}).then((machine) => {{
            for (const [name, values] of Object.entries({given})) machine.arrays[name].set(values);
            const {{qdd, lam, change}} = machine.arrays;
            return [machine.call('evaluation'), machine.call('correction'),
                    [...qdd], [...lam], [...change]]; }})""")
        assert results[:2] == [1, 1]
        for found, which, source, size in zip(
                results[2:], (calls.EVALUATION, calls.EVALUATION, calls.CORRECTION),
                (calls.QDD, calls.LAM, calls.CORRECTIONS), (nv, nc, 2 * nv)):
            outputs, _ = interpret(MechanismTrace(model, with_arms=False).routine(which),
                                   _inputs(model, q, qd, tau))
            assert_agree(found, _array(outputs, source, size), SOLVE)


def test_a_singular_position_is_named(bare):
    scene = load_scene('bennett')
    _, machine = standalone(scene, OwnMotion())
    # Without the other equations that it has for this.
    machine['choices'] = machine['choices'][:1]
    tau = accurate(scene).joint_torques({}).tolist()
    with pytest.raises(AssertionError, match='closure equations depend on one another'):
        run(bare, machine, tau, 5.0)


def test_what_follows_the_time_is_as_in_the_scene(bare, tmp_path):
    (tmp_path / 'scene.yaml').write_text(TIMED)
    scene = load_scene(tmp_path / 'scene.yaml')
    _, machine = standalone(scene, OwnMotion())
    assert len(machine['clocks']) == 6
    simulation = accurate(scene)
    found = run(bare, machine, simulation.joint_torques({}).tolist(), 1.1)
    simulation.step({}, 1.1)
    require_same(found, simulation)
    # Of the work that is exchanged the balance misses nothing.
    assert abs(found['residual']) < 1e-8


def test_numbers_and_effects_are_changed_as_in_the_scene(bare):
    scene = load_scene('double_wishbone')
    description, machine = standalone(scene, OwnMotion())
    name, effect = next((name, one) for name, one in machine['effects'].items()
                        if one['type'] == 'point_spring')
    masses = [slider['key'] for slider in description['sliders'] if slider['group'] == 'masses']
    values = {f'effects.{name}.stiffness': 0.7 * effect['values']['stiffness'],
              masses[0]: 3.0, masses[-1]: 2.0}
    lines = [f'machine.arrays.values[13 * {effect["row"]} + {effect["columns"]["stiffness"][0]}]'
             f' = {values[f"effects.{name}.stiffness"]};']
    for slider in description['sliders']:
        if slider['key'] in values:
            for index, slope in machine['numbers'][slider['key']]['body']:
                lines.append(f'machine.arrays.body[{index}] += '
                             f'{slope * (values[slider["key"]] - slider["value"])!r};')
    simulation = accurate(changed(scene, {
        tuple(key.split('.')): value for key, value in values.items()}))
    found = run(bare, machine, simulation.joint_torques({}).tolist(), 0.3, '\n'.join(lines))
    simulation.step({}, 0.3)
    require_same(found, simulation)


@pytest.mark.parametrize('text', (
    '1.05+2*pi*t', '0.3*sin(2*t)', '-t**2/3+cos(t)*exp(-t)', 'sqrt(1+t)*log(2+t)', '(1+t)**1.5',
    'atan2(sin(t), 2+t)', 'hypot(t, 1)', 'tan(0.3*t)',
    'asin(0.2*t)+acos(0.1*t)-atan(t)', 'radians(30*t)', '2**t', '(1-t)**3'))
def test_expressions_have_rates_and_accelerations(text, bare):
    motion = PrescribedMotion('expression', joint='j', expression=text)
    for time in (0.0625, 0.7, 1.9):
        assert bare.ask(f'expressionOf({json.dumps(text)})({time})') == pytest.approx(
            [float(value) for value in motion.at(time)], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize('text', (
    '1+', 'x', 'sin()', '2 3', 'sin(1, 2)', 'alert(1)', '(t', 'abs(t)'))
def test_what_is_no_expression_is_refused(text, bare):
    with pytest.raises(AssertionError, match='expected an expression'):
        bare.ask(f'expressionOf({json.dumps(text)})')


def test_a_scene_without_code_is_refused_with_the_reason(tmp_path, capsys):
    assert main(['view', 'rope_hoist', '--save', str(tmp_path / 'page.html'), '--live']) == 1
    assert 'effects.rope (cable: it slackens' in capsys.readouterr().err
    assert not (tmp_path / 'page.html').exists()


@pytest.mark.parametrize('arguments, expected', (
    (('three_rrr', '--live'), '--live: expected it with --save'),
    (('three_rrr', '--save', 'page.html', '--live', '--duration', '3'), '--duration'),
    (('run.csv', '--save', 'page.html', '--live'), '--live: expected a scene')))
def test_options_that_mean_nothing_are_refused(arguments, expected, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(['view', *arguments]) == 2
    assert expected in capsys.readouterr().err


@pytest.fixture(scope='module')
def saved(tmp_path_factory):
    """Return a page of a four-bar whose crank turns."""
    path = tmp_path_factory.mktemp('page') / 'four_bar.html'
    assert main(['view', 'four_bar', '--save', str(path), '--live']) == 0
    return path


def test_a_page_runs_from_disk(open_page, saved, tmp_path):
    assert saved.stat().st_size < 1e6
    tab = open_page(saved.as_uri())
    tab.wait(READY)
    # It plays by itself, as closedloop view does.
    tab.wait('page.playing && page.socket.machine.time > 0.3')
    assert tab.ask('page.controls.motion') == 'own'
    assert tab.ask('page.controls.drives.crank_joint') == {'mode': SPEED, 'value': 2.0 * math.pi}
    # The drive keeps its speed once it has got there.
    tab.click('#play')
    tab.wait('!page.playing')
    assert tab.ask('page.socket.machine.state[3]') == pytest.approx(2.0 * math.pi, rel=0.1)
    machine = 'page.socket.machine'
    tab.ask('page.ask("drive", {joint: "crank_joint", mode: "expression"});'
            'page.ask("command", {joint: "crank_joint", value: "nonsense("})')
    assert 'expected an expression' in tab.ask('page.socket.notes.at(-1).text')
    tab.ask('page.ask("motion", {which: "free"})')
    assert tab.ask('page.controls.motion') == 'free'
    # Steps are made one by one.
    time = tab.ask(f'{machine}.time')
    tab.click('#step')
    assert tab.ask(f'{machine}.time') == pytest.approx(time + 0.01, abs=1e-9)
    # A length is changed: the loops stay closed, and what is drawn follows.
    slider = next(iter(tab.ask('page.scene.sliders.filter(({group}) => group === "lengths")')))
    key, longer = json.dumps(slider['key']), 1.1 * slider['value']
    tab.ask(f'page.ask("set", {{key: {key}, value: {longer}}})')
    assert tab.ask(f'page.scene.sliders.find((one) => one.key === {key}).value') == longer
    assert tab.ask('page.frame.row[page.scene.columns.plots + page.scene.plots.findIndex('
                   '(plot) => plot.column === "closure")]') < 1e-9
    assert tab.ask('JSON.stringify(page.scene.joints) !== JSON.stringify('
                   'page.data.description.joints) || JSON.stringify(page.scene.cuts) !== '
                   'JSON.stringify(page.data.description.cuts)')
    # What cannot be closed is refused, and nothing changes.
    tab.ask(f'page.ask("set", {{key: {key}, value: 50}})')
    assert 'cannot be closed' in tab.ask('page.socket.notes.at(-1).text')
    assert tab.ask(f'page.socket.numbers[{key}]') == longer
    tab.click('#runs-panel summary')
    path = tab.download('[data-file="csv"]', tmp_path)
    with path.open(encoding='utf-8') as stream:
        rows = list(csv.DictReader(stream))
    assert {'time [s]', 'position.crank_joint [rad]', 'energy.kinetic [J]'} <= set(rows[0])
    times = [float(row['time [s]']) for row in rows]
    assert times[0] == 0.0 and times == sorted(times)
    tab.click('#reset')
    tab.wait('page.now === 0')
    assert not tab.errors
    tab.close()


def test_a_point_is_dragged(open_page, saved):
    tab = open_page(saved.as_uri())
    tab.wait(READY)
    tab.ask('page.ask("reset"); page.ask("motion", {which: "free"})')
    tab.wait('!page.playing && page.now === 0')
    x, y = tab.ask("""(() => {
        const [x, y] = page.picture.project(page.picture.grabbed([0, 1]));
        const box = document.getElementById("solid").getBoundingClientRect();
        return [x + box.x, y + box.y]; })()""")
    tab.mouse('mousePressed', x, y, 1)
    tab.mouse('mouseMoved', x + 60, y - 40, 1)
    tab.wait('page.socket.machine.hand !== null')
    work = 'page.socket.machine.state[page.socket.machine.nq + page.socket.machine.nv]'
    tab.ask('page.ask("step", {count: 100})')
    # The hand has put energy into the machine, and the balance knows.
    assert abs(tab.ask(work)) > 1e-4
    assert abs(tab.ask('page.socket.machine.residual')) < 1e-8
    tab.mouse('mouseReleased', x + 60, y - 40)
    tab.wait('page.socket.machine.hand === null')
    assert not tab.errors
    tab.close()


def test_effects_are_switched(open_page, tmp_path):
    path = tmp_path / 'page.html'
    assert main(['view', 'slider_crank_end_stop', '--drives', 'free', '--save', str(path),
                 '--live']) == 0
    tab = open_page(path.as_uri())
    tab.wait(READY)
    tab.ask('page.ask("reset")')
    name = next(name for name, one in tab.ask('page.controls.effects').items()
                if one['type'] == 'end_stop')
    scene = load_scene('slider_crank_end_stop')
    tab.ask(f'page.ask("effect", {{name: {json.dumps(name)}, enabled: false}});'
            'page.ask("effect", {name: "gravity", values: {acceleration: [1, -3]}});'
            'page.ask("step", {count: 300})')
    simulation = accurate(replace(scene, switched_off=(name,), effects={
        **scene.effects, 'gravity': replace(scene.effects['gravity'], acceleration=(1.0, -3.0))}))
    simulation.step({}, 0.3)
    found = tab.ask('[...page.socket.machine.state]')
    np.testing.assert_allclose(found[:3], simulation.position, rtol=0, atol=1e-9)
    tab.ask('page.ask("effect", {name: "gravity", values: {acceleration: [1]}})')
    assert 'expected 2 numbers' in tab.ask('page.socket.notes.at(-1).text')
    assert not tab.errors
    tab.close()


def test_a_page_without_scripts_says_what_is_missing(open_page, saved):
    tab = open_page(saved.as_uri(), scripts=False)
    tab.wait('document.readyState === "complete" && Boolean(document.querySelector("noscript p"))')
    assert 'Allow scripts' in tab.ask('document.querySelector("noscript p").innerText')
    tab.close()
