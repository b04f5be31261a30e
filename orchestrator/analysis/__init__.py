"""Pure computation on recordings: frames, demodulation, sweeps, integration, flux maps and their checks.

Depends on waveforms and currents only, and on no drive, plugin or engine. Functions import scipy, numba and xarray
where they use them.
"""

from orchestrator.analysis._between import steep_steps
from orchestrator.analysis._captures import each_capture
from orchestrator.analysis._checks import (
    band_percent,
    check_map,
    difference_percent,
    flux_at,
    rated_flux_wb,
    reference_flux_wb,
    values_at,
)
from orchestrator.analysis._crossings import Network, crossings_of, join_paths
from orchestrator.analysis._energy_fit import EnergyFit
from orchestrator.analysis._energy_polynomial import PolynomialFit, fit_polynomial
from orchestrator.analysis._energy_search import fit_energy
from orchestrator.analysis._integration import Inductances, IntegratedFlux, flux_steps, integrate, invert
from orchestrator.analysis._next_point import Candidate, KnownMap, injected_points, known_map
from orchestrator.analysis._phase_loss import NO_LOSS, PhaseLoss
from orchestrator.analysis._resistance import (
    COPPER_PER_K,
    DEFAULT_RESISTANCE_STD_RATIO,
    KnownResistance,
    known_resistance,
    temperature_rise,
)
from orchestrator.analysis._ripple import Ripple, axis_difference_rad, demodulate, fixed_axis_rad, injection_frequency
from orchestrator.analysis._ripple_regression import ONE_AXIS_ERROR
from orchestrator.analysis._rotor_lock import judge_lock, lock_duration_ratio
from orchestrator.analysis._row_decay import decay_weight, exact_inductance
from orchestrator.analysis._spin import (
    SpinFit,
    SpunPoints,
    fit_spin,
    flux_by_emf,
    magnet_axis,
    require_emf_follows_angle,
    rotor_angles_rad,
    spun_points,
)
from orchestrator.analysis._steady_currents import Dwell, mean_over_dwell
from orchestrator.analysis._step_trace import STEP_KNOTS, StepTrace, count_reversals, trace_steps
from orchestrator.analysis._steps import Priors, StepsFit, fit_steps
from orchestrator.analysis._sweep import (
    FluxPath,
    Sweep,
    SweepTrace,
    find_dwells,
    flux_from_dwells,
    sweep_of,
    trace_sweep,
)
from orchestrator.analysis._voltage_losses import KNOTS, VoltageLosses, close_loops

__all__ = [
    "COPPER_PER_K",
    "DEFAULT_RESISTANCE_STD_RATIO",
    "KNOTS",
    "NO_LOSS",
    "ONE_AXIS_ERROR",
    "STEP_KNOTS",
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
    "Priors",
    "Ripple",
    "SpinFit",
    "SpunPoints",
    "StepTrace",
    "StepsFit",
    "Sweep",
    "SweepTrace",
    "VoltageLosses",
    "axis_difference_rad",
    "band_percent",
    "check_map",
    "close_loops",
    "count_reversals",
    "crossings_of",
    "decay_weight",
    "demodulate",
    "difference_percent",
    "each_capture",
    "exact_inductance",
    "find_dwells",
    "fit_energy",
    "fit_polynomial",
    "fit_spin",
    "fit_steps",
    "fixed_axis_rad",
    "flux_at",
    "flux_by_emf",
    "flux_from_dwells",
    "flux_steps",
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
    "mean_over_dwell",
    "rated_flux_wb",
    "reference_flux_wb",
    "require_emf_follows_angle",
    "rotor_angles_rad",
    "spun_points",
    "steep_steps",
    "sweep_of",
    "temperature_rise",
    "trace_steps",
    "trace_sweep",
    "values_at",
]
