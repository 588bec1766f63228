# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Make the moving picture at the top of README.md: ``doc/pictures/machines.gif``.

    python doc/make_moving_picture.py [SCENE ...]          (from the checkout, on the PYTHONPATH)

The machines are simulated under drives that follow a motion which repeats itself, and drawn by the
page of ``closedloop view``. Needs Chromium.
"""

from pathlib import Path
import sys
from tempfile import TemporaryDirectory
from test.view.browser import browser

from closedloop_dynamics.scene.loading import load_scene
from closedloop_dynamics.simulation.simulation import Simulation
from closedloop_dynamics.view.columns import SimulationRows
from closedloop_dynamics.view.description import describe
from closedloop_dynamics.view.page import recorded_page
from closedloop_dynamics.view.posing import felt_inertia
import numpy as np
from PIL import Image

OUTPUT = Path(__file__).resolve().parent / 'pictures' / 'machines.gif'
# Scene -> of each drive, turns in a period, and the amplitude [rad, m] and phase of a sine.
MOTIONS = {
    'carpet_scraper_on_carpet': {'theta_1': (3, 0.0, 0.0)},
    'three_rrr': {f'theta_{n}': (0, 0.35, phase) for n, phase in (
        (1, 0.0), (6, 2.1), (7, 4.2))},
    'stewart_platform': {f'leg_{n}': (0, 0.05, phase) for n, phase in zip(
        range(1, 7), (0.0, 0.3, 2.1, 2.4, 4.2, 4.5))},
}
# Of a motion and of a drive's answer [s, 1/s]; frames per second; pixels.
PERIOD, RATE, FRAMES, SIZE, COLORS = 4.0, 40.0, 15, 330, 96
# Rows of a motion in each frame, for smooth paths; of the simulation [s].
FINER, STEP = 4, 0.002
# What is beside the picture is left out.
STYLE = ('header, aside, #transport, #views, #legend {display: none !important} '
         'main {grid-template-columns: 1fr} #solid, #lines {inset: 0; height: 100%} '
         'html, body, #stage {background: #ffffff} '
         '#stage {height: 100vh; min-height: 0; border: 0} #unit, #grid {bottom: 8px}')


def motion(simulation, wanted):
    """Simulate two periods under drives that follow a motion; return the rows of the second."""
    names, felt = simulation.coordinates, felt_inertia(simulation)
    start = names.by_freedom(simulation.position)
    drives = [(name, names.index[name], felt[names.index[name]], start[names.index[name]], *how)
              for name, how in wanted.items()]
    shown, rows = SimulationRows(simulation), []
    steps, frame = round(PERIOD / STEP), 1.0 / (FRAMES * FINER * STEP)
    for step in range(2 * steps):
        if step >= steps and len(rows) * frame <= step - steps:
            rows.append(shown.row())
        w = 2.0 * np.pi / PERIOD
        # The motion begins softly.
        soft = min(1.0, step / steps * 2.0)
        torques = {}
        for name, place, inertia, middle, turns, amplitude, phase in drives:
            t = step * STEP
            goal = middle + turns * w * t + soft * amplitude * np.sin(w * t + phase)
            rate = turns * w + soft * amplitude * w * np.cos(w * t + phase)
            torques[name] = inertia * RATE * (
                RATE * (goal - names.by_freedom(simulation.position)[place])
                + 2.0 * (rate - simulation.velocity[place]))
        simulation.step(torques, STEP)
    return shown.columns, np.array(rows)


def pictures(tab, count):
    """Return the frames of a page that has a motion in it."""
    tab.wait('typeof page !== "undefined" && Boolean(page.shownRow)')
    tab.ask('(() => { page.playing = false; page.picture.forget(); '
            'page.theme.paper = [1, 1, 1]; const s = '
            f'document.createElement("style"); s.textContent = "{STYLE}"; '
            'document.head.append(s); })()')
    # Twice round: the path of the point is whole in the second.
    for k in [*range(count), *range(count)]:
        tab.ask(f'new Promise((done) => {{ page.now = {k} / {FRAMES * FINER}; '
                'requestAnimationFrame(() => requestAnimationFrame(done)); })')
        if k == 0:
            found = []
        if k % FINER == 0:
            found.append(Image.fromarray(tab.picture()))
    return found


def main(scenes):
    """Make the picture of some machines, side by side."""
    rows = []
    with TemporaryDirectory() as folder, browser() as open_page:
        for name in scenes:
            scene = load_scene(name)
            columns, shown = motion(Simulation(scene), MOTIONS[name])
            page = Path(folder, 'page.html')
            page.write_text(recorded_page(
                name, describe(
                    scene.mechanism, columns, scene.effects, mode='recording', title=name),
                np.arange(len(shown)) / (FRAMES * FINER), shown), encoding='utf-8')
            tab = open_page(f'{page.as_uri()}?smooth', width=SIZE, height=SIZE)
            rows.append(pictures(tab, len(shown)))
            tab.close()
            print(f'{name}: {len(rows[-1])} frames', flush=True)
    frames = []
    for parts in zip(*rows):
        frames.append(Image.new('RGB', (SIZE * len(parts), SIZE)))
        for k, part in enumerate(parts):
            frames[-1].paste(part, (SIZE * k, 0))
    sample = Image.new('RGB', (frames[0].width, 4 * SIZE))
    for k in range(4):
        sample.paste(frames[k * len(frames) // 4], (0, k * SIZE))
    palette = sample.quantize(COLORS, Image.Quantize.MEDIANCUT)
    first, *others = (frame.quantize(palette=palette, dither=Image.Dither.NONE)
                      for frame in frames)
    # A GIF counts in hundredths of a second.
    first.save(OUTPUT, save_all=True, append_images=others, duration=10 * round(100 / FRAMES),
               loop=0, optimize=False)
    print(f'{OUTPUT}: {OUTPUT.stat().st_size / 1e6:.2f} MB')


if __name__ == '__main__':
    main(sys.argv[1:] or list(MOTIONS))
