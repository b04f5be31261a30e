"""Comparison of runs: before and after, motor A and B, cold and hot. Fits nothing: it reads each run's results."""

from orchestrator.interface.comparison._comparison import ComparedRuns, RunsComparison, compare_runs
from orchestrator.interface.comparison._rows import change_rows, run_rows
from orchestrator.interface.comparison._run_summary import RunSummary

__all__ = [
    "ComparedRuns",
    "RunSummary",
    "RunsComparison",
    "change_rows",
    "compare_runs",
    "run_rows",
]
