# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""The key figures of a driven mechanism as one page of HTML, which needs no other file."""

from base64 import b64encode
from html import escape
from importlib.util import find_spec
from io import BytesIO
import math
import re

import numpy as np

from . import design
from .cycle import advantages, load_spectrum, opened, transmission_extremes
from .quantities import (
    by_name, coordinate, curves, force_parts, forces, moved, Quantity, torques)
from .transmission import transmission_angle
from ..mechanism.coordinates import unit_of
from ..mechanism.extras import remedy
from ..mechanism.fields import among
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
# Lengths in one table of sensitivities; ranges of a load spectrum that are shown.
WIDEST, RANGES = 4, 3
# Share of the largest work below which work is rounding.
ROUNDING = 1e-12
# Width and height of a page of a PDF within its margins [pt].
PAPER = 530.0, 720.0
# Sections that are summarised in a few lines, too.
IN_SHORT = ('Mechanism', 'Transmission angle', 'Drive', 'Energy')


def write_report(path, scene, run, table, tolerances=None, changes=None, spent=None):
    """
    Write a page of what a designer asks of a mechanism; return it in a few lines of text.

    Parameters
    ----------
    path : pathlib.Path
        Of the page, ``*.html``, or of a document of the same, ``*.pdf``, which needs fpdf2.
    scene : scene_records.Scene
        Whose start is on the branch.
    run : kinematics.DrivenRun
        Of the scene, with three poses or more.
    table : tuple
        What ``run.table()`` returned.
    tolerances : mapping of str to float, optional
        Plus or minus, three standard deviations: by kind of ``design.KINDS``, or by parameter;
        others are those of ``design.TOLERANCES``.
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
    ValueError
        For tolerances of nothing that the scene has, and a document without fpdf2.

    """
    if path.suffix == '.pdf' and find_spec('fpdf') is None:
        raise ValueError(f'output: a PDF needs {remedy("fpdf")}; a page of HTML does not')
    sections = _sections(scene, run, table, _tolerated(scene, tolerances or {}), spent)
    title = scene.name
    if changes:
        title += ' with ' + ', '.join(f'{key} = {value:g}' for key, value in changes.items())
    page = _page(escape(title), scene, sections)
    if path.suffix == '.pdf':
        _write_document(path, page)
    else:
        path.write_text(page, encoding='utf-8')
    return '\n'.join(
        '  '.join([f'{title}:', *(f'{name} {cell}'.strip() for name, cell in zip(rows[0], row))])
        for title, rows, _ in sections if title in IN_SHORT for row in rows[1:])


def _tolerated(scene, given):
    """Return kind and tolerance by key path of what has one."""
    keys = design.tolerated_keys(scene)
    names = {key.removeprefix('parameters.'): key for key in keys}
    for what in given:
        if what not in (*design.KINDS, *names):
            raise ValueError(f'tolerance: expected one of {among([*design.KINDS, *names])}, '
                             f'got {what!r}')
    return {key: (kind, given.get(name, given.get(kind, design.TOLERANCES[kind].values)))
            for name, key in names.items() for kind in [keys[key]]}


def _write_document(path, page):
    """Write a page as a PDF."""
    # Only here, as it takes long to load.
    from fpdf import FPDF
    document = FPDF(format='A4')
    document.set_font('Helvetica', size=9)
    document.add_page()
    page = page.partition('<body>')[2].partition('</body>')[0]
    # As wide as the paper, unless they are too high for it.
    page = re.sub(r'data-ratio="(.*?)"', lambda found: 'width="{:.0f}"'.format(
        min(PAPER[0], PAPER[1] / float(found[1]))), page)
    document.write_html(page, table_line_separators=True)
    document.output(path)


