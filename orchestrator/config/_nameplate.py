"""Consistency of a nameplate: relations between its values, and its likelihood.

With p pole pairs, omega = 2 pi f, I and V the rated current and phase voltage (peak) of a star:
n = 60 f / p, P = 2 pi n T / 60 = 3/2 V I times power factor and efficiency,
T = 3/2 p (psi i_q + (L_d - L_q) i_d i_q) at most over all angles of I, and omega psi, R I and omega L I
add up to V. Bounds are wide where motors differ.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from protocols import Motor

Values = Mapping[str, float]

VALUE_STD = 0.14
"""Standard deviation of the logarithm of a value on a nameplate: tolerances, temperature, a rating with a margin."""
_NOT_EXACT = {
    *("rated_voltage_rms_v", "rated_current_rms_a", "rated_power_w", "stator_resistance_ohm"),
    *("d_inductance_h", "q_inductance_h", "pm_flux_wb"),
}
"""Fields with a tolerance. Speed, frequency and torque follow from other ratings: a deviation is a contradiction."""


@dataclass(frozen=True)
class Ratio:
    """Distribution of a relation's left side over its right side, over motors.

    Attributes
    ----------
    low, high : float
        Range over motors.
    usual : float
        Typical ratio.
    spread : float
        Standard deviation of its natural logarithm for exact values; infinite: not used in the likelihood.
    steeper_below : float
        Spread above the usual ratio over that below it.
    """

    low: float
    high: float
    usual: float
    spread: float
    steeper_below: float = 1.0


@dataclass(frozen=True)
class Relation:
    """One equation between numbers of a nameplate.

    Attributes
    ----------
    words : str
        Text of the left side; field names in braces are filled in.
    given : tuple of str
        Required fields.
    computed : callable
        Left side from the values.
    unit : str
    reference : callable
        Right side from the values.
    reference_words : str
        Text of the right side.
    ratio : Ratio
    """

    words: str
    given: tuple[str, ...]
    computed: Callable[[Values], float]
    unit: str
    reference: Callable[[Values], float]
    reference_words: str
    ratio: Ratio

    def holds(self, values: Values) -> bool:
        """Whether the ratio is within the range; True where a value is missing."""
        return not self._applies(values) or self.ratio.low <= self._value(values) <= self.ratio.high

    def counts(self, values: Values) -> bool:
        """Whether it is used in the likelihood and all its values are known."""
        return math.isfinite(self.ratio.spread) and self._applies(values)

    def off_usual(self, values: Values) -> float:
        """Natural logarithm of its ratio over the usual one, scaled below that to the same spread."""
        off = math.log(max(self._value(values), 1e-12) / self.ratio.usual)
        return off if off > 0.0 else self.ratio.steeper_below * off

    def describe(self, values: Values, derived: Collection[str] = ()) -> str:
        """Text with the numbers of both sides; fields `derived` from others are marked."""
        stated = self.reference_words
        for name in derived:
            stated = stated.replace(f"{name} is ", f"{name} from the others is ")
        written = {name: f"{value:.4g}" for name, value in values.items()}
        left, right = (text.format_map(written) for text in (self.words, stated))
        return f"{left} = {self.computed(values):.4g}{self.unit and ' ' + self.unit}, and {right}"

    def _applies(self, values: Values) -> bool:
        return all(name in values for name in self.given)

    def _value(self, values: Values) -> float:
        return self.computed(values) / self.reference(values)


def _omega(values: Values) -> float:
    return 2.0 * math.pi * values["rated_frequency_hz"]


def _peak_a(values: Values) -> float:
    return math.sqrt(2.0) * values["rated_current_rms_a"]


def _phase_peak_v(values: Values) -> float:
    return math.sqrt(2.0 / 3.0) * values["rated_voltage_rms_v"]


def _best_current(values: Values) -> tuple[float, float]:
    """i_d and i_q of the rated current at maximum torque [A]."""
    # With D = L_d - L_q the derivative of (psi + D i_d) i_q along the circle vanishes where 2 D i_d^2 + psi i_d = D
    # I^2.
    peak_a, psi = _peak_a(values), values["pm_flux_wb"]
    l_d, l_q = _inductances(values)
    reluctance = (l_d - l_q) * peak_a
    cosine = 2.0 * reluctance / (psi + math.sqrt(psi**2 + 8.0 * reluctance**2))
    return peak_a * cosine, peak_a * math.sqrt(1.0 - cosine**2)


def largest_torque_nm(values: Values) -> float:
    """Maximum torque over all angles of the rated current [Nm]."""
    i_d, i_q = _best_current(values)
    l_d, l_q = _inductances(values)
    return 1.5 * values["pole_pairs"] * (values["pm_flux_wb"] + (l_d - l_q) * i_d) * i_q


def _inductances(values: Values) -> tuple[float, float]:
    l_d = values.get("d_inductance_h", values.get("q_inductance_h", 0.0))
    return l_d, values.get("q_inductance_h", l_d)


def _required_voltage(values: Values) -> float:
    """Phase voltage (peak) for the rated current at maximum torque and rated frequency [V]."""
    d, q = _best_current(values)
    (l_d, l_q), omega = _inductances(values), _omega(values)
    r_s = values["stator_resistance_ohm"]
    return math.hypot(r_s * d - omega * l_q * q, r_s * q + omega * (l_d * d + values["pm_flux_wb"]))


def _usual_copper_loss(values: Values) -> float:
    """Typical copper loss at the rated point [W]: 20 % of 100 W, a smaller share of larger powers."""
    power = values["rated_power_w"]
    return 0.2 * power * float((power / 100.0) ** -0.3)


def _voltage_share(words: str, given: tuple[str, ...], computed: Callable[[Values], float], ratio: Ratio) -> Relation:
    stated = "rated_voltage_rms_v is {rated_voltage_rms_v}, {phase_peak_v} V peak in a phase"
    fields = (*given, "rated_voltage_rms_v")
    return Relation(words, fields, computed, "V", _phase_peak_v, stated, ratio)


def _reactance_drop(axis: str, ratio: Ratio) -> Relation:
    field = f"{axis}_inductance_h"
    return _voltage_share(
        f"2 pi f {{{field}}} H x the peak current",
        ("rated_frequency_hz", field, "rated_current_rms_a"),
        lambda v: _omega(v) * v[field] * _peak_a(v),
        ratio,
    )


RELATIONS = (
    Relation(
        "60 x {rated_frequency_hz} Hz / {pole_pairs} pole pairs",
        ("rated_frequency_hz", "pole_pairs", "rated_speed_rpm"),
        lambda v: 60.0 * v["rated_frequency_hz"] / v["pole_pairs"],
        "rpm",
        lambda v: v["rated_speed_rpm"],
        "rated_speed_rpm is {rated_speed_rpm}",
        Ratio(0.95, 1.05, usual=1.0, spread=0.015),
    ),
    Relation(
        "{rated_torque_nm} Nm x 2 pi {rated_speed_rpm} rpm / 60",
        ("rated_torque_nm", "rated_speed_rpm", "rated_power_w"),
        lambda v: v["rated_torque_nm"] * 2.0 * math.pi * v["rated_speed_rpm"] / 60.0,
        "W",
        lambda v: v["rated_power_w"],
        "rated_power_w is {rated_power_w}",
        Ratio(0.8, 1.25, usual=1.0, spread=0.06),
    ),
    Relation(
        "the largest torque of {pole_pairs} pole pairs, {pm_flux_wb} Wb and {rated_current_rms_a} A rms",
        ("pole_pairs", "pm_flux_wb", "rated_current_rms_a", "rated_torque_nm"),
        largest_torque_nm,
        "Nm",
        lambda v: v["rated_torque_nm"],
        "rated_torque_nm is {rated_torque_nm}",
        Ratio(0.8, 1.9, usual=1.1, spread=0.12),
    ),
    Relation(
        "{rated_power_w} W over sqrt 3 x {rated_voltage_rms_v} V x {rated_current_rms_a} A",
        ("rated_power_w", "rated_voltage_rms_v", "rated_current_rms_a"),
        lambda v: v["rated_power_w"] / (1.5 * _phase_peak_v(v) * _peak_a(v)),
        "",
        lambda _: 1.0,
        "power factor times efficiency are 0.35 to 1",
        Ratio(0.35, 1.2, usual=0.7, spread=0.2),
    ),
    _voltage_share(
        "2 pi {rated_frequency_hz} Hz x {pm_flux_wb} Wb",
        ("rated_frequency_hz", "pm_flux_wb"),
        lambda v: _omega(v) * v["pm_flux_wb"],
        Ratio(0.15, 1.3, usual=0.65, spread=0.8),
    ),
    _voltage_share(
        "the voltage of {pm_flux_wb} Wb, R_s and L with {rated_current_rms_a} A rms at {rated_frequency_hz} Hz",
        ("rated_frequency_hz", "pm_flux_wb", "rated_current_rms_a", "stator_resistance_ohm", "pole_pairs"),
        _required_voltage,
        Ratio(0.3, 2.0, usual=0.9, spread=0.17),
    ),
    _voltage_share(
        "{stator_resistance_ohm} ohm x {rated_current_rms_a} A rms x 1.414",
        ("stator_resistance_ohm", "rated_current_rms_a"),
        lambda v: v["stator_resistance_ohm"] * _peak_a(v),
        Ratio(0.001, 0.6, usual=0.06, spread=1.2),
    ),
    Relation(
        "copper loss 3 x {stator_resistance_ohm} ohm x ({rated_current_rms_a} A rms)^2",
        ("stator_resistance_ohm", "rated_current_rms_a", "rated_power_w"),
        lambda v: 1.5 * v["stator_resistance_ohm"] * _peak_a(v) ** 2,
        "W",
        _usual_copper_loss,
        "motors of {rated_power_w} W lose {usual_copper_loss_w} W or so",
        Ratio(0.05, 5.0, usual=0.8, spread=0.7),
    ),
    _reactance_drop("d", Ratio(0.005, 5.0, usual=0.25, spread=1.5)),
    # Without a spread: q correlates with d, and the next relation models their ratio.
    _reactance_drop("q", Ratio(0.005, 5.0, usual=0.35, spread=math.inf)),
    Relation(
        "q_inductance_h / d_inductance_h = {q_inductance_h} H / {d_inductance_h} H",
        ("d_inductance_h", "q_inductance_h", "pm_flux_wb"),
        lambda v: v["q_inductance_h"] / v["d_inductance_h"],
        "",
        lambda _: 1.0,
        "across the magnet (q) it is 0.85 to 8 times that along it (d)",
        Ratio(0.85, 8.0, usual=1.2, spread=0.8, steeper_below=5.0),
    ),
    Relation(
        "L / R = {d_inductance_h} H / {stator_resistance_ohm} ohm",
        ("d_inductance_h", "stator_resistance_ohm"),
        lambda v: v["d_inductance_h"] / v["stator_resistance_ohm"],
        "s",
        lambda _: 1.0,
        "windings have 10 us to 0.5 s",
        Ratio(1e-5, 0.5, usual=3e-3, spread=1.8),
    ),
)


def stated_values(motor: Motor) -> dict[str, float]:
    """The nameplate's positive numbers, by field."""
    return {
        name: float(value)
        for name, value in motor.model_dump().items()
        if isinstance(value, int | float) and not isinstance(value, bool) and value > 0
    }


