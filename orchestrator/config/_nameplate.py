"""A nameplate held against itself: which of its numbers contradict each other, and which slip would explain that.

With p pole pairs, omega = 2 pi f, I and V the rated current and phase voltage (peak) of a star:
n = 60 f / p, P = 2 pi n T / 60, T = 3/2 p (psi i_q + (L_d - L_q) i_d i_q) at most over all angles of I,
and omega psi, R I and omega L I are what a motor leaves of V. Bounds are wide where motors differ.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from protocols import Motor

Values = Mapping[str, float]


@dataclass(frozen=True)
class Relation:
    """One equation between numbers of a nameplate.

    Attributes
    ----------
    words : str
        How it is written; fields in braces are put in.
    given : tuple of str
        The fields that it needs.
    computed : callable
        Its left side, of the values.
    beside : str or None
        The field that it should be; None: the rated phase voltage, peak.
    unit : str
    low, high : float
        Of the left side over the right one, as far as motors go.
    """

    words: str
    given: tuple[str, ...]
    computed: Callable[[Values], float]
    beside: str | None
    unit: str
    low: float
    high: float

    def holds(self, values: Values) -> bool:
        """Also where a value is missing."""
        if any(name not in values for name in (*self.given, self._stated)):
            return True
        return self.low <= self.computed(values) / self._right(values) <= self.high

    def said(self, values: Values) -> str:
        """The numbers of both sides."""
        left = self.words.format_map({name: f"{value:.4g}" for name, value in values.items()})
        right = f"{self._stated} is {values[self._stated]:.4g}"
        if self.beside is None:
            right = f"{right}, {self._right(values):.4g} V peak in a phase"
        return f"{left} = {self.computed(values):.4g} {self.unit}, and {right}"

    @property
    def _stated(self) -> str:
        return self.beside or "rated_voltage_rms_v"

    def _right(self, values: Values) -> float:
        return values[self._stated] * (1.0 if self.beside else math.sqrt(2.0 / 3.0))


@dataclass(frozen=True)
class Slip:
    """A number written in another way than its field has it."""

    fields: tuple[str, ...]
    factor: float
    """By which the right number is the written one."""
    words: str


def _omega(values: Values) -> float:
    return 2.0 * math.pi * values["rated_frequency_hz"]


def _peak_a(values: Values) -> float:
    return math.sqrt(2.0) * values["rated_current_rms_a"]


def _largest_torque(values: Values) -> float:
    angle = np.linspace(0.0, math.pi, 181)
    i_d, i_q = _peak_a(values) * np.cos(angle), _peak_a(values) * np.sin(angle)
    salient = values.get("d_inductance_h", 0.0) - values.get("q_inductance_h", values.get("d_inductance_h", 0.0))
    return float(np.max(1.5 * values["pole_pairs"] * (values["pm_flux_wb"] + salient * i_d) * i_q))


def _reactance_drop(axis: str) -> Relation:
    field = f"{axis}_inductance_h"
    return Relation(
        f"2 pi f {{{field}}} H x the peak current",
        ("rated_frequency_hz", field, "rated_current_rms_a"),
        lambda v: _omega(v) * v[field] * _peak_a(v),
        None,
        "V",
        0.005,
        5.0,
    )


RELATIONS = (
    Relation(
        "60 x {rated_frequency_hz} Hz / {pole_pairs} pole pairs",
        ("rated_frequency_hz", "pole_pairs"),
        lambda v: 60.0 * v["rated_frequency_hz"] / v["pole_pairs"],
        "rated_speed_rpm",
        "rpm",
        0.95,
        1.05,
    ),
    Relation(
        "{rated_torque_nm} Nm x 2 pi {rated_speed_rpm} rpm / 60",
        ("rated_torque_nm", "rated_speed_rpm"),
        lambda v: v["rated_torque_nm"] * 2.0 * math.pi * v["rated_speed_rpm"] / 60.0,
        "rated_power_w",
        "W",
        0.8,
        1.25,
    ),
    Relation(
        "the largest torque of {pole_pairs} pole pairs, {pm_flux_wb} Wb and {rated_current_rms_a} A rms",
        ("pole_pairs", "pm_flux_wb", "rated_current_rms_a"),
        _largest_torque,
        "rated_torque_nm",
        "Nm",
        0.8,
        1.9,
    ),
    Relation(
        "2 pi {rated_frequency_hz} Hz x {pm_flux_wb} Wb",
        ("rated_frequency_hz", "pm_flux_wb"),
        lambda v: _omega(v) * v["pm_flux_wb"],
        None,
        "V",
        0.15,
        1.3,
    ),
    Relation(
        "{stator_resistance_ohm} ohm x {rated_current_rms_a} A rms x 1.414",
        ("stator_resistance_ohm", "rated_current_rms_a"),
        lambda v: v["stator_resistance_ohm"] * _peak_a(v),
        None,
        "V",
        0.001,
        0.6,
    ),
    _reactance_drop("d"),
    _reactance_drop("q"),
)
INDUCTANCES = ("d_inductance_h", "q_inductance_h")
SLIPS = (
    *(Slip(fields, 1e-3, "in mH") for fields in (INDUCTANCES, *((name,) for name in INDUCTANCES))),
    Slip(INDUCTANCES, 1e-6, "in uH"),
    Slip(("pm_flux_wb",), 1e-3, "in mWb"),
    Slip(("stator_resistance_ohm",), 1e-3, "in milliohm"),
    Slip(("rated_power_w",), 1e3, "in kW"),
    Slip(("rated_speed_rpm",), 30.0 / math.pi, "in rad/s"),
    Slip(("pole_pairs",), 0.5, "the number of poles"),
    Slip(("rated_current_rms_a",), math.sqrt(0.5), "the peak, not the rms value"),
    Slip(("rated_current_rms_a",), 1e-3, "in mA"),
    Slip(("pm_flux_wb",), math.sqrt(2.0), "the rms, not the peak value"),
    Slip(("rated_voltage_rms_v",), math.sqrt(3.0), "from phase to star point, not from line to line"),
)
"""Likely ones first: where two explain the same, the first is named."""


def nameplate_doubts(motor: Motor) -> Iterator[str]:
    """What a nameplate says against itself, a sentence each; none where it agrees or says too little.

    Parameters
    ----------
    motor : Motor

    Yields
    ------
    str
        The fields, both numbers, and the slip of one field that would put all of it right, where there is one.
    """
    values = {name: value for name, value in motor.model_dump().items() if isinstance(value, int | float) and value > 0}
    broken = [relation for relation in RELATIONS if not relation.holds(values)]
    if not broken:
        return
    slip = _explanation(values)
    for relation in broken:
        yield f"motor: {relation.said(values)}: these do not go together"
    if slip is not None:
        fields = " and ".join(f"motor.{name}" for name in slip.fields)
        right = ", ".join(f"{values[name] * slip.factor:.4g}" for name in slip.fields)
        yield f"{fields}: {right} would fit: is what is written {slip.words}?"


def _explanation(values: Values) -> Slip | None:
    """The first slip that leaves nothing broken."""
    for slip in SLIPS:
        if all(name in values for name in slip.fields):
            mended = {**values, **{name: slip.factor * values[name] for name in slip.fields}}
            if all(relation.holds(mended) for relation in RELATIONS):
                return slip
    return None
