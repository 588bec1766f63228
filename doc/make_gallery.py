# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Write ``gallery.md`` and its pictures: twelve machines with the numbers of their reports."""

from concurrent.futures import ThreadPoolExecutor
import os
from pathlib import Path
import subprocess
import sys
from tempfile import TemporaryDirectory

from PIL import Image

HERE = Path(__file__).resolve().parent
WIDTH = 720
# Title, commands that make a scene (not those of entries before), the scene, and its drives.
MACHINES = (
    ('Crank-rocker', (), 'four_bar', ('crank_joint=60:420deg:361',)),
    ('Slider-crank', (), 'slider_crank', ('crank_joint=60:420deg:361',)),
    ('Hoeken straight-line leg with a pantograph', (), 'hoeken_pantograph_leg',
     ('theta_1=60:420deg:361',)),
    ('Carpet scraper', (), 'carpet_scraper_dry', ('theta_1=60:420deg:361',)),
    ('Planar parallel manipulator', (), 'three_rrr_vertical',
     ('theta_1=2:2.2:21', 'theta_6=3.4', 'theta_7=4.7')),
    ('First cognate of the crank-rocker', ('cognates four_bar --output cognates',),
     'cognates/cognate_1.yaml', ('coupler_joint=30:390deg:361',)),
    ('Second cognate of the crank-rocker', (),
     'cognates/cognate_2.yaml', ('input_joint=30:390deg:361',)),
    ('Inversion of the slider-crank: an oscillating cylinder',
     ('invert slider_crank --ground rod --output cylinder.yaml',),
     'cylinder.yaml', ('crank_joint=-60:-420deg:361',)),
    ('Inversion of the crank-rocker: a double crank',
     ('invert four_bar --ground crank --output drag_link.yaml',), 'drag_link.yaml',
     ('crank_joint=-60:-420deg:361',)),
    ('Mirror image of the Hoeken leg', ('mirror hoeken_pantograph_leg --output other_leg.yaml',),
     'other_leg.yaml', ('theta_1=-60:-420deg:361',)),
    ('Spatial crank-rocker', (), 'rssr_four_bar', ('crank=0:360deg:361',)),
    ('Mirror image of the spatial crank-rocker',
     ('mirror rssr_four_bar --axis z --output mirrored.yaml',), 'mirrored.yaml',
     ('crank=0:360deg:361',)))
INTRODUCTION = """\
# Gallery

Twelve machines, each with the commands for its picture and its numbers (drive torques in N m).
`python doc/make_gallery.py` makes the page again; the terms are explained in
[recipes.md](recipes.md#words-of-the-trade).
[optimise.md](optimise.md) improves the numbers of a machine.
"""


# What derives a machine from another one.
DERIVED = HERE / 'examples' / 'derived_machines'


def shown(command, program=('-m', 'closedloop_dynamics.cli')):
    """Run a command of ``closedloop``, or of another program; return what it prints."""
    done = subprocess.run([sys.executable, *program, *command.split()],
                          capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f'{command}: {done.stderr}')
    return done.stdout


def entry(number, title, made, scene, drives):
    """Return the section of a machine, and write its picture."""
    options = ' '.join(f'--drive {drive}' for drive in drives)
    commands = [f'report {scene} {options} --output report_{number}.html',
                f'kinematics {scene} {options} --output rows_{number}.csv',
                f'plot rows_{number}.csv --output pictures_{number}']
    numbers = [line.strip() for line in shown(commands[-3]).splitlines()[:-1]]
    shown(commands[-2])
    shown(commands[-1])
    picture = Image.open(f'pictures_{number}/positions.png').convert('RGB')
    picture.thumbnail((WIDTH, WIDTH))
    picture.quantize(64).save(HERE / 'pictures' / f'gallery_{number}.png', optimize=True)
    console = '\n'.join([
        *(f'$ python doc/examples/derived_machines {command}' for command in made),
        *(f'$ closedloop {command}' for command in commands)])
    return (f'\n## {title}\n\n![{title} in several positions](pictures/gallery_{number}.png)\n\n'
            f'```text\n{console}\n' + '\n'.join(numbers) + '\n```\n')


if __name__ == '__main__':
    with TemporaryDirectory() as folder:
        os.chdir(folder)
        with ThreadPoolExecutor() as several:
            list(several.map(lambda made: shown(made, [DERIVED]), sorted(
                {made for _, each, *_ in MACHINES for made in each})))
            sections = list(several.map(entry, range(1, len(MACHINES) + 1), *zip(*MACHINES)))
    (HERE / 'gallery.md').write_text(INTRODUCTION + ''.join(sections), encoding='utf-8')
