"""The shelf of runs: an index of their folders, tags and notes, and the limits by which a motor is accepted."""

from orchestrator.shelf.acceptance import judge_acceptance
from orchestrator.shelf.facts import COLUMNS, NUMBERS, RunFacts, read_facts
from orchestrator.shelf.labels import relabel, save_labels
from orchestrator.shelf.query import (
    DEFAULT_COLUMNS,
    Condition,
    FoundRuns,
    RunQuery,
    cells,
    find_runs,
    known_column,
)

__all__ = [
    "COLUMNS",
    "DEFAULT_COLUMNS",
    "NUMBERS",
    "Condition",
    "FoundRuns",
    "RunFacts",
    "RunQuery",
    "cells",
    "find_runs",
    "judge_acceptance",
    "known_column",
    "read_facts",
    "relabel",
    "save_labels",
]
