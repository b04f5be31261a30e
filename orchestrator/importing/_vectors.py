"""Convert columns into stator-frame vectors in SI, as amplitude-invariant peak values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from orchestrator.importing._signals import (
    DUTIES,
    Angle,
    BusVoltage,
    CurrentSignal,
    Numbering,
    PhaseCurrents,
    Scaling,
    Temperature,
    VoltageSignal,
)
from orchestrator.importing._source import Numbers
from orchestrator.importing._units import FACTORS, ZERO_CELSIUS_K
from orchestrator.numerics.frames import from_phases, to_ab

Columns = Mapping[str, Numbers]

TO_PEAK: Mapping[Scaling, float] = MappingProxyType(
    {"amplitude_invariant": 1.0, "power_invariant": math.sqrt(2.0 / 3.0), "rms": math.sqrt(2.0)}
)
"""Factor from each scaling to amplitude-invariant vectors."""


def _legs(*order: int) -> Numbers:
    return np.array([[order[state] >> 2 & 1, order[state] >> 1 & 1, order[state] & 1] for state in range(8)], float)


LEGS: Mapping[Numbering, Numbers] = MappingProxyType(
    {
        "sectors": _legs(0b000, 0b100, 0b110, 0b010, 0b011, 0b001, 0b101, 0b111),
        "bits_abc": _legs(*range(8)),
        "bits_cba": _legs(*range(8))[:, ::-1],
    }
)
"""The legs a, b, c (1: at the bus) of each switching state, shape (8, 3)."""


def vectors(
    signal: CurrentSignal | VoltageSignal,
    columns: Columns,
    rotor_angle_rad: float | Numbers,
    pole_pairs: int,
    dc_v: Numbers,
) -> Numbers:
    """A signal as vectors (alpha, beta), shape (n, 2).

    Parameters
    ----------
    rotor_angle_rad : float, or array of shape (n,)
        Angle for a dq signal that names no own angle column.
    pole_pairs : int
        Pole pairs of the motor, for mechanical angles.
    dc_v : array, shape (n,)
        The bus voltage [V], for voltages in duty.
    """
    x = _stator_vectors(signal, columns, rotor_angle_rad, pole_pairs)
    return x * dc_v[:, None] if signal.unit in DUTIES else x


def _stator_vectors(
    signal: CurrentSignal | VoltageSignal, columns: Columns, rotor_angle_rad: float | Numbers, pole_pairs: int
) -> Numbers:
    if signal.frame == "abc":
        return from_phases(phases(signal, columns))
    if isinstance(signal, VoltageSignal) and signal.numbering is not None:
        return from_phases(LEGS[signal.numbering][columns[signal.columns["state"]].astype(np.intp)])
    known = _in_unit(signal, columns)
    if signal.frame == "line_to_line":
        ab, bc, ca = _three(known, ("ab", "bc", "ca"))
        return from_phases(np.column_stack([ab - ca, bc - ab, ca - bc]) / 3.0)
    axes = ("alpha", "beta") if signal.frame == "alpha_beta" else ("d", "q")
    nothing = np.zeros_like(next(iter(known.values())))
    x = np.column_stack([known.get(axis, nothing) for axis in axes])
    if signal.frame == "alpha_beta":
        return x
    return to_ab(x, rotor_angle_rad if signal.angle is None else angle_rad(signal.angle, columns, pole_pairs))


def wrong_state(voltage: VoltageSignal, columns: Columns) -> int | None:
    """The first row whose switching state is not a whole number from 0 to 7."""
    if voltage.frame != "switching":
        return None
    states = columns[voltage.columns["state"]]
    wrong = (states != np.floor(states)) | (states < 0) | (states > 7)
    return int(np.argmax(wrong)) if wrong.any() else None


def phases(signal: CurrentSignal | VoltageSignal | PhaseCurrents, columns: Columns) -> Numbers:
    """Phase quantities (a, b, c), shape (n, 3); with two columns, the third makes the sum zero."""
    if isinstance(signal, PhaseCurrents):
        known: dict[str, Numbers] = {a: _from_raw(signal, columns[n], signal.unit) for a, n in signal.columns.items()}
        return np.column_stack(_three(known, ("a", "b", "c")))
    return np.column_stack(_three(_in_unit(signal, columns), ("a", "b", "c")))


def _in_unit(signal: CurrentSignal | VoltageSignal, columns: Columns) -> dict[str, Numbers]:
    """The columns by axis, in SI."""
    scale = FACTORS[signal.unit] * TO_PEAK[signal.scaling or "amplitude_invariant"]
    return {
        axis: (columns[name] - signal.offset_of(axis)) * (signal.factor_of(axis) * scale)
        for axis, name in signal.columns.items()
    }


def _three(known: Mapping[str, Numbers], axes: tuple[str, str, str]) -> list[Numbers]:
    """Three quantities; a missing third makes the sum zero."""
    closing = -np.sum(list(known.values()), axis=0)
    return [known.get(axis, closing) for axis in axes]


def _from_raw(raw: Angle | BusVoltage | PhaseCurrents | Temperature, values: Numbers, unit: str) -> Numbers:
    return (values - raw.offset) * (raw.factor * FACTORS[unit])


def angle_rad(angle: Angle, columns: Columns, pole_pairs: int) -> float | Numbers:
    """An electrical angle in radians: a number, or shape (n,)."""
    turns = pole_pairs if angle.mechanical else 1
    if angle.value is not None:
        return (angle.value - angle.offset) * angle.factor * FACTORS[angle.unit] * turns
    assert angle.column is not None  # an angle has either
    return _from_raw(angle, columns[angle.column], angle.unit) * turns


def bus_v(bus: BusVoltage, columns: Columns) -> Numbers:
    """The bus voltage [V], shape (n,)."""
    return _from_raw(bus, columns[bus.column], bus.unit)


def temperature_c(temperature: Temperature, columns: Columns) -> Numbers:
    """The temperature [degrees Celsius], shape (n,)."""
    values = _from_raw(temperature, columns[temperature.column], temperature.unit)
    return values - ZERO_CELSIUS_K if temperature.unit == "K" else values
