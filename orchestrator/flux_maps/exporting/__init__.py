"""Exports of a flux map: files for other tools, torque curves, saliency, the inverse map.

Knows flux maps and nothing of recordings, drives or estimators. scipy and xarray are imported where they are used.
"""

from orchestrator.flux_maps.exporting._exporting import FORMATS, ExportReport, export_map
from orchestrator.flux_maps.exporting._inverse import invert
from orchestrator.flux_maps.exporting._torque import Trajectory, mtpa, mtpv, saliency, torque_nm

__all__ = [
    "FORMATS",
    "ExportReport",
    "Trajectory",
    "export_map",
    "invert",
    "mtpa",
    "mtpv",
    "saliency",
    "torque_nm",
]
