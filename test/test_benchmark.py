# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The benchmarks run, and the document they fill has a place for all that they measure."""

from dataclasses import replace
import importlib
import json
import math
from pathlib import Path
import re
import shutil
import sys

from closedloop_dynamics.codegen.expression_graph import (
    cosine, ExpressionGraph, LOAD, MULTIPLY, Q, Routine, sine)
from closedloop_dynamics.effects.registry import EFFECTS
from closedloop_dynamics.scene.records import Initial, Scene
from closedloop_dynamics.simulation.simulation import Simulation
import numpy as np
import pytest

from .formats import machines

ROOT = Path(__file__).resolve().parents[1]
BENCHMARKS = ROOT / 'benchmark'

# They may take minutes on a busy machine.
pytestmark = [pytest.mark.timeout(1200), pytest.mark.skipif(
    not BENCHMARKS.is_dir(), reason='not in a source checkout')]


@pytest.fixture
def benchmark(monkeypatch):
    """Return a function that imports a benchmark by name."""
    monkeypatch.setattr(sys, 'path', [str(BENCHMARKS), *sys.path])
    return importlib.import_module


def test_gradients_prints_their_price(benchmark, capsys):
    assert benchmark('gradients').main(['four_bar', '--repeats', '2']) == 0
    rows = [row for row in capsys.readouterr().out.splitlines() if '`four_bar`' in row]
    numbers = [[float(number) for number in row.split('|')[2:-1]] for row in rows]
    # Of whole trajectories, and of single steps with Jacobians.
    assert [len(one) for one in numbers] == [4, 3]
    assert min(min(one[:2]) for one in numbers) > 0.0


@pytest.mark.parametrize('option, columns', [(None, 12), ('--rollouts', 3)])
def test_python_calls_prints_times(benchmark, capsys, option, columns):
    assert benchmark('python_calls').main(
        ['four_bar', '--count', '400', '--repeats', '2', *filter(None, [option])]) == 0
    text = capsys.readouterr().out
    assert 'llvmlite' in text and 'commit' in text
    line = next(line for line in text.splitlines() if line.startswith('four_bar'))
    numbers = [float(number) for number in line.split()[1:]]
    # Differences may be less than what disturbs them.
    assert len(numbers) == columns and max(numbers) > 0.0


@pytest.mark.skipif(shutil.which('cc') is None, reason='needs a C compiler, called cc')
def test_steps_of_exported_code_are_timed(benchmark, capsys):
    assert benchmark('exported_code').main(['four_bar', '--quick']) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert '`four_bar`' in line
    assert len([number for number in re.findall(r'[\d.]+', line) if float(number) > 0.0]) == 5


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which('cc') is None or not sys.platform.startswith('linux'),
    reason='needs a C compiler, called cc, on Linux')
def test_cycles_of_the_hardware_interface_are_timed(benchmark, capsys):
    assert benchmark('exported_code').main(['four_bar', '--cycles', '--quick']) == 0
    line = capsys.readouterr().out.splitlines()[-1]
    assert '`four_bar`' in line
    times = [float(number) for number in re.findall(r'[\d.]+', line)]
    assert len(times) == 6 and min(times) > 0.0


def test_tables_of_the_accuracy_document_are_those_of_its_files(benchmark, tmp_path):
    document = benchmark('make_accuracy_doc')
    parts = document.passages(ROOT / 'doc' / 'pictures')
    for page in document.PAGES:
        text = (ROOT / 'doc' / page).read_text()
        shutil.copy(ROOT / 'doc' / page, tmp_path)
        begun = re.findall(r'<!-- begin (.*) -->', text)
        here = {name: parts.pop(name) for name in begun if name in parts}
        assert document.filled(text, here) == text, (
            'python benchmark/make_accuracy_doc.py --measured makes them again')
        assert {name for name in begun if name not in here} == {
            {'accuracy.md': 'machine', 'accuracy_methods.md': 'methods machine',
             'accuracy_machines.md': 'machines machine'}[page]}
    assert not parts
    with pytest.raises(KeyError, match='no passage'):
        document.filled(text, {'poem': ''})
    with pytest.raises(KeyError, match=r"no page has the passages \['poem'\]"):
        document.fill_pages(tmp_path, {'poem': ''})
    methods = (ROOT / 'doc' / 'accuracy_methods.md').read_text()
    for case in document.CASES:
        assert f'(pictures/accuracy_{case.name}.png)' in methods