def completed(values: Values) -> dict[str, float]:
    """The values, completed by those that follow from others."""
    full = dict(values)
    if {"rated_speed_rpm", "pole_pairs"} <= full.keys():
        full.setdefault("rated_frequency_hz", full["rated_speed_rpm"] * full["pole_pairs"] / 60.0)
    if {"rated_frequency_hz", "pole_pairs"} <= full.keys():
        full.setdefault("rated_speed_rpm", 60.0 * full["rated_frequency_hz"] / full["pole_pairs"])
    radians_per_s = 2.0 * math.pi * full.get("rated_speed_rpm", 0.0) / 60.0
    if radians_per_s and "rated_torque_nm" in full:
        full.setdefault("rated_power_w", full["rated_torque_nm"] * radians_per_s)
    if radians_per_s and "rated_power_w" in full:
        full.setdefault("rated_torque_nm", full["rated_power_w"] / radians_per_s)
    if "rated_power_w" in full:
        full["usual_copper_loss_w"] = _usual_copper_loss(full)
    if "rated_voltage_rms_v" in full:
        full["phase_peak_v"] = _phase_peak_v(full)
    return full


def broken_relations(values: Values) -> list[str]:
    """Texts of the relations that do not hold, each with the numbers of both sides."""
    full = completed(values)
    return [relation.describe(full, full.keys() - values.keys()) for relation in RELATIONS if not relation.holds(full)]


