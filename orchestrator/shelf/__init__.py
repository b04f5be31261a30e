"""The shelf of runs: an index of their folders, tags and notes, and the limits by which a motor is accepted."""

from orchestrator.shelf.acceptance import judge_acceptance
from orchestrator.shelf.facts import (
    COLUMNS,
    NUMBERS,
    QUANTITIES,
    RunFacts,
    cells,
    interval_columns,
    is_text,
    read_facts,
    with_intervals,
)
from orchestrator.shelf.index import count_stale
from orchestrator.shelf.junit import write_junit
from orchestrator.shelf.labels import load_labels, relabel, save_labels
from orchestrator.shelf.query import DEFAULT_COLUMNS, Condition, FoundRuns, RunQuery, find_runs, known_column
from orchestrator.shelf.station import NOT_ACCEPTED, JudgedRun, ask_serial, judge_run, run_folder_of, work_through

__all__ = [
    "COLUMNS",
    "DEFAULT_COLUMNS",
    "NOT_ACCEPTED",
    "NUMBERS",
    "QUANTITIES",
    "Condition",
    "FoundRuns",
    "JudgedRun",
    "RunFacts",
    "RunQuery",
    "ask_serial",
    "cells",
    "count_stale",
    "find_runs",
    "interval_columns",
    "is_text",
    "judge_acceptance",
    "judge_run",
    "known_column",
    "load_labels",
    "read_facts",
    "relabel",
    "run_folder_of",
    "save_labels",
    "with_intervals",
    "work_through",
    "write_junit",
]
