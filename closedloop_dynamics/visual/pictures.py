# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures of a motion: joints, constraint forces, the mechanism in several positions."""

import numpy as np

from .appearance import COLORS, DASHES, DOTS_PER_INCH
from .drawing import all_places, MechanismArtist
from .trajectory import magnitudes
from .views import FRONT, perspective, PLANE, SIDE, TOP
from ..mechanism.coordinates import QUANTITIES
from ..mechanism.extras import of_an_extra
from ..mechanism.kinematics import body_poses
from ..mechanism.mechanism import CUT_WITHOUT_MOMENT, REVOLUTE
from ..mechanism.rotations import direction

with of_an_extra():
    import matplotlib.figure
    from matplotlib.lines import Line2D
    from matplotlib.ticker import SymmetricalLogLocator

WANTED = {'color': '#D55E00', 'linewidth': 1.1, 'linestyle': (0, (4, 3))}
TURN = 2.0 * np.pi
# Poses looked at when positions to draw are chosen.
POSE_CANDIDATES = 400
# Positions in one picture.
MOST = 5
# In space: positions in one picture, and its width and the height of its views [inch].
MOST_IN_SPACE, SPATIAL_WIDTH, SPATIAL_HEIGHT = 3, 10.0, 8.5


def joint_motion(motion, title, wanted=None):
    """
    Draw positions, velocities and the efforts of the driven joints over time, a row a joint.

    Orientations are drawn as the components of their quaternions. ``wanted``: positions and
    velocities that the joints were to have, shape (n, nv), NaN where nothing was wanted; or None.
    """
    groups = motion.mechanism.coordinates.groups
    wanted_position, wanted_velocity = wanted or (None, None)
    columns = [('position', motion.position, wanted_position),
               ('velocity', motion.velocity, wanted_velocity)]
    if any(group.joint.actuated for group in groups):
        columns.append(('effort', motion.effort, None))
    figure = matplotlib.figure.Figure(
        figsize=(10.0, 1.4 + 1.15 * len(groups)), layout='constrained', dpi=DOTS_PER_INCH)
    panels = figure.subplots(len(groups), len(columns), sharex=True, squeeze=False)
    figure.suptitle(title, fontweight='bold', x=0.02, ha='left')
    for group, row in zip(groups, panels):
        for axes, (quantity, values, goals) in zip(row, columns):
            if quantity == 'effort' and not group.joint.actuated:
                axes.axis('off')
                continue
            places = group.coordinates if quantity == 'position' else group.rates
            turning = (quantity == 'position' and group.joint.type == REVOLUTE
                       and np.ptp(values[:, places]) > TURN)
            shown = _wrapped if turning else np.asarray
            for place, color in zip(places, COLORS):
                axes.plot(motion.time, shown(values[:, place]), color=color, linewidth=1.3)
            # Nothing is wanted of turns in space.
            for rate in group.rates if goals is not None and not group.turned else ():
                if np.isfinite(goals[:, rate]).any():
                    axes.plot(motion.time, shown(goals[:, rate]), label='wanted', **WANTED)
            name = f'{group.name}\n' if quantity == 'position' else ''
            unit = ('x, y, z, w' if group.turned and quantity == 'position'
                    else QUANTITIES[quantity][int(group.length)])
            axes.set_ylabel(f'{name}[{unit}]', fontsize=9)
            if turning:
                axes.set_title('within a turn', fontsize=8, color='0.35', loc='right', pad=2)
            _plain(axes)
    for axes, (quantity, *_) in zip(panels[0], columns):
        axes.set_title(quantity, fontsize=10, loc='left')
    for column in panels.T:
        lowest = [axes for axes in column if axes.axison][-1]
        lowest.set_xlabel('time [s]')
        lowest.tick_params(labelbottom=True)
    figure.align_ylabels()
    if wanted is not None:
        figure.legend(handles=[Line2D([], [], label='wanted', **WANTED)],
                      loc='outside lower right', frameon=False, fontsize=9)
    return figure


