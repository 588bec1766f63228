# Copyright 2026 The closedloop_dynamics authors
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.


"""
What watching the pivots costs where no configuration is singular.

Three copies of the package are compiled side by side, as ``effects_absent`` does: as it is, the
same once more, and one without the watch: no ratio is formed, no smallest one kept, and nothing
branches into refinement or the rank-revealing path.
"""

import sys

from effects_absent import arguments_of, compare

COPIES = ('as_it_is', 'once_more', 'without_watch')
# Each must be found, once: what it is, and what is left of it.
CUTS = {
    'core/elimination.py': (
        ("""\
        ratio = factor[first] / scale[j]
        # Written so that a NaN (0/0: an equation no motion can change) counts as poor.
        smallest = choose(ratio >= smallest, smallest, choose(ratio > 0.0, ratio, 0.0))
""", ''),
        ("""\
    smallest = factorize(model, work)
    fine = good(model, smallest, SMALL_PIVOT)
    # A small one may be that of the masses alone: what is told is what ``refinement`` finds.
    note(model, work, choose(fine, smallest, 1.0))
    return fine
""", """\
    factorize(model, work)
    return True
""")),
    'integration/evaluation.py': (
        ("""\
        elif calls.call(table, calls.EVALUATION, q, qd) == 0:
            calls.call(table, calls.OUTWARD, q, qd)
            _accelerate_anew(table, q, qd)
""", """\
        else:
            calls.call(table, calls.EVALUATION, q, qd)
"""),),
    'integration/projection.py': (
        ("""\
    return (calls.call(system.table, calls.CORRECTION, q, qd) != 0
            or calls.call(system.table, calls.REFINED_CORRECTION, q, qd) != 0)
""", """\
    calls.call(system.table, calls.CORRECTION, q, qd)
    return True
"""),),
}


def cut_watch(directory):
    """
    Cut the watch of the pivots out of a copy of the package.

    Parameters
    ----------
    directory : pathlib.Path
        Of the copy.

    """
    for name, cuts in CUTS.items():
        path = directory / name
        text = path.read_text()
        for passage, rest in cuts:
            if text.count(passage) != 1:
                raise RuntimeError(f'{name}: expected once, to be cut out:\n{passage}')
            text = text.replace(passage, rest)
        path.write_text(text)


def main(arguments=None):
    """Run the benchmark."""
    compare(arguments_of(arguments, __doc__), COPIES, cut_watch)
    return 0


if __name__ == '__main__':
    sys.exit(main())
