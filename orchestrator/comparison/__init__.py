"""Runs against each other: before and after, motor A and B, cold and hot. Fits nothing: it reads what each run said."""

from orchestrator.comparison._comparing import (
    MapChange,
    Quantity,
    RunsComparison,
    SideBySide,
    compare_runs,
)
from orchestrator.comparison._rows import change_rows, run_rows
from orchestrator.comparison._said import RunSaid

__all__ = [
    "MapChange",
    "Quantity",
    "RunSaid",
    "RunsComparison",
    "SideBySide",
    "change_rows",
    "compare_runs",
    "run_rows",
]
