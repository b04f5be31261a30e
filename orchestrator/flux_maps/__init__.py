"""Flux maps of any source: read from files, interpolated, audited and repaired.

Knows flux maps and nothing of recordings, drives or estimators. scipy and xarray are imported where they are used.
"""

from orchestrator.flux_maps._audit import MapAudit, audit_map
from orchestrator.flux_maps._basis import ROOM_C, in_ascii, magnet_basis, magnet_is_copied, resistance_basis
from orchestrator.flux_maps._faults import USES
from orchestrator.flux_maps._filling import fill_smoothly
from orchestrator.flux_maps._gridding import CSV_UNITS, MapFile
from orchestrator.flux_maps._loading import UnknownLayoutError, load_map, read_map
from orchestrator.flux_maps._magnet import has_no_rest_flux, with_magnet
from orchestrator.flux_maps._picture import draw_audit
from orchestrator.flux_maps._repair import Repair, repair_map
from orchestrator.flux_maps._suggesting import suggest_mapping
from orchestrator.flux_maps._surface import WHERE, MapSurface

__all__ = [
    "CSV_UNITS",
    "ROOM_C",
    "USES",
    "WHERE",
    "MapAudit",
    "MapFile",
    "MapSurface",
    "Repair",
    "UnknownLayoutError",
    "audit_map",
    "draw_audit",
    "fill_smoothly",
    "has_no_rest_flux",
    "in_ascii",
    "load_map",
    "magnet_basis",
    "magnet_is_copied",
    "read_map",
    "repair_map",
    "resistance_basis",
    "suggest_mapping",
    "with_magnet",
]
