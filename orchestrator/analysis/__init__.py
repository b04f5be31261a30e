"""Pure computation on recordings: frames, demodulation, sweeps, integration, flux maps and their checks.

Knows waveforms and currents; drives, plugins and the engine it has never heard of. scipy, numba and xarray are
imported where they are used.
"""

from orchestrator.analysis._checks import check_map, difference_percent, flux_at, rated_flux_wb
from orchestrator.analysis._crossings import Network, join_paths
from orchestrator.analysis._dwells import Dwell, dwell
from orchestrator.analysis._estimation import estimate_recording
from orchestrator.analysis._flux_map_file import load_flux_map, save_flux_map
from orchestrator.analysis._frames import to_ab, to_dq
from orchestrator.analysis._integration import Inductances, IntegratedFlux, along, integrate, invert
from orchestrator.analysis._lock import judge_lock
from orchestrator.analysis._report import EstimationReport, ResistanceReport
from orchestrator.analysis._ripple import Ripple, demodulate, injection_frequency
from orchestrator.analysis._surface import SmoothSurface, TaylorSurface, current_axes, inside_hull, require_area
from orchestrator.analysis._sweep import FluxPath, Sweep, evaluate_sweep, find_dwells

__all__ = [
    "Dwell",
    "EstimationReport",
    "FluxPath",
    "Inductances",
    "IntegratedFlux",
    "Network",
    "ResistanceReport",
    "Ripple",
    "SmoothSurface",
    "Sweep",
    "TaylorSurface",
    "along",
    "check_map",
    "current_axes",
    "demodulate",
    "difference_percent",
    "dwell",
    "estimate_recording",
    "evaluate_sweep",
    "find_dwells",
    "flux_at",
    "injection_frequency",
    "inside_hull",
    "integrate",
    "invert",
    "join_paths",
    "judge_lock",
    "load_flux_map",
    "rated_flux_wb",
    "require_area",
    "save_flux_map",
    "to_ab",
    "to_dq",
]
