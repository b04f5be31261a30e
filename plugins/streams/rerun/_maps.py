"""Flux surfaces, inductances over the current plane, and the checks of a map, as entries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from orchestrator.formatting.colours import (
    D_AXIS,
    GRID,
    GUIDE,
    METHODS,
    MODEL,
    Q_AXIS,
    SCREEN,
    TEXT,
    diverging,
    opaque,
    packed,
    sequential,
)
from orchestrator.formatting.names import MAP_QUANTITIES, PAPER_CROSSINGS
from orchestrator.formatting.profiles import flux_at_zero
from orchestrator.formatting.quantities import number, percent
from plugins.streams.rerun._axes import WIDTH, Chart, colour_bar, lined, picture, plane, ticks, worded
from plugins.streams.rerun._detail import DETAIL
from plugins.streams.rerun._tape import Entry, When, entry
from protocols import FluxMap, FluxMapEstimate, RealArray

INDUCTANCES = {name: f"{symbol} [{unit}]" for name, (symbol, unit) in MAP_QUANTITIES.items() if unit == "mH"}


@dataclass(frozen=True)
class FluxBox:
    """The box in which the flux surfaces of both axes stand: currents to ±reach, flux to ±height (A, Wb)."""

    reach_a: float
    height_wb: float

    def furniture(self, when: When) -> list[Entry]:
        """Scale, edges and words of both boxes."""
        out: list[Entry] = []
        for axis in ("d", "q"):
            path = f"flux/{axis}/box"
            size = [1.0 / self.reach_a, 1.0 / self.reach_a, DETAIL.box_half_height / self.height_wb]
            out.append(entry(path, when, rr.Transform3D(scale=size)))
            out.append(entry(f"flux/{axis}/edges", when, rr.LineStrips3D(_edges(), colors=packed(GRID), radii=-0.6)))
            at, labels = self._words(axis)
            words = rr.Points3D(at, labels=labels, show_labels=True, colors=packed(TEXT), radii=-0.01)
            out.append(entry(f"flux/{axis}/words", when, words))
        return out

    def _words(self, axis: str) -> tuple[list[list[float]], list[str]]:
        """Ticks of i_d along the edge in front, of i_q along the one on the left, of the flux on the post behind it."""
        h = DETAIL.box_half_height
        words: list[tuple[list[float], str]] = []
        for value in ticks(-self.reach_a, self.reach_a, 4):
            at = value / self.reach_a
            words += [([at, -1.1, -h], number(value, 3)), ([-1.1, at, -h], number(value, 3))]
        top = 1e3 * self.height_wb
        words += [([-1.05, 1.12, h * v / top], number(v, 3)) for v in ticks(-top, top, 4)]
        words += [([0, -1.35, -h], "i_d [A]"), ([-1.35, 0, -h], "i_q [A]"), ([-1, 1.1, 1.25 * h], f"ψ_{axis} [mWb]")]
        return [at for at, _ in words], [text for _, text in words]

    def points(self, when: When, i_dq: RealArray, psi_dq: RealArray) -> list[Entry]:
        """Flux at the points reached, in both boxes."""
        out = []
        for column, (axis, colour) in enumerate((("d", D_AXIS), ("q", Q_AXIS))):
            at = np.column_stack([i_dq, psi_dq[:, column]])
            dots = rr.Points3D(at, colors=packed(colour), radii=-3.0)
            out.append(entry(f"flux/{axis}/box/points", when, dots, array_bytes=at.nbytes))
        return out

    def surfaces(self, when: When, grid: FluxMap) -> list[Entry]:
        """The map as two surfaces, flux counted from that at zero current."""
        i_d, i_q = _thinned(grid.i_d), _thinned(grid.i_q)
        rows, columns = np.searchsorted(grid.i_d, i_d), np.searchsorted(grid.i_q, i_q)
        out, zero = [], flux_at_zero(grid)
        for axis in ("d", "q"):
            psi = np.asarray(getattr(grid, f"psi_{axis}"))[np.ix_(rows, columns)] - zero[axis]
            mesh = _mesh(i_d, i_q, psi, self.height_wb)
            path = f"flux/{axis}/box/surface"
            out.append(
                entry(path, when, rr.Clear(recursive=False) if mesh is None else mesh, array_bytes=40 * psi.size)
            )
        return out


def _edges() -> list[list[list[float]]]:
    h = DETAIL.box_half_height
    floor = [[-1, -1, -h], [1, -1, -h], [1, 1, -h], [-1, 1, -h], [-1, -1, -h]]
    level = [[x, y, 0.0] for x, y, _ in floor]
    posts = [[[x, y, -h], [x, y, h]] for x, y in ((-1, 1), (1, 1))]
    return [floor, level, *posts]


def _thinned(axis: RealArray) -> RealArray:
    return axis[:: max(1, -(-len(axis) // DETAIL.surface_nodes))]


def _mesh(i_d: RealArray, i_q: RealArray, psi: RealArray, height_wb: float) -> rr.Mesh3D | None:
    """A triangulated sheet over the cells whose four corners are known; None where there is none."""
    known = np.isfinite(psi)
    cell = known[:-1, :-1] & known[1:, :-1] & known[:-1, 1:] & known[1:, 1:]
    if not cell.any():
        return None
    number = np.arange(psi.size).reshape(psi.shape)
    a, b, c, d = (n[cell] for n in (number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]))
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]).astype(np.uint32)
    x, y = np.meshgrid(i_d, i_q, indexing="ij")
    at = np.stack([x.ravel(), y.ravel(), np.where(known, psi, 0.0).ravel()], axis=1).astype(np.float32)
    colours = sequential(0.5 + 0.5 * np.clip(np.where(known, psi, 0.0).ravel() / height_wb, -1.0, 1.0))
    return rr.Mesh3D(vertex_positions=at, triangle_indices=triangles, vertex_colors=colours)


def reach_of(grid: FluxMap) -> float:
    """Largest current of a map on either axis [A]."""
    return float(max(np.abs(grid.i_d).max(), np.abs(grid.i_q).max(), 1e-9))


def flux_height(grid: FluxMap) -> float:
    """Largest flux on either axis, counted from that at zero current [Wb]."""
    zero = flux_at_zero(grid)
    values = np.concatenate([(grid.psi_d - zero["d"]).ravel(), (grid.psi_q - zero["q"]).ravel()])
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if known.size and known.max() > 0.0 else 1.0


def inductance_entries(when: When, grid: FluxMap) -> list[Entry]:
    """L_dd, L_dq and L_qq over the current plane, each with its colour bar; L_dq about zero."""
    return [
        item
        for name, unit in INDUCTANCES.items()
        for item in over_plane(
            f"maps/{name}/amperes",
            when,
            (grid.i_d, grid.i_q),
            1e3 * np.asarray(getattr(grid, name)),
            unit,
            about_zero=name == "l_dq",
        )
    ]


def over_plane(
    path: str, when: When, axes: tuple[RealArray, RealArray], values: RealArray, unit: str, *, about_zero: bool = False
) -> list[Entry]:
    """Values on a grid of currents, shape (d, q), as colours over the current plane; nothing where none is known."""
    known = values[np.isfinite(values)]
    if not known.size:
        return []
    low, high = (float(v) for v in np.quantile(known, (0.005, 0.995)))
    paint = sequential
    if about_zero:
        high = max(abs(low), abs(high), 1e-9)
        low, paint = -high, diverging
    high = max(high, low + 1e-9)
    i_d, i_q = (np.linspace(axis[0], axis[-1], DETAIL.map_pixels) for axis in axes)
    near = np.ix_(_nearest(axes[0], i_d), _nearest(axes[1], i_q))
    image = opaque(paint((values[near].T - low) / (high - low)), SCREEN)
    corner, size = (float(i_d[0]), float(i_q[0])), (float(np.ptp(i_d)), float(np.ptp(i_q)))
    reach_a = 1.05 * float(max(np.abs(axis).max() for axis in axes))
    return [
        *plane(path, reach_a, when=when),
        picture(f"{path}/values", when, image, corner, size),
        *colour_bar(path, when, reach_a, paint(np.linspace(0.0, 1.0, 64)), (low, high), unit),
    ]


def _nearest(axis: RealArray, wanted: RealArray) -> NDArray[np.intp]:
    middles: RealArray = 0.5 * (axis[:-1] + axis[1:])
    return np.searchsorted(middles, wanted)


CHECKS = Chart("checks", (1e-3, 10.0), (0.0, 1.0), "per cent of the rated flux", "", log_x=True)


def check_entries(when: When, maps: Mapping[str, FluxMapEstimate]) -> list[Entry]:
    """Crossings and parity of each method as bars, the paper's crossings beside them."""
    bars: list[tuple[str, float, str]] = []
    for name, estimate in maps.items():
        for what, value in (("crossings", estimate.checks.crossings), ("parity", estimate.checks.parity)):
            for axis in "dq":
                figure = None if value is None else getattr(value, f"{axis}_percent")
                if figure is not None:
                    bars.append((f"{name}: {what} {axis}", figure, METHODS.get(estimate.map.basis, MODEL)))
    bars += [(f"the paper: crossings {axis}", getattr(PAPER_CROSSINGS, f"{axis}_percent"), GUIDE) for axis in "dq"]
    out: list[Entry] = []
    at = 1.0 - (np.arange(len(bars)) + 0.5) / len(bars)
    words: list[tuple[float, float, str]] = []
    for colour in sorted({bar[2] for bar in bars}):
        strips = [
            CHECKS.place([CHECKS.x[0], figure], [y, y])
            for (_, figure, paint), y in zip(bars, at, strict=True)
            if paint == colour
        ]
        out.append(lined(f"checks/bars/{colour[1:].lower()}", when, strips, colour, -4.0))
    for (label, figure, _), y in zip(bars, at, strict=True):
        x, height = CHECKS.place([max(figure, CHECKS.x[0])], [y])[0]
        words.append((float(np.clip(x, 28.0, WIDTH - 28.0)), float(height), f"{label} {percent(figure)}"))
    return [*out, worded("checks/words", when, words)]
