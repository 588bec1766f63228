# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Every command, script and file in README.md and doc/ does what the page says.

What is run is what stands in fenced blocks: ``console`` (lines with ``$`` are commands, the
others their output, ``...`` for what is left out), ``python``, and ``yaml`` and ``xml`` whose
first line is a comment with the file's name. A comment before a block says how it is run:

    <!-- exits with 2 -->                     the exit code expected
    <!-- each in a terminal of its own -->    nodes, run together, ended by Ctrl-C
    <!-- with what was recorded above -->     after these nodes, with the bag they leave behind
    <!-- needs gymnasium -->                  run where that module is installed
    <!-- not run: why -->
"""

from dataclasses import dataclass
from importlib.util import find_spec
import os
from pathlib import Path
import re
import runpy
import shlex
import signal
import subprocess
import sys
from test.ros.domains import reserve_domain
import time

from closedloop_dynamics.cli import main
from hard_cases import CASES
from programs import FUNCTIONS, Program
import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = 'closedloop_dynamics'
PAGES = [ROOT / 'README.md', *sorted((ROOT / 'doc').glob('*.md'))]
BLOCK = re.compile(
    r'(?:^<!-- (?P<note>[^\n]*?) -->\n)?^```(?P<kind>\w+)\n(?P<text>.*?)^```$', re.M | re.S)
TERMINALS = 'each in a terminal of its own'
AFTERWARDS = 'with what was recorded above'
# How long a recording may take to grow on disk, which it does once a second [s].
PATIENCE = 240.0
# Commands that are not run from here, and why.
ELSEWHERE = {
    'python doc/examples/derived_machines': 'test/simulation/test_derived_machines.py does',
    'scripts/build': 'test/engine/test_build.py does',
    'scripts/demo': 'test/ros/test_demo.py runs what it calls',
    'scripts/test': 'it runs this test',
    'source': 'set-up of a shell', 'mkdir': 'set-up', 'python3 -m venv': 'set-up',
    'pip install': 'needs an index', 'python -m colcon build': 'test/packaging does',
    'ros2 bag': 'needs ros2cli', 'ros2 topic': 'needs ros2cli', 'ros2 param': 'needs ros2cli',
    'ros2 launch': 'needs ros2launch', 'ros2 service': 'needs ros2cli',
}


@dataclass(frozen=True)
class Block:
    """One fenced block of a page."""

    page: Path
    line: int
    kind: str
    note: str
    text: str

    def __str__(self):
        return f'{self.page.name}:{self.line}'

    @property
    def commands(self):
        """Return pairs of a command and the lines of its output."""
        parts = re.split(r'^\$ ', self.text, flags=re.M)
        assert not parts[0].strip(), f'{self}: output before a command'
        return [(part.splitlines()[0], part.splitlines()[1:]) for part in parts[1:]]


def blocks_of(page):
    text = page.read_text()
    return [Block(page, text.count('\n', 0, match.start('kind')) + 1, match['kind'],
                  match['note'] or '', match['text']) for match in BLOCK.finditer(text)]


def write_files(page, directory):
    """Write the files that a page shows; return their names."""
    names = []
    for block in blocks_of(page):
        name = re.match(r'(?:# (?=\S+\.yaml\n)|<!-- (?=\S+ -->\n))(\S+)', block.text)
        if block.kind in ('yaml', 'xml') and name:
            (directory / name[1]).write_text(block.text)
            names.append(name[1])
    return names


@pytest.fixture
def scratch(tmp_path, monkeypatch):
    """Return an empty working directory, with the checkout's config/ in it."""
    (tmp_path / 'config').symlink_to(ROOT / 'config')
    monkeypatch.chdir(tmp_path)
    return tmp_path


def run_closedloop(command, capsys):
    """Return exit code and all output of a command."""
    try:
        code = main(shlex.split(command)[1:])
    except SystemExit as end:
        code = end.code
    return code, '\n'.join(capsys.readouterr())


def words(line):
    return ' '.join(line.split())


def check_output(where, wanted, output):
    """Check that the lines wanted are in the output, in their order."""
    lines = iter([words(line) for line in output.splitlines()])
    for line in wanted:
        if line.strip() not in ('', '...'):
            assert words(line) in lines, f'{where}: no line {line!r} (there) in\n{output}'


