"""Statistics of a fleet's table: distributions, outliers, drift, batches, control limits, pairs."""

from orchestrator.fleet.statistics._limits import read_limits, require_known
from orchestrator.fleet.statistics._pairs import WITHIN
from orchestrator.fleet.statistics._priors import priors_of
from orchestrator.fleet.statistics._reporting import report_of
from orchestrator.fleet.statistics._rows import (
    SECTIONS,
    change_rows,
    count_rows,
    date,
    judgement_rows,
    outlier_rows,
    pair_rows,
    prior_rows,
)
from orchestrator.fleet.statistics._table import FleetTable, fleet_of, read_fleet

__all__ = [
    "SECTIONS",
    "WITHIN",
    "FleetTable",
    "change_rows",
    "count_rows",
    "date",
    "fleet_of",
    "judgement_rows",
    "outlier_rows",
    "pair_rows",
    "prior_rows",
    "priors_of",
    "read_fleet",
    "read_limits",
    "report_of",
    "require_known",
]
