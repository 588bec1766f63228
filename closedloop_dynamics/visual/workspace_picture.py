# SPDX-FileCopyrightText: 2026 The closedloop_dynamics authors
# SPDX-License-Identifier: Apache-2.0

"""Pictures of a workspace: maps of the plane, slices of space."""

import numpy as np

from .appearance import DOTS_PER_INCH
from .drawing import MechanismArtist
from ..mechanism.extras import of_an_extra

with of_an_extra():
    import matplotlib.colors
    import matplotlib.figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

# Slices of space in one picture.
SLICES = 6
# Colours of nodes without a value by status, of curves by kind, and of the edge of what all
# orientations reach.
STATUS_COLORS = ('#FFFFFF', '#CFE3F1', '#D9D9D9', '#F3CBB6')
CURVES = {'type 1': ('#000000', '-'), 'type 2': ('#D55E00', '-')}
DEXTEROUS = '#D55E00'


def workspace_picture(axes, status, values, label, title, meanings, curves=(), inner=None,
                      machine=None, logarithmic=False):
    """
    Draw a map.

    Parameters
    ----------
    axes : sequence of (str, ndarray)
        Names and values of the grid's axes that have several [m].
    status : ndarray of int, shape of the grid along these
        A place in ``meanings``.
    values : ndarray or None
        What is drawn, of the same shape; NaN where there is nothing.
    label : str
        Of the values.
    title : str
        Of the picture.
    meanings : sequence of str
        Meaning of each status.
    curves : sequence of (str, ndarray of shape (n, 2))
        Kinds and places of curves.
    inner : ndarray of bool, optional
        Its edge is drawn; in a plane.
    machine : tuple of (Mechanism, ndarray of shape (1, nb, 3)), optional
        Drawn on top; in the plane.
    logarithmic : bool
        Whether the colours are.

    """
    figure = matplotlib.figure.Figure(figsize=(9.0, 7.0), layout='constrained',
                                      dpi=DOTS_PER_INCH)
    figure.suptitle(title, fontweight='bold', x=0.02, ha='left')
    shown = np.full(status.shape, np.nan) if values is None else values
    finite = shown[np.isfinite(shown)]
    norm = None
    if len(finite):
        low, high = (float(one) for one in np.percentile(finite, (0, 98)))
        high = high if high > low else low + max(abs(low), 1.0) * 1e-9
        wide = logarithmic and high > 10.0 * low > 0.0
        norm = (matplotlib.colors.LogNorm if wide else matplotlib.colors.Normalize)(low, high)
    if len(axes) == 3:
        panels = _slices(figure, axes, status, shown, norm)
    else:
        panels = [_panel(figure.subplots(), axes, status, shown, norm)]
        panel, mesh = panels[0]
        if len(axes) == 2:
            for kind, places in curves:
                color, line = CURVES[kind]
                panel.plot(*places.T, color=color, linestyle=line, linewidth=1.4, zorder=8)
            if inner is not None and inner.any() and not inner.all():
                panel.contour(axes[0][1], axes[1][1], inner.T.astype(float), levels=[0.5],
                              colors=[DEXTEROUS], linewidths=1.6, zorder=8)
            if machine is not None:
                artist = MechanismArtist(panel, *machine)
                artist.ground()
                artist.bodies(0, 0.55)
                panel.autoscale(False)
    mesh = next((mesh for _, mesh in panels if mesh is not None), None)
    if mesh is not None and norm is not None:
        figure.colorbar(mesh, ax=[panel for panel, _ in panels], label=label, shrink=0.8,
                        extend='max' if finite.max() > norm.vmax else 'neither')
    _legend(figure, status, shown, meanings, curves, inner)
    return figure


def _panel(panel, axes, status, values, norm):
    """Draw a line, or an area, into a panel; return it and its coloured artist."""
    names = [name for name, _ in axes]
    panel.set_xlabel(f'{names[0]} [m]')
    if len(axes) == 1:
        panel.plot(axes[0][1], values, color='#0072B2')
        panel.grid(color='0.93')
        return panel, None
    panel.set_ylabel(f'{names[1]} [m]')
    (_, x), (_, y) = axes
    colors = matplotlib.colors.ListedColormap(STATUS_COLORS)
    panel.pcolormesh(x, y, status.T, cmap=colors, vmin=-0.5, vmax=len(STATUS_COLORS) - 0.5,
                     shading='nearest', rasterized=True)
    mesh = panel.pcolormesh(x, y, np.ma.masked_invalid(values).T, norm=norm, cmap='viridis',
                            shading='nearest', rasterized=True)
    panel.set_aspect('equal')
    return panel, mesh


def _slices(figure, axes, status, values, norm):
    """Draw slices across the last axis that has something; return panels and meshes."""
    name, heights = axes[2]
    full = next((full for full in (
        np.flatnonzero(where.any(axis=(0, 1))) for where in (np.isfinite(values), status > 0))
        if len(full)), np.arange(len(heights)))
    chosen = full[np.unique(np.linspace(0, len(full) - 1, SLICES).astype(int))]
    panels = figure.subplots(2, 3, sharex=True, sharey=True, squeeze=False).flat
    found = []
    for panel, k in zip(panels, chosen):
        found.append(_panel(panel, axes[:2], status[..., k], values[..., k], norm))
        panel.set_title(f'{name} = {heights[k]:.4g} m', fontsize=9, loc='left')
    for panel in list(figure.axes)[len(chosen):]:
        panel.axis('off')
    for panel in figure.axes:
        panel.label_outer()
    return found


def _legend(figure, status, values, meanings, curves, inner):
    handles = [Patch(facecolor=STATUS_COLORS[k], edgecolor='0.6', label=text)
               for k, text in enumerate(meanings)
               if k > 0 and ((status == k) & ~np.isfinite(values)).any()]
    handles += [Line2D([], [], color=CURVES[kind][0], linestyle=CURVES[kind][1],
                       label=f'{kind} singularities')
                for kind in dict.fromkeys(kind for kind, _ in curves)]
    if inner is not None and inner.any() and not inner.all():
        handles.append(Line2D([], [], color=DEXTEROUS, label='edge of the dexterous workspace'))
    if handles:
        figure.legend(handles=handles, loc='outside lower left', ncols=3, frameon=False,
                      fontsize=9)
