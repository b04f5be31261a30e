"""The functions of the C code in int32 with numbers of SI, as `Functions` has those in float."""

from __future__ import annotations

import ctypes
import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tests.orchestrator.tuning.functions import Functions, Words

Integers = NDArray[np.int32]

MICRO, NANO, MILLI = 1e-6, 1e-9, 1e-3
TURN32 = 2.0 * math.pi / 2.0**32
RAW = 0.0
"""Of an array that is no vector: its words are passed on as they are."""
SIGNATURES: dict[str, tuple[str, tuple[float, ...], float]] = {
    "psi_wb": ("psi_nwb", (MICRO, MICRO, NANO), RAW),
    "inductance_h": ("inductance_nh", (MICRO, MICRO, NANO), RAW),
    "r_s_ohm": ("r_s_uohm", (MILLI,), MICRO),
    "torque_limit_nm": ("torque_limit_unm", (MILLI, MICRO, MICRO), MICRO),
    "current_reference_a": ("current_reference_ua", (MICRO, MILLI, MICRO, MICRO, MICRO), RAW),
    "current_control_init": ("current_control_int32_init", (RAW,), RAW),
    "current_control_v": ("current_control_uv", (RAW, MICRO, MICRO, MILLI, MICRO, MICRO, MICRO), RAW),
    "leg_voltage_v": ("leg_voltage_uv", (MICRO, MICRO), MICRO),
    "corrected_current_a": ("corrected_current_ua", (MICRO, MICRO), RAW),
    "add_bias_v": ("add_bias_uv", (MICRO,), RAW),
    "torque_reference_nm": ("torque_reference_unm", (MICRO, MILLI, MICRO), MICRO),
    "angle_rad": ("angle_turn32", (TURN32, MILLI), TURN32),
    "angle_ahead_rad": ("angle_ahead_turn32", (TURN32, MILLI), TURN32),
}
"""Of each function: its name, the units of its arguments and that of its result."""


class Machine(Protocol):
    """Something that executes the functions."""

    def call_int32(self, name: str, *arguments: int | Integers) -> int:
        """The 32 bits that a function returns."""


class HostInt32:
    """A library of this machine."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library

    def call_int32(self, name: str, *arguments: int | Integers) -> int:
        function = getattr(self._library, f"motor_{name}")
        function.restype = ctypes.c_int32
        result: int = function(
            *(ctypes.c_void_p(a.ctypes.data) if isinstance(a, np.ndarray) else ctypes.c_int32(a) for a in arguments)
        )
        return result


class Int32Functions(Functions):
    """The functions with numbers of SI; what is not finite becomes zero."""

    def __init__(self, machine: Machine) -> None:
        self._machine = machine

    def call(self, name: str, *arguments: float | Words) -> int | float:
        symbol, units, result_unit = SIGNATURES[name]
        arrays: dict[int, Integers] = {}
        passed: list[int | Integers] = []
        for argument, unit in zip(arguments, units, strict=True):
            if not isinstance(argument, np.ndarray):
                passed.append(_integer(argument, unit))
            elif unit == RAW:
                passed.append(argument.view(np.int32))
            else:
                integers = np.array([_integer(float(x), unit) for x in argument], dtype=np.int32)
                passed.append(arrays.setdefault(id(argument), integers))
        result = self._machine.call_int32(symbol, *passed)
        for argument, unit in zip(arguments, units, strict=True):
            if isinstance(argument, np.ndarray) and unit != RAW:
                argument[:] = arrays[id(argument)] * unit
        if result_unit == RAW:
            return result
        return (result % 2**32 if result_unit == TURN32 else result) * result_unit


def _integer(value: float, unit: float) -> int:
    if not math.isfinite(value):
        return 0
    if unit == TURN32:
        return (round(value / unit) + 2**31) % 2**32 - 2**31
    return round(min(max(value / unit, -(2.0**31) + 1.0), 2.0**31 - 1.0))
