"""The report's pictures, each a data URI of an SVG. One colour means one thing on the whole page.

Colours are Okabe and Ito's (https://jfly.uni-koeln.de/color/), told apart by colour-blind readers
too: five for the current that is held, one each for the two methods, black for what is measured
directly. Dashed is classical, solid is injection.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from plugins.streams.report._collect import Paths
from protocols import FluxMap, RealArray, ResistanceEstimate

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

METHOD_COLOURS = {"injection": "#CC79A7", "classical": "#009E73"}
OTHER_METHOD = "#F0E442"
HELD_COLOURS = ("#0072B2", "#56B4E9", "#000000", "#E69F00", "#D55E00")
"""From the most negative held current to the most positive one; black is zero."""
LINES = {"classical": "--", "injection": "-"}
WIDTH_IN, HEIGHT_IN = 4.9, 3.7


def paths_figure(paths: Paths) -> str:
    """Currents that were reached, on the (i_d, i_q) plane."""
    figure, axes = _new()
    for number, path in enumerate(paths.classical):
        label = "classical sweep" if number == 0 else None
        axes.plot(path[:, 0], path[:, 1], "--", color=METHOD_COLOURS["classical"], lw=1.2, label=label)
    if len(paths.injection):
        i_d, i_q = paths.injection.T
        axes.plot(i_d, i_q, ".", color=METHOD_COLOURS["injection"], ms=5, label="injection, mean")
    axes.set_aspect("equal", adjustable="box")
    _label(axes, "$i_d$ [A]", "$i_q$ [A]")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2, frameon=False, fontsize=9)
    return _uri(figure)


def flux_figure(maps: dict[str, FluxMap], axis: str) -> str:
    """psi_d over i_d for several i_q (axis "d"), or psi_q over i_q for several i_d (axis "q").

    Fluxes count from the one at zero current, as in the paper; the band is 95 %.
    """
    figure, axes = _new()
    other = "q" if axis == "d" else "d"
    held = held_currents(maps.values(), other)
    for value, colour in zip(held, _colours_of(held), strict=True):
        for method, found in maps.items():
            current, flux, std = profile(found, f"psi_{axis}", axis, value)
            flux = (flux - _at_zero(found, axis)) * 1e3
            axes.plot(current, flux, LINES.get(method, ":"), color=colour, lw=1.5)
            if method != "classical":
                axes.fill_between(current, flux - 1.96e3 * std, flux + 1.96e3 * std, color=colour, alpha=0.2, lw=0)
        axes.plot([], [], "-", color=colour, label=_amperes(value))
    _label(axes, f"$i_{axis}$ [A]", rf"$\psi_{axis} - \psi_{axis}(0,0)$ [mWb]")
    axes.legend(title=f"held $i_{other}$", frameon=False, fontsize=9, title_fontsize=9, loc="upper left")
    return _uri(figure)


def difference_figure(classical: FluxMap, injection: FluxMap) -> str:
    """Flux by the classical method minus that by injection, along both axes, each from zero current."""
    figure, axes = _new()
    for axis, line in (("d", "-"), ("q", "--")):
        current, flux, _ = profile(injection, f"psi_{axis}", axis, 0.0)
        theirs, classical_flux, _ = profile(classical, f"psi_{axis}", axis, 0.0)
        beside = np.interp(current, theirs, classical_flux - _at_zero(classical, axis), left=np.nan, right=np.nan)
        apart = beside - (flux - _at_zero(injection, axis))
        other = "q" if axis == "d" else "d"
        axes.plot(current, 1e3 * apart, line, color="black", lw=1.5, label=rf"$\psi_{axis}(i_{axis})$, $i_{other} = 0$")
    axes.axhline(0.0, color="0.6", lw=0.8)
    _label(axes, "current on the axis [A]", "classical − injection [mWb]")
    axes.legend(frameon=False, fontsize=9)
    return _uri(figure)


def inductance_figure(found: FluxMap, name: str) -> str:
    """l_dd, l_qq or l_dq over the current plane, in mH; L_dq about zero in two hues."""
    figure, axes = _new()
    values = 1e3 * np.asarray(getattr(found, name))
    mesh_scale = _scale(values, about_zero=name == "l_dq")
    mesh = axes.pcolormesh(found.i_d, found.i_q, values.T, shading="nearest", rasterized=True, **mesh_scale)
    bar = figure.colorbar(mesh, ax=axes)
    bar.set_label("mH")
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if high - low > 1e-9 * max(abs(low), abs(high)):
        _contours(axes, found, values)
        bar.ax.set_ylim(low, high)
    axes.set_aspect("equal", adjustable="box")
    _label(axes, "$i_d$ [A]", "$i_q$ [A]")
    return _uri(figure)


def resistance_figure(estimate: ResistanceEstimate, nameplate_ohm: float | None) -> str:
    """R_s over the run: each reading with its 95 % interval, the estimate as a band."""
    figure, axes = _new()
    time = np.array([r.start_s for r in estimate.readings])
    value = np.array([r.value_ohm for r in estimate.readings])
    std = np.array([r.std_ohm for r in estimate.readings])
    axes.axhspan(estimate.low, estimate.high, color="#56B4E9", alpha=0.35, lw=0, label="estimate, 95 %")
    axes.errorbar(time, value, 1.96 * std, fmt="o", color="black", ms=3.5, lw=1, label="reading, 95 %")
    if nameplate_ohm is not None:
        axes.axhline(nameplate_ohm, color="#E69F00", ls=":", lw=1.5, label="nameplate")
    _label(axes, "time [s]", r"$R_s$ [$\Omega$]")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, frameon=False, fontsize=9)
    return _uri(figure)


def held_currents(maps: Iterable[FluxMap], axis: str) -> tuple[float, ...]:
    """Up to five currents of an axis to draw curves for: zero, both ends and the middles between.

    They lie on the first map's grid, so that its curves are the file's own numbers.
    """
    found = next(iter(maps))
    grid = np.asarray(getattr(found, f"i_{axis}"))
    known = np.isfinite(found.psi_d).any(axis=1 if axis == "d" else 0)
    usable = grid[known] if known.any() else grid
    wanted = np.array([usable[0], usable[0] / 2, 0.0, usable[-1] / 2, usable[-1]])
    nearest = usable[np.abs(usable[:, None] - wanted).argmin(axis=0)]
    return tuple(float(value) for value in np.unique(nearest))


def profile(found: FluxMap, name: str, along: str, held: float) -> tuple[RealArray, RealArray, RealArray]:
    """Current, value and standard deviation along one axis, the other axis held (linear between grid lines)."""
    other = "q" if along == "d" else "d"
    grid = np.asarray(getattr(found, f"i_{other}"))
    values, stds = (np.asarray(getattr(found, key)) for key in (name, f"{name}_std"))
    if other == "d":
        values, stds = values.T, stds.T
    current = np.asarray(getattr(found, f"i_{along}"))
    on_line = np.flatnonzero(np.isclose(grid, held, rtol=0.0, atol=1e-9))
    if len(on_line):
        return current, np.asarray(values[:, on_line[0]]), np.asarray(stds[:, on_line[0]])
    if not grid[0] < held < grid[-1]:
        return current, np.full(current.shape, np.nan), np.full(current.shape, np.nan)
    upper = int(np.searchsorted(grid, held))
    weight = (held - grid[upper - 1]) / (grid[upper] - grid[upper - 1])
    between = [(1.0 - weight) * x[:, upper - 1] + weight * x[:, upper] for x in (values, stds)]
    return current, np.asarray(between[0]), np.asarray(between[1])


def _amperes(value: float) -> str:
    return f"{value:+.2g} A".replace("-", "−") if value else "0 A"


def _scale(values: RealArray, about_zero: bool) -> dict[str, Any]:
    """Colour map and its limits, the dark ends left out so that black contours stay readable."""
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if about_zero:
        largest = 1.4 * max(-low, high) or 1.0
        return {"cmap": "PuOr", "vmin": -largest, "vmax": largest}
    return {"cmap": "YlGnBu", "vmin": low, "vmax": high + 0.6 * (high - low)}


def _at_zero(found: FluxMap, axis: str) -> float:
    """psi(0, 0) as it is in the file; 0 where the map does not reach it."""
    current, flux, _ = profile(found, f"psi_{axis}", axis, 0.0)
    known = np.isfinite(flux)
    if not known.any() or not current[known][0] <= 0.0 <= current[known][-1]:
        return 0.0
    return float(np.interp(0.0, current[known], flux[known]))


def _colours_of(held: Sequence[float]) -> list[str]:
    """Black for zero, cold below, warm above, stronger further out."""
    largest = max(map(abs, held)) or 1.0
    return [HELD_COLOURS[round(2 + 2 * value / largest)] for value in held]


def _contours(axes: Axes, found: FluxMap, values: RealArray) -> None:
    if min(values.shape) < 2:
        return
    lines = axes.contour(found.i_d, found.i_q, np.ma.masked_invalid(values.T), levels=6, colors="black", linewidths=0.6)
    axes.clabel(lines, fontsize=8, fmt="%.3g")


def _new() -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), layout="constrained")
    axes = figure.add_subplot()
    axes.spines[["top", "right"]].set_visible(False)
    axes.tick_params(labelsize=9)
    return figure, axes


def _label(axes: Axes, x: str, y: str) -> None:
    axes.set_xlabel(x, fontsize=10)
    axes.set_ylabel(y, fontsize=10)
    axes.grid(alpha=0.25, lw=0.6)


def _uri(figure: Figure) -> str:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="svg", dpi=150, metadata={"Date": None})
    return "data:image/svg+xml;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