def test_figures_of_the_readme_and_of_sentences_are_those_of_the_files(benchmark):
    documents, sentences = benchmark('make_documents'), benchmark('sentences')
    pictures = ROOT / 'doc' / 'pictures'
    for page, parts in (('README.md', documents.readme_passages(pictures)),
                        ('doc/performance.md', {'space speed': sentences.space_speed(pictures)})):
        text = (ROOT / page).read_text()
        assert benchmark('make_accuracy_doc').filled(text, parts) == text, (
            'python benchmark/make_documents.py --measured makes them again')
    assert (ROOT / 'README.md').read_text().count('<!-- begin') == 2


@pytest.mark.parametrize('group', ['plane', 'space'])
def test_tables_of_the_peers_are_those_of_their_files(benchmark, group):
    report, sentences = benchmark('peer_report'), benchmark('sentences')
    evaluations, runs, _ = (
        ROOT / 'doc' / 'pictures' / f'performance_{report.FILES[group]}{end}'
        for end in report.ENDS)
    by_scene = {}
    for row in sentences.read(evaluations):
        by_scene.setdefault(row['scene'], []).append({**row, 'best': float(row['best'])})
    motions = [{**row, 'best': float(row['best'] or 'nan'), 'error': float(row['error'] or 'nan')}
               for row in sentences.read(runs)]
    uncertain = {row['case']: float(row['uncertainty']) for row in motions}
    cases = [{'name': name, 'uncertainty': known} for name, known in uncertain.items()]
    parts = {name: text for name, text in report.passages({group: {
        'evaluation': by_scene, 'motions': motions, 'cases': cases, 'agreement': {},
        'load': (0, 0), 'machine': '', 'date': '', 'quick': False, 'rollouts': (),
        'short_rollouts': (), 'left out': {}}}).items()
        if name.split()[-1] in ('evaluation', 'motions', 'reference')}
    text = (ROOT / 'doc' / 'performance.md').read_text()
    assert len(parts) == 3 and benchmark('make_accuracy_doc').filled(text, parts) == text
    # An error of 1e-8 is shown where the reference is known ten times better, and only there.
    shown = {name for name in uncertain if f'| {name} | 1e-08 |' in text}
    assert shown == {name for name, known in uncertain.items() if known <= 1e-9}


@pytest.mark.slow
def test_every_machine_is_measured_at_three_accuracies(benchmark, monkeypatch, tmp_path):
    machines, report = benchmark('all_machines'), benchmark('all_machines_report')
    monkeypatch.setattr(machines, 'commit', lambda: 'abc1234')
    assert len(machines.ROBOTS) == 10
    assert machines.main(['four_bar', '--quick', '--output', str(tmp_path)]) == 0
    results = report.Results(tmp_path / 'all_machines.csv')
    assert results.machines == {'four_bar': 'scene'}
    for rate in machines.RATES:
        rows = [results.ours('four_bar', rate, target) for target in machines.TARGETS]
        assert all(row['error'] <= row['target'] and row['duration'] == 1.0 for row in rows)
        counts = [row['evaluations_per_second'] for row in rows]
        # Where torques are held for short, a step is what it is.
        assert (rate == 1000) == (counts[2] < 2.0 * counts[0])
    assert report.picture(tmp_path / 'all_machines.csv').axes[0].get_title() == 'free'
    # What was measured is not measured again, as after a run that was ended.
    kept = tmp_path / 'all_machines.json'
    known = json.loads(kept.read_text())
    known['machines']['four_bar'][0]['note'] = 'kept'
    kept.write_text(json.dumps(known))
    machines.main(['four_bar', '--quick', '--output', str(tmp_path)])
    assert 'kept' in [row['note'] for row in machines.read(tmp_path / 'all_machines.csv')]


