"""Pictures of the literal page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from orchestrator.formatting.colours import BLUE, GREEN, VERMILION
from orchestrator.formatting.drawing import CURRENT_LABELS, STYLE, bare, empty_figure, name_axes
from plugins.commands.reproduction.literal._budget import Budget, along, side_by_side
from plugins.commands.reproduction.literal._evaluation import Literal

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SIGNAL, GAP = "literal-signal.png", "literal-gap.png"


def draw_all(measured: Literal, budget: Budget, folder: Path) -> None:
    """Write every picture into a folder."""
    for name, figure in ((SIGNAL, _signal(measured)), (GAP, _gap(budget))):
        figure.savefig(folder / name, dpi=STYLE.dpi, metadata={"Software": None})


def _signal(measured: Literal) -> Figure:
    """Mean current and virtual measurement in time, with the Hessian times the injected vector."""
    signal = measured.signal
    figure = empty_figure(9.4, 4.0)
    left, right = figure.subplots(1, 2)
    until = np.searchsorted(signal.time_s, signal.time_s[0] + 1.0)
    thin = slice(0, until, max(1, until // 1500))
    time_s = signal.time_s[thin]
    fitted = signal.swing[thin] @ measured.signal_hessian
    settled = 1e3 * (signal.mean - signal.mean.mean(axis=0))[len(signal.mean) // 2 :]
    for k, (axis, colour) in enumerate(zip("dq", (BLUE, GREEN), strict=True)):
        left.plot(time_s, 1e3 * (signal.mean[thin, k] - signal.mean[thin, k].mean()), color=colour, label=f"$i_{axis}$")
        right.plot(time_s, signal.ripple[thin, k], color=colour, lw=2.0, label=rf"$\tilde\imath_{axis}$")
        right.plot(time_s, fitted[:, k], "--", color="black", lw=0.8)
    left.set_ylim(*(1.3 * edge for edge in (settled.min(), settled.max())))
    name_axes(bare(left), "time [s]", "mean current less its mean [mA]")
    name_axes(bare(right), "time [s]", "virtual measurement [A]")
    for axes in (left, right):
        axes.legend(frameon=False, fontsize=STYLE.small_pt)
    return figure


def _gap(budget: Budget) -> Figure:
    """Flux by injection less flux by integration along both axes, with and without hysteresis."""
    figure = empty_figure(9.4, 4.0)
    for column, axes in enumerate(figure.subplots(1, 2)):
        axis = "dq"[column]
        for bench, colour, words in ((budget.still, BLUE, "no hysteresis"), (budget.iron, VERMILION, "hysteresis")):
            swept = along(bench.classical(), column)
            for paths, line, rule in (
                (bench.injection(), "-", "rectangles"),
                (bench.by_regression(), "--", "improved"),
            ):
                current, own, theirs = side_by_side(along(paths, column), swept, column)
                axes.plot(current, 1e3 * (own - theirs), line, color=colour, lw=1.3, label=f"{words}, {rule}")
        name_axes(bare(axes), CURRENT_LABELS[axis], rf"$\psi_{axis}$ by injection less by integration [mWb]")
    figure.axes[1].legend(frameon=False, fontsize=STYLE.small_pt)
    return figure
