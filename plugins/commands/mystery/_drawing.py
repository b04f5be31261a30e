"""Draws a motor by a number: its nameplate, its true plant and the hidden effects."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from plugins.drives.simulated import usual_limits
from protocols import Limits, Motor

Rng = np.random.Generator
Parameters = dict[str, float]

HOW_MANY = {0: 0.1, 1: 0.35, 2: 0.35, 3: 0.2}
"""Probability by the number of hidden effects."""


@dataclass(frozen=True)
class Mystery:
    """A drawn motor with its public data and its sealed plant."""

    motor: Mapping[str, Any]
    """The nameplate in a procedure's form."""
    limits: Limits
    plant: Mapping[str, Any]
    """The simulated drive's sealed option `plant`."""
    seed: int
    """Seed of the sensors' noise."""


def draw(number: int) -> Mystery:
    """The motor behind a number; the same number gives the same motor."""
    rng = np.random.default_rng([number, 0x6D79_7374])
    motor = _nameplate(rng)
    count = int(rng.choice(list(HOW_MANY), p=list(HOW_MANY.values())))
    names = sorted(str(name) for name in rng.choice(sorted(_SIZES), count, replace=False))
    plant = {
        "magnetics": {
            "kind": "nameplate",
            "d_fall": _digits(rng.uniform(0.2, 0.45)),
            "q_fall": _digits(rng.uniform(0.25, 0.5)),
            "cross": _digits(rng.uniform(0.04, 0.12)),
        },
        "resistance_ohm": _digits(motor["stator_resistance_ohm"] * rng.uniform(0.96, 1.1)),
        "effects": {name: _SIZES[name](rng, motor) for name in names},
    }
    limits = usual_limits(Motor.model_validate(motor))
    return Mystery(motor, limits, plant, seed=int(rng.integers(1, 2**31)))


def _nameplate(rng: Rng) -> dict[str, Any]:
    """A variant of the 400 W machine with other power, voltage, resistance and saliency."""
    size, volts = math.exp(rng.uniform(-0.7, 0.7)), rng.uniform(110.0, 200.0)
    amps = 1.66 * size * 139.3 / volts
    ohms = volts / 139.3 / (amps / 1.66)
    torque = 2.12 * size
    l_d = 0.04325 * ohms * rng.uniform(0.8, 1.2)
    return {
        "name": f"{400 * size:.0f} W mystery motor",
        "pole_pairs": 2,
        "rated_power_w": _digits(400.0 * size),
        "rated_voltage_rms_v": _digits(volts),
        "rated_current_rms_a": _digits(amps),
        "rated_frequency_hz": 60.0,
        "rated_speed_rpm": 1800.0,
        "rated_torque_nm": _digits(torque),
        "stator_resistance_ohm": _digits(4.25 * ohms * rng.uniform(0.8, 1.2)),
        "d_inductance_h": _digits(l_d),
        "q_inductance_h": _digits(l_d * rng.uniform(1.3, 2.0)),
        "pm_flux_wb": _digits(torque / (1.5 * 2 * math.sqrt(2.0) * amps)),
    }


def _digits(value: float) -> float:
    return float(f"{value:.3g}")


def _between(rng: Rng, low: float, high: float) -> float:
    """A log-uniform value, rounded to three digits."""
    return _digits(math.exp(rng.uniform(math.log(low), math.log(high))))


def _signed(rng: Rng, low: float, high: float) -> float:
    return _between(rng, low, high) * float(rng.choice([-1.0, 1.0]))


def _amps(motor: Mapping[str, Any]) -> float:
    return float(motor["rated_current_rms_a"]) / 1.66


def _volts(motor: Mapping[str, Any]) -> float:
    return float(motor["rated_voltage_rms_v"]) / 139.3


MIN_ANGLE_RAD = 0.01
"""Smallest misalignment (electrical), above the error of the alignment itself."""


def _dead_time(rng: Rng, m: Mapping[str, Any]) -> Parameters:
    return {"voltage_v": _digits(_between(rng, 0.3, 8.0) * _volts(m)), "threshold_a": _digits(0.08 * _amps(m))}


def _hysteresis(rng: Rng, m: Mapping[str, Any]) -> Parameters:
    return {
        "half_width_a": _digits(_between(rng, 0.02, 0.08) * _amps(m)),
        "reversible_ratio": _digits(rng.uniform(0.85, 0.97)),
    }


def _heating(rng: Rng, m: Mapping[str, Any]) -> Parameters:
    watts = 17.6 / (m["stator_resistance_ohm"] * m["rated_current_rms_a"] ** 2 * 1.5)
    return {
        "rise_per_watt": _digits(_between(rng, 0.001, 0.006) * watts),
        "time_constant_s": _digits(rng.uniform(40, 300)),
    }


def _eddy(rng: Rng, m: Mapping[str, Any]) -> Parameters:
    return {"core_loss_ohm": _digits(_between(rng, 300.0, 2000.0) * _volts(m) / _amps(m))}


_SIZES: Mapping[str, Callable[[Rng, Mapping[str, Any]], Parameters]] = {
    "brake_compliance": lambda r, m: {"rad_per_nm": _digits(_between(r, 0.002, 0.02) * 2.12 / m["rated_torque_nm"])},
    "bus_sag": lambda r, m: {"per_watt": _digits(_between(r, 0.003, 0.01) / m["rated_power_w"])},
    "current_filter": lambda r, m: {"time_constant_s": _between(r, 2e-6, 20e-6)},
    "current_gain_mismatch": lambda r, m: {"gain_a_minus_b": _signed(r, 0.003, 0.03)},
    "current_nonlinearity": lambda r, m: {"cubic_per_a2": _digits(_signed(r, 5e-5, 4e-4) / _amps(m) ** 2)},
    "current_offset": lambda r, m: {
        "offset_a_a": _digits(_signed(r, 0.005, 0.05) * _amps(m)),
        "offset_b_a": _digits(_signed(r, 0.005, 0.05) * _amps(m)),
    },
    "dead_time": _dead_time,
    "device_drop": lambda r, m: {"voltage_v": _digits(_between(r, 0.5, 1.5) * _volts(m))},
    "eddy_currents": _eddy,
    "hysteresis": _hysteresis,
    "magnet_heating": lambda r, m: {
        "flux_change_wb": _digits(-_between(r, 0.01, 0.05) * m["pm_flux_wb"]),
        "time_constant_s": _digits(r.uniform(30, 150)),
    },
    "phase_resistance_imbalance": lambda r, m: {
        "extra_a_ohm": _digits(_between(r, 0.003, 0.1) * m["stator_resistance_ohm"])
    },
    "rotor_misalignment": lambda r, m: {"angle_rad": _signed(r, MIN_ANGLE_RAD, 0.09)},
    "skin_effect": lambda r, m: {"extra_ohm": _digits(_between(r, 0.3, 5.0) * _volts(m) / _amps(m))},
    "slot_harmonics": lambda r, m: {"relative": _between(r, 0.01, 0.05)},
    "voltage_bias": lambda r, m: {
        "bias_a_v": _digits(_signed(r, 0.05, 0.5) * _volts(m)),
        "bias_b_v": _digits(_signed(r, 0.05, 0.5) * _volts(m)),
    },
    "voltage_delay": lambda r, m: {"delay_s": _between(r, 3e-6, 50e-6)},
    "winding_heating": _heating,
}
"""Parameters of each effect, first the one by which guesses are judged."""
