"""What the plant is and remembers, in numbers: its parameters, and the layout of its state. Nothing moves here."""

from __future__ import annotations

import math
from typing import NamedTuple

SQRT3 = math.sqrt(3.0)

# The state, one vector of floats so that it can be saved and taken up again as it is.
PSI_D, PSI_Q, THETA, OMEGA, SKIN_ALPHA, SKIN_BETA = range(6)
STOPS = 6  # three stops, (d, q) each; what is before them is integrated, what follows is moved once a step
HEAT, MAGNET_A, ANCHOR, MOVING, COS, SIN = range(12, 18)
I_ALPHA, I_BETA, TORQUE, READING_A, READING_B = range(18, 23)
VOLTAGES = 24  # commanded voltages (alpha, beta) of the last four samples, newest first
DELAYED = 5
INTEGRAL_D, INTEGRAL_Q, COMMAND_D, COMMAND_Q, SPENT, BUS, SHOWN_D, SHOWN_Q, IRON_D, IRON_Q = range(34, 44)
CORE_D, CORE_Q, DAMPER_D, DAMPER_Q, HOUSING, AMBIENT = range(44, 50)
SWITCHED = 50
"""From here on: what a switched inverter and its sensors remember (`_switching`, `_sensing`)."""
SUPPLY, JUNCTION, CARRIER = 50, 51, 52
"""True bus voltage, the devices' heat, which half of the carrier the next row begins with."""
LEVEL, DUE = 53, 56
"""Of three legs: high or low; when a pending edge comes, from the start of the carrier's half on."""
BEHIND_A, BEHIND_B = 59, 60
"""How far the sensors' filters are behind the phase currents."""
SUM_A, SUM_B = 61, 62
"""Integral of the phase currents since the last row [A s]."""
DRIFT, REMANENT, BEFORE = 63, 66, 69
"""Of three sensors: offset walked so far, what the core remembers, the current at the last row [A]."""
SIGN_D, SIGN_Q = 72, 73
"""Which way the voltage of steps points now, along each axis."""
STATE_LENGTH = 74

MOVING_DRIVEN = 2.0
"""`MOVING` of a rotor that another machine turns, whatever its torque; 1: it moves by itself; 0: it rests."""


class PlantParameters(NamedTuple):
    """All numbers of the plant but its energy, in SI."""

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
    """Of the branch beside the magnetising inductance: 1 / (R tau)."""
    core_q_per_h: float
    core_rate: float
    """1 / tau."""
    damper_d_per_h: float
    damper_q_per_h: float
    damper_rate: float
    has_branches: bool
    """Whether core and damper are branches that this plant's step moves itself."""
    inverter_slope_ohm: float
    """Largest of the inverter's dv/di."""
    stop_slope: float
    """Of each of the three stops [A/Wb]."""
    stop_limit_a: float
    """Of the first; the others' are twice and three times that."""
    stop_d_over_q: float
    """Of the limits."""
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
    """Whether the winding stands on a housing, and in a room, that warm as well."""
    housing_per_watt: float
    housing_step: float
    ambient_step: float
    """By which the resistance rises in a sample, whatever flows, relative."""
    twist_rad_per_nm: float
    twist_lag_s: float
    torsion_rate: float
    """Of the rotor on the brake's spring [rad/s]; 0: it follows with the lag."""
    torsion_damping: float
    backlash_rad: float
    backlash_nm: float
    inertia: float
    viscous: float
    friction_nm: float
    """Torque that sets the rotor moving, and that brakes it then; infinite where it is locked."""
    filter_s: float
    uneven: bool
    """Whether the phases lose voltage each on its own."""
    twists: bool
    off_ohm: float
    """What the blocked bridge looks like: drains the current within a few samples."""
