# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The key figures of a driven mechanism as one page of HTML, which needs no other file."""

from base64 import b64encode
from html import escape
from io import BytesIO
import math

import numpy as np
from scipy.integrate import trapezoid

from . import design
from .kinematics import by_name, curves, drive_axis, forces, torques
from .transmission import transmission_angle
from ..mechanism.four_bar import four_bar
from ..visual.trajectory import from_rows

STYLE = """
body {font: 15px/1.45 sans-serif; max-width: 62em; margin: 2em auto; padding: 0 1em; color: #222}
h1 {font-size: 1.5em} h2 {font-size: 1.15em; margin-top: 1.8em; border-bottom: 1px solid #ccc}
table {border-collapse: collapse; margin: .6em 0}
th, td {text-align: left; padding: .15em 1.2em .15em 0; vertical-align: top}
th {font-weight: normal; color: #555; border-bottom: 1px solid #ddd}
td.number {font-variant-numeric: tabular-nums} p.note {color: #555}
img {display: block; max-width: 100%}
@media print {
  body {margin: 0; font-size: 10pt}
  h2 {break-after: avoid} img, table {break-inside: avoid} img {max-height: 16cm}
}
"""
# Lengths in one table of sensitivities.
WIDEST = 4
# Sections that are summarised in a few lines, too.
IN_SHORT = ('Mechanism', 'Transmission angle', 'Drive', 'Energy')


def write_report(path, scene, run, table, tolerance=1e-4, changes=None, spent=None):
    """
    Write a page of what a designer asks of a mechanism; return it in a few lines of text.

    Parameters
    ----------
    path : pathlib.Path
        Of the page, ``*.html``.
    scene : scene_records.Scene
        Whose start is on the branch.
    run : kinematics.DrivenRun
        Of the scene, with three poses or more.
    table : tuple
        What ``run.table()`` returned.
    tolerance : float
        Of every length, plus or minus; three standard deviations [m].
    changes : mapping of str to float, optional
        Numbers by key path in which the scene is another one than its name says, for the title.
    spent : float, optional
        CPU time of the run [s].

    Returns
    -------
    str

    Raises
    ------
    OSError
        Where the page cannot be written.

    """
    sections = _sections(scene, run, table, tolerance, spent)
    title = scene.name
    if changes:
        title += ' with ' + ', '.join(f'{key} = {value:g}' for key, value in changes.items())
    path.write_text(_page(escape(title), scene, sections), encoding='utf-8')
    return '\n'.join(
        '  '.join([f'{title}:', *(f'{name} {cell}'.strip() for name, cell in zip(rows[0], row))])
        for title, rows, _ in sections if title in IN_SHORT for row in rows[1:])


def _sections(scene, run, table, tolerance, spent):
    """Return title, rows of a table with its header, and pictures or notes, of each section."""
    column = by_name(table)
    name, values = design.drive_values(run)
    at = _drive_shown(run)
    found = [_mechanism(scene, run, table, at)]
    found.append(('Motion', [
        ('', 'minimum', 'at', 'maximum', 'at', 'stroke', 'dwell', 'time ratio'),
        *((what, f'{one.least.value:.6g}', at(one.least.drive), f'{one.most.value:.6g}',
           at(one.most.drive), f'{one.most.value - one.least.value:.6g}', at(one.dwell),
           '-' if math.isnan(one.time_ratio) else f'{one.time_ratio:.4g}')
          for what, one in design.outputs(run, table).items())],
        [f'<p class="note">Joints [rad or m] and points [m] over {escape(name)}. Dwell: the '
         'longest part of the drive over which a quantity stays within '
         f'{design.DWELL:.0%} of its stroke. Time ratio: of the slower stroke to the quicker '
         'one over a whole turn.</p>']))
    angle = transmission_angle(run.mechanism, run.position, name)
    if angle is not None:
        found.append(('Transmission angle', [
            ('', 'angle [deg]', 'at'),
            *((what, f'{math.degrees(one.value):.4f}', at(one.drive)) for what, one in (
                ('minimum', design.extreme(angle, values, np.argmin)),
                ('maximum', design.extreme(angle, values))))], []))
    found += _loads(run, column, values, at)
    found.append(_tolerances(scene, run, tolerance))
    found.append(('Accuracy', [
        ('', ''), ('largest closure error', f'{column["closure"].max():.2g} m or rad'),
        *([] if spent is None else [
            ('CPU time', f'{spent:.3g} s for {len(run.time)} poses')])], [
        '<p class="note">Positions, rates and accelerations solve the closure equations to '
        'rounding: nothing is integrated.</p>']))
    return found