@pytest.mark.slow
def test_held_torques_of_every_machine_accelerate_its_drives_alike(benchmark):
    machines = benchmark('all_machines')
    for scene in ('three_rrr', 'delta_robot'):
        simulation = Simulation.from_scene(scene)
        held = machines.torques(simulation, 100)
        assert held.shape == (100, len(simulation.torque_names))
        state = simulation.position, simulation.velocity
        still = simulation.forward_dynamics(*state)[0]
        rates = simulation.mechanism.coordinates.rates
        for joint in simulation.actuated_joints:
            place = rates[joint].start
            # Twice the mean at first.
            pushed = simulation.forward_dynamics(*state, {joint: held[0, place]})[0] - still
            assert abs(pushed[place]) == pytest.approx(2.0 * machines.PUSH, rel=1e-6)


def test_the_best_of_the_others_is_the_cheapest_that_keeps_an_error(benchmark, tmp_path):
    machines, report = benchmark('all_machines'), benchmark('all_machines_report')
    usual = {'machine': 'one', 'kind': 'scene', 'rate': 0, 'known_to': 1e-8, 'duration': 1.0}
    machines.write([
        {**usual, 'engine': machines.OURS, 'setting': f'accuracy {target:.0e}', 'target': target,
         'error': 0.1 * target, 'cpu_time_per_second': cost}
        for target, cost in ((1e-3, 1.0), (1e-6, 2.0), (1e-9, 4.0))] + [
        {**usual, 'engine': engine, 'setting': f'{method}, step 1 s', 'error': error,
         'cpu_time_per_second': cost}
        for engine, method, error, cost in (
            ('MuJoCo', 'RK4', 1e-4, 3.0), ('Other', 'B', 1e-7, 5.0), ('Other', 'C', 1e-7, 9.0),
            ('Other', 'D', math.nan, 0.1))],
        tmp_path / 'rows.csv')
    results = report.Results(tmp_path / 'rows.csv')
    found = [results.other('one', 0, target) for target in machines.TARGETS]
    assert [row and row['cpu_time_per_second'] for row in found] == [3.0, 5.0, None]
    # The reference is not known to 1e-9.
    assert results.ours('one', 0, 1e-9) is None and results.digit('one', 0) is None
    assert '| one | 1 s | 2 s | - | - | 3 s M4 (3) | 5 s Other B (2.5) | not reached |' in (
        report.table(results, 0))


def test_why_a_machine_is_not_measured_in_others_is_named(benchmark, tmp_path):
    machines, report = benchmark('all_machines'), benchmark('all_machines_report')
    usual = {'kind': 'scene', 'rate': 0, 'known_to': 1e-12, 'duration': 1.0}
    ours = {**usual, 'engine': machines.OURS, 'setting': 'accuracy 1e-03', 'target': 1e-3,
            'error': 1e-4, 'cpu_time_per_second': 1.0}
    machines.write([
        {**ours, 'machine': 'still', 'note': 'stands still'}, {**ours, 'machine': 'geared'},
        {'machine': 'geared', 'kind': 'scene', 'rate': 0, 'engine': 'Pinocchio',
         'note': 'cannot express it: couplings of joints'},
        {**ours, 'machine': 'coarse'},
        {**usual, 'machine': 'coarse', 'engine': 'MuJoCo', 'setting': 'RK4, step 1 s',
         'error': 1.0, 'cpu_time_per_second': 1.0}], tmp_path / 'rows.csv')
    results = report.Results(tmp_path / 'rows.csv')
    assert [results.why(name, 0) for name in ('still', 'geared', 'coarse')] == [
        'stands still', 'cannot express it', 'not reached']
    assert '| geared | Pinocchio | cannot express it: couplings of joints |' in (
        report.reasons(results))


@pytest.mark.parametrize('exact', [-1, 0, 3, 11, 12])
def test_the_coarsest_setting_that_keeps_an_error_is_bisected(benchmark, exact):
    runner, targets = benchmark('peer_runner'), benchmark('all_machines').TARGETS
    tried, found = [], {}

    def measure(number):
        tried.append(number)
        # An error of each target from a number on; finer settings take longer.
        found[number] = 0.0 if number >= exact else 1.0
        return found[number], 1e-3 * number

    runner.explored(measure, 12, targets, 1.0)
    assert len(tried) == len(set(tried)) <= 5
    if exact < 12:
        assert found[max(exact, 0)] == 0.0 and (exact <= 0 or found[exact - 1] == 1.0)
    tried.clear()
    # Without targets one after the other, up to the first that takes too long.
    runner.explored(measure, 12, None, 3.5e-3)
    assert tried == [0, 1, 2, 3, 4]


