# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The findings on a scene's effects as a table, a CSV file and pictures."""

import numpy as np

from .effects import changes_of_position
from ..mechanism.extras import of_an_extra
from ..mechanism.rotations import direction
from ..visual.appearance import COLORS, DASHES, DOTS_PER_INCH
from ..visual.tables import markdown_table, seconds, short, text_table, write_csv

HEADER = ('effect', 'arithmetic alone', 'arithmetic without', 'motion without', 'time without',
          'position', 'points', 'effort', 'force', 'energy', 'dissipated')
UNITS = ('', 'x bare', *3 * ('x whole',), '[rad, m]', '[m]', '[N m, N]', '[N]', '[J]', '[J]')
NOTE = (
    'arithmetic alone: time of one evaluation of the accelerations with these effects alone, over '
    'that without any;\narithmetic without: of the scene without them, over the whole scene. '
    'Medians in turn, in the same states of the\nmotion, and how far they are uncertain. motion '
    'without: evaluations that a simulated second takes without them,\nover those of the whole '
    'scene. time without: the product of these two.\nposition (of orientations the angle), places '
    'of the named points, effort, force (cut joints), energy (kinetic and\nstored): the largest '
    'change that leaving them out makes; dissipated: by them, in the scene as it is.')
# Share of the time that counts as zero [1].
NEGLIGIBLE = 0.02


def table(study, style=text_table):
    """
    Return the findings as a table.

    ``style``: callable; ``tables.text_table`` or ``tables.markdown_table``.
    """
    header = [f'{name} {unit}'.strip() for name, unit in zip(HEADER, UNITS)]
    lines = [style(header, [
        (label(finding), ratio(finding.alone), ratio(finding.without), short(finding.motion),
         short(finding.time),
         *(short(value) for value in (finding.position, finding.place, finding.effort,
                                      finding.force, finding.energy, dissipated(study, finding))))
        for finding in study.findings])]
    lines += [f'without {label(finding)}: {finding.failure}' for finding in study.findings
              if finding.failure]
    return '\n\n'.join(lines)


def advice(study, matters):
    """
    Say which effects matter, and how much leaving out the others saves.

    Lines for each type of effect, and one for those that together change positions or places by
    less than ``matters`` [rad or m].
    """
    lines = []
    for finding in (*study.findings, *filter(None, [study.together])):
        name = label(finding)
        if finding is study.together:
            name = f'{" and ".join(finding.names)} together'
        if finding.run is None:
            lines.append(f'{name}: needed, the scene does not run without')
            continue
        changed = [f'{finding.joint} by {finding.position:.2g} rad or m'] if finding.joint else []
        if finding.point:
            changed.append(f'{finding.point} by {finding.place:.2g} m')
        if finding.force > 0.0:
            changed.append(f'forces at the cut joints by {finding.force:.2g} N')
        lines.append(f'{name}: changes {", ".join(changed) or "nothing"}, {_time(finding)}: '
                     + (f'matters, at {matters:g}' if finding.moved > matters else
                        f'leave out, if {matters:g} is all that matters'))
    return '\n'.join(lines)


def _time(finding):
    """Return an effect's share of the computing time, in words."""
    saved = 1.0 - finding.time
    if np.isnan(saved):
        return 'takes a time that could not be measured'
    if abs(saved) < max(NEGLIGIBLE, finding.without.noise):
        return 'takes no time worth speaking of'
    if saved < 0.0:
        return f'without it the motion takes {-100.0 * saved:.0f} % more time'
    return (f'takes {100.0 * saved:.0f} % of the time '
            f'({_part(finding.without.value, finding.without.noise)} an evaluation, '
            f'{_part(finding.motion, 0.0)} the evaluations)')


def _part(left, noise):
    """Return the saving that a remaining share means, in words."""
    saved = 1.0 - left
    return 'nothing of' if abs(saved) < max(NEGLIGIBLE, noise) else f'{100.0 * saved:.0f} % of'


def summary(study):
    """Return the summary of the whole scene, a few lines."""
    balance = study.run.balance[-1]
    return '\n'.join([
        f'one evaluation: {seconds(study.bare)} without any effect, {ratio(study.off)} times that '
        f'with all listed but switched off, {ratio(study.whole)} times with all of them',
        f'a simulated second takes {study.run.evaluations:.0f} of them',
        f'noise: the same without any effect, measured once more, took {ratio(study.again)} times '
        'as long',
        f'energy at the end: kinetic {balance[0]:.4g} J, stored {balance[1]:.4g} J, dissipated '
        f'{balance[2]:.4g} J, work {balance[3]:.4g} J; the balance is off by {balance[4]:.1g} J'])


