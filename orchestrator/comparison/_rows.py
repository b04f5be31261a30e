"""A comparison of runs as rows of text, the head first: alike in a terminal, on the page and in the viewer."""

from __future__ import annotations

from orchestrator.comparison._comparing import MapChange, Quantity, RunsComparison
from orchestrator.formatting.quantities import UNKNOWN, measured, percent, quantity, vector

_WORDS = {None: UNKNOWN, True: "changed", False: "same"}


def run_rows(found: RunsComparison) -> list[tuple[str, ...]]:
    """Which runs, one a row."""
    head = ("run", "motor", "measured", "map", "verdict")
    rows = [
        (run.name, run.motor, run.created, _map_words(run.method, run.usable), run.verdict or "not diagnosed")
        for run in found.runs
    ]
    return [head, *rows]


def change_rows(found: RunsComparison) -> list[tuple[str, ...]]:
    """Quantities, sizes of effects and maps: whether each differs from the first run's, then a column a run."""
    names = [run.name for run in found.runs]
    head = ("", *(f"{name} against {names[0]}" for name in names[1:]), *names)
    rows = [_quantity_row(one) for one in (*found.quantities, *found.effects)]
    for label, pick in (
        ("map apart, rms", lambda m: percent(m.rms_percent)),
        ("largest difference", _largest),
        ("noise of both maps", lambda m: percent(m.noise_percent)),
        ("slide along i_d", lambda m: quantity(m.slide_a, "A")),
        ("common gain", lambda m: percent(m.gain_percent)),
        ("left by these two", lambda m: percent(m.left_percent)),
    ):
        changed = [_WORDS[m.changed] if label.startswith("map") else "" for m in found.maps]
        rows.append((label, *changed, UNKNOWN, *map(pick, found.maps)))
    return [head, *rows]


def _quantity_row(found: Quantity) -> tuple[str, ...]:
    values = (UNKNOWN if v is None else measured(v.value, v.low, v.high, v.unit) for v in found.values)
    return found.name, *(_WORDS[changed] for changed in found.changed[1:]), *values


def _largest(found: MapChange) -> str:
    at = "" if found.largest_at is None else f" at {vector(*found.largest_at)}"
    return percent(found.largest_percent) + at


def _map_words(method: str | None, usable: bool) -> str:
    return "none" if method is None else method if usable else f"{method}, not to be relied on"
