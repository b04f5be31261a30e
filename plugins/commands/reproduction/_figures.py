"""The paper's figures, drawn from one run: one PNG each, in the paper's order and with its axes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from orchestrator.formatting.colours import BLUE, GREEN, VERMILION
from orchestrator.formatting.drawing import (
    BASIS_LINES,
    CURRENT_LABELS,
    STYLE,
    bare,
    current_plane,
    empty_figure,
    name_axes,
    signed_scale,
)
from orchestrator.formatting.profiles import flux_at_zero, profile
from orchestrator.numerics.types import Array
from plugins.commands.reproduction._material import Loop, Material

if TYPE_CHECKING:
    from matplotlib.figure import Figure


# The colours of the paper: blue, green and red.
D_COLOUR, Q_COLOUR, ZERO_COLOUR = BLUE, GREEN, VERMILION
FLUX_LABELS = {"d": r"$\psi_d - \psi_M$ [mWb]", "q": r"$\psi_q$ [mWb]"}


def draw_all(material: Material, folder: Path) -> tuple[str, ...]:
    """Write every figure into a folder; returns the names of the files, in the paper's order."""
    figures: dict[str, Callable[[Material], Figure]] = {
        "trajectories.png": _trajectories,
        "processing.png": _processing,
        "classical.png": _classical,
        "paths.png": _paths,
        "injection.png": _injection,
        "inductances.png": _inductances,
        "comparison.png": _comparison,
    }
    for name, make in figures.items():
        make(material).savefig(folder / name, dpi=STYLE.dpi, metadata={"Software": None})
    return tuple(figures)


def _trajectories(material: Material) -> Figure:
    figure = empty_figure(6.4, 5.6)
    for axes, trajectory in zip(figure.subplots(3, 1, sharex=True), material.trajectories, strict=True):
        axes.plot(trajectory[:, 0], trajectory[:, 1], color=D_COLOUR, label="$i_d$")
        axes.plot(trajectory[:, 0], trajectory[:, 2], color=Q_COLOUR, label="$i_q$")
        name_axes(bare(axes), "", "current [A]")
    axes.set_xlabel("time [s]")
    figure.axes[0].legend(frameon=False, ncols=2, loc="upper right")
    return figure


def _processing(material: Material) -> Figure:
    figure = empty_figure(9.0, 4.0)
    left, right = figure.subplots(1, 2)
    for loop, colour in zip(material.loops, (D_COLOUR, Q_COLOUR), strict=True):
        name = r"$\psi_d(i_d, 0) - \psi_M$" if loop.axis == "d" else r"$\psi_q(0, i_q)$"
        swing = loop.uncompensated - 0.5 * (loop.uncompensated.max() + loop.uncompensated.min())
        left.plot(loop.current, swing, color=colour, lw=0.6, label=name)
        right.plot(loop.current, 1e3 * _centred(loop), "--", color=colour, lw=0.5)
        right.plot(loop.mean_current, 1e3 * loop.mean, color="black", lw=1.0, ls=":")
        right.plot([], [], "--", color=colour, label=name)
    right.plot([], [], ":", color="black", label="averaged")
    left.set_title("voltage drops not compensated", fontsize=STYLE.small_pt)
    right.set_title("compensated, and averaged", fontsize=STYLE.small_pt)
    name_axes(bare(left), "current on the axis [A]", "flux [Wb]")
    name_axes(bare(right), "current on the axis [A]", "flux [mWb]")
    for axes in (left, right):
        axes.legend(frameon=False, fontsize=STYLE.small_pt)
    return figure


def _centred(loop: Loop) -> Array:
    """The loop's flux, shifted to the mean of the averaged curve."""
    order = np.argsort(loop.mean_current)
    on_curve = np.interp(loop.current, loop.mean_current[order], loop.mean[order])
    return np.asarray(loop.compensated - np.mean(loop.compensated - on_curve))


def _classical(material: Material) -> Figure:
    return _space([(sweep[:, :2], sweep[:, 2:]) for sweep in material.sweeps], lines=True)


