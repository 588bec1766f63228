# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""``closedloop recover``: repair a bag that was cut short or damaged."""

from pathlib import Path

from .command import Command, complain, UsageError
from ..recording.contents import messages
from ..recording.reading import BagReadError
from ..recording.recover import recover
from ..visual.tables import text_table


def _add_arguments(parser):
    parser.add_argument('bag', metavar='BAG', type=Path,
                        help='directory of the bag, or one of its files')
    parser.add_argument('--output', metavar='DIR', type=Path,
                        help='directory of the new bag; must not exist (default: the name of the '
                             'old one with _recovered behind it)')


def _run(arguments):
    bag = arguments.bag.resolve()
    output = arguments.output or bag.with_name(f'{bag.stem}_recovered')
    if output.exists():
        raise UsageError(f'--output: {output} exists; name another directory')
    try:
        counts, damaged = recover(bag, output)
    except BagReadError as error:
        raise UsageError(str(error)) from None
    print(f'{output}: {sum(counts.values())} messages')
    if counts:
        print(text_table(('topic', 'messages'), [
            (topic, str(count)) for topic, count in sorted(counts.items())]))
    if not damaged.finished:
        print('the recording was not ended in order')
    for damage in damaged.damages:
        complain(arguments, damage)
    if damaged.lost == 0:
        return 0
    return complain(arguments, f'{messages(damaged.lost)} could not be recovered')


COMMAND = Command(
    name='recover',
    summary='repair a bag that was cut short or damaged',
    description="""\
Copy whatever is sound in a bag into a new one (mcap), with index and metadata. A
recorder that was killed leaves a bag without them, which ros2 bag does not open;
all but the last 0.1 s of messages are in it. Every chunk (mcap) or message (sqlite3 from
closedloop_recorder) is checked by its checksum; damaged ones are left out and named, and
the exit code is 1 if messages were lost by it. The old bag stays as it is.
""",
    epilog="""\
examples:
  closedloop recover my_bag
""",
    add_arguments=_add_arguments,
    run=_run,
    reads_scenes=False)
