"""A flux map and its faults as one picture: the fluxes, and where reciprocity, parity and convexity fail."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orchestrator.flux_maps._audit import MapAudit
from orchestrator.flux_maps._checks import curl, least_inductances, unevenness
from orchestrator.flux_maps._surface import MapSurface
from orchestrator.formatting.colours import D_AXIS, MODEL, Q_AXIS, VERMILION
from orchestrator.formatting.drawing import STYLE, bare, current_plane, empty_figure, name_axes, signed_scale
from orchestrator.recording import replace_file
from protocols import FluxMap, InputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_FORMATS = (".svg", ".png", ".pdf")


def draw_audit(path: Path, flux_map: FluxMap, audit: MapAudit, repaired: FluxMap | None = None) -> None:
    """Draw into a file; raises `InputError` for an unknown kind of file, `StorageError` where it cannot be written."""
    kind = path.suffix.lower()
    if kind not in _FORMATS:
        raise InputError(str(path), "--picture", f"expected a file that ends in {', '.join(_FORMATS)}")
    buffer = io.BytesIO()
    dated = {"CreationDate": None} if kind == ".pdf" else {"Date": None} if kind == ".svg" else None
    figure_of(flux_map, audit, repaired).savefig(buffer, format=kind[1:], dpi=STYLE.dpi, metadata=dated)
    replace_file(path, buffer.getvalue())


def figure_of(flux_map: FluxMap, audit: MapAudit, repaired: FluxMap | None = None) -> Figure:
    """The picture."""
    surface = MapSurface(flux_map)
    figure = empty_figure(2.0 * STYLE.width_in, 2.0 * STYLE.height_in)
    axes = figure.subplots(2, 2)
    _fluxes(bare(axes[0, 0]), flux_map, repaired)
    _plane(figure, bare(axes[0, 1]), surface, 1e3 * _cells_as_points(surface)[surface.known], signed=True)
    axes[0, 1].set_title("reciprocity: $L_{dq} - L_{qd}$ [mH]", fontsize=STYLE.normal_pt)
    uneven = np.linalg.norm(unevenness(surface, audit.axis_rad or 0.0), axis=1)
    _plane(figure, bare(axes[1, 0]), surface, 100.0 * uneven / audit.swing_wb, signed=False)
    turned = np.degrees(audit.axis_rad or 0.0)
    axes[1, 0].set_title(f"unevenness about {turned:+.2f}° [% of the swing]", fontsize=STYLE.normal_pt)
    _plane(figure, bare(axes[1, 1]), surface, 1e3 * least_inductances(surface), signed=False)
    axes[1, 1].set_title("least incremental inductance [mH]", fontsize=STYLE.normal_pt)
    if audit.non_convex:
        axes[1, 1].plot(*np.array(audit.non_convex).T, "x", color=VERMILION, ms=8, mew=2, label="not convex")
        axes[1, 1].legend(fontsize=STYLE.small_pt, loc="lower left")
    return figure


def _fluxes(axes: Axes, flux_map: FluxMap, repaired: FluxMap | None) -> None:
    """psi_d over i_d, a line for each i_q, and psi_q over i_q; some seven of each."""
    for map_, colours, line in ((flux_map, (D_AXIS, Q_AXIS), "-"), (repaired, (MODEL, MODEL), ":")):
        if map_ is None:
            continue
        d, q = (np.asarray(axis, dtype=np.float64) for axis in (map_.i_d, map_.i_q))
        few_q, few_d = (np.unique(np.linspace(0, len(axis) - 1, 7).astype(int)) for axis in (q, d))
        names = ("$\\psi_d$ over $i_d$", "$\\psi_q$ over $i_q$") if map_ is flux_map else ("repaired", "")
        for x, tables, colour, name in (
            (d, map_.psi_d[:, few_q].T, colours[0], names[0]),
            (q, map_.psi_q[few_d], colours[1], names[1]),
        ):
            for k, table in enumerate(tables):
                axes.plot(x, 1e3 * table, line, color=colour, lw=1.3, label=name if name and not k else None)
    name_axes(axes, "$i_d$, $i_q$ [A]", "$\\psi$ [mWb]")
    axes.legend(fontsize=STYLE.small_pt, frameon=False)


def _plane(figure: Figure, axes: Axes, surface: MapSurface, values: Any, *, signed: bool) -> None:
    table = np.full(surface.known.shape, np.nan)
    table[surface.known] = values
    if not np.isfinite(table).any():
        axes.text(0.5, 0.5, "not available", ha="center", va="center", transform=axes.transAxes)
        current_plane(axes)
        axes.set(xlim=surface.i_d[[0, -1]], ylim=surface.i_q[[0, -1]])
        return
    scale = signed_scale(table[np.isfinite(table)]) if signed else {"cmap": "viridis"}
    mesh = axes.pcolormesh(surface.i_d, surface.i_q, table.T, shading="nearest", rasterized=True, **scale)
    figure.colorbar(mesh, ax=axes).ax.tick_params(labelsize=STYLE.small_pt)
    current_plane(axes)


def _cells_as_points(surface: MapSurface) -> Any:
    """Each point's mean over the whole cells around it."""
    padded = np.pad(curl(surface), 1, constant_values=np.nan)
    around = np.stack([padded[:-1, :-1], padded[1:, :-1], padded[:-1, 1:], padded[1:, 1:]])
    count = np.isfinite(around).sum(axis=0)
    return np.where(count > 0, np.nansum(around, axis=0) / np.maximum(count, 1), np.nan)
