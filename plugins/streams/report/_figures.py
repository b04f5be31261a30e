"""The report's pictures, each a data URI of an SVG. One colour means one thing on the whole page.

Five colours for the current that is held, one for each method, black for what is measured directly.
Dashed is classical, solid is injection, dotted is any other method.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from orchestrator.flux_maps.exporting import Trajectory, saliency, torque_nm
from orchestrator.formatting.colours import BLACK, BLUE, GUIDE, METHODS, ORANGE, SKY, VERMILION
from orchestrator.formatting.drawing import (
    BASIS_LINES,
    CURRENT_LABELS,
    STYLE,
    current_plane,
    legend_above,
    name_axes,
    new_figure,
    signed_scale,
    uri,
)
from orchestrator.formatting.profiles import flux_at_zero, profile
from orchestrator.formatting.quantities import decimals_of, number
from plugins.streams.report._collect import Paths
from protocols import Basis, FluxMap, RealArray, ResistanceReading

if TYPE_CHECKING:
    from matplotlib.axes import Axes

HELD_COLOURS = (BLUE, SKY, BLACK, ORANGE, VERMILION)
"""From the most negative held current to the most positive one; black is zero."""


def paths_figure(paths: Paths) -> str:
    """Currents that were reached, on the (i_d, i_q) plane."""
    figure, axes = new_figure()
    for k, path in enumerate(paths.classical):
        label = "classical sweep" if k == 0 else None
        axes.plot(path[:, 0], path[:, 1], "--", color=METHODS[Basis.INTEGRATION], lw=1.2, label=label)
    if len(paths.injection):
        i_d, i_q = paths.injection.T
        axes.plot(i_d, i_q, ".", color=METHODS[Basis.INJECTION], ms=5, label="injection, mean")
    for k, path in enumerate(paths.steps):
        axes.plot(path[:, 0], path[:, 1], "-", color=SKY, lw=0.5, zorder=1, label="voltage steps" if k == 0 else None)
    if len(paths.spin):
        i_d, i_q = paths.spin.T
        axes.plot(i_d, i_q, "x", color=VERMILION, ms=4, label="turning, mean")
    current_plane(axes)
    legend_above(axes, 2)
    return uri(figure)


def flux_figure(maps: dict[str, FluxMap], axis: str, reached: RealArray | None = None) -> str:
    """psi_d over i_d for several i_q (axis "d"), or psi_q over i_q for several i_d (axis "q").

    Fluxes count from the one at zero current, as in the paper; the band is 95 %. `reached` are currents of the other
    axis that were held while it was measured.
    """
    figure, axes = new_figure()
    other = "q" if axis == "d" else "d"
    held, lines = held_currents(maps.values(), other, reached), _lines_of(maps)
    for value, colour in zip(held, _colours_of(held), strict=True):
        for grid in maps.values():
            current, flux, std = profile(grid, f"psi_{axis}", axis, value)
            flux = (flux - flux_at_zero(grid)[axis]) * 1e3
            axes.plot(current, flux, BASIS_LINES.get(grid.basis, ":"), color=colour, lw=1.5)
            if grid.basis is not Basis.INTEGRATION:
                axes.fill_between(current, flux - 1.96e3 * std, flux + 1.96e3 * std, color=colour, alpha=0.2, lw=0)
        axes.plot(
            [], [], "-" if len(lines) > 1 else next(iter(lines.values())), color=colour, label=_amperes(value, held)
        )
    name_axes(axes, CURRENT_LABELS[axis], rf"$\psi_{axis} - \psi_{axis}(0,0)$ [mWb]")
    axes.legend(title=f"held $i_{other}$", frameon=False, fontsize=STYLE.small_pt, title_fontsize=STYLE.small_pt)
    if len(lines) > 1:
        shown = [axes.plot([], [], line, color=GUIDE, lw=1.5, label=method)[0] for method, line in lines.items()]
        figure.legend(handles=shown, loc="outside upper center", ncols=2, frameon=False, fontsize=STYLE.small_pt)
    return uri(figure)


def _lines_of(maps: dict[str, FluxMap]) -> dict[str, str]:
    """The line style of each method; those that share a style have one entry."""
    named: dict[str, list[str]] = {}
    for method, grid in maps.items():
        named.setdefault(BASIS_LINES.get(grid.basis, ":"), []).append(method)
    return {", ".join(methods): line for line, methods in named.items()}


def difference_figure(classical: FluxMap, injection: FluxMap) -> str:
    """Flux by the classical method minus that by injection, along both axes, each from zero current."""
    figure, axes = new_figure()
    for axis, line in (("d", "-"), ("q", "--")):
        current, flux, _ = profile(injection, f"psi_{axis}", axis, 0.0)
        theirs, classical_flux, _ = profile(classical, f"psi_{axis}", axis, 0.0)
        beside = np.interp(current, theirs, classical_flux - flux_at_zero(classical)[axis], left=np.nan, right=np.nan)
        apart = beside - (flux - flux_at_zero(injection)[axis])
        other = "q" if axis == "d" else "d"
        axes.plot(current, 1e3 * apart, line, color=BLACK, lw=1.5, label=rf"$\psi_{axis}(i_{axis})$, $i_{other} = 0$")
    axes.axhline(0.0, color=GUIDE, lw=0.8)
    name_axes(axes, "current on the axis [A]", "classical − injection [mWb]")
    axes.legend(frameon=False, fontsize=STYLE.small_pt)
    return uri(figure)


def inductance_figure(grid: FluxMap, name: str) -> str:
    """l_dd, l_qq or l_dq over the current plane, in mH; L_dq about zero in two hues."""
    values = 1e3 * np.asarray(getattr(grid, name))
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    scale = {"cmap": "YlGnBu", "vmin": low, "vmax": high + 0.6 * (high - low)}  # black contours stay readable
    if name == "l_dq":
        scale = signed_scale(values[np.isfinite(values)], 1.4)
    return _plane_picture(grid, values, "mH", 6, (low, high) if _varies(values) else None, **scale)


def flux_plane_figure(grid: FluxMap, axis: str) -> str:
    """psi_d or psi_q over the current plane, in mWb."""
    return _plane_picture(grid, 1e3 * np.asarray(getattr(grid, f"psi_{axis}")), "mWb", 8, cmap="YlGnBu", alpha=0.8)


def saliency_figure(grid: FluxMap) -> str:
    """From the d axis to the axis of least inductance, electrical degrees: the error of tracking by injection."""
    degrees = np.degrees(saliency(grid).angle_rad)
    return _plane_picture(grid, degrees, "degrees", 7, **signed_scale(degrees[np.isfinite(degrees)], 1.4))


def torque_figure(grid: FluxMap, pole_pairs: int, mtpa: Trajectory | None, mtpv: Trajectory | None) -> str:
    """Lines of equal torque [Nm], the most torque an ampere (MTPA) and a volt (MTPV) where they lie inside the map."""
    figure, axes = new_figure()
    _contours(axes, grid, torque_nm(grid, pole_pairs), 11)
    for name, line, colour, style in (("MTPA", mtpa, VERMILION, "-"), ("MTPV", mtpv, ORANGE, "--")):
        if line is not None and line.interior.any():
            inside = np.where(line.interior[:, None], line.i_dq, np.nan)
            axes.plot(inside[:, 0], inside[:, 1], style, color=colour, lw=2, label=name)
    current_plane(axes)
    if axes.get_legend_handles_labels()[0]:
        legend_above(axes, 2)
    return uri(figure)


def temperature_figure(readings: RealArray) -> str:
    """Time [s] and temperature [degrees Celsius] of segments, shape (n, 2)."""
    figure, axes = new_figure()
    axes.plot(readings[:, 0], readings[:, 1], "o-", color=BLACK, ms=3.5, lw=1)
    name_axes(axes, "time [s]", "temperature [°C]")
    return uri(figure)


def resistance_figure(
    readings: Sequence[ResistanceReading], interval: tuple[float, float], nameplate_ohm: float | None, band: str
) -> str:
    """R_s over the run: each reading with its 95 % interval, the estimate as a band of this name."""
    figure, axes = new_figure()
    time = np.array([r.start_s for r in readings])
    value = np.array([r.value_ohm for r in readings])
    std = np.array([r.std_ohm for r in readings])
    axes.axhspan(*interval, color=SKY, alpha=0.35, lw=1.5, label=band)
    axes.errorbar(time, value, 1.96 * std, fmt="o", color=BLACK, ms=3.5, lw=1, label="reading, 95 %")
    if nameplate_ohm is not None:
        axes.axhline(nameplate_ohm, color=ORANGE, ls=":", lw=1.5, label="nameplate")
    name_axes(axes, "time [s]", r"$R_s$ [$\Omega$]")
    legend_above(axes, 3)
    return uri(figure)


def held_currents(maps: Iterable[FluxMap], axis: str, reached: RealArray | None = None) -> tuple[float, ...]:
    """Up to five currents of an axis to draw curves for: zero, both ends and the middles between.

    They are among those that were reached, where these are given and in the map, else nodes of the first map's grid.
    """
    first = next(iter(maps))
    grid = np.asarray(getattr(first, f"i_{axis}"))
    known = np.isfinite(first.psi_d).any(axis=1 if axis == "d" else 0)
    usable = grid[known] if known.any() else grid
    if reached is not None and np.ptp(reached) > 0.1 * np.ptp(usable):  # else it was held at zero, but for noise
        usable = np.sort(np.append(reached[(reached >= usable[0]) & (reached <= usable[-1])], 0.0))
    wanted = np.array([usable[0], usable[0] / 2, 0.0, usable[-1] / 2, usable[-1]])
    nearest = usable[np.abs(usable[:, None] - wanted).argmin(axis=0)]
    return tuple(float(value) for value in np.unique(nearest))


def _amperes(value: float, among: Sequence[float]) -> str:
    """A held current to the digits that the largest among them needs."""
    rounded = round(value, decimals_of(max(map(abs, among)), 3))
    return f"{rounded:+.6g} A".replace("-", "−") if rounded else "0 A"


def _colours_of(held: Sequence[float]) -> list[str]:
    """Black for zero, cold below, warm above, stronger further out."""
    largest = max(map(abs, held)) or 1.0
    return [HELD_COLOURS[round(2 + 2 * value / largest)] for value in held]


def _plane_picture(
    grid: FluxMap,
    values: RealArray,
    unit: str,
    levels: int,
    bar_limits: tuple[float, float] | None = None,
    **style: Any,
) -> str:
    """Values over the current plane as colour, with so many contours."""
    figure, axes = new_figure()
    mesh = axes.pcolormesh(grid.i_d, grid.i_q, values.T, shading="nearest", rasterized=True, **style)
    bar = figure.colorbar(mesh, ax=axes)
    bar.set_label(unit)
    _contours(axes, grid, values, levels)
    if bar_limits is not None:
        bar.ax.set_ylim(*bar_limits)
    current_plane(axes)
    return uri(figure)


def _contours(axes: Axes, grid: FluxMap, values: RealArray, levels: int) -> None:
    if min(values.shape) < 2 or np.isfinite(values).sum() < 4 or not _varies(values):
        return
    known = np.ma.masked_invalid(values.T)
    lines = axes.contour(grid.i_d, grid.i_q, known, levels=levels, colors=BLACK, linewidths=0.7)
    axes.clabel(lines, fontsize=STYLE.small_pt - 1, fmt=lambda level: number(level, 3))


def _varies(values: RealArray) -> bool:
    low, high = np.nanmin(values), np.nanmax(values)
    return bool(high - low > 1e-9 * max(abs(low), abs(high)))
