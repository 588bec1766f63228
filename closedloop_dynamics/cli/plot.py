# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop plot``: pictures of a run."""

from .command import (
    Command, directory_options, DRAWING, free_paths, recording_arguments, recording_of,
    write_drawing)
from ..recording.recording import since_the_last_reset
from ..visual.progress import announced

TITLES = {
    'joint_motion': 'joint motion',
    'constraint_forces': 'constraint forces in world axes',
    'positions': 'positions and forces',
}


def _run(arguments):
    files = dict(zip(TITLES, free_paths(arguments, *(f'{name}.png' for name in TITLES))))
    # Only here, as it takes libraries of an extra.
    from ..visual import pictures
    with announced('Reading ...'):
        recording = recording_of(arguments, arguments.recording)
    motion = since_the_last_reset(recording.motion)
    arguments.output.mkdir(parents=True, exist_ok=True)
    with announced('Drawing ...'):
        for name, title in TITLES.items():
            draw = getattr(pictures, name)
            draw(motion, f'{recording.scene.name}: {title}').savefig(files[name])
            print(files[name])
        if arguments.drawing is not None:
            write_drawing(arguments, motion, recording.scene.name)
            print(arguments.drawing)
    return 0


COMMAND = Command(
    name='plot',
    summary='draw a run: joint motion, forces at the cut joints, positions',
    description="""\
Draw positions, velocities and efforts of the joints over time, the forces at the cut joints over
time, and the mechanism in several positions. What is shown after a reset is the run since then.
""",
    examples=(
        'plot my_bag --output pictures',
        'plot run.csv --output pictures',
        'plot run.csv --output pictures --drawing run.svg'),
    arguments=(
        *recording_arguments(),
        *directory_options(', '.join(f'{name}.png' for name in TITLES), ''),
        DRAWING),
    run=_run)