def _injection(material: Material) -> Figure:
    estimate = material.estimates["injection"]
    zero = np.array(list(flux_at_zero(estimate.map).values()))
    i_dq, psi_dq = (np.asarray(x, dtype=np.float64) for x in (estimate.points.i_dq, estimate.points.psi_dq - zero))
    return _space([(i_dq, psi_dq)], lines=False)


def _space(parts: list[tuple[Array, Array]], *, lines: bool) -> Figure:
    """psi_d and psi_q over the current plane."""
    figure = empty_figure(9.4, 4.4)
    for k, (name, colour) in enumerate((("d", D_COLOUR), ("q", Q_COLOUR))):
        axes: Any = figure.add_subplot(1, 2, k + 1, projection="3d")
        for current, flux in parts:
            if lines:
                axes.plot(current[:, 0], current[:, 1], 1e3 * flux[:, k], color=colour, lw=1.2)
            else:
                axes.scatter(current[:, 0], current[:, 1], 1e3 * flux[:, k], color=colour, s=3, linewidths=0)
        axes.set_xlabel(CURRENT_LABELS["d"])
        axes.set_ylabel(CURRENT_LABELS["q"])
        axes.set_title(FLUX_LABELS[name], fontsize=STYLE.small_pt)
        axes.view_init(elev=22, azim=-125 if k == 0 else -60)  # psi_d is flat along i_q, and psi_q along i_d
        axes.set_box_aspect((1, 1, 0.8), zoom=0.92)
    return figure


def _paths(material: Material) -> Figure:
    figure = empty_figure(4.8, 4.6)
    axes = figure.add_subplot()
    reached = material.estimates["injection"].points.i_dq
    axes.plot(reached[:, 0], reached[:, 1], ".", color=D_COLOUR, ms=3)
    current_plane(bare(axes))
    return figure


def _inductances(material: Material) -> Figure:
    """L_dd, L_qq and L_dq over the flux plane, as the paper's."""
    grid = material.estimates["injection"].map
    zero = flux_at_zero(grid)
    psi_d, psi_q = 1e3 * (grid.psi_d - zero["d"]), 1e3 * (grid.psi_q - zero["q"])
    figure = empty_figure(11.0, 3.6)
    for axes, (key, name) in zip(
        figure.subplots(1, 3), {"l_dd": "L_{dd}", "l_qq": "L_{qq}", "l_dq": "L_{dq}"}.items(), strict=True
    ):
        values = 1e3 * np.asarray(getattr(grid, key))
        is_known = np.isfinite(values) & np.isfinite(psi_d) & np.isfinite(psi_q)
        scale = signed_scale(values[is_known]) if key == "l_dq" else {"cmap": "YlGnBu"}
        contours = axes.tricontourf(psi_d[is_known], psi_q[is_known], values[is_known], levels=14, **scale)
        figure.colorbar(contours, ax=axes).set_label("mH")
        axes.set_title(f"${name}$", fontsize=STYLE.small_pt)
        name_axes(bare(axes), *FLUX_LABELS.values())
    return figure


def _comparison(material: Material) -> Figure:
    figure = empty_figure(9.4, 4.0)
    for axes, axis in zip(figure.subplots(1, 2), "dq", strict=True):
        other = "q" if axis == "d" else "d"
        for held, colour in ((0.0, ZERO_COLOUR), (-2.0, D_COLOUR), (2.0, Q_COLOUR)):
            for grid in (material.estimates[name].map for name in ("classical", "injection")):
                current, flux, _ = profile(grid, f"psi_{axis}", axis, held)
                axes.plot(
                    current, 1e3 * (flux - flux_at_zero(grid)[axis]), BASIS_LINES[grid.basis], color=colour, lw=1.3
                )
            axes.plot([], [], color=colour, label=f"$i_{other}$ = {held:+.0f} A" if held else f"$i_{other}$ = 0")
        axes.legend(frameon=False, fontsize=STYLE.small_pt)
        name_axes(bare(axes), CURRENT_LABELS[axis], FLUX_LABELS[axis])
    return figure
