"""One pass of the estimators over a recording, and its results as files."""

from orchestrator.estimation.estimation import estimate_recording
from orchestrator.estimation.flux_map_file import load_flux_map, save_flux_map

__all__ = ["estimate_recording", "load_flux_map", "save_flux_map"]
