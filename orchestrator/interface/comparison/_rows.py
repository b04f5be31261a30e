"""A comparison of runs as rows of text, the head first, for terminal, page and viewer."""

from __future__ import annotations

from orchestrator.formatting.quantities import UNKNOWN, measured, percent, quantity, vector
from orchestrator.formatting.results import USABILITY_WORDS
from orchestrator.interface.comparison._comparison import MapChange, RunsComparison

_WORDS = {None: UNKNOWN, True: "changed", False: "same"}


def run_rows(comparison: RunsComparison) -> list[tuple[str, ...]]:
    """The runs, one per row."""
    head = ("run", "motor", "measured", "map", "verdict")
    rows = []
    for run in comparison.runs:
        how = "" if run.usable else f", {USABILITY_WORDS[run.usability]}"
        flux_map = "none" if run.method is None else f"{run.method}{how}"
        rows.append((run.name, run.motor, run.created, flux_map, run.verdict or "not diagnosed"))
    return [head, *rows]


def change_rows(comparison: RunsComparison) -> list[tuple[str, ...]]:
    """Quantities, sizes of effects and maps: whether each differs from the first run's, then a column per run."""
    names = [run.name for run in comparison.runs]
    head = ("", *(f"{name} against {names[0]}" for name in names[1:]), *names)
    rows = []
    for row in (*comparison.quantities, *comparison.effects):
        values = (UNKNOWN if v is None else measured(v.value, v.low, v.high, v.unit) for v in row.values)
        rows.append((row.name, *(_WORDS[changed] for changed in row.changed[1:]), *values))
    for label, pick in (
        ("map change, rms", lambda m: percent(m.rms_percent)),
        ("largest difference", _largest),
        ("noise of both maps", lambda m: percent(m.noise_percent)),
        ("shift along i_d", lambda m: quantity(m.slide_a, "A")),
        ("common gain", lambda m: percent(m.gain_percent)),
        ("remainder", lambda m: percent(m.left_percent)),
    ):
        changed = [_WORDS[m.changed] if label.startswith("map") else "" for m in comparison.maps]
        rows.append((label, *changed, UNKNOWN, *map(pick, comparison.maps)))
    return [head, *rows]


def _largest(change: MapChange) -> str:
    at = "" if change.largest_at is None else f" at {vector(*change.largest_at)}"
    return percent(change.largest_percent) + at
