"""The columns of a capture file, and their arrays in a `Capture`."""

from __future__ import annotations

from typing import Any

import numpy as np

from protocols import Capture, RealArray

VOLTAGE = ("v_alpha", "v_beta")
CURRENT = ("i_alpha", "i_beta")
BUS = "v_dc"
PHASE_CURRENT = ("i_a", "i_b", "i_c")
TEMPERATURE = "temperature_c"
THETA = "theta_rad"

REQUIRED = (*VOLTAGE, *CURRENT, BUS)


def columns_of(capture: Capture) -> dict[str, RealArray]:
    """Views of a capture's columns by name, in the order of the file; nothing is copied."""
    columns: dict[str, RealArray] = {}
    columns.update(zip(VOLTAGE, capture.v_ab.T, strict=True))
    columns.update(zip(CURRENT, capture.i_ab.T, strict=True))
    columns[BUS] = capture.v_dc
    if capture.i_abc is not None:
        columns.update(zip(PHASE_CURRENT, capture.i_abc.T, strict=True))
    if capture.temperature_c is not None:
        columns[TEMPERATURE] = capture.temperature_c
    if capture.theta_rad is not None:
        columns[THETA] = capture.theta_rad
    return columns


def first_non_finite(column: np.ndarray[Any, Any]) -> int | None:
    """Index of the first NaN or infinity, None where all samples are finite."""
    finite = np.isfinite(column)
    return None if finite.all() else int(np.argmin(finite))
