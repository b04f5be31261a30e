"""What may be hidden: the catalogue's effects in forms of their own, and foreign ones that no catalogue has.

Sizes are those of the 400 W machine and are scaled to others; no case is made up here.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tests.blind.magnetics import PM400, Machine

Rng = np.random.Generator
Changes = dict[str, float]


@dataclass(frozen=True)
class Size:
    """A catalogue effect's range, and what a size of it does to the plant."""

    low: float
    typical: float
    high: float
    build: Callable[[Rng, float, Machine], tuple[Changes, dict[str, float]]]
    inverse: bool = False

    def relative(self, value: float) -> float:
        return self.typical / value if self.inverse else value / self.typical


def _sign(rng: Rng) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _volts(m: Machine) -> float:
    return m.bus_v / PM400.bus_v


def _amps(m: Machine) -> float:
    return m.rated_current_rms_a / PM400.rated_current_rms_a


def _ohms(m: Machine) -> float:
    return m.resistance_ohm / PM400.resistance_ohm


def _henries(m: Machine) -> float:
    return m.l_q_h / PM400.l_q_h


def _dead_time(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    volts, knee = v * _volts(m), float(np.exp(rng.uniform(np.log(0.02), np.log(0.15)))) * _amps(m)
    return {"dead_v": volts, "dead_a": knee, "dead_shape": int(rng.integers(3)), "substeps": 4}, {"voltage_v": volts}


def _device_drop(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    volts = v * _volts(m)
    return {"drop_v": volts, "drop_a": rng.uniform(0.008, 0.025) * _amps(m), "substeps": 4}, {"voltage_v": volts}


def _bus_sag(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    per_watt = v / m.rated_power_w
    return {"sag_per_watt": per_watt, "sag_s": rng.uniform(0.5e-3, 3e-3)}, {"per_watt": per_watt}


def _voltage_delay(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    late = v * PM400.injection_hz / m.injection_hz
    return {"delay_samples": late * m.sampling_hz}, {"delay_s": late}


def _current_filter(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    lag = v * PM400.injection_hz / m.injection_hz
    return {"filter_s": lag, "substeps": 4}, {"time_constant_s": lag}


def _gain_mismatch(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    g = _sign(rng) * v
    return {"gain_a": 1 + g / 2, "gain_b": 1 - g / 2}, {"gain_a_minus_b": g}


def _resistance_imbalance(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    extra = v * m.resistance_ohm
    if rng.random() < 0.5:
        return {"extra_a": extra}, {"extra_a_ohm": extra, "extra_b_ohm": 0.0}
    return {"extra_b": extra}, {"extra_a_ohm": 0.0, "extra_b_ohm": extra}


def _current_offset(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    a, b = _sign(rng) * v * _amps(m), rng.uniform(-1, 1) * v * _amps(m)
    return {"offset_a": a, "offset_b": b}, {"offset_a_a": a, "offset_b_a": b}


def _voltage_bias(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    a, b = _sign(rng) * v * _volts(m), rng.uniform(-1, 1) * v * _volts(m)
    return {"bias_a": a, "bias_b": b}, {"bias_a_v": a, "bias_b_v": b}


def _nonlinearity(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    cubic = _sign(rng) * v / (1.67 * m.top_a) ** 2
    return {"cubic": cubic}, {"cubic_per_a2": cubic}


def _heating(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    rise = v / (_ohms(m) * _amps(m) ** 2)
    share = rng.uniform(0.3, 0.7)
    return {
        "heat_fast": share * rise, "heat_fast_s": rng.uniform(20, 60), "heat_slow": (1 - share) * rise,
        "heat_slow_s": rng.uniform(150, 500),
    }, {}  # fmt: skip


def _skin(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    slow = rng.uniform(20, 60)
    extra = v * _henries(m)
    return {"skin_ohm": extra, "skin_slow_hz": slow, "skin_fast_hz": rng.uniform(2, 5) * slow}, {"extra_ohm": extra}


def _eddy(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    ohm = v * _henries(m) * m.injection_hz / PM400.injection_hz
    late = rng.uniform(0.1, 0.25) / m.sampling_hz
    return {"eddy_ohm": ohm, "eddy_s": late, "substeps": 8}, {"core_loss_ohm": ohm}


def _hysteresis(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    half, knee_wb = v * _amps(m), rng.uniform(5e-3, 15e-3) * _henries(m) * _amps(m)
    return {
        "loop_a": half, "loop_per_wb": 0.5 * half / knee_wb, "loop_power": rng.uniform(1.0, 3.0), "substeps": 4,
    }, {}  # fmt: skip


def _misalignment(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    angle = _sign(rng) * np.deg2rad(v)
    return {"angle": angle}, {"angle_rad": angle}


def _twist(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    twist = v * PM400.rated_torque_nm / m.rated_torque_nm
    return {"twist": twist, "twist_s": rng.uniform(0.5e-3, 4e-3)}, {"rad_per_nm": twist}


def _magnet(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    return {"magnet_a": -v * _amps(m), "magnet_s": rng.uniform(20, 150)}, {}


def _slots(rng: Rng, v: float, m: Machine) -> tuple[Changes, dict[str, float]]:
    return {"slot": v}, {}


CATALOGUE: dict[str, Size] = {
    "dead_time": Size(0.2, 8.0, 11.0, _dead_time),
    "device_drop": Size(0.8, 1.0, 1.2, _device_drop),
    "bus_sag": Size(0.002, 0.005, 0.01, _bus_sag),
    "voltage_delay": Size(1e-6, 10e-6, 50e-6, _voltage_delay),
    "current_filter": Size(1e-6, 5e-6, 20e-6, _current_filter),
    "current_gain_mismatch": Size(0.002, 0.01, 0.03, _gain_mismatch),
    "phase_resistance_imbalance": Size(0.002, 0.005, 0.1, _resistance_imbalance),
    "current_offset": Size(0.005, 0.015, 0.05, _current_offset),
    "voltage_bias": Size(0.05, 0.15, 0.5, _voltage_bias),
    "current_nonlinearity": Size(0.001, 0.003, 0.01, _nonlinearity),
    "winding_heating": Size(0.001, 0.003, 0.006, _heating),
    "skin_effect": Size(0.3, 1.0, 5.0, _skin),
    "eddy_currents": Size(300.0, 1000.0, 3000.0, _eddy, inverse=True),
    "hysteresis": Size(0.01, 0.025, 0.04, _hysteresis),
    "rotor_misalignment": Size(0.5, 2.0, 5.0, _misalignment),
    "brake_compliance": Size(0.002, 0.005, 0.02, _twist),
    "magnet_heating": Size(0.05, 0.15, 0.3, _magnet),
    "slot_harmonics": Size(0.01, 0.03, 0.05, _slots),
}
"""Ranges of the catalogue: V, V, of the voltage at rated power, s, s, relative, of R_s, A, V, of full scale, 1/W,
ohm, ohm, A (half the loop's width), degrees electrical, rad/Nm, A along i_d, relative."""


FOREIGN: dict[str, Callable[[Rng], Changes]] = {
    "poor_contact": lambda r: {"contact_ohm": r.uniform(0.5, 3), "contact_a": r.uniform(0.1, 0.5), "substeps": 4},
    "resistance_step": lambda r: {"step_ohm": r.uniform(0.1, 0.5), "step_at_s": r.uniform(15, 50)},
    "drifting_sensor": lambda r: {"drift_a_per_s": _sign(r) * r.uniform(2e-4, 1e-3)},
    "sensor_gain_drift": lambda r: {"gain_drift_per_s": _sign(r) * r.uniform(1e-4, 5e-4)},
    "saturating_sensor": lambda r: {"clip_a": r.uniform(4.0, 6.0)},
    "mains_hum": lambda r: {"hum_a": r.uniform(0.01, 0.04)},
    "interleaved_adc": lambda r: {"odd_offset": _sign(r) * r.uniform(0.005, 0.02), "odd_gain": r.uniform(-0.01, 0.01)},
    "sticky_quantiser": lambda r: {"stick_a": r.uniform(0.02, 0.06)},
    "lost_samples": lambda r: {"glitch": r.uniform(-2.3, -1.6)},
    "sensor_crosstalk": lambda r: {"crosstalk": _sign(r) * r.uniform(0.005, 0.03)},
    "unlogged_bus_ripple": lambda r: {"bus_ripple": r.uniform(0.03, 0.1), "bus_ripple_hz": r.uniform(280, 320)},
    "wandering_clock": lambda r: {"clock_wander": _sign(r) * r.uniform(1e-4, 5e-4)},
    "coarse_pwm_counter": lambda r: {"step_v": r.uniform(0.5, 2.0)},
    "warming_dead_time": lambda r: {
        "dead_v": r.uniform(1, 6), "dead_a": r.uniform(0.03, 0.1), "dead_trend_per_s": r.uniform(2e-3, 8e-3),
        "substeps": 4,
    },
    "loose_phase": lambda r: {"loose_ohm": r.uniform(0.1, 0.5), "loose_rate": 3.7},
    "brake_creep": lambda r: {"creep_rad": _sign(r) * r.uniform(0.02, 0.08), "creep_s": r.uniform(10, 60)},
    "brake_slip": lambda r: {"slip_rad": _sign(r) * r.uniform(0.01, 0.05), "slip_at_s": r.uniform(15, 50)},
    "magnetic_viscosity": lambda r: {"viscous_per_wb": r.uniform(0.3, 1.5), "viscous_s": r.uniform(0.03, 0.3)},
}  # fmt: skip
"""Nothing that the catalogue has; sizes for the 400 W machine."""


IN_THE_LIBRARY: dict[str, tuple[str, ...]] = {"drifting_sensor": ("current_offset_drift",)}
"""Foreign effects that the library has by now: they are foreign where it is taken out."""
