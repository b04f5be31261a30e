"""Thousands of recordings as one table: found below folders and URLs, analysed by any number of workers, in Parquet.

Each recording is analysed as if it were alone; nothing here knows an estimator or an effect.
"""

from orchestrator.fleet._cluster import ClusterSettings, connected
from orchestrator.fleet._engine import Done, EngineSettings, Task, work_through
from orchestrator.fleet._fleet import FleetJob, JobReport, find_sources
from orchestrator.fleet._progress import JobProgress
from orchestrator.fleet._sources import Source, sources_below
from orchestrator.fleet._table import FleetTable, TableSettings, parts_of, read_table
from orchestrator.fleet._work import Order, Plan, bare_fields, versions, work_on

__all__ = [
    "ClusterSettings",
    "Done",
    "EngineSettings",
    "FleetJob",
    "FleetTable",
    "JobProgress",
    "JobReport",
    "Order",
    "Plan",
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