def constraint_forces(motion, title):
    """Draw the constraint force of every cut joint over time."""
    if not motion.mechanism.planar:
        return _spatial_forces(motion, title)
    cuts = motion.mechanism.cut_joints
    torques = [k for k, cut in enumerate(cuts)
               if cut.type not in (REVOLUTE, *CUT_WITHOUT_MOMENT)]
    figure, rows = _panels(len(cuts) + bool(torques), title)
    rows = rows[:, 0]
    for k, (axes, cut) in enumerate(zip(rows, cuts)):
        _, x, y = motion.forces[:, k].T
        axes.plot(motion.time, x, label='x', **_style(0))
        axes.plot(motion.time, y, label='y', **_style(1))
        axes.plot(motion.time, np.hypot(x, y), label='magnitude', color='0.35', linestyle='--',
                  linewidth=1.1)
        axes.set_ylabel(f'{cut.name} [N]')
        axes.set_title(f'on {cut.body_a}, by {cut.body_b}', fontsize=9, color='0.35', loc='right')
        _legend_beside(axes)
    for k in torques:
        rows[-1].plot(motion.time, motion.forces[:, k, 0], label=cuts[k].name, **_style(k))
    if torques:
        rows[-1].set_ylabel('torque [N m]')
        _legend_beside(rows[-1])
    return figure


def _spatial_forces(motion, title):
    """Draw force and, where there is one, moment of every cut joint in space over time."""
    cuts = motion.mechanism.cut_joints
    moments = [cut.type not in CUT_WITHOUT_MOMENT for cut in cuts]
    figure, rows = _panels(len(cuts), title, 1 + any(moments))
    for k, (row, cut) in enumerate(zip(rows, cuts)):
        halves = motion.forces[:, k, 3:], motion.forces[:, k, :3]
        for axes, values, unit, shown in zip(row, halves, ('[N]', 'moment [N m]'),
                                             (True, moments[k])):
            if not shown:
                axes.axis('off')
                continue
            for n, component in enumerate(values.T):
                axes.plot(motion.time, component, label='xyz'[n], **_style(n))
            axes.plot(motion.time, np.linalg.norm(values, axis=1), label='magnitude',
                      color='0.35', linestyle='--', linewidth=1.1)
            axes.set_ylabel(unit)
        row[0].set_ylabel(f'{cut.name} [N]')
        row[0].set_title(
            f'on {cut.body_a}, by {cut.body_b}', fontsize=9, color='0.35', loc='right')
        _legend_beside(row[-1] if moments[k] else row[0])
    return figure


def positions(motion, title):
    """Draw the mechanism in some positions, its first point's path and the constraint forces."""
    mechanism = motion.mechanism
    poses = body_poses(mechanism, motion.position)
    point = mechanism.points[0].name if mechanism.points else None
    views = [PLANE] if mechanism.planar else [
        FRONT, SIDE, TOP, perspective(all_places(mechanism, poses))]
    figure = matplotlib.figure.Figure(layout='constrained', dpi=DOTS_PER_INCH)
    panels = figure.subplots(*((1, 1) if mechanism.planar else (2, 2)), squeeze=False).flat
    chosen = spread_positions(poses, MOST if mechanism.planar else MOST_IN_SPACE)
    last = chosen[-1]
    forces = motion.forces[last]
    # Forces that were not recorded are NaN.
    known = bool(np.isfinite(forces).all())
    largest = magnitudes(forces).max(initial=0.0) if known else 0.0
    for axes, view in zip(panels, views):
        artist = MechanismArtist(axes, mechanism, poses, view)
        if view.name:
            axes.set_title(view.name, fontsize=10, loc='left')
        artist.ground()
        for rank, index in enumerate(chosen, 1):
            artist.bodies(index, (rank / len(chosen)) ** 1.5)
        if point is not None:
            artist.mark(artist.path(point)[last])
        if known:
            artist.forces(last, forces, largest)
        if view is views[-1]:
            artist.cut_names(last, np.nan_to_num(forces))
    times = ', '.join(f'{motion.time[index]:.2f}' for index in chosen)
    figure.suptitle(title, fontweight='bold', x=0.02, ha='left')
    force = (f'force on body A at {motion.time[last]:.2f} s: up to {largest:.3g} N\n'
             f'(in the whole run up to {_largest_force(motion):.3g} N)') if largest else None
    figure.legend(handles=artist.legend_handles(point, force), loc='outside lower center',
                  ncols=3, fontsize=9, frameon=False, title_fontsize=9,
                  title=f'positions at {times} s, pale to strong')
    if mechanism.planar:
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        height = np.clip(7.0 * (high - low) / (right - left), 3.0, 8.5)
    else:
        height = SPATIAL_HEIGHT
    figure.set_size_inches(8.0 if mechanism.planar else SPATIAL_WIDTH, height + 1.5)
    return figure