def test_estimators_are_timed_and_their_bands_counted(benchmark, monkeypatch, capsys):
    estimation = benchmark('estimation')
    estimation.cycles('three_rrr', 20, 1)
    # Of 20 runs 14 or fewer are in a region of 95 % once in 30,000 times.
    estimation.coverage('four_bar', 20, 1)
    cycle, bands = capsys.readouterr().out.splitlines()
    error = re.match(r'three_rrr: a cycle [0-9.]+ us, largest error of rates (.*)', cycle)[1]
    assert float(error) < 3.0 * estimation.RATE
    inside, reported = map(float, re.match(
        r'four_bar: ([0-9.]+) % in .*; alarms ([0-9.]+) % as given', bands).groups())
    assert inside > 70.0 and reported <= 5.0


def test_samples_a_second_stand_beside_their_error(benchmark, monkeypatch, capsys, tmp_path):
    throughput = benchmark('throughput')
    monkeypatch.setattr(throughput, 'FIXED_STEPS', {'rk4': (1e-2, 5e-3)})
    monkeypatch.setattr(throughput, 'ADAPTIVE', (('auto', 'accuracy', (1e-6,)),))
    path = tmp_path / 'samples.csv'
    assert throughput.main(['--scene', 'four_bar', '--samples', '3', '--repeats', '1',
                            '--fidelity', '--without-mujoco', '--csv', str(path)]) == 0
    rows = benchmark('sentences').read(path)
    errors = [float(row['error']) for row in rows]
    # RK4 is of fourth order.
    assert errors[1] < errors[0] / 8.0 and errors[2] < 1e-6
    assert throughput.fidelity_table(rows) in capsys.readouterr().out


def test_what_sentences_recommend_is_borne_out(benchmark):
    document = benchmark('make_accuracy_doc')
    pictures = ROOT / 'doc' / 'pictures'

    def evaluations(settings, target):
        best = document.cheapest(settings, target)
        return best.evaluations if best else math.inf

    for of in document.free_settings(pictures).values():
        # Below 1e-6 none is cheaper than DOP853.
        counts = {name: evaluations(of[name], 1e-9) for name in ('rk4', 'dopri5', 'dop853')}
        assert min(counts, key=counts.get) == 'dop853'
    for text, of in document.held_settings(pictures).items():
        ratio = evaluations(of['rk4'], 1e-6) / evaluations(of['dop853'], 1e-6)
        assert ratio > 3.0 if '100 Hz' in text else ratio < 1.0


def test_released_manipulator_amplifies_errors_as_the_pages_say():
    simulation = Simulation.from_scene('three_rrr', integrator='dop853', tolerance=1e-13)
    drives = list(simulation.actuated_joints)
    start = [simulation.position[simulation.joint_names.index(name)] for name in drives]

    def motion(moved):
        simulation.reset()
        simulation.set_state(dict(zip(drives, np.add(start, moved))), hold=drives)
        positions = [simulation.position.copy()]
        for _ in range(2):
            simulation.step(duration=1.0)
            positions.append(simulation.position.copy())
        return np.array(positions)

    apart = np.abs([motion(1e-7 * one) - motion(np.zeros(3)) for one in np.eye(3)]).max(axis=2)
    _, one, two = (apart / apart[:, :1]).max(axis=0)
    assert one == pytest.approx(32.0, rel=0.02) and two == pytest.approx(29e3, rel=0.02)
    pages = [(ROOT / 'doc' / f'{name}.md').read_text() for name in ('accuracy', 'performance')]
    assert all('up to 32 times' in ' '.join(page.split()) for page in pages)


def test_measuring_begins_at_a_clean_commit(benchmark, monkeypatch, capsys):
    documents = benchmark('make_documents')
    monkeypatch.setattr(documents, 'commit', lambda: 'abc1234-dirty')
    with pytest.raises(SystemExit):
        documents.main([])
    assert 'expected a clean checkout, got abc1234-dirty' in capsys.readouterr().err


