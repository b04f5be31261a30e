"""Thousands of recordings, one table: found below folders and URLs, worked on by however many workers, kept as Parquet.

Each recording is analysed as one alone would be; nothing here knows an estimator or an effect.
"""

from orchestrator.fleet._cluster import ClusterSettings, connected
from orchestrator.fleet._engine import Done, EngineSettings, Task, work_through
from orchestrator.fleet._fleet import FailedSource, FleetJob, JobReport, find_sources
from orchestrator.fleet._progress import Progress
from orchestrator.fleet._sources import Source, sources_below
from orchestrator.fleet._table import FleetTable, TableSettings, parts_of, read_table
from orchestrator.fleet._work import Order, Plan, bare_fields, versions, work_on

__all__ = [
    "ClusterSettings",
    "Done",
    "EngineSettings",
    "FailedSource",
    "FleetJob",
    "FleetTable",
    "JobReport",
    "Order",
    "Plan",
    "Progress",
    "Source",
    "TableSettings",
    "Task",
    "bare_fields",
    "connected",
    "find_sources",
    "parts_of",
    "read_table",
    "sources_below",
    "versions",
    "work_on",
    "work_through",
]