def shapes(mechanism, deflections, title):
    """
    Draw shapes of motion, each in a panel: one position strong, others pale behind it.

    ``deflections``, by the titles of the panels, shape (n, nq); the first position of each is
    strong.
    """
    columns = min(len(deflections), 3)
    rows = -(-len(deflections) // columns)
    figure = matplotlib.figure.Figure(
        figsize=(1.0 + 4.0 * columns, 1.4 + 3.6 * rows), layout='constrained',
        dpi=DOTS_PER_INCH)
    panels = figure.subplots(rows, columns, squeeze=False).flat
    poses = {name: body_poses(mechanism, each) for name, each in deflections.items()}
    everything = np.concatenate(list(poses.values()))
    view = PLANE if mechanism.planar else perspective(all_places(mechanism, everything))
    for name, each in poses.items():
        axes = next(panels)
        # All to one scale.
        artist = MechanismArtist(axes, mechanism, np.concatenate((each, everything)), view)
        axes.set_title(name, fontsize=10, loc='left')
        artist.ground()
        for index in range(1, len(each)):
            artist.bodies(index, 0.25)
        artist.bodies(0)
    for axes in panels:
        axes.axis('off')
    figure.suptitle(title, fontweight='bold', x=0.02, ha='left')
    figure.legend(handles=artist.legend_handles(), loc='outside lower center', ncols=3,
                  fontsize=9, frameon=False)
    return figure


def _largest_force(motion):
    """Return the largest constraint force, unknown ones apart [N]."""
    return np.nanmax(magnitudes(motion.forces))


def deviations(result, title):
    """Draw how far recorded states are from those simulated again, over time."""
    motion = result.recorded
    forces = result.deviation('forces')
    groups = motion.mechanism.coordinates.groups
    panels = [(f'{quantity} [{unit}]', np.stack([
        np.abs(result.deviation(quantity)[:, getattr(group, places)]).max(axis=1)
        for group in groups], axis=1), [group.name for group in groups])
              for quantity, places, unit in (('position', 'coordinates', 'rad, m'),
                                             ('velocity', 'rates', 'rad/s, m/s'))]
    if motion.mechanism.cut_joints:
        panels.append(('force [N]', magnitudes(forces),
                       [cut.name for cut in motion.mechanism.cut_joints]))
    figure, rows = _panels(len(panels), title)
    for axes, (label, values, names) in zip(rows[:, 0], panels):
        for k, name in enumerate(names):
            axes.plot(motion.time, values[:, k], label=name, **_style(k))
        # Zero and rounding side by side with visible values.
        largest = np.nanmax(values, initial=0.0)
        axes.set_yscale('symlog', linthresh=1e-15)
        axes.yaxis.set_major_locator(SymmetricalLogLocator(base=1e3, linthresh=1e-15))
        axes.set_ylim(0.0, max(10.0 * largest, 1e-14))
        axes.set_ylabel(label)
        _legend_beside(axes)
    return figure


def over_drive(curves, label, title, common=()):
    """
    Draw curves over the drive, a panel a quantity.

    ``curves``, by the quantity with its unit and by name: driven values and what belongs to them,
    shape (n,) each; ``label``: the driven coordinate, with its unit; ``common``: names of all
    panels, which one legend below them explains then.
    """
    figure, rows = _panels(len(curves), title)
    for axes, (quantity, values) in zip(rows[:, 0], curves.items()):
        for k, (name, (x, y)) in enumerate(values.items()):
            axes.plot(x, y, label=name, **_style(common.index(name) if common else k))
        axes.set_ylabel(quantity)
        if not common:
            _legend_beside(axes)
    rows[-1, 0].set_xlabel(label)
    if common:
        _legend_below(figure, common)
    return figure


def bands(curves, label, title):
    """
    Draw estimates with two standard deviations on both sides, a panel a quantity.

    ``curves``, by the quantity with its unit and by name: abscissa, values and standard
    deviations, shape (n,) each; ``label``: the abscissa, with its unit.
    """
    figure, rows = _panels(len(curves), title)
    for axes, (quantity, values) in zip(rows[:, 0], curves.items()):
        for k, (name, (x, y, deviation)) in enumerate(values.items()):
            axes.plot(x, y, label=name, **_style(k))
            axes.fill_between(x, y - 2.0 * deviation, y + 2.0 * deviation, alpha=0.2,
                              color=COLORS[k % len(COLORS)], linewidth=0.0)
        # What is hardly known at first would hide all that comes later.
        known = np.concatenate([y[len(y) // 20:] for _, y, _ in values.values()])
        wide = np.concatenate([2.0 * each[len(each) // 20:] for *_, each in values.values()])
        low, high = np.nanmin(known - wide), np.nanmax(known + wide)
        room = 0.05 * (high - low) or 1e-3 * max(1.0, abs(high))
        axes.set_ylim(low - room, high + room)
        axes.set_ylabel(quantity)
        _legend_beside(axes)
    rows[-1, 0].set_xlabel(label)
    return figure


def timing_chart(lines, label, title):
    """Draw each line, a pair of abscissa and values, between its least and its largest value."""
    figure, panels = _panels(len(lines), title)
    for axes, (name, (abscissa, values)) in zip(panels.ravel(), lines.items()):
        axes.fill_between(abscissa, values, values.min(), color=COLORS[0], alpha=0.15)
        axes.plot(abscissa, values, color=COLORS[0], linewidth=1.3)
        axes.set_ylabel(name, rotation=0, ha='right', va='center')
        axes.set_yticks([values.min(), values.max()])
        _plain(axes)
    panels.ravel()[-1].set_xlabel(label)
    return figure


def hodographs(forces, title):
    """
    Draw the tips of forces over a motion, from the origin, one panel a force.

    ``forces``: components, each shape (n,), by name; of three the first and the last are drawn.
    """
    columns = min(3, len(forces))
    rows = -(-len(forces) // columns)
    figure = matplotlib.figure.Figure(
        figsize=(10.0, 0.8 + 3.2 * rows), layout='constrained', dpi=DOTS_PER_INCH)
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    figure.suptitle(title, fontweight='bold', x=0.02, ha='left')
    for axes in panels[len(forces):]:
        axes.axis('off')
    for axes, (name, parts) in zip(panels, forces.items()):
        axes.plot(parts[0], parts[-1], color=COLORS[0], linewidth=1.2)
        axes.plot(parts[0][0], parts[-1][0], 'o', color=COLORS[1], markersize=4.0)
        axes.plot(0.0, 0.0, '+', color=COLORS[6])
        axes.set_aspect('equal', 'datalim')
        axes.set_title(name, fontsize='medium')
        axes.set_xlabel('x [N]')
        axes.set_ylabel(f'{"xyz"[len(parts) - 1]} [N]')
        _plain(axes)
    return figure


def pareto_front(front, others, before, labels, title):
    """
    Draw the machines' values of two objectives, whose names are the labels.

    ``front``, ``others``, shape (n, 2): both aims of the machines on the front, and of those that
    it is better than; ``before``: those of the machine as it was, or None.
    """
    figure = matplotlib.figure.Figure(
        figsize=(8.0, 6.0), layout='constrained', dpi=DOTS_PER_INCH)
    figure.suptitle(title, fontweight='bold', x=0.02, ha='left')
    axes = figure.subplots()
    if len(others):
        axes.plot(*np.transpose(others), 'o', markersize=4, color='0.7', label='others')
    axes.plot(*np.transpose(front), marker='o', label='Pareto front', **_style(0))
    for number, place in enumerate(front, 1):
        axes.annotate(str(number), place, xytext=(5, 5), textcoords='offset points', fontsize=8)
    if before is not None:
        axes.plot(*before, marker='s', linestyle='', color=_style(1)['color'], label='before')
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    _plain(axes)
    axes.margins(0.08)
    axes.legend(frameon=False, fontsize=9)
    return figure


def overlaid_paths(paths, view, title, marked=()):
    """
    Draw the paths of points of several machines in one picture.

    ``paths``, by machine and by point, shape (n, 2), in space (n, 3) [m], are seen in a view;
    ``marked``: places that are marked [m], of such shapes.
    """
    figure = matplotlib.figure.Figure(
        figsize=(9.0, 7.0), layout='constrained', dpi=DOTS_PER_INCH)
    figure.suptitle(title, fontweight='bold', x=0.02, ha='left')
    axes = figure.subplots()
    for places in marked:
        axes.plot(*view.project(places).T, marker='x', linestyle='', color='black')
    for k, (machine, points) in enumerate(paths.items()):
        for n, places in enumerate(points.values()):
            seen = view.project(places)
            axes.plot(*seen.T, **_style(k))
            axes.plot(*seen[0], marker='o', markersize=4, color=_style(k)['color'])
    axes.set_aspect('equal', adjustable='datalim')
    axes.set_xlabel(view.labels[0])
    axes.set_ylabel(view.labels[1])
    _plain(axes)
    _legend_below(figure, list(paths))
    return figure


def spread_positions(poses, count):
    """
    Choose positions that differ most from each other; the last one is always among them.

    ``poses``: shape (n, nb, 3), in space (n, nb, 7); of the bodies.
    """
    candidates = np.unique(np.linspace(0, len(poses) - 1, POSE_CANDIDATES).astype(int))
    if poses.shape[-1] == 3:
        extent = np.ptp(poses[..., :2], axis=(0, 1)).max()
        chosen = poses[candidates]
        places = np.concatenate(
            [chosen[..., :2], 0.3 * extent * direction(chosen[..., 2])], axis=-1
        ).reshape(len(chosen), -1)
    else:
        extent = np.ptp(poses[..., :3], axis=(0, 1)).max()
        # A turn changes a quaternion by half as much.
        places = np.concatenate([
            poses[candidates, :, :3], 0.6 * extent * poses[candidates, :, 3:]], axis=2)
        places = places.reshape(len(candidates), -1)
    chosen = [len(candidates) - 1]
    distance = np.full(len(candidates), np.inf)
    while len(chosen) < count:
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
        if distance.max() <= 1e-3 * extent:
            break
        chosen.append(int(distance.argmax()))
    return sorted(int(candidates[index]) for index in chosen)


def _panels(count, title, columns=1):
    """Return a figure and its panels, shape (count, columns), with one time axis."""
    figure = matplotlib.figure.Figure(
        figsize=(9.0 if columns == 1 else 12.0, 1.2 + 2.1 * max(count, 1)), layout='constrained',
        dpi=DOTS_PER_INCH)
    rows = figure.subplots(max(count, 1), columns, sharex=True, squeeze=False)
    figure.suptitle(title, fontweight='bold', x=0.02, ha='left')
    for axes in rows.flat:
        _plain(axes)
    for axes in rows[-1]:
        axes.set_xlabel('time [s]')
    figure.align_ylabels()
    return figure, rows


def _plain(axes):
    axes.grid(color='0.92')
    axes.spines[['top', 'right']].set_visible(False)
    axes.margins(x=0.01)


def _legend_beside(axes):
    axes.legend(loc='center left', bbox_to_anchor=(1.0, 0.5), frameon=False, fontsize=9)


def _legend_below(figure, names):
    handles = [Line2D([], [], label=name, **_style(k)) for k, name in enumerate(names)]
    figure.legend(handles=handles, loc='outside lower left', frameon=False, fontsize=9)


def _style(index):
    # Thinner and thinner, so that a line that another one follows can still be seen below it.
    return {'color': COLORS[index % len(COLORS)], 'linewidth': max(2.4 - 0.2 * index, 1.1),
            'linestyle': DASHES[index // len(COLORS) % len(DASHES)]}


def _wrapped(angle):
    """Return an angle between -pi and pi, with a gap where it jumps."""
    wrapped = np.array((angle + np.pi) % TURN - np.pi)
    jumps = np.flatnonzero(np.abs(np.diff(wrapped)) > np.pi)
    wrapped[jumps] = np.nan
    return wrapped
