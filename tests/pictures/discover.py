"""`python -m tests.pictures.discover [FOLDER]`: the worked cases of docs/discover.md, each as one picture.

Left the law that was learned, right the held-out error before and after. Recordings and results are kept in
``runs/discover``, and what is there is not made again.
"""

from __future__ import annotations

import sys
from pathlib import Path

import fluxbench
from orchestrator.discovery import Discovery, draw_law, load_discovery
from orchestrator.formatting.drawing import BEFORE_COLOUR, STYLE, bare, empty_figure, name_axes
from tests.laws.subjects import subject
from tests.pictures.report import PICTURES

CASES = {
    "poor-joint": ("foreign:0", 55806391),
    "drifting-gain": ("foreign:3", 55806391),
    "resistance-step": ("foreign:1", 20261202),
    "saturating-sensor": ("foreign:4", 20261202),
    "creeping-brake": ("foreign:15", 20261202),
    "skin-effect": ("left_out:11", 20261202),
}
"""Recordings of the blind suite, by the name of their picture and folder."""
NAMES = tuple(f"discover-{name}" for name in CASES)
WORK = Path("runs/discover")
SIZE_IN, DPI = (8.2, 3.2), 80


def discover_pictures(folder: Path) -> tuple[Path, ...]:
    """Draw every case; those that are not in `WORK` are recorded, diagnosed and learned from, for minutes."""
    return tuple(_drawn(learned(name), folder / f"discover-{name}.png") for name in CASES)


def learned(name: str) -> Discovery:
    """What is learned of a case."""
    label, seed = CASES[name]
    hidden, place = subject(label, seed), WORK / name
    if not (place / "recording.json").exists():
        hidden.record(place)
    found = load_discovery(place)
    return found if found is not None else fluxbench.discover(place, without=hidden.without)


def _drawn(found: Discovery, picture: Path) -> Path:
    figure = empty_figure(*SIZE_IN)
    left, right = figure.subplots(1, 2, width_ratios=(3, 2))
    draw_law(bare(left), found.laws[0])
    errors = {"before": found.before_rms_v, "with the law": found.after_rms_v, "noise": found.floor_rms_v}
    values = [1e3 * (volts or 0.0) for volts in errors.values()]
    bars = bare(right).barh(list(errors), values, color=[BEFORE_COLOUR, "#D55E00", "#0072B2"])
    right.invert_yaxis()
    right.bar_label(bars, [f"{value:.3g}" for value in values], padding=3, fontsize=STYLE.small_pt)
    name_axes(right, "held-out error [mV]", "")
    right.set_xlim(0.0, 1.2 * max(values))
    figure.savefig(picture, dpi=DPI)
    return picture


if __name__ == "__main__":
    for made in discover_pictures(Path(sys.argv[1]) if len(sys.argv) > 1 else PICTURES):
        print(made)