# They compute for longer than five seconds.
LONG = ('optimise.md', 'recipes.md', 'synthesis.md', 'control.md', 'workspace.md')


@pytest.mark.parametrize('page', [
    pytest.param(page, marks=pytest.mark.slow) if page.name in LONG else page
    for page in PAGES], ids=lambda page: page.name)
def test_commands_and_scripts_do_what_the_page_says(page, scratch, capsys):
    write_files(page, scratch)
    for block in blocks_of(page):
        if block.note.startswith('not run: ') or block.note in (TERMINALS, AFTERWARDS):
            continue
        needed = re.fullmatch(r'needs (\w+)', block.note)
        if needed and find_spec(needed[1]) is None:
            continue
        if block.kind == 'python':
            script = scratch / f'line_{block.line}.py'
            script.write_text(block.text)
            runpy.run_path(str(script))
        elif block.kind == 'console':
            expected = int((re.fullmatch(r'exits with (\d+)', block.note) or [0, 0])[1])
            for command, wanted in block.commands:
                if command.split()[0] == 'closedloop':
                    code, output = run_closedloop(command, capsys)
                    assert code == expected, f'{block}: {command}\n{output}'
                    check_output(block, wanted, output)
                else:
                    assert any(command.startswith(known) for known in ELSEWHERE), (
                        f'{block}: nothing runs {command!r}; add it here, or mark the block')


def next_block(block):
    """Return the block of commands that follows on the page; None at its end."""
    later = [each for each in blocks_of(block.page)
             if each.line > block.line and each.kind == 'console']
    return later[0] if later else None


def recordings(block):
    """Return the names of the bags that the recorders of a block write."""
    return re.findall(r'closedloop_recorder .*-p output:=(\w+)', block.text)


def wait_for_more(names):
    """Wait until bags have grown on disk."""
    def sizes():
        # A draft of the metadata may go between the look into the folder and that at the file.
        return [sum(path.stat().st_size for path in Path(name).iterdir()
                    if path.suffix in ('.mcap', '.db3')) for name in names]

    before, deadline = sizes(), time.monotonic() + PATIENCE
    while any(now <= then for now, then in zip(sizes(), before)):
        assert time.monotonic() < deadline, f'{names} do not grow'
        time.sleep(0.05)


TOGETHER = [block for page in PAGES for block in blocks_of(page) if block.note == TERMINALS]
# Without --all those of one node, of two in lockstep, and of ones that are asked afterwards.
SHORT = ('describe_a_mechanism.md', 'examples_impedance.md', 'examples_lockstep.md')


@pytest.mark.parametrize('block', [
    block if block.page.name in SHORT else pytest.param(block, marks=pytest.mark.slow)
    for block in TOGETHER], ids=str)
def test_nodes_run_together_as_the_page_says(block, scratch, capsys):
    write_files(block.page, scratch)
    started = []
    with reserve_domain() as domain:
        environment = {'ROS_DOMAIN_ID': str(domain), 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
                       'ROS_LOG_DIR': str(scratch / 'log')}
        try:
            for command, _ in block.commands:
                command = command.removeprefix('ros2 run closedloop_dynamics ')
                executable, *arguments = shlex.split(command)
                assert executable in FUNCTIONS
                started.append(Program(executable, arguments, scratch / f'{executable}.log',
                                       environment, scratch))
            for process in started:
                process.wait_until_ready()
            if started[0].executable == 'closedloop_recorder':
                # Something is to be in the bag.
                for topic in ('joint_states', 'scene', 'replay_log'):
                    started[0].wait_for(f'/{topic}: first message')
                names = recordings(block)
                for _ in range(2):
                    wait_for_more(names)
            for process in reversed(started):
                assert process.stop(signal.SIGINT) == 0, process.output
        finally:
            for process in started:
                process.popen.kill()
                process.popen.wait()
    for name in recordings(block):
        assert (scratch / name / 'metadata.yaml').is_file()
    following = next_block(block)
    if following is not None and following.note == AFTERWARDS:
        for command, wanted in following.commands:
            code, output = run_closedloop(command, capsys)
            assert code == 0, f'{following}: {command}\n{output}'
            check_output(following, wanted, output)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page):
    text = re.sub(r'^```.*?^```$', '', page.read_text(), flags=re.M | re.S)
    for target in re.findall(r'\]\(([^)\s]+)\)', text):
        if target.startswith(('http://', 'https://')):
            continue
        path, _, anchor = target.partition('#')
        file = (page.parent / path).resolve() if path else page
        assert file.exists(), f'{page.name}: {target}'
        if anchor:
            headings = re.findall(r'^#+ (.*)$', file.read_text(), flags=re.M)
            assert anchor in {anchor_of(heading) for heading in headings}, target