def ratio(value):
    """Return a ratio of times with its uncertainty, in words; a dash where there is none."""
    if np.isnan(value.value):
        return '-'
    digits = 2 if value.noise > 0.002 else 3
    return f'{value.value:.{digits}f} ± {max(value.noise, 10.0 ** -digits):.{digits}f}'


def dissipated(study, finding):
    """Return the energy that effects of one type dissipate in the scene as it is [J]."""
    readings = (study.run.readings[name] for name in finding.names)
    return float(sum(one['dissipated_energy'][-1] for one in readings
                     if 'dissipated_energy' in one))


def label(finding):
    """Return the name of a type of effect, and how many there are."""
    count = len(finding.names)
    return finding.kind if count == 1 else f'{finding.kind} ({count})'


def write(study, directory):
    """Write table and pictures."""
    directory.mkdir(parents=True, exist_ok=True)
    paths = [directory / name for name in file_names(study.simulation.scene)]
    name = study.simulation.scene.name
    write_csv(paths[0], [f'{key} {unit}'.strip() for key, unit in zip(HEADER, UNITS)], [
        (label(f), f.alone.value, f.without.value, f.motion, f.time, f.position, f.place, f.effort,
         f.force, f.energy, dissipated(study, f))
        for f in study.findings])
    paths[1].write_text(f'# What the effects of {name} cost and change\n\n'
                        f'{table(study, markdown_table)}\n\n{NOTE}\n\n{summary(study)}\n',
                        encoding='utf-8')
    changes(study).savefig(paths[2], dpi=DOTS_PER_INCH)
    for path, contact in zip(paths[3:], contacts(study.simulation.scene)):
        work(study, contact).savefig(path, dpi=DOTS_PER_INCH)
    return paths


def file_names(scene):
    """Return the names of the files that ``write`` makes for a scene."""
    return [f'{scene.name}_effects.{ending}' for ending in ('csv', 'md', 'png')] + [
        f'{scene.name}_{name}.png' for name in contacts(scene)]


def contacts(scene):
    """Return the names of the effects that scrape or rub at a point of a planar mechanism."""
    return [name for name, effect in scene.effects.items()
            if scene.mechanism.planar and 'scraping_force' in effect.READINGS]


