"""Runs on disk: directory, lock, journal and provenance. The engine decides what happens in a run."""

from orchestrator.runs._directory import RunDirectory, is_run, last_end, private_directory
from orchestrator.runs._journal import Journal, JournalRecord
from orchestrator.runs._opening import open_any, refuse_file, require_file_place, without_private
from orchestrator.runs._provenance import Provenance, provenance
from orchestrator.runs._record import RunRecord
from orchestrator.runs._staging import remove_stale_staging

__all__ = [
    "Journal",
    "JournalRecord",
    "Provenance",
    "RunDirectory",
    "RunRecord",
    "is_run",
    "last_end",
    "open_any",
    "private_directory",
    "provenance",
    "refuse_file",
    "remove_stale_staging",
    "require_file_place",
    "without_private",
]