def test_document_parts_are_measured(benchmark, tmp_path, monkeypatch):
    document = benchmark('make_accuracy_doc')
    # The sentences compare stabilisations with none.
    chosen = [document.Line('rk4'), document.Line('dop853'), document.Line('rk4', 'none')]
    monkeypatch.setattr(document, 'default_lines', lambda: chosen)
    path, pictures = tmp_path / 'accuracy.md', tmp_path / 'pictures'
    for page in document.PAGES:
        shutil.copy(ROOT / 'doc' / page, tmp_path)
    pictures.mkdir()
    for table in (ROOT / 'doc' / 'pictures').glob('accuracy_*.csv'):
        (pictures / table.name).write_text(table.read_text())
    assert document.main(
        ['--quick', '--only', 'three_rrr', '--document', str(path)]) == 0
    settings = document.settings_of_study(pictures / 'accuracy_three_rrr.csv')
    assert set(settings) == {'rk4', 'dop853', *benchmark('yardsticks').SOLVERS}
    # Error control takes fewer evaluations, whatever the machine is busy with.
    counts = [min(setting.evaluations for setting in document.holding(settings[name], 1e-6))
              for name in ('rk4', 'dop853')]
    assert counts[1] < counts[0] / 2
    assert (pictures / 'accuracy_three_rrr.png').stat().st_size > 10000


def test_held_torques_cost_what_the_tableaus_say(benchmark):
    held = benchmark('held_torques')
    position, evaluations, cost = held.motion('three_rrr', 1000, 'rk4', 1, rounds=1)
    finer, twice, untimed = held.motion('three_rrr', 1000, 'rk4', 2)
    finest, *_ = held.motion('three_rrr', 1000, 'rk4', 4)
    assert cost > 0.0 and math.isnan(untimed)
    # Four evaluations a step, and some where the energy is looked at.
    assert 4000 <= evaluations <= 4040 and 8000 <= twice <= 8040
    # Fourth order, although the torques jump at every period.
    errors = [abs(one - finest).max() for one in (position, finer)]
    assert errors[0] > 0.8 * 16.0 * errors[1]


def test_energy_of_rk4_is_lost_with_the_fifth_power_of_the_step(benchmark):
    coarse, fine = (benchmark('energy_study').energy_errors(
        'carpet_scraper', {'integrator': 'rk4', 'step_size': size})[1] for size in (1e-3, 5e-4))
    assert coarse < 0.0 and fine < 0.0
    assert 0.8 * 32.0 < coarse / fine < 1.25 * 32.0


@pytest.fixture(scope='module')
def quick_results(tmp_path_factory):
    """Run every part of the performance document quickly; return where the results are."""
    output = tmp_path_factory.mktemp('benchmark_output')
    folder = tmp_path_factory.mktemp('models')
    (folder / 'four_bar.urdf').write_text(machines.four_bar())
    (folder / 'arm.urdf').write_text(machines.robot(machines.LINKS, machines.TREE))
    families = tmp_path_factory.mktemp('families')
    (families / 'four_bar_branch_1_1.urdf').write_text(machines.four_bar())
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(BENCHMARKS)
        importlib.import_module('make_performance_doc').measure(
            ('startup',), output, True, sys.executable)
        # Without a start of Python for each.
        for part in ('operation_count', 'elements', 'size', 'models'):
            assert importlib.import_module(part).main([
                '--output', str(output), '--quick',
                *([str(folder)] if part == 'models' else [])]) == 0
        peers = importlib.import_module('peers')
        # Others are unrolled in ten times the time.
        patch.setitem(peers.GROUPS, 'space', replace(
            peers.GROUPS['space'], scenes=('bricard',),
            cases=[case for case in peers.GROUPS['space'].cases if case[1] == 'bricard'],
            rollout=('bricard', {})))
        patch.setitem(peers.GROUPS, 'generated', replace(
            peers.GROUPS['generated'], scenes=('three_rrr',)))
        # The others need a minute, and may not be installed: test_peers_agree looks at them.
        results = {group: peers.measure(group, True, ('peer_ours',), families)
                   for group in peers.GROUPS}
        (output / 'peers.json').write_text(json.dumps(results))
        report = importlib.import_module('peer_report')
        for group, result in results.items():
            report.write_files(result, output, group)
            texts = report.passages({group: result}).values()
            assert peers.GROUPS[group].scenes[0] in ''.join(texts)
    return output