def mismatch(values: Values) -> float:
    """Twice the negative logarithm of the likelihood of a nameplate, up to a constant.

    The relations' logarithms x are normal about their usual values. Their covariance is the spread of motors plus the
    error of each value: C = diag(s^2) + t^2 J J', J = dx / d ln(value). So one generously rated voltage, which moves
    all relations that contain it, does not count as five contradictions.

        x' C^-1 x + ln det C
    """
    full = completed(values)
    used = [relation for relation in RELATIONS if relation.counts(full)]
    if not used:
        return 0.0
    x = np.array([relation.off_usual(full) for relation in used])
    step, slopes = 0.01, []
    for name in _NOT_EXACT & values.keys():
        shifted = completed({**values, name: values[name] * math.exp(step)})
        slopes.append((np.array([relation.off_usual(shifted) for relation in used]) - x) / step)
    jacobian = np.array(slopes).reshape(len(slopes), len(used))
    covariance = np.diag([relation.ratio.spread**2 for relation in used]) + VALUE_STD**2 * jacobian.T @ jacobian
    return float(x @ np.linalg.solve(covariance, x) + np.linalg.slogdet(covariance)[1])


def is_judged(values: Values, name: str) -> bool:
    """Whether a relation whose ratio varies by less than a factor e compares this value with others."""
    full = completed(values)
    return any(name in one.given and one.counts(full) and one.ratio.spread < 1.0 for one in RELATIONS)


def contradictions(motor: Motor) -> Iterator[str]:
    """Each violated relation, as a sentence."""
    for relation in broken_relations(stated_values(motor)):
        yield f"motor: {relation}: these values contradict each other"
