# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""
Sentences of the documents, with numbers from the CSV files of doc/pictures.

What a sentence recommends is written by hand: read it again where its numbers change much.
"""

import csv
from math import inf, log10
from statistics import median
from textwrap import fill

from closedloop_dynamics.visual.tables import seconds, share

OURS = 'closedloop_dynamics'
WIDTH = 120
STABILISED, SPATIAL = ('three_rrr', 'carpet_scraper'), ('stewart_platform', 'delta_robot')


def read(path):
    """Return the rows of a CSV file."""
    with open(path, newline='', encoding='utf-8') as file:
        return list(csv.DictReader(file))


def spread(values, digits=2):
    """Return the range of some numbers in words, as ``7 to 11``; ``-`` of none."""
    values = list(values)
    if not values:
        return '-'
    ends = [f'{value:.0f}' if value >= 4.95 else f'{value:.{digits}g}'
            for value in (min(values), max(values))]
    return ends[0] if ends[0] == ends[1] else ' to '.join(ends)


def paragraph(text, first='', others=''):
    """Return a text in lines as the documents have them, in Markdown."""
    return fill(' '.join(text.split()), WIDTH, initial_indent=first, subsequent_indent=others,
                break_long_words=False, break_on_hyphens=False)


def accuracy_advice(free, held, pictures, cheapest):
    """
    Return the advice of doc/accuracy.md.

    Parameters
    ----------
    free, held : dict
        {what moves: {integrator: settings}}, by ``make_accuracy_doc``.
    pictures : pathlib.Path
        Where the CSV files are.
    cheapest : callable
        Of settings and an error.

    """
    def growth(name):
        pairs = [(cheapest(of[name], 1e-3), cheapest(of[name], 1e-9)) for of in free.values()]
        return spread([fine.cost / coarse.cost for coarse, fine in pairs if coarse and fine])

    def at(rate, attribute, target, name, other=None):
        found = []
        for text, of in held.items():
            one = cheapest(of[name], target)
            if text.endswith(f', {rate} Hz') and one:
                against = getattr(cheapest(of[other], target), attribute) if other else 1.0
                found.append(getattr(one, attribute) / against)
        return found

    energy = {(row['scene'], row['integrator'], row['step_size'] or row['tolerance']):
              float(row['largest_relative_energy_error'] or 'nan')
              for row in read(pictures / 'accuracy_energy.csv')
              if row['stabilisation'] == 'projection'}
    kept, lost = ([energy[scene, *method] for scene in STABILISED]
                  for method in (('dop853', '1e-10'), ('rk4', '0.001')))
    steps = stabilisation_costs(pictures)
    auto = at(100, 'evaluations', 1e-6, 'auto', 'dop853')
    advice = (
        f"""**Torques that are constant or change slowly: take `dop853`**, or `auto`, which steps
        by it. From an error of 1e-3 to 1e-9 the cost of `dop853` grows {growth('dop853')} times,
        that of `rk4` {growth('rk4')} times.""",
        f"""**Torques held at 100 Hz: take `dop853`**, or `dopri5`, which makes fewer evaluations
        for coarse errors. For 1e-6 `rk4` needs
        {spread(at(100, 'evaluations', 1e-6, 'rk4', 'dop853'))} times as many evaluations.""",
        f"""**Torques held at 1 kHz: take `auto`, or `rk4` for coarse errors.** A period is a step,
        of 4 (`rk4`), 7 (`dopri5`, which `auto` takes there) or 12 (`dop853`) evaluations: called
        from Python, for an error of 1e-6, `rk4` takes
        {spread(at(1000, 'cost', 1e-6, 'rk4', 'dop853'))} and `auto`
        {spread(at(1000, 'cost', 1e-6, 'auto', 'dop853'))} times the CPU time of `dop853`.""",
        f"""**`auto` checks its error in the first second by a second run**: with torques held at
        100 Hz it makes {spread(auto)} times the evaluations of `dop853` in that second. At 1 kHz
        the check takes over the steps of the run.""",
        """**Tolerance is not error.** It bounds the local error of each step. Begin with a
        tolerance ten times smaller than the error you want: the 3-RRR released from rest
        amplifies a small error in a base joint up to 32 times within a second.""",
        f"""**Keep `projection`.** A step of RK4 costs {spread(steps['projection'])} times one
        without stabilisation, whose drift costs accuracy. `independent` (coordinates) closes the
        loops equally well for {spread(steps['independent'])} times that cost.""",
        f"""**Energy** of undriven, frictionless motion over 10 s: `dop853` at tolerance 1e-10
        keeps it to {kept[0]:.0e} (3-RRR) and {kept[1]:.0e} (scraper), RK4 with 1 ms to
        {lost[0]:.0e} and {lost[1]:.0e}.""")
    return '\n'.join(paragraph(text, '* ', '  ') for text in advice)


def stabilisation_costs(pictures):
    """Return what RK4's steps cost with each stabilisation, in those without, of both machines."""
    found = {}
    for scene in STABILISED:
        costs = {}
        for row in read(pictures / f'accuracy_{scene}.csv'):
            # Of tables that were made while dense formulations could be chosen, not these.
            ours = row.get('formulation', 'subsystem') == 'subsystem'
            if ours and row['integrator'] == 'rk4' and not row['failure']:
                costs.setdefault(row['stabilisation'], {})[row['step_size']] = float(
                    row['cpu_time_per_second'])
        for name, of in costs.items():
            common = of.keys() & costs['none'].keys()
            found.setdefault(name, []).append(
                median(of[size] / costs['none'][size] for size in common))
    return found


