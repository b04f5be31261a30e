"""Pure computation on recordings: frames, demodulation, sweeps, integration, flux maps and their checks.

Knows waveforms and currents; drives, plugins and the engine it has never heard of. scipy, numba and xarray are
imported where they are used.
"""

from orchestrator.analysis._checks import check_map, difference_percent, flux_at, flux_ratio, rated_flux_wb
from orchestrator.analysis._crossings import Network, join_paths
from orchestrator.analysis._dwells import Dwell, dwell
from orchestrator.analysis._energy_fit import EnergyFit
from orchestrator.analysis._energy_search import fit_energy
from orchestrator.analysis._estimation import estimate_recording
from orchestrator.analysis._flux_map_file import load_flux_map, save_flux_map
from orchestrator.analysis._frames import to_ab, to_dq
from orchestrator.analysis._integration import Inductances, IntegratedFlux, along, integrate, invert
from orchestrator.analysis._lock import judge_lock
from orchestrator.analysis._loops import KNOTS, VoltageLosses, close_loops
from orchestrator.analysis._report import EstimationReport, ResistanceReport
from orchestrator.analysis._ripple import Ripple, demodulate, injection_frequency
from orchestrator.analysis._surface import SmoothSurface, TaylorSurface, current_axes, inside_hull, require_area
from orchestrator.analysis._sweep import (
    FluxPath,
    Sweep,
    SweepTrace,
    evaluate_sweep,
    find_dwells,
    flux_by_rests,
    sweep_of,
    trace_sweep,
)

__all__ = [
    "KNOTS",
    "Dwell",
    "EnergyFit",
    "EstimationReport",
    "FluxPath",
    "Inductances",
    "IntegratedFlux",
    "Network",
    "ResistanceReport",
    "Ripple",
    "SmoothSurface",
    "Sweep",
    "SweepTrace",
    "TaylorSurface",
    "VoltageLosses",
    "along",
    "check_map",
    "close_loops",
    "current_axes",
    "demodulate",
    "difference_percent",
    "dwell",
    "estimate_recording",
    "evaluate_sweep",
    "find_dwells",
    "fit_energy",
    "flux_at",
    "flux_by_rests",
    "flux_ratio",
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
    "sweep_of",
    "to_ab",
    "to_dq",
    "trace_sweep",
]