def anchor_of(heading):
    """Return the anchor that GitHub gives a heading."""
    return re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-')


def test_pages_are_found():
    assert {'README.md', 'interface.md', 'theory.md'} <= {page.name for page in PAGES}
    assert len(TOGETHER) >= 3


def test_readme_fits_on_a_few_screens():
    assert len((ROOT / 'README.md').read_text().splitlines()) <= 120


def test_hard_cases_are_as_many_as_the_pages_say():
    assert len(CASES) == 60
    assert 'Sixty hard cases' in (ROOT / 'README.md').read_text()
    assert 'sixty hard cases' in (ROOT / 'doc' / 'stability.md').read_text()


def test_folders_and_files_that_the_pages_name_exist():
    text = ''.join(page.read_text() for page in PAGES)
    folders = set(re.findall(r'`(config/\w+/)`', text))
    files = set(re.findall(r'`((?:benchmark|config|doc|scripts|test)/[\w/]+(?:\.\w+)?)`', text))
    rooms = '|'.join(path.parent.name for path in (ROOT / PACKAGE).glob('*/__init__.py'))
    modules = {f'{PACKAGE}/{name}' for name in re.findall(rf'`((?:{rooms})/[\w/]+\.py)`', text)}
    assert len(folders) >= 3 and len(files) >= 10 and len(modules) >= 10
    assert [name for name in folders | files | modules if not (ROOT / name).exists()] == []


def test_every_shipped_scene_is_shown():
    page = (ROOT / 'doc' / 'machines.md').read_text()
    scenes = [path.stem for path in (ROOT / 'config' / 'scenes').glob('*.yaml')]
    assert len(scenes) > 20
    assert [name for name in scenes if f'`{name}`' not in page] == []


@pytest.mark.parametrize('name', ('scene_keys', 'stability_cases'))
def test_pages_that_are_written_from_the_code_are_up_to_date(name):
    written = runpy.run_path(str(ROOT / 'doc' / f'make_{name}.py'))
    assert (ROOT / 'doc' / f'{name}.md').read_text() == written['page'](), (
        f'python doc/make_{name}.py writes the page again')


@pytest.mark.slow
def test_site_is_built_without_a_broken_link(tmp_path):
    pytest.importorskip('mkdocs', reason='requirements/docs.txt is not installed')
    pytest.importorskip('mkdocstrings', reason='requirements/docs.txt is not installed')
    done = subprocess.run(
        [sys.executable, '-m', 'mkdocs', 'build', '--strict', '--site-dir', str(tmp_path)],
        cwd=ROOT, env={**os.environ, 'NO_MKDOCS_2_WARNING': '1'}, stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    assert done.returncode == 0, done.stdout
    pages = {page.name.replace('README', 'index') for page in PAGES}
    assert {name.replace('.md', '.html') for name in pages} <= {
        path.name for path in tmp_path.glob('*.html')}
    # Machines that are simulated in the browser, with a link to each.
    live, gallery = tmp_path / 'live', (tmp_path / 'live.html').read_text()
    assert {'four_bar', 'stewart_platform'} <= {page.stem for page in live.glob('*.html')}
    for page in live.glob('*.html'):
        assert f'href="live/{page.name}"' in gallery
        assert page.with_suffix('.svg').is_file() or page.stem == 'editor'
    reference = (tmp_path / 'reference.html').read_text()
    assert 'inverse_dynamics' in reference and ':::' not in reference
    assert 'inverse_dynamics' in (tmp_path / 'search' / 'search_index.json').read_text()
    # The box that chooses among versions.
    assert '"version": {"provider": "mike"}' in reference
    # Nothing is loaded from elsewhere.
    sources = re.findall(r'(?:src|href)="(https?://[^"]+)"[^>]*>', re.sub(
        r'<a [^>]*>', '', reference))
    assert sources == []