@pytest.mark.slow
def test_performance_document_is_filled(benchmark, quick_results, tmp_path):
    document = benchmark('make_performance_doc')
    path = tmp_path / 'performance.md'
    path.write_text((ROOT / 'doc' / 'performance.md').read_text())
    assert document.main(['--measured', '--output', str(quick_results),
                          '--document', str(path)]) == 0
    text = path.read_text()
    texts = document.passages(quick_results, document.PARTS)
    # The sentence on speed in space comes from the files of the peers.
    assert text.count('<!-- begin') == len({*texts, 'space speed'})
    for name in texts:
        assert f'<!-- begin {name} -->' in text
    for picture in ('peers', 'peers_space', 'size'):
        assert (tmp_path / 'pictures' / f'performance_{picture}.png').stat().st_size > 10000
        assert f'(pictures/performance_{picture}.png)' in text


@pytest.mark.slow
def test_quick_results_make_sense(benchmark, quick_results):
    peers = benchmark('peers')
    sizes = json.loads((quick_results / 'size.json').read_text())['rows']
    assert {row['family'] for row in sizes} == {'ladder', 'star of four', 'star of eight', 'chain'}
    assert all(row['best'] > 0.0 and row['full rank'] for row in sizes)
    counts = json.loads((quick_results / 'operation_count.json').read_text())['counts']
    for part in counts.values():
        assert all(part['chain'][kind] <= part['all'][kind] for kind in part['all'])
        # Without an effect there is less to do than where some act.
        assert sum(part['all'].values()) < part['in parts']
    # At most one division for the articulated inertia of each joint and for each pivot.
    assert 0 < counts['three_rrr']['all']['divide'] <= 7 + 4
    assert counts['three_rrr']['all']['sine and cosine'] == 7
    element, = json.loads((quick_results / 'elements.json').read_text())['elements']
    assert all(time > 0.0 for time in element['times'])
    start, = json.loads((quick_results / 'startup.json').read_text())['rows']
    assert start['import'] > 0.0 and start['memory'] > 2 ** 20
    # One of the two has a loop.
    model, = json.loads((quick_results / 'models.json').read_text())['models']
    assert (model['name'], model['rank'], model['loops']) == ('four_bar', 2, 1)
    assert model['times']['ours']['best'] > 0.0
    # Of what is installed: lcaba keeps loops closed by a penalty, with one iteration, which leaves
    # an error of its own (1.5e-7 here); the others tell that of ours.
    assert all(error < (1e-5 if name == 'lcaba' else 1e-8)
               for name, error in model['errors'].items())
    for group, result in json.loads((quick_results / 'peers.json').read_text()).items():
        assert not peers.GROUPS[group].cases or min(
            row['error'] for row in result['motions']) < 1e-8


def test_operations_of_a_routine_are_counted(benchmark):
    count = benchmark('operation_count')
    graph = ExpressionGraph()
    x, y, z = (graph.put(LOAD, Q, place) for place in range(3))
    shared = y * z
    # Fused; of a product that is used again nothing is; nobody needs the last one.
    outputs = [x * y + cosine(x + y), shared - sine(x + y), -shared / x]
    graph.put(MULTIPLY, x.place, z.place)
    routine = Routine('some', graph, [(0, *pair) for pair in enumerate(outputs)])
    everything, chain = count.tally(routine)
    assert everything == {'add': 2, 'multiply': 1, 'multiply and add': 1, 'divide': 1,
                          'sine and cosine': 1}
    assert chain == {'add': 1, 'multiply': 0, 'multiply and add': 1, 'divide': 0,
                     'sine and cosine': 1}


def test_code_that_single_operations_are_timed_with_repeats_them(benchmark):
    repeated = benchmark('operation_count').repeated
    # Of the last one the distance from the fixed point, 1, shrinks.
    for kind, expected in (('add', 0.7 + 30 * 0.999), ('multiply', 0.7 * 0.999 ** 30),
                           ('divide', 0.7), ('multiply and add', 1.0 - 0.3 * 0.999 ** 30)):
        call = repeated(kind, 2, 30)
        call()
        np.testing.assert_allclose(call.out, expected, rtol=1e-13)