def changes(study):
    """Draw the scene as it is, and without each type of effect."""
    with of_an_extra():
        import matplotlib.figure
    run, simulation = study.run, study.simulation
    joint = int(np.argmax(sum(
        np.abs(_moved(study, finding.run)).max(axis=0) for finding in _made(study)) + np.zeros(
            len(simulation.joint_names))))
    cut = _most_changed(study, 'force')
    driven = _most_changed(study, 'effort')
    panels = [
        (f'change of position of\n{simulation.joint_names[joint]} [rad or m]',
         lambda r: _moved(study, r)[:, joint])]
    if np.abs(run.effort).max() > 0.0:
        panels.append((f'effort of {simulation.joint_names[driven]}\n[N m or N]',
                       lambda r: r.effort[:, driven]))
    if simulation.mechanism.cut_joints:
        panels.append((f'force at {simulation.mechanism.cut_joints[cut].name}\n[N]',
                       lambda r: r.force[:, cut]))
    panels.append(('kinetic and stored\nenergy [J]', lambda r: r.balance[:, :2].sum(axis=1)))
    figure = matplotlib.figure.Figure((11.0, 2.2 * len(panels) + 1.0), layout='constrained')
    figure.suptitle(f'{simulation.scene.name}: as it is, and without each type of effect')
    grid = figure.add_gridspec(len(panels), 2, width_ratios=(3.0, 1.0))
    first = None
    for row, (title, of) in enumerate(panels):
        axes = first = figure.add_subplot(grid[row, 0], sharex=first)
        # Wide and pale below the others, which would be hidden where they change nothing.
        axes.plot(run.time, of(run), color='0.75', linewidth=5.0, label='as it is')
        for k, finding in enumerate(study.findings):
            if finding.run is None:
                continue
            axes.plot(finding.run.time, of(finding.run), label=f'without {label(finding)}',
                      color=COLORS[k % 6], linestyle=DASHES[k // 6], linewidth=1.1)
        axes.set_ylabel(title)
        axes.grid(alpha=0.3)
        axes.tick_params(labelbottom=row == len(panels) - 1)
    axes.set_xlabel('time [s]')
    handles, labels = axes.get_legend_handles_labels()
    side = figure.add_subplot(grid[0, 1])
    side.axis('off')
    side.legend(handles, labels, loc='upper left', frameon=False, borderaxespad=0.0)
    _costs(study, figure.add_subplot(grid[1:, 1]))
    return figure


def _costs(study, axes):
    """Draw the time of an evaluation with each type alone."""
    names = ['nothing, once more', 'listed, all off', *map(label, study.findings),
             'the whole scene']
    ratios = [study.again, study.off, *(f.alone for f in study.findings), study.whole]
    values = [one.value for one in ratios]
    colors = ['#dddddd', '#999999', *(COLORS[k % 6] for k in range(len(study.findings))),
              '#333333']
    places = np.arange(len(names))[::-1]
    axes.barh(places, values, color=colors, height=0.6)
    axes.hlines(places, [one.low for one in ratios], [one.high for one in ratios],
                color='#d62728', linewidth=1.0)
    for place, name, one in zip(places, names, ratios):
        axes.text(one.high, place, f' {one.value:.2f}  {name}', va='center', fontsize=8)
    axes.axvline(1.0, color='black', linewidth=0.8, linestyle=':')
    axes.set_xlim(0.0, 2.0 * max(one.high for one in ratios))
    axes.set_yticks([])
    axes.set_xlabel('time of one evaluation\nwith each alone,\n'
                    f'over {seconds(study.bare)} without any\n'
                    '(lines: 95 % range of the median)')
    for side in ('top', 'right', 'left'):
        axes.spines[side].set_visible(False)


def _most_changed(study, quantity):
    """Return the column of a quantity that the effects change most."""
    whole = getattr(study.run, quantity)
    if whole.shape[1] == 0:
        return 0
    change = sum(np.abs(getattr(f.run, quantity) - whole).max(axis=0) for f in _made(study))
    return int(np.argmax(change))


def _made(study):
    """Return the findings whose runs were made."""
    return [finding for finding in study.findings if finding.run is not None]


def _moved(study, run):
    """Return how far a run is from the scene as it is, shape (n, nv)."""
    return changes_of_position(study.simulation.coordinates, run, study.run)


def work(study, contact):
    """Draw force, path and work of a machine that works on a contact."""
    with of_an_extra():
        import matplotlib.figure
    run, simulation = study.run, study.simulation
    effect = simulation.scene.effects[contact]
    joint = simulation.joint_names.index((simulation.actuated_joints or ['-'])[0])
    turn, angle = _last_turn(run, joint)
    figure = matplotlib.figure.Figure((10.0, 8.5), layout='constrained')
    figure.suptitle(f'{simulation.scene.name}: one turn of {simulation.joint_names[joint]}')
    top, middle, bottom = figure.subplots(3, 1)
    top.plot(angle, run.effort[turn, joint], color=COLORS[0], label='drive, as it is')
    free = next(f.run for f in study.findings if contact in f.names)
    if free is not None:
        other, other_angle = _last_turn(free, joint)
        top.plot(other_angle, free.effort[other, joint], color='#777777', linestyle='--',
                 label=f'without {contact}')
    top.set_ylabel('torque of the drive [N m]')
    forces = run.readings[contact]
    touching = forces['depth'][turn] > 0.0
    top.fill_between(angle, 0, 1, where=touching, color='#B8A200', alpha=0.15, linewidth=0,
                     transform=top.get_xaxis_transform(), label=f'{effect.point} in contact')
    rows = np.sort(turn)
    along = run.points[effect.point][rows] @ direction(effect.angle)
    hidden = np.where(forces['depth'][rows] > 0.0, 1.0, np.nan)
    for k, key in enumerate(('normal_force', 'friction_force', 'scraping_force')):
        middle.plot(along, hidden * forces[key][rows], color=COLORS[k],
                    label=key.replace('_', ' '))
    middle.set_ylabel('force on the point [N]')
    middle.set_xlabel(f'place of {effect.point} along {contact} [m]')
    for k, cut in enumerate(simulation.mechanism.cut_joints):
        bottom.plot(angle, run.force[turn, k], color=COLORS[k % 7], label=cut.name)
    bottom.set_ylabel('force at the cut joints [N]')
    for axes in (top, bottom):
        axes.set_xlim(0.0, 360.0)
        axes.set_xticks(range(0, 361, 45))
        axes.set_xlabel(f'{simulation.joint_names[joint]} [degrees]')
    for axes in (top, middle, bottom):
        axes.grid(alpha=0.3)
        axes.legend(loc='upper left', bbox_to_anchor=(1.0, 1.0), frameon=False)
    return figure


def _last_turn(run, joint):
    """Return the rows of the last turn of a joint, sorted by its angle, and these in degrees."""
    angle = run.position[:, joint]
    rows = np.flatnonzero(np.abs(angle - angle[-1]) < 2.0 * np.pi * 1.01)
    degrees = np.degrees(angle[rows] % (2.0 * np.pi))
    order = np.argsort(degrees)
    return rows[order], degrees[order]
