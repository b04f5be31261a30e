"""Pure computation on recordings: frames, demodulation, sweeps, integration, flux maps and their checks.

Depends on waveforms and currents only, and on no drive, plugin or engine. Functions import scipy, numba and xarray
where they use them.
"""

from orchestrator.analysis._between import steep_steps
from orchestrator.analysis._checks import check_map, difference_percent, flux_at, rated_flux_wb, reference_flux_wb
from orchestrator.analysis._crossings import Network, crossings_of, join_paths
from orchestrator.analysis._each_capture import each_capture
from orchestrator.analysis._energy_fit import EnergyFit
from orchestrator.analysis._energy_polynomial import PolynomialFit, fit_polynomial
from orchestrator.analysis._energy_search import fit_energy
from orchestrator.analysis._integration import Inductances, IntegratedFlux, along, integrate, invert
from orchestrator.analysis._next_point import Candidate, KnownMap, injected_points, known_map
from orchestrator.analysis._phase_loss import NO_LOSS, PhaseLoss
from orchestrator.analysis._resistance import (
    COPPER_PER_K,
    UNSTATED,
    KnownResistance,
    known_resistance,
    temperature_rise,
)
from orchestrator.analysis._ripple import Ripple, axes_apart_rad, demodulate, injection_frequency, one_way_rad
from orchestrator.analysis._ripple_regression import ONE_AXIS
from orchestrator.analysis._rotor_lock import judge_lock, lock_duration_ratio
from orchestrator.analysis._row_decay import decay_weight, exact_inductance
from orchestrator.analysis._spin import (
    SpinFit,
    SpunPoints,
    fit_spin,
    flux_by_emf,
    magnet_axis,
    require_emf_turns_with,
    spun_points,
    theta_of,
)
from orchestrator.analysis._steady_currents import Dwell, dwell
from orchestrator.analysis._step_trace import STEP_KNOTS, StepTrace, trace_steps, turns_of
from orchestrator.analysis._steps import Beliefs, StepsFit, fit_steps
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
from orchestrator.analysis._voltage_losses import KNOTS, VoltageLosses, close_loops

__all__ = [
    "COPPER_PER_K",
    "KNOTS",
    "NO_LOSS",
    "ONE_AXIS",
    "STEP_KNOTS",
    "UNSTATED",
    "Beliefs",
    "Candidate",
    "Dwell",
    "EnergyFit",
    "FluxPath",
    "Inductances",
    "IntegratedFlux",
    "KnownMap",
    "KnownResistance",
    "Network",
    "PhaseLoss",
    "PolynomialFit",
    "Ripple",
    "SpinFit",
    "SpunPoints",
    "StepTrace",
    "StepsFit",
    "Sweep",
    "SweepTrace",
    "VoltageLosses",
    "along",
    "axes_apart_rad",
    "check_map",
    "close_loops",
    "crossings_of",
    "decay_weight",
    "demodulate",
    "difference_percent",
    "dwell",
    "each_capture",
    "evaluate_sweep",
    "exact_inductance",
    "find_dwells",
    "fit_energy",
    "fit_polynomial",
    "fit_spin",
    "fit_steps",
    "flux_at",
    "flux_by_emf",
    "flux_by_rests",
    "injected_points",
    "injection_frequency",
    "integrate",
    "invert",
    "join_paths",
    "judge_lock",
    "known_map",
    "known_resistance",
    "lock_duration_ratio",
    "magnet_axis",
    "one_way_rad",
    "rated_flux_wb",
    "reference_flux_wb",
    "require_emf_turns_with",
    "spun_points",
    "steep_steps",
    "sweep_of",
    "temperature_rise",
    "theta_of",
    "trace_steps",
    "trace_sweep",
    "turns_of",
]