def test_comparison_notices_what_is_slower(benchmark):
    compare = benchmark('compare')
    rng = np.random.default_rng(3)
    base = 1e-6 * rng.uniform(1.0, 1.3, 25)
    times = {'same': (base, base * rng.uniform(0.98, 1.02, 25)),
             'slower': (base, 1.2 * base), 'faster': (base, 0.8 * base)}
    result = {'machine': 'one', 'commits': ['a', 'b'],
              'times': {task: [list(part) for part in both] for task, both in times.items()}}
    assert {task: row['verdict'] for task, row in compare.summary(result).items()} == {
        'same': '', 'slower': 'slower', 'faster': 'faster'}
    assert '1.200 (1.200 to 1.200) slower' in compare.report(result)


@pytest.mark.slow
def test_comparison_runs_two_commits(benchmark, tmp_path):
    if not (ROOT / '.git').exists():
        pytest.skip('not in a checkout')
    path = tmp_path / 'comparison.json'
    assert benchmark('compare').main(
        ['HEAD', '--quick', '--task', 'evaluation three_rrr', '--output', str(path)]) in (0, 1)
    result = json.loads(path.read_text())
    assert len(result['times']['evaluation three_rrr'][1]) == 3


@pytest.mark.parametrize('engine', [
    'peer_exudyn', *(pytest.param(engine, marks=pytest.mark.slow) for engine in (
        'peer_pinocchio', 'peer_mujoco', 'peer_drake', 'peer_generated', 'peer_clusters'))])
def test_peers_agree(benchmark, engine):
    pytest.importorskip({'peer_pinocchio': 'pinocchio', 'peer_mujoco': 'mujoco',
                         'peer_drake': 'pydrake', 'peer_exudyn': 'exudyn',
                         'peer_generated': 'casadi', 'peer_clusters': 'casadi'}[engine])
    peers, cases, runner = map(benchmark, ('peers', 'peer_cases', 'peer_runner'))
    for machine in (cases.Machine(name, cases.load_scene(name, tree))
                    for group in peers.GROUPS.values() if engine in group.engines
                    for name in group.scenes if group is not peers.GROUPS['families']
                    for tree in cases.trees(name)):
        built, why = runner.engines(machine, [engine])
        assert not why
        row, *others = runner.agreement(machine, built, cases.random_states(machine.scene, 3))
        # Drake's constraints give way, however short the step.
        assert row.get('limit', row['error']) < {
            'peer_drake': 2e-2, 'peer_exudyn': 1e-6, 'peer_mujoco': 1e-6}.get(engine, 1e-9)
        assert row['error'] < 2e-2 and all(other['error'] < 1e-5 for other in others)


def of_tower(benchmark, loops, branches=1):
    """Return a tower of four-bars in space under gravity, as a machine of the peers."""
    mechanism, position = benchmark('families').tower(loops, branches, (0.8, 1.1, 0.5))
    return benchmark('peer_cases').Machine(mechanism.name, Scene(
        mechanism.name, None, '', mechanism,
        Initial(position, (0.0,) * mechanism.coordinates.nv),
        {'gravity': EFFECTS['gravity'](acceleration=(1.0, -9.0, 3.0))}))


@pytest.mark.parametrize('name', ['four_bar', 'carpet_scraper', 'bricard', 'double_wishbone',
                                  (2, 1), (2, 2)])
def test_solvers_on_symbols_accelerate_as_we_do(benchmark, name):
    pytest.importorskip('casadi')
    cases, kkt, caba = map(benchmark, ('peer_cases', 'peer_generated', 'peer_clusters'))
    machine = of_tower(benchmark, *name) if isinstance(name, tuple) else cases.Machine(
        name, cases.load_scene(name))
    data = Simulation(machine.scene).data
    solvers = [kind(machine) for kind in (kkt.System, caba.Clusters)]
    for q, qd, tau in cases.random_states(machine.scene, 3):
        data.system.tau[:] = tau
        data.system.native.evaluate(q, qd)
        turns = np.zeros((2, len(qd)))
        for one in solvers:
            angles = q[one.angles]
            turns[:, :len(angles)] = np.cos(angles), np.sin(angles)
            found = one.function(q, qd, tau, *turns).full()[:, 0]
            assert np.abs(found - data.system.qdd).max() < 1e-11 * np.abs(found).max()