def _mechanism(scene, run, table, at):
    name, _ = design.drive_values(run)
    joint = name if name in scene.mechanism.coordinates.names else None
    freedoms = str(design.degrees_of_freedom(scene, run.position[0]))
    if run.idle:
        freedoms += f' ({run.idle} idle: rods that turn about themselves)'
    drives = ', '.join(f'{one} from {at(each[0]) if one == name else f"{each[0]:.6g}"} to '
                       f'{at(each[-1]) if one == name else f"{each[-1]:.6g}"}'
                       for one, each in run.driven.items())
    rows = [('', ''), ('degrees of freedom', freedoms),
            ('drive', f'{drives} in {run.time[-1]:.6g} s, {len(run.time)} poses')]
    bars = joint and four_bar(scene.mechanism, joint)
    if bars:
        base, crank, coupler, rocker = bars.lengths
        rows += [('lengths', f'base {base:.6g} m, input {crank:.6g} m, coupler {coupler:.6g} m, '
                             f'output {rocker:.6g} m'),
                 ('four-bar linkage', f'{bars.kind} ({bars.grashof})'),
                 ('limit positions', ', '.join(
                     f'+-{math.degrees(one):.6g} deg between input link and base'
                     for one in bars.limits) or 'none: the input turns round')]
    rows += [(f'end stop {what}', f'{one} goes beyond it by at most {most.value:.6g} at '
                                  f'{at(most.drive)}')
             for (what, one), most in design.stops_met(run, table).items()]
    if run.end is not None:
        rows.append(('end of the branch', run.end.reason))
    return 'Mechanism', rows, _pictures(run, table)


def _loads(run, column, values, at):
    exerted, power = torques(run, column), 0.0
    rows = [('', 'largest', 'at', 'rms', 'largest power [W]', 'at')]
    for what, torque in exerted.items():
        rate = column[f'velocity.{what}'] if f'velocity.{what}' in column else (
            np.ptp(run.driven[what]) / run.time[-1] * np.sign(
                run.driven[what][-1] - run.driven[what][0]) * np.ones_like(torque))
        power = power + torque * rate
        largest = design.extreme(torque, values, lambda one: np.argmax(np.abs(one)))
        fastest = design.extreme(torque * rate, values, lambda one: np.argmax(np.abs(one)))
        unit = design.effort_unit(run, what)
        rows.append((what, f'{largest.value:z.6g} {unit}', at(largest.drive),
                     f'{_rms(torque, run.time):.6g} {unit}', f'{fastest.value:z.6g}',
                     at(fastest.drive)))
    yield 'Drive', rows, []
    if exerted:
        yield 'Energy', [
            ('', '[J]'), ('work of the drives', f'{trapezoid(power, run.time):z.6g}'),
            ('supplied by the drives', f'{trapezoid(np.maximum(power, 0.0), run.time):z.6g}'),
            ('absorbed by the drives',
             f'{trapezoid(np.maximum(-power, 0.0), run.time):z.6g}')], []
    yield 'Forces in the joints', [('', 'largest [N]', 'at'), *(
        (what, f'{one.value:.6g}', at(one.drive)) for what, one in (
            (what, design.extreme(force, values)) for what, force in forces(column).items()))], []
    force, moment = design.shaking(run)
    size = np.linalg.norm(force, axis=1)
    rows = [('', 'largest', 'at', 'rms')]
    for what, each in (('force [N]', size),
                       ('moment about the origin [N m]', design.signed_or_size(moment))):
        one = design.extreme(each, values, lambda one: np.argmax(np.abs(one)))
        rows.append((what, f'{one.value:z.6g}', at(one.drive), f'{_rms(each, run.time):.6g}'))
    yield 'Shaking force and moment', rows, [
        '<p class="note">Force and moment of the bodies\' inertia on the ground, without weights '
        'and other forces.</p>']


