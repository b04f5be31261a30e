"""Plain tables and numbers for a person, alike on a terminal and in a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def print_table(headings: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Columns as wide as they need to be; the first to the left, the others to the right."""
    widths = [max(len(line[k]) for line in (headings, *rows)) for k in range(len(headings))]
    for line in (headings, ["-" * width for width in widths], *rows):
        cells = [
            line[0].ljust(widths[0]),
            *(cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True)),
        ]
        print("  ".join(cells).rstrip())


def amount(value: float | None, unit: str) -> str:
    """Three digits and a unit; a dash where there is no number."""
    # Zero has no sign here.
    return "-" if value is None else f"{value + 0.0:.4g} {unit}"


def duration(seconds: float) -> str:
    """Seconds below two minutes, then minutes and seconds."""
    if seconds < 120:
        return f"{seconds:.3g} s"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s"


def stage_as_yaml(stage: Mapping[str, Any]) -> str:
    """A stage as it stands in a procedure's `stages`, ready to paste."""
    import yaml

    lines = yaml.safe_dump([dict(stage)], sort_keys=False, default_flow_style=None, width=100).splitlines()
    return "\n".join(f"  {line}" for line in lines)