def accuracy_costs(settings, cheapest):
    """Return the sentences of README.md on what accuracy costs, of the driven 3-RRR."""
    coarse, fine = (cheapest(settings['dop853'], target) for target in (1e-6, 1e-9))
    auto = min(settings['auto'], key=lambda setting: abs(log10(setting.tolerance) + 6.0))
    return paragraph(f"""
        On the 3-RRR an error of 1e-6 rad after one second costs {seconds(coarse.cost)} of CPU time
        with `dop853`, {share(coarse.cost)}; an error of 1e-9 rad costs
        {spread([fine.cost / coarse.cost])} times that. The default, `auto`, chooses the steps for
        an accuracy of 1e-6 and checks it by a second run beside the first: its error
        was {auto.error:.0e} rad, at {seconds(auto.cost)} ([doc/accuracy.md](doc/accuracy.md)).""")


def evaluation_ratios(pictures, name, scenes=None):
    """Return {(engine, what): times as slow as ours} of each scene of a group."""
    rows = read(pictures / f'performance_{name}_evaluation.csv')
    found = {}
    for row in rows:
        if scenes is None or row['scene'] in scenes:
            ours = min(float(other['best']) for other in rows
                       if (other['scene'], other['engine']) == (row['scene'], OURS))
            of, key = found.setdefault(row['scene'], {}), (row['engine'], row['what'])
            # Of several trees the one that suits best.
            of[key] = min(of.get(key, inf), float(row['best']) / ours)
    return found


def motion_ratios(pictures, name, target):
    """Return {motion: cost of the best of the others in ours} for an error."""
    best = {}
    for row in read(pictures / f'performance_{name}_motions.csv'):
        if float(row['error'] or 'nan') <= target:
            kind = best.setdefault(row['case'], {})
            ours = row['engine'] == OURS
            kind[ours] = min(kind.get(ours, inf), float(row['best']))
    return {case: of[False] / of[True] for case, of in best.items() if len(of) == 2}


def _of(ratios, engine, *parts):
    """Return the least ratio in each scene of some ways of an engine, where it was measured."""
    found = [[value for (name, what), value in of.items() if name == engine and what in parts]
             for of in ratios.values()]
    return [min(values) for values in found if values]


def speed(pictures, by_default):
    """Return the item of README.md on speed; ``by_default``: a sentence on the default method."""
    plane = evaluation_ratios(pictures, 'peers')
    space = evaluation_ratios(pictures, 'peers_space', SPATIAL)
    pinocchio = ('evaluation, C++ loop', 'evaluation by lcaba, C++ loop')
    mujoco = ('mj_forward, from Python', 'mj_step (Euler), C loop')
    by_casadi = evaluation_ratios(pictures, 'peers_generated').values()
    generated = [min(value for (engine, _), value in of.items() if engine != OURS)
                 for of in by_casadi]
    solvers = ' or '.join(sorted({engine.replace(' by CasADi', '') for of in by_casadi
                                  for engine, _ in of} - {OURS}))
    best = motion_ratios(pictures, 'peers', 1e-6).values()
    return paragraph(f"""
        **Fast**, mostly by code that is generated for the mechanism
        ([measurements](doc/performance.md)): an evaluation is, in the plane,
        {spread(_of(plane, 'Pinocchio', *pinocchio))} times faster than Pinocchio's in C++ and
        {spread(_of(plane, 'MuJoCo', *mujoco))} times than MuJoCo's, of a Stewart platform and a
        Delta robot
        {spread(_of(space, 'Pinocchio', *pinocchio) + _of(space, 'MuJoCo', *mujoco))} times; beside
        the fastest code that CasADi generates and gcc compiles ({solvers}), it is
        {spread(generated)} times as fast, on five machines. A planar motion with an error of
        1e-6 is {spread(best)} times faster, all by the cheapest setting found afterwards.
        {by_default}""", '- ', '  ')


def space_speed(pictures):
    """Return the sentences of doc/performance.md on machines in space."""
    ratios = evaluation_ratios(pictures, 'peers_space')
    coarse, fine = (motion_ratios(pictures, 'peers_space', target).values()
                    for target in (1e-6, 1e-9))
    mujoco = ('mj_forward, from Python', 'mj_step (Euler), C loop')
    constraint, lcaba = 'evaluation, C++ loop', 'evaluation by lcaba, C++ loop'
    return paragraph(f"""
        An evaluation is {spread(_of(ratios, 'Pinocchio', constraint))} times faster than with
        `constraintDynamics`, {spread(_of(ratios, 'Pinocchio', lcaba))} times faster than with
        `lcaba` and one iteration, and {spread(_of(ratios, 'MuJoCo', *mujoco))} times faster than
        with MuJoCo. Whole motions are {spread(coarse)} times faster than with the best of the
        others for an error of 1e-6, and {spread(fine)} times for 1e-9.""")
