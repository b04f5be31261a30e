"""Columns into stator-frame vectors, amplitude-invariant peak values, SI; nothing is judged here."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from orchestrator.importing._mapping import (
    Angle,
    BusVoltage,
    CurrentSignal,
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
"""What vectors of each scaling are multiplied by to have the length of the phases' peak."""


def vectors(signal: CurrentSignal | VoltageSignal, columns: Columns, rotor_angle_rad: float | Numbers) -> Numbers:
    """A signal as vectors (alpha, beta), shape (n, 2).

    Parameters
    ----------
    rotor_angle_rad : float, or array of shape (n,)
        Taken where a signal in the dq frame names no angle of its own.
    """
    scale = signal.factor * FACTORS[signal.unit] * TO_PEAK[signal.scaling or "amplitude_invariant"]
    if signal.frame == "abc":
        return from_phases(phases(signal, columns))
    axes = ("alpha", "beta") if signal.frame == "alpha_beta" else ("d", "q")
    # The frame says which axes there are; mypy does not follow it into the keys.
    x = scale * np.column_stack([columns[signal.columns[axis]] for axis in axes])  # type: ignore[index]
    if signal.frame == "alpha_beta":
        return x
    return to_ab(x, rotor_angle_rad if signal.angle is None else angle_rad(signal.angle, columns))


def phases(signal: CurrentSignal | VoltageSignal | PhaseCurrents, columns: Columns) -> Numbers:
    """Phase quantities (a, b, c), shape (n, 3); the third of two is what brings their sum to zero."""
    scaling = None if isinstance(signal, PhaseCurrents) else signal.scaling
    scale = signal.factor * FACTORS[signal.unit] * TO_PEAK[scaling or "amplitude_invariant"]
    known: dict[str, Numbers] = {axis: scale * columns[column] for axis, column in signal.columns.items()}
    for third in {"a", "b", "c"} - known.keys():
        known[third] = -np.sum(list(known.values()), axis=0)
    return np.column_stack([known[axis] for axis in ("a", "b", "c")])


def angle_rad(angle: Angle, columns: Columns) -> float | Numbers:
    """An angle in radians: a number, or shape (n,)."""
    if angle.value is not None:
        return angle.value * FACTORS[angle.unit]
    assert angle.column is not None  # an angle has either
    return columns[angle.column] * FACTORS[angle.unit]


def bus_v(bus: BusVoltage, columns: Columns) -> Numbers:
    """The bus voltage [V], shape (n,)."""
    return columns[bus.column] * (bus.factor * FACTORS[bus.unit])


def temperature_c(temperature: Temperature, columns: Columns) -> Numbers:
    """The temperature [degrees Celsius], shape (n,)."""
    values = columns[temperature.column]
    return values - ZERO_CELSIUS_K if temperature.unit == "K" else values
