"""One pass of the estimators over a recording, and its results as files."""

from orchestrator.estimation.delivery import deliver_model, estimate_of_map
from orchestrator.estimation.estimation import estimate_recording
from orchestrator.estimation.flux_map_file import flux_dataset, load_flux_map, load_own_flux_map, save_flux_map
from orchestrator.estimation.results import RECOMMENDED_MAP, has_estimates, load_estimates
from orchestrator.estimation.staging import staging_folder
from orchestrator.estimation.usability import missing_model, model_check

__all__ = [
    "RECOMMENDED_MAP",
    "deliver_model",
    "estimate_of_map",
    "estimate_recording",
    "flux_dataset",
    "has_estimates",
    "load_estimates",
    "load_flux_map",
    "load_own_flux_map",
    "missing_model",
    "model_check",
    "save_flux_map",
    "staging_folder",
]