def _sections(scene, run, table, tolerances, spent):
    """Return title, rows of a table with its header, and pictures or notes, of each section."""
    column, name, at = by_name(table), run.drive.name, run.drive.text
    found = [_mechanism(scene, run, table, at)]
    found.append(('Motion', [
        ('', 'minimum', 'at', 'maximum', 'at', 'stroke', 'dwell', 'time ratio'),
        *((what, shown(one.least.value), at(one.least.drive), shown(one.most.value),
           at(one.most.drive), shown(one.most.value - one.least.value), at(one.dwell),
           '-' if math.isnan(one.time_ratio) else f'{one.time_ratio:.4g}')
          for what, one in design.outputs(run, table).items()
          for shown in [coordinate(run.mechanism, what).text])],
        [f'<p class="note">Joints and points over {escape(name)}. Dwell: the '
         'longest part of the drive over which a quantity stays within '
         f'{design.DWELL:.0%} of its stroke. Time ratio: of the slower stroke to the quicker '
         'one over a whole turn.</p>', _timing(run, column)]))
    found += _transmission(run, at)
    found += _loads(run, column, at)
    found.append(_tolerances(tolerances, scene, run))
    found.append(('Accuracy', [
        ('', ''), ('largest closure error', f'{column["closure"].max():.2g} m or rad'),
        *([] if spent is None else [
            ('CPU time', f'{spent:.3g} s for {len(run.time)} poses')])], [
        '<p class="note">Positions, rates and accelerations solve the closure equations to '
        'rounding: nothing is integrated.</p>']))
    return found


def _mechanism(scene, run, table, at):
    name = run.drive.name
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
    away = opened(run)
    if away:
        rows.append(('cycle', 'none: after a turn of its drive the linkage does not return ('
                     + ', '.join(f'{what} by {coordinate(run.mechanism, what).text(value)}'
                                 for what, value in away.items())
                     + '); work, strokes and time ratios are those of one turn'))
    return 'Mechanism', rows, _pictures(run, table)


def _transmission(run, at):
    angles = transmission_extremes(run)
    names = 'least', *['other extreme'] * len(angles)
    yield 'Transmission angle', [('', 'angle', 'at'), *(
        (what, f'{math.degrees(one.value):.4f} deg', at(one.drive))
        for what, one in zip(names, angles))], [] if angles else [
        '<p class="note">None: no coupler between pins, and no slot, leads from the driven link '
        'to one that turns or slides on the ground.</p>']
    gains = advantages(run)
    if gains:
        yield 'Mechanical advantage', [
            ('', 'least', 'at', 'dead centres: infinite at'),
            *((what, f'{one.least.value:.5g}{_per(run, what)}', at(one.least.drive),
               ', '.join(map(at, one.dead_centres)) or 'none') for what, one in gains.items())], [
            '<p class="note">Effort of the output per effort of the drive, without friction and '
            'inertia.</p>']


def _per(run, output):
    """Return the unit of the advantage of an output."""
    units = [unit_of(run.mechanism, 'effort', name)
             for name in (output, run.drive.name)]
    return '' if units[0] == units[1] else f' {units[0]} per {units[1]}'


def _loads(run, column, at):
    from scipy.integrate import trapezoid
    exerted, power = torques(run, column), 0.0
    rows = [('', 'largest', 'at', 'rms', 'largest power [W]', 'at')]
    for what, torque in exerted.items():
        rate = column[f'velocity.{what}'] if f'velocity.{what}' in column else (
            np.ptp(run.driven[what]) / run.time[-1] * np.sign(
                run.driven[what][-1] - run.driven[what][0]) * np.ones_like(torque.values))
        own = Quantity(what, 'W', torque.values * rate)
        power = power + own.values
        largest, fastest = torque.largest(run.drive), own.largest(run.drive)
        rows.append((what, f'{largest.value:z.6g} {torque.unit}', at(largest.drive),
                     f'{_rms(torque, run.time):.6g} {torque.unit}', f'{fastest.value:z.6g}',
                     at(fastest.drive)))
    yield 'Drive', rows, []
    if exerted:
        works = {f'{what} the drives': trapezoid(part, run.time) for what, part in (
            ('work of', power), ('supplied by', np.maximum(power, 0.0)),
            ('absorbed by', np.maximum(-power, 0.0)))}
        most = max(map(abs, works.values()))
        yield 'Energy', [
            ('', '[J]'), *((what, f'{work if abs(work) > ROUNDING * most else 0.0:z.6g}')
                           for what, work in works.items())], []
    yield 'Forces in the joints', [
        ('', 'largest [N]', 'at', 'load spectrum: ranges [N] x cycles'), *(
            (what, f'{one.value:.6g}', at(one.drive), _spectrum(force.values))
            for what, force in forces(column).items() for one in [force.extreme(run.drive)])], [
        '<p class="note">Load spectrum: ranges of the magnitude over the drive by rainflow '
        f'counting (ASTM E1049), the {RANGES} largest.</p>', _hodographs(run, column)]
    rows = [('', 'largest', 'at', 'rms')]
    for each in design.shaking_sizes(run):
        one = each.largest(run.drive)
        rows.append((each.label, f'{one.value:z.6g}', at(one.drive),
                     f'{_rms(each, run.time):.6g}'))
    yield 'Shaking force and moment', rows, [
        '<p class="note">Force and moment of the bodies\' inertia on the ground, without weights '
        'and other forces.</p>']


