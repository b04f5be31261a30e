"""Table of references for an excitation: one row per sample from the start of settling to the capture's end."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from protocols import Excitation, GatesOff, Injection, Trapezoid

COLUMNS = ("time_s", "gates", "current_control", "i_d_a", "i_q_a", "v_d_v", "v_q_v", "captured")
"""Current references, and the voltage to be added to that of the current control or to its frozen mean."""

Floats = NDArray[np.float64]


def table_of(excitation: Excitation, sampling_frequency_hz: float) -> Floats:
    """The table, shape (n, 8), in the believed dq frame; see `COLUMNS`."""
    fs, settling = sampling_frequency_hz, round(excitation.settling_s * sampling_frequency_hz)
    rows = settling + excitation.rows(fs)
    table = np.zeros((rows, len(COLUMNS)))
    t = np.arange(rows) / fs
    table[:, 0], table[settling:, 7] = t, 1.0
    if isinstance(excitation, GatesOff):
        return table
    table[:, 1:3] = 1.0
    table[:, 3:5] = excitation.start_dq_a
    if isinstance(excitation, Trapezoid):
        table[settling:, 3:5] += _trapezoid(excitation, t[: rows - settling])
    if isinstance(excitation, Injection):
        begins = round(excitation.settle_s * fs)
        table[begins:, 2] = 0.0
        table[begins:, 5:7] = _injected(excitation, t[: rows - begins])
    return table


def write_table(path: Path, table: Floats) -> None:
    """Write the table as CSV with a header line."""
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=",".join(COLUMNS), comments="")


def _trapezoid(e: Trapezoid, t: Floats) -> Floats:
    wave = np.interp(t / e.period_s % 1.0, [0.0, 0.125, 0.375, 0.625, 0.875, 1.0], [0.0, 1.0, 1.0, -1.0, -1.0, 0.0])
    along = {"d": (1.0, 0.0), "q": (0.0, 1.0), "dq": (np.sqrt(0.5), np.sqrt(0.5))}[e.swept_axis]
    swept: Floats = e.amplitude_a * wave[:, None] * np.array(along)
    return swept


def _injected(e: Injection, t: Floats) -> Floats:
    # A row that is at a period's end except for rounding belongs to the next period.
    phase = np.round(e.frequency_hz * t, 9) % 1.0
    wave = np.where(phase < 0.5, 1.0, -1.0) if e.waveform == "square" else np.sin(2.0 * np.pi * phase)
    turn = 2.0 * np.pi * e.rotation_hz * t
    injected: Floats = e.amplitude_v * wave[:, None] * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    return injected
