"""Parameters of the plant, and the layout of its state vector."""

from __future__ import annotations

import math
from typing import NamedTuple

SQRT3 = math.sqrt(3.0)

# The state is one vector of floats, so that it can be saved and restored whole.
PSI_D, PSI_Q, THETA, OMEGA, SKIN_ALPHA, SKIN_BETA = range(6)
STOPS = 6  # three stops, (d, q) each; entries before are integrated, entries after are updated once a step
HEAT, MAGNET_A, ANCHOR, MOVING, COS, SIN = range(12, 18)
I_ALPHA, I_BETA, TORQUE, READING_A, READING_B = range(18, 23)
VOLTAGES = 24  # commanded voltages (alpha, beta) of the last four samples, newest first
DELAYED = 5
INTEGRAL_D, INTEGRAL_Q, COMMAND_D, COMMAND_Q, OVERLOAD, BUS, FILTERED_D, FILTERED_Q, IRON_D, IRON_Q = range(34, 44)
CORE_D, CORE_Q, DAMPER_D, DAMPER_Q, HOUSING, AMBIENT = range(44, 50)
# The switched inverter and its sensors (`_switching`, `_sensing`).
SUPPLY, JUNCTION, CARRIER = 50, 51, 52
"""True bus voltage [V], the devices' temperature rise [K], carrier direction at the next row (0: rising)."""
LEVEL, DUE = 53, 56
"""Level of each leg (0 or 1); time of its pending edge since the last turning point of the carrier [s]."""
FILTER_LAG_A, FILTER_LAG_B = 59, 60
"""Output of the sensors' filters minus the phase current [A]."""
SUM_A, SUM_B = 61, 62
"""Integral of the phase currents since the last row [A s]."""
DRIFT, REMANENT, LAST_CURRENT = 63, 66, 69
"""Offset drift, remanent reading and the current at the last row of each of three sensors [A]."""
SIGN_D, SIGN_Q = 72, 73
"""Present sign of the step voltage along each axis."""
STATE_LENGTH = 74

MOVING_DRIVEN = 2.0
"""`MOVING` of a rotor driven by another machine; 1: it turns by its own torque; 0: it is at rest."""


class PlantParameters(NamedTuple):
    """Parameters of the plant except its magnetic energy, in SI."""

    sample_s: float
    substeps: int
    pole_pairs: float
    resistance_ohm: float
    extra_a_ohm: float
    extra_b_ohm: float
    on_resistance_ohm: float
    dead_time_v: float
    dead_time_per_a: float
    drop_v: float
    drop_per_a: float
    bias_alpha_v: float
    bias_beta_v: float
    dc_bus_v: float
    sag_per_watt: float
    delay_samples: float
    skin_ohm: float
    skin_rate: float
    eddy_siemens: float
    core_d_per_h: float
    """Inverse inductance 1 / (R tau) of the branch parallel to the magnetising inductance."""
    core_q_per_h: float
    core_rate: float
    """1 / tau."""
    damper_d_per_h: float
    damper_q_per_h: float
    damper_rate: float
    has_branches: bool
    """Whether `_plant` advances the core and damper branches (else `_switching` does)."""
    inverter_slope_ohm: float
    """Largest dv/di of winding and inverter."""
    stop_slope: float
    """Slope of each of the three stops [A/Wb]."""
    stop_limit_a: float
    """Limit of the first stop; the others have twice and three times that."""
    stop_d_over_q: float
    """Ratio of the stops' limits along d and q."""
    has_stops: bool
    slot_per_h: float
    slot_order: float
    slot_phase: float
    magnet_final_a: float
    magnet_step: float
    """1 - exp(-h / tau)."""
    heat_per_watt: float
    heat_step: float
    """1 - exp(-h / tau)."""
    has_housing: bool
    """Whether the housing or the ambient warms as well."""
    housing_per_watt: float
    housing_step: float
    ambient_step: float
    """Relative rise of the resistance per sample by the ambient temperature."""
    twist_rad_per_nm: float
    twist_lag_s: float
    torsion_rate: float
    """Torsional resonance of rotor and brake [rad/s]; 0: first-order lag instead."""
    torsion_damping: float
    backlash_rad: float
    backlash_nm: float
    inertia: float
    viscous: float
    friction_nm: float
    """Static and Coulomb friction torque; infinite where the rotor is locked."""
    filter_s: float
    uneven: bool
    """Whether any voltage loss depends on a single phase current."""
    twists: bool
    off_ohm: float
    """Resistance that represents the blocked bridge: the current decays within a few samples."""
