"""Pictures of the motor over the current plane: torque with its best lines, fluxes, where the saliency points.

And the temperature that was recorded, over time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from orchestrator.flux_maps.exporting import Trajectory, saliency, torque_nm
from orchestrator.formatting.colours import BLACK, ORANGE, VERMILION
from orchestrator.formatting.drawing import (
    STYLE,
    current_plane,
    legend_above,
    name_axes,
    new_figure,
    signed_scale,
    uri,
)
from orchestrator.formatting.quantities import number
from protocols import FluxMap, RealArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def torque_figure(grid: FluxMap, pole_pairs: int, mtpa: Trajectory | None, mtpv: Trajectory | None) -> str:
    """Lines of equal torque [Nm], the most torque an ampere (MTPA) and a volt (MTPV) where they lie inside the map."""
    figure, axes = new_figure()
    _lines(axes, grid, torque_nm(grid, pole_pairs), 11)
    for name, line, colour, style in (("MTPA", mtpa, VERMILION, "-"), ("MTPV", mtpv, ORANGE, "--")):
        if line is not None and line.interior.any():
            inside = np.where(line.interior[:, None], line.i_dq, np.nan)
            axes.plot(inside[:, 0], inside[:, 1], style, color=colour, lw=2, label=name)
    current_plane(axes)
    if axes.get_legend_handles_labels()[0]:
        legend_above(axes, 2)
    return uri(figure)


def flux_plane_figure(grid: FluxMap, axis: str) -> str:
    """psi_d or psi_q over the current plane, in mWb."""
    figure, axes = new_figure()
    values = 1e3 * np.asarray(getattr(grid, f"psi_{axis}"))
    mesh = axes.pcolormesh(grid.i_d, grid.i_q, values.T, shading="nearest", rasterized=True, cmap="YlGnBu", alpha=0.8)
    figure.colorbar(mesh, ax=axes).set_label("mWb")
    _lines(axes, grid, values, 8)
    current_plane(axes)
    return uri(figure)


def saliency_figure(grid: FluxMap) -> str:
    """From the d axis to the axis of least inductance, electrical degrees: what a tracking by injection is off by."""
    figure, axes = new_figure()
    degrees = np.degrees(saliency(grid).angle_rad)
    scale = signed_scale(degrees[np.isfinite(degrees)], 1.4)
    mesh = axes.pcolormesh(grid.i_d, grid.i_q, degrees.T, shading="nearest", rasterized=True, **scale)
    figure.colorbar(mesh, ax=axes).set_label("degrees")
    _lines(axes, grid, degrees, 7)
    current_plane(axes)
    return uri(figure)


def temperature_figure(readings: RealArray) -> str:
    """Time [s] and temperature [degrees Celsius] of segments, shape (n, 2)."""
    figure, axes = new_figure()
    axes.plot(readings[:, 0], readings[:, 1], "o-", color=BLACK, ms=3.5, lw=1)
    name_axes(axes, "time [s]", "temperature [°C]")
    return uri(figure)


def _lines(axes: Axes, grid: FluxMap, values: RealArray, levels: int) -> None:
    known = np.ma.masked_invalid(values.T)
    if min(values.shape) < 2 or known.count() < 4 or float(np.ptp(known.compressed())) == 0.0:
        return
    lines = axes.contour(grid.i_d, grid.i_q, known, levels=levels, colors=BLACK, linewidths=0.7)
    axes.clabel(lines, fontsize=STYLE.small_pt - 1, fmt=lambda level: number(level, 3))
