"""The functions of the C code with numbers and arrays of Python, whatever they are compiled for."""

from __future__ import annotations

import ctypes
import math
from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from orchestrator.numerics.types import Array

Words = NDArray[np.float32]
"""An array of the C code; a struct is one, too."""

RESULT_IS_FLOAT = ("r_s_ohm", "torque_reference_nm", "torque_limit_nm", "leg_voltage_v", "angle_rad", "angle_ahead_rad")
STATE_WORDS = 7
"""Of motor_current_control: lost_v, given_v and psi_expected_wb, two each, and samples, an integer."""


class Functions(ABC):
    """The functions of the symbol `motor`."""

    @abstractmethod
    def call(self, name: str, *arguments: float | Words) -> int | float:
        """Call with arguments in their order; arrays are changed in place."""

    def number(self, name: str, *values: float | Words) -> float:
        return float(self.call(name, *values))

    def vector(self, name: str, size: int, *values: float) -> tuple[int, Array]:
        out = words(size)
        report = self.call(name, *values, out)
        return int(report), out.astype(np.float64)

    def state(self) -> Words:
        """A state of the current control: lost_v, given_v and psi_expected_wb are its first six words."""
        state = words(STATE_WORDS)
        self.call("current_control_init", state)
        return state

    def control(
        self,
        state: Words,
        i_ref: Sequence[float] | Array | Words,
        i: Sequence[float] | Array,
        omega: float,
        v_dc: float,
        r_s: float = math.nan,
    ) -> tuple[int, Array]:
        """Voltage [V]; by default with the resistance of the tables, which takes the place of an invalid one."""
        out = words(2)
        pair = (np.array(x, dtype=np.float32) for x in (i_ref, i))
        report = self.call("current_control_v", state, *pair, omega, v_dc, r_s, out)
        return int(report), out.astype(np.float64)


class HostFunctions(Functions):
    """Those of a library of this machine."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._library = library

    def call(self, name: str, *arguments: float | Words) -> int | float:
        function = getattr(self._library, f"motor_{name}")
        function.restype = ctypes.c_float if name in RESULT_IS_FLOAT else ctypes.c_int
        result: int | float = function(
            *(ctypes.c_void_p(a.ctypes.data) if isinstance(a, np.ndarray) else ctypes.c_float(a) for a in arguments)
        )
        return result


def words(size: int) -> Words:
    return np.zeros(size, dtype=np.float32)