def _tolerances(scene, run, tolerance):
    title = 'Sensitivity and tolerances'
    keys = design.length_keys(scene)
    try:
        if any(name not in scene.mechanism.coordinates.names for name in run.driven):
            raise ValueError('points are driven')
        found = design.sensitivity(scene, run, keys)
    except ValueError as error:
        return title, [('', '')], [f'<p class="note">Not computed: {escape(str(error))}.</p>']
    most = np.abs(found.derivatives).max(axis=0)
    shown = [k for k in range(len(keys)) if most[:, k].max() > 0.0]
    # Of many lengths, several tables below one another: a page is only so wide.
    tables = [_table([
        ('', *(keys[k].removeprefix('parameters.').removeprefix('mechanism.') for k in some)),
        *((what, *(f'{row[k]:.3g}' for k in some)) for what, row in zip(found.outputs, most))])
        for some in (shown[first:first + WIDEST] for first in range(0, len(shown), WIDEST))]
    return title, [('', '1 sigma', 'worst case'), *(
        (what, f'{sigma:.3g}', f'{worst:.3g}') for what, sigma, worst in zip(
            found.outputs, found.sigma(tolerance),
            found.worst(tolerance)))], [
        '<p class="note">Largest error over the drive [rad, m] where every length is off by '
        f'{tolerance:g} m: all at their worst, and one standard deviation where that '
        'is three of each. Below, the largest change over the drive with each length '
        '[rad/m, m/m].</p>', *tables]


def _rms(values, times):
    return math.sqrt(trapezoid(values ** 2, times) / (times[-1] - times[0]))


def _drive_shown(run):
    """Return the function that writes a drive's value, in degrees where it turns."""
    _, label = drive_axis(run)
    if label.endswith('[deg]'):
        return lambda value: f'{math.degrees(value):.6g} deg'
    return lambda value: f'{value:.6g} m'


def _pictures(run, table):
    # Only here, as it takes long to load.
    from ..visual import pictures
    values, label = drive_axis(run)
    title = run.scene.name
    shown = {quantity: {name: (values, each) for name, each in lines.items()}
             for quantity, lines in curves(run, table).items()}
    return [_image(pictures.positions(from_rows(run.mechanism, *table), title), 'positions'),
            _image(pictures.over_drive(shown, label, f'{title}: over the drive'), 'curves')]


def _image(figure, name):
    file = BytesIO()
    figure.savefig(file, format='png')
    return (f'<img alt="{name}" src="data:image/png;base64,'
            f'{b64encode(file.getvalue()).decode("ascii")}">')


def _page(title, scene, sections):
    """Return the page, which needs no other file."""
    parts = [f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}'
             f'</title><style>{STYLE}</style></head><body>\n<h1>{title}</h1>',
             f'<p>{escape(scene.mechanism.description or "")}</p>']
    for name, (header, *rows), more in sections:
        parts.append(f'<h2>{escape(name)}</h2>')
        parts += [_table([header, *rows])] * bool(rows) + more
    return '\n'.join([*parts, '</body></html>\n'])


def _table(rows):
    """Return a table of HTML, its header the first row unless that is empty."""
    header, *rows = rows
    cells = ['<tr>' + ''.join(f'<th>{escape(cell)}</th>' for cell in header) + '</tr>'
             if any(header) else '']
    cells += ['<tr>' + ''.join(f'<td class="number">{escape(cell)}</td>' for cell in row)
              + '</tr>' for row in rows]
    return f'<table>{"".join(cells)}</table>'
