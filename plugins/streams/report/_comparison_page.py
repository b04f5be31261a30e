"""Runs side by side as a page: the tables of `fluxbench compare RUN RUN...`, and the maps over each other."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from orchestrator.formatting.colours import BLUE, GREEN, ORANGE, PURPLE, VERMILION
from orchestrator.formatting.drawing import STYLE, current_plane, label, legend_above, name_axes, new_figure, uri
from orchestrator.formatting.sentences import typographic
from orchestrator.interface.api import compare_runs
from orchestrator.interface.comparison import ComparedRuns, change_rows, run_rows
from orchestrator.recording import replace_file
from plugins.streams.report._content import Picture
from plugins.streams.report._page import filled

FILE_NAME = "comparison.html"
_COLOURS = (BLUE, VERMILION, GREEN, PURPLE, ORANGE)
_LINES = ("-", "--", ":", "-.")


def write_comparison(paths: Sequence[Path], out: Path | None = None) -> Path:
    """Make the page of several runs; into ``comparison.html`` here by default.

    Raises
    ------
    RecordingError
        Where one of them is none, or was not estimated.
    StorageError
        Where the file cannot be written.
    """
    runs = compare_runs(*paths)
    comparison = runs.comparison
    page = filled(
        "comparison.html",
        title=" · ".join(run.name for run in comparison.runs),
        remarks=[typographic(remark.text) for remark in comparison.remarks],
        runs=run_rows(comparison),
        changes=change_rows(comparison),
        pictures=list(_pictures(runs)),
    )
    target = out if out is not None else Path(FILE_NAME)
    replace_file(target, page.encode("utf-8"))
    return target


def _pictures(compared: ComparedRuns) -> Iterator[Picture]:
    if not any(run.surface for run in compared.runs):
        yield Picture("Maps", "Not drawn: no run has a flux map.")
        return
    for k, (axis, other) in enumerate((("d", "q"), ("q", "d"))):
        caption = f"Less its value at zero current; i_{other} held at zero, and at half of the largest."
        yield Picture(f"ψ_{axis} over i_{axis}", caption, _fluxes(compared, k))
    for k, change in enumerate(compared.comparison.maps, start=1):
        if change.rms_percent is not None:
            title = f"{compared.comparison.runs[k].name} minus {compared.comparison.runs[0].name}"
            yield Picture(title, "Length of the flux’ difference in mWb.", _difference(compared, k))


def _fluxes(compared: ComparedRuns, axis: int) -> str:
    figure, axes = new_figure()
    for n, run in enumerate(compared.runs):
        if run.surface is None:
            continue
        nodes, across = (run.surface.i_d, run.surface.i_q)[axis], (run.surface.i_d, run.surface.i_q)[1 - axis]
        x = np.linspace(nodes[0], nodes[-1], 121)
        for m, held in enumerate((0.0, 0.5 * float(across[-1]))):
            at = np.column_stack((x, np.full_like(x, held))[:: 1 if axis == 0 else -1])
            psi = 1e3 * (run.surface.psi(at) - run.surface.psi(np.zeros((1, 2))))[:, axis]
            psi[~run.surface.inside(at)] = np.nan
            name = None if m else label(compared.comparison.runs[n].name, 18)
            axes.plot(x, psi, _LINES[n % len(_LINES)], color=_COLOURS[n % len(_COLOURS)], lw=1.4, label=name)
    letter = "dq"[axis]
    name_axes(axes, f"$i_{letter}$ [A]", f"$\\psi_{letter}$ [mWb]")
    legend_above(axes, min(len(compared.runs), 3))
    return uri(figure)


def _difference(compared: ComparedRuns, run: int) -> str:
    figure, axes = new_figure()
    first = compared.runs[0].surface
    assert first is not None  # a difference was made with it
    length = 1e3 * np.linalg.norm(compared.flux_change(run), axis=2)
    mesh = axes.pcolormesh(first.i_d, first.i_q, length.T, shading="nearest", cmap="viridis", rasterized=True)
    figure.colorbar(mesh, ax=axes).ax.tick_params(labelsize=STYLE.small_pt)
    current_plane(axes)
    return uri(figure)