def _spectrum(force):
    """Return the largest ranges of a force with their numbers of cycles."""
    if find_spec('rainflow') is None:
        return f'needs {remedy("rainflow")}'
    return ', '.join(f'{size:.4g} x {count:g}' for size, _, count in load_spectrum(force)[:RANGES]
                     if size > 1e-9 * force.max())


def _tolerances(tolerances, scene, run):
    title = 'Sensitivity and tolerances'
    keys = tuple(tolerances)
    sizes = np.array([size for _, size in tolerances.values()])
    try:
        if any(name not in scene.mechanism.coordinates.names for name in run.driven):
            raise ValueError('points are driven')
        found = design.sensitivity(scene, run, keys)
    except ValueError as error:
        return title, [('', '')], [f'<p class="note">Not computed: {escape(str(error))}.</p>']
    # Angles as a designer reads them.
    ones = [coordinate(run.mechanism, what, 1.0).shown for what in found.outputs]
    turned, units = np.array([one.values for one in ones]), [one.unit for one in ones]
    most = np.abs(found.derivatives).max(axis=0) * turned[:, np.newaxis]
    shown = [k for k in range(len(keys)) if most[:, k].max() > 0.0]
    # Many lengths take several tables below one another, as a page is narrow.
    tables = [_table([
        ('', *(keys[k].removeprefix('parameters.').removeprefix('mechanism.') for k in some)),
        *((what, *(f'{row[k]:.3g}' for k in some)) for what, row in zip(found.outputs, most))])
        for some in (shown[first:first + WIDEST] for first in range(0, len(shown), WIDEST))]
    used = {}
    for key, (kind, size) in tolerances.items():
        used.setdefault((kind, size), []).append(
            key.removeprefix('parameters.').removeprefix('mechanism.'))
    limits = '; '.join(
        f'{escape(", ".join(names) if scene.parameters else "places of joints")} ({kind}) '
        f'{size:g} {design.TOLERANCES[kind].unit}' for (kind, size), names in used.items())
    return title, [('', '1 sigma', 'worst case'), *(
        (what, f'{sigma:.3g} {unit}', f'{worst:.3g} {unit}') for what, sigma, worst, unit in zip(
            found.outputs, found.sigma(sizes) * turned, found.worst(sizes) * turned, units))], [
        f'<p class="note">Largest error over the drive with tolerances, plus or minus: {limits}. '
        'All at their worst, and one standard deviation where a tolerance is three. Below, the '
        'largest change over the drive with each number [deg or m per its unit].</p>', *tables]


def _rms(one, times):
    from scipy.integrate import trapezoid
    return math.sqrt(trapezoid(one.values ** 2, times) / (times[-1] - times[0]))


def _timing(run, column):
    """Return a timing chart: each output between its ends over the drive."""
    from ..visual import pictures
    drive, lines = run.drive.shown, [one.shown for one in moved(run, column).values()]
    return _image(pictures.timing_chart(
        {one.label: (drive.values, one.values) for one in lines if np.ptp(one.values) > 0.0},
        drive.label, f'{run.scene.name}: timing'), 'timing chart')


def _hodographs(run, column):
    """Return the curves of the forces in all joints, in the plane x over y."""
    from ..visual import pictures
    return _image(pictures.hodographs(
        force_parts(column), f'{run.scene.name}: hodographs of the forces'), 'hodographs')


def _pictures(run, table):
    # Only here, as it takes long to load.
    from ..visual import pictures
    drive, title = run.drive.shown, run.scene.name
    shown = {quantity: {name: (drive.values, each) for name, each in lines.items()}
             for quantity, lines in curves(run, table).items()}
    angle = transmission_angle(run.mechanism, run.position, run.drive.name)
    if angle is not None:
        shown['transmission angle [deg]'] = {'least of all': (drive.values, np.degrees(angle))}
    return [_image(pictures.positions(from_rows(run.mechanism, *table), title), 'positions'),
            _image(pictures.over_drive(shown, drive.label, f'{title}: over the drive'), 'curves')]


def _image(figure, name):
    file = BytesIO()
    figure.savefig(file, format='png')
    width, height = figure.get_size_inches()
    return (f'<img data-ratio="{height / width:.3f}" alt="{name}" src="data:image/png;base64,'
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