def test_clusters_take_operations_in_proportion_to_their_number(benchmark):
    pytest.importorskip('casadi')
    caba, kkt = benchmark('peer_clusters').Clusters, benchmark('peer_generated')
    counts = [sum(kkt.operations(of_tower(benchmark, loops), caba).values())
              for loops in (1, 2, 3, 4)]
    # The first and the last four-bar carry less, or are carried by the free body.
    np.testing.assert_allclose(np.diff(counts), np.diff(counts).mean(), rtol=0.05)
    joints = [sum(kkt.operations(of_tower(benchmark, loops)).values()) for loops in (1, 2, 3, 4)]
    # The inertia matrix of all joints grows with the square.
    assert np.diff(joints, 2).min() > 0 and counts[3] < joints[3]


def test_operations_of_other_solvers_are_shown_beside_ours(benchmark):
    count = benchmark('operation_count')
    ours = count.count(count.models()['four_bar'])
    text = count.table({'counts': dict.fromkeys(('four_bar', 'rack_press'), ours), 'rivals': {
        'four_bar': {'KKT': 1234, 'C-ABA': 567}}})
    header, _, *rows = ([cell.strip() for cell in line.split('|')] for line in text.splitlines())
    shown = [[row[header.index(name)] for name in ("a KKT system's", "C-ABA's")] for row in rows]
    assert shown == [['1234', '567'], ['-', '-']]


def test_why_a_simulator_is_left_out_is_shown_in_its_place(benchmark):
    row = {'tree': 'shipped', 'what': 'evaluation', 'best': 1e-6, 'error': 0.0, 'version': '1'}
    ours, other = ({**row, 'engine': name} for name in ('closedloop_dynamics', 'Other'))
    rows = {'small': [ours, {**other, 'best': 2e-6}], 'large': [ours]}
    report, result = benchmark('peer_report'), {
        'evaluation': rows, 'agreement': rows, 'motions': [],
        'left out': {'small': {}, 'large': {'Other': 'too large'}}}
    assert report.evaluation_table(result).splitlines()[-1] == (
        '| Other | evaluation | 2 us (2.00) | too large |')
    assert report.agreement_table(result).splitlines()[-1] == '| Other 1 | 0e+00 | - |'


def test_a_simulator_that_was_given_another_machine_is_refused(benchmark):
    cases, runner = benchmark('peer_cases'), benchmark('peer_runner')
    machine = cases.Machine('four_bar', cases.load_scene('four_bar'))
    (ours,), why = runner.engines(machine, ['peer_ours'])
    assert not why
    states = cases.random_states(machine.scene, 2)
    row, = runner.agreement(machine, [ours], states)
    assert row['error'] < 1e-12

    class Other:
        name, version, agreed, limit, others = 'Other', '1', 1e-5, None, {}

        def __init__(self, *factors):
            factors = iter(factors)
            self.acceleration = lambda *state: next(factors) * ours.acceleration(*state)

    row, = runner.agreement(machine, [Other(1.0, 1.0 + 1e-6)], states)
    assert row['error'] == pytest.approx(1e-6, rel=1e-3)
    for factors in ((1.0, 1.0 + 2e-5), (1.0, math.nan), (math.nan, 1.0)):
        with pytest.raises(cases.Disagreement, match='four_bar in Other: accelerations differ'):
            runner.agreement(machine, [Other(*factors)], states)
    # Where what they tend to is wrong, as well.
    soft = Other(1.0, 1.0)
    soft.limit, soft.limit_agreed, soft.limit_name = Other(1.0, 1.1).acceleration, 1e-3, 'hard'
    with pytest.raises(cases.Disagreement, match='by 0.1, relative; at most 0.001 was expected'):
        runner.agreement(machine, [soft], states)


def test_throughput_counts_steps(benchmark, capsys):
    assert benchmark('throughput').main(
        ['--scene', 'four_bar', '--samples', '2', '--steps', '5', '--repeats', '1', '--threads',
         '1', '2', '--without-mujoco']) == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if 'rk4' in line)
    speeds = [float(cell.replace(',', '')) for cell in line.split('|')[2:5]]
    assert all(speed > 0.0 for speed in speeds[:2]) and speeds[2] < 1e-6
